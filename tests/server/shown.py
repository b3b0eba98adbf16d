"""A robot for the dashboard to show: pictures, numbers, a service, candidates that do not fit."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from queue import SimpleQueue
from typing import Annotated, Literal, TypedDict

from uoarm import RobotManager
from uoarm.config import loads
from uoarm.local import Octets, Range

SHOWN = """
version: 1
bridges: {python: {}, other: {plugin: python}}
functions:
  camera:
    description: pictures that a test takes
    components:
      - {name: front, bridge: python, output: {endpoint: ["tests.server.shown:camera"]}}
  faces:
    components:
      - name: strict
        bridge: other
        priority: 10
        input: {from: camera, endpoint: ["tests.server.shown:narrow"]}
        output: {endpoint: ["tests.server.shown:narrow"]}
      - name: loose
        bridge: python
        input: {from: camera, endpoint: ["tests.server.shown:count"]}
        output: {endpoint: ["tests.server.shown:count"]}
      - name: spare
        bridge: python
        priority: -1
        input: {from: camera, endpoint: ["tests.server.shown:count"]}
        output: {endpoint: ["tests.server.shown:count"]}
  hopeless:
    components:
      - name: unfit
        bridge: python
        input: {from: camera, endpoint: ["tests.server.shown:narrow"]}
        output: {endpoint: ["tests.server.shown:narrow"]}
  drive:
    description: drives to a place
    components:
      - {name: driver, bridge: python, service: {endpoint: ["tests.server.shown:drive"]}}
  echo:
    components:
      - name: echo
        bridge: python
        input: {endpoint: ["tests.server.shown:echo"]}
        output: {endpoint: ["tests.server.shown:echo"]}
"""
END = object()


class Image(TypedDict):
    width: Annotated[int, Range(0, 4096)]
    height: Annotated[int, Range(0, 4096)]
    encoding: Literal["rgb8"]
    data: Octets


class Icon(TypedDict):
    width: Annotated[int, Range(0, 16)]
    height: Annotated[int, Range(0, 4096)]
    encoding: Literal["rgb8"]
    data: Octets


class Count(TypedDict):
    count: int


class Goal(TypedDict):
    x: Annotated[float, Range(-10, 10)]
    frame: Literal["map", "odom"]
    hurry: bool
    stops: list[Count]


class Answer(TypedDict):
    text: str


class Camera:
    """The pictures that a test has the camera take."""

    def __init__(self) -> None:
        self.taken: SimpleQueue[object] = SimpleQueue()

    def take(self, colour: tuple[int, int, int]) -> None:
        """Take a picture of four by three pixels of one colour."""
        self.taken.put({"width": 4, "height": 3, "encoding": "rgb8", "data": bytes(colour) * 12})

    def put(self, item: object) -> None:
        self.taken.put(item)

    def reset(self) -> None:
        self.taken = SimpleQueue()


front = Camera()


def camera() -> Iterator[Image]:
    taken = front.taken
    while (item := taken.get()) is not END:
        if isinstance(item, Exception):
            raise item
        yield item  # type: ignore[misc] # what a test puts there


def narrow(message: Icon) -> Count:
    return {"count": message["width"]}


def count(message: Image) -> Count:
    return {"count": message["data"][0]}


def drive(message: Goal) -> Answer:
    stops = ", ".join(str(stop["count"]) for stop in message["stops"])
    hurry = "fast" if message["hurry"] else "slowly"
    return {"text": f"{hurry} to {message['x']} on {message['frame']} by {stops}"}


def echo(message: Count) -> Count:
    return message


def crowd(functions: int, candidates: int) -> str:
    """Return a configuration of many components, ten functions in a chain."""
    place = 'endpoint: ["tests.server.shown:echo"]'
    lines = ["version: 1", "bridges: {python: {}, other: {plugin: python}}", "functions:"]
    for number in range(functions):
        lines += [f"  part{number}:", "    components:"]
        for candidate in range(candidates):
            bridge = ("python", "other")[candidate % 2]
            lines.append(f"      - name: part{number}_{candidate}")
            lines.append(f"        bridge: {bridge}")
            lines.append(f"        priority: {-candidate}")
            if number % 10:
                lines.append(f"        input: {{from: part{number - 1}, {place}}}")
            lines.append(f"        output: {{{place}}}")
    return "\n".join(lines)


def manage(configuration: str) -> RobotManager:
    """Make a manager whose configuration has this folder's files."""
    return RobotManager(loads(configuration, origin=str(Path(__file__).parent / "robot.yaml")))


@contextmanager
def shown_robot() -> Iterator[RobotManager]:
    """Have the robot that is shown, with a new camera."""
    front.reset()
    with manage(SHOWN) as robot:
        yield robot
        front.put(END)
