"""Components that give back what they take, of types as ROS has them, and services."""

from __future__ import annotations

import threading
from typing import Annotated, TypedDict

from uoarm.local import Range

# ruff: noqa: E501 - a configuration with long lines
CONFIGURATION = """
version: 1
bridges: {python: {}}
functions:
  scalars: {components: [{name: scalars, bridge: python, input: &scalars {endpoint: ["echoes:scalars"], queue: {length: 10000}}, output: {endpoint: ["echoes:scalars"]}}]}
  arrays: {components: [{name: arrays, bridge: python, input: {endpoint: ["echoes:arrays"], queue: {length: 10000}}, output: {endpoint: ["echoes:arrays"]}}]}
  image: {components: [{name: image, bridge: python, input: {endpoint: ["echoes:image"], queue: {length: 100}}, output: {endpoint: ["echoes:image"]}}]}
  set: {components: [{name: set, bridge: python, service: {endpoint: ["echoes:set_"]}}]}
  measure: {components: [{name: measure, bridge: python, service: {endpoint: ["echoes:measure"]}}]}
  failing: {components: [{name: failing, bridge: python, service: {endpoint: ["echoes:failing"]}}]}
  silent: {components: [{name: silent, bridge: python, service: {endpoint: ["echoes:silent"]}}]}
"""
release = threading.Event()


class Scalars(TypedDict):
    flag: bool
    small: Annotated[int, Range(0, 255)]
    signed: Annotated[int, Range(-(2**31), 2**31 - 1)]
    wide: Annotated[int, Range(-(2**63), 2**63 - 1)]
    real: float
    text: str


Scalars.__name__ = "test_msgs/msg/Scalars"


class Point(TypedDict):
    x: float
    y: float


class Arrays(TypedDict):
    numbers: list[float]
    points: list[Point]
    texts: list[str]


class Image(TypedDict):
    width: Annotated[int, Range(0, 2**32 - 1)]
    data: bytes


class Flag(TypedDict):
    data: bool


class Words(TypedDict):
    text: str


class Outcome(TypedDict):
    success: bool
    message: str


Flag.__name__, Outcome.__name__ = "std_srvs/srv/SetBool_Request", "std_srvs/srv/SetBool_Response"


def scalars(message: Scalars) -> Scalars:
    return message


def arrays(message: Arrays) -> Arrays:
    return message


def image(message: Image) -> Image:
    return message


def set_(request: Flag) -> Outcome:
    return {"success": request["data"], "message": f"data is {request['data']}"}


def measure(request: Words) -> Point:
    return {"x": float(len(request["text"])), "y": 0.0}


def failing(request: Flag) -> Outcome:
    raise ValueError("it is broken")


def silent(request: Flag) -> Outcome:
    release.wait()
    return {"success": False, "message": ""}
