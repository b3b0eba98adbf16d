"""Components that tests play on: what they emit, when they hang and when they die."""

from __future__ import annotations

import threading
from typing import Annotated, TypedDict

from uoarm.local import Range
from uoarm.testing import Script, patience

Small = Annotated[int, Range(0, 255)]
Wide = Annotated[int, Range(-32768, 32767)]
FACE = """
version: 1
bridges: {one: {plugin: memory}, two: {plugin: memory}}
functions:
  camera: {components: [{name: eye, bridge: one, output: {endpoint: [eye]}}]}
  face:
    components:
      - {name: finder, bridge: two, input: {from: camera, endpoint: [finder]},
         output: {endpoint: [finder]}}
"""
"""A chain of two memory bridges, which a test plays on."""


class Narrow(TypedDict):
    value: Small


class Broad(TypedDict):
    value: Wide


class Renamed(TypedDict):
    amount: Small


END = Script.END
script = Script()
narrow = script.source(Narrow)
broad = script.source(Broad)
gate = threading.Event()
building = threading.Event()
built: list[str] = []
closed: list[str] = []


def reset() -> None:
    """Begin a test with nothing played and the gate shut."""
    script.reset()
    gate.clear()
    building.clear()
    built.clear()
    closed.clear()


def release() -> None:
    """Let everything that waits go on."""
    gate.set()
    script.reset()


def take_narrow(message: Narrow) -> Narrow:
    return {"value": message["value"]}


def take_broad(message: Broad) -> Broad:
    return {"value": message["value"]}


def take_renamed(message: Renamed) -> Renamed:
    return {"amount": message["amount"]}


def stuck(message: Narrow) -> Narrow:
    gate.wait(patience())
    return message


def greet(message: Narrow) -> Broad:
    return {"value": -message["value"]}


def hang(message: Narrow) -> Narrow:
    gate.wait(patience())
    return message


class Counted:
    """Says when it is built and closed."""

    def __init__(self) -> None:
        built.append("counted")

    def __call__(self, message: Narrow) -> Narrow:
        return message

    def close(self) -> None:
        closed.append("counted")


class Unbuildable:
    """Cannot be built."""

    def __init__(self) -> None:
        raise RuntimeError("no such device")

    def __call__(self, message: Narrow) -> Narrow:
        return message


class Slow:
    """Hangs while it is built."""

    def __init__(self) -> None:
        gate.wait(patience())

    def __call__(self, message: Narrow) -> Narrow:
        return message


class Exclusive:
    """Can be there once only, as a camera or a serial line is."""

    there = threading.Lock()

    def __init__(self, offset: int = 0) -> None:
        if not self.there.acquire(blocking=False):
            raise RuntimeError("the device is in use")
        self.offset = offset

    def __call__(self, message: Narrow) -> Narrow:
        return {"value": message["value"] + self.offset}

    def close(self) -> None:
        self.there.release()


class SlowlyExclusive(Exclusive):
    """Can be there once only, and with an offset hangs while it is built."""

    def __init__(self, offset: int = 0) -> None:
        super().__init__(offset)
        if offset:
            building.set()
            gate.wait(patience())
