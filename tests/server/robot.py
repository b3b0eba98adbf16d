"""Components that the server's tests play on."""

from __future__ import annotations

import threading
from collections import Counter, deque
from collections.abc import Iterator
from typing import Annotated, Any, TypedDict

from uoarm.local import Range
from uoarm.testing import patience

CONFIGURATION = """
version: 1
bridges: {python: {}}
functions:
  numbers:
    description: what a test plays
    components:
      - {name: numbers, bridge: python, output: {endpoint: ["tests.server.robot:numbers"]}}
  picture:
    components:
      - {name: picture, bridge: python, output: {endpoint: ["tests.server.robot:picture"]}}
  doubled:
    components:
      - name: doubled
        bridge: python
        input: {from: numbers, endpoint: ["tests.server.robot:double"]}
        output: {endpoint: ["tests.server.robot:double"]}
  echo:
    components:
      - name: echo
        bridge: python
        input: {endpoint: ["tests.server.robot:echo"], queue: {length: 1000}}
        output: {endpoint: ["tests.server.robot:echo"]}
  add:
    components:
      - {name: adder, bridge: python, service: {endpoint: ["tests.server.robot:add"]}}
  anything:
    components:
      - {name: anything, bridge: python, service: {endpoint: ["tests.server.robot:anything"]}}
  many:
    components:
      - {name: many, bridge: python, service: {endpoint: ["tests.server.robot:many"]}}
  parrot:
    components:
      - {name: parrot, bridge: python, service: {endpoint: ["tests.server.robot:parrot"]}}
  slow:
    components:
      - {name: slow, bridge: python, service: {endpoint: ["tests.server.robot:slow"]}}
  broken:
    components:
      - {name: broken, bridge: python, service: {endpoint: ["tests.server.robot:broken"]}}
  hang:
    components:
      - name: hang
        bridge: python
        input: {endpoint: ["tests.server.robot:hang"]}
        output: {endpoint: ["tests.server.robot:hang"]}
  missing:
    components:
      - {name: missing, bridge: python, output: {endpoint: ["tests.server.robot:nothing"]}}
"""

Small = Annotated[int, Range(0, 255)]


class Number(TypedDict):
    value: int


class Narrow(TypedDict):
    value: Small


class Picture(TypedDict):
    width: int
    data: bytes


class Pair(TypedDict):
    a: float
    b: float


class Text(TypedDict):
    text: str


class Many(TypedDict):
    values: list[float]


END = object()


class Script:
    """What sources emit. Only the newest source of a name plays: an old one that still waits in
    its thread takes nothing away from it."""

    def __init__(self) -> None:
        self.gate = threading.Event()
        self._changed = threading.Condition()
        self._items: dict[str, deque[object]] = {"numbers": deque(), "picture": deque()}
        self._newest: dict[str, object] = {}
        self.started = Counter[str]()
        self.hanging: list[None] = []

    def reset(self) -> None:
        with self._changed:
            self.gate = threading.Event()
            self._items = {name: deque() for name in self._items}
            self._newest.clear()
            self.started.clear()
            self.hanging = []
            self._changed.notify_all()

    def put(self, *items: object) -> None:
        """Play pictures and numbers, each where they belong."""
        with self._changed:
            for item in items:
                name = "picture" if isinstance(item, dict) and "width" in item else "numbers"
                self._items[name].append(item)
            self._changed.notify_all()

    def release(self) -> None:
        self.gate.set()
        self.reset()
        self.gate.set()

    def play(self, name: str) -> Iterator[object]:
        me = object()
        with self._changed:
            self._newest[name] = me
            self.started[name] += 1
            self._changed.notify_all()
        while True:
            with self._changed:
                self._changed.wait_for(lambda: self._items[name] or not self._plays(name, me))
                if not self._plays(name, me):
                    return
                item = self._items[name].popleft()
            if item is END:
                return
            if isinstance(item, Exception):
                raise item
            yield item

    def _plays(self, name: str, me: object) -> bool:
        return self._newest.get(name) is me


script = Script()


def numbers() -> Iterator[Number]:
    yield from script.play("numbers")  # type: ignore[misc] # a lie is part of some tests


def picture() -> Iterator[Picture]:
    yield from script.play("picture")  # type: ignore[misc] # what a test puts there


def double(message: Number) -> Number:
    return {"value": 2 * message["value"]}


def echo(message: Narrow) -> Narrow:
    return message


def add(message: Pair) -> Number:
    return {"value": int(message["a"] + message["b"])}


def slow(message: Number) -> Number:
    script.gate.wait(patience())
    return message


def parrot(message: Text) -> Text:
    return message


def many(message: Number) -> Many:
    return {"values": [0.5] * message["value"]}


def hang(message: Text) -> Text:
    script.hanging.append(None)
    script.gate.wait(patience())
    return message


def broken(message: Number) -> Number:
    raise ValueError(f"cannot do {message['value']}")


def anything(message: Any) -> Number:
    """Take a value of any structure."""
    del message
    return {"value": 1}
