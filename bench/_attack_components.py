"""Components behind the server that `bench.attack` attacks."""

from __future__ import annotations

import threading
from typing import Any, TypedDict

_CONFIGURATION = """
version: 1
bridges: {python: {}}
functions:
  add:
    components:
      - {name: add, bridge: python, service: {endpoint: ["bench._attack_components:add"]}}
  anything:
    components:
      - {name: anything, bridge: python, service: {endpoint: ["bench._attack_components:anything"]}}
  sleeper:
    components:
      - {name: sleeper, bridge: python, service: {endpoint: ["bench._attack_components:sleep"]}}
  hang:
    components:
      - name: hang
        bridge: python
        input: {endpoint: ["bench._attack_components:hang"]}
        output: {endpoint: ["bench._attack_components:hang"]}
  drive:
    components:
      - name: base
        bridge: python
        input: {endpoint: ["bench._attack_components:drive"], stop: {message: {speed: 0}}}
"""

_FUNCTION = """
  f%d:
    components:
      - name: c%d
        bridge: python
        input: {endpoint: ["bench._attack_components:hang"]}
        output: {endpoint: ["bench._attack_components:hang"]}
"""


def configuration(functions: int) -> str:
    """Return the robot's file, with so many functions more, `f0` and on."""
    return _CONFIGURATION + "".join(_FUNCTION % (number, number) for number in range(functions))


class Pair(TypedDict):
    a: int
    b: int


class Sum(TypedDict):
    sum: int


class Command(TypedDict):
    speed: float


class Numbers(TypedDict):
    data: list[float]


def add(pair: Pair) -> Sum:
    return {"sum": pair["a"] + pair["b"]}


def anything(message: Any) -> Sum:
    """Take a value of any structure."""
    del message
    return {"sum": 1}


def sleep(pair: Pair) -> Sum:
    threading.Event().wait()
    return {"sum": pair["a"]}


def hang(numbers: Numbers) -> Numbers:
    threading.Event().wait()
    return numbers


def drive(command: Command) -> None:
    """Take a command, or the message that stops."""
