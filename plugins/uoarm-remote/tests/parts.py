"""What the robots of the tests are made of: plain Python components."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from typing import Annotated, Any, TypedDict

from uoarm.local import Range

Numbers = Annotated[int, Range(-(2**63), 2**63 - 1)]


class Pose(TypedDict):
    x: float
    y: float
    name: str


class Image(TypedDict):
    width: Annotated[int, Range(0, 2**32 - 1)]
    data: bytes


class Value(TypedDict):
    value: Numbers


class Speed(TypedDict):
    speed: float


class Stage:
    """What the tests and the components share."""

    def __init__(self) -> None:
        self.release, self.silent = threading.Event(), threading.Event()
        self.ends = {name: threading.Event() for name in ("first", "second")}
        self.taken: list[Any] = []
        self.changed = threading.Condition()

    def note(self, message: Any) -> None:
        with self.changed:
            self.taken.append(message)
            self.changed.notify_all()


stage = Stage()


def renew() -> None:
    """Begin anew, and let go of what hangs."""
    stage.release.set()
    for event in stage.ends.values():
        event.set()
    stage.__init__()  # type: ignore[misc]


def integers(message: Value) -> Value:
    return message


def text(message: str) -> str:
    return message


def pose(message: Pose) -> Pose:
    return message


def image(message: Image) -> Image:
    return message


def _until_ended(name: str) -> Iterator[Value]:
    yield {"value": 1}
    stage.ends[name].wait()
    raise RuntimeError(f"{name} was unplugged")


def first() -> Iterator[Value]:
    return _until_ended("first")


def second() -> Iterator[Value]:
    return _until_ended("second")


def double(request: Value) -> Value:
    return {"value": 2 * request["value"]}


def length(request: str) -> Value:
    return {"value": len(request)}


def failing(request: Value) -> Value:
    raise ValueError(f"{request} cannot be doubled")


def silent(request: Value) -> Value:
    """Answer when the test is over."""
    stage.silent.set()
    stage.release.wait()
    return request


def drive(command: Speed) -> None:
    stage.note(command["speed"])


def counter() -> Iterator[Value]:
    """Count as long as it is taken."""
    value = 0
    while not stage.release.wait(0.005):
        value += 1
        yield {"value": value}
