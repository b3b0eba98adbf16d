"""Components that the server's tests play on."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from queue import SimpleQueue
from typing import Annotated, TypedDict

from uoarm.local import Range

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
  slow:
    components:
      - {name: slow, bridge: python, service: {endpoint: ["tests.server.robot:slow"]}}
  broken:
    components:
      - {name: broken, bridge: python, service: {endpoint: ["tests.server.robot:broken"]}}
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


END = object()


class Script:
    """What sources emit; each test has a queue of its own."""

    def __init__(self) -> None:
        self.queue: SimpleQueue[object] = SimpleQueue()
        self.gate = threading.Event()

    def reset(self) -> None:
        self.queue = SimpleQueue()
        self.gate = threading.Event()

    def put(self, *items: object) -> None:
        for item in items:
            self.queue.put(item)

    def release(self) -> None:
        self.gate.set()
        self.queue.put(END)


script = Script()


def numbers() -> Iterator[Number]:
    queue = script.queue
    while (item := queue.get()) is not END:
        if isinstance(item, Exception):
            raise item
        yield item  # type: ignore[misc] # a lie is part of some tests


def picture() -> Iterator[Picture]:
    queue = script.queue
    while (item := queue.get()) is not END:
        yield item  # type: ignore[misc] # what a test puts there


def double(message: Number) -> Number:
    return {"value": 2 * message["value"]}


def echo(message: Narrow) -> Narrow:
    return message


def add(message: Pair) -> Number:
    return {"value": int(message["a"] + message["b"])}


def slow(message: Number) -> Number:
    script.gate.wait(30)
    return message


def broken(message: Number) -> Number:
    raise ValueError(f"cannot do {message['value']}")
