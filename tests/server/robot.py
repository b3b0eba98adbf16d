"""Components that the server's tests play on."""

from __future__ import annotations

import asyncio
import threading
from typing import Annotated, Any, TypedDict

from uoarm.local import Range
from uoarm.testing import Script, patience

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
  quits:
    components:
      - {name: quits, bridge: python, service: {endpoint: ["tests.server.robot:quits"]}}
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


def many_functions(count: int) -> str:
    """Return the configuration of a robot whose functions f0, f1 and so on echo."""
    parts = "".join(
        f"""
  f{number}:
    components:
      - name: c{number}
        bridge: python
        input: {{endpoint: ["tests.server.robot:echo"]}}
        output: {{endpoint: ["tests.server.robot:echo"]}}"""
        for number in range(count)
    )
    return f"version: 1\nbridges: {{python: {{}}}}\nfunctions:{parts}\n"


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


END = Script.END


class Play:
    """What the sources emit, and what holds up who waits for the test."""

    def __init__(self) -> None:
        self.gate = threading.Event()
        self.numbers = Script()
        self.pictures = Script()
        self.hanging: list[None] = []

    def reset(self) -> None:
        self.gate = threading.Event()
        self.numbers.reset()
        self.pictures.reset()
        self.hanging = []

    def put(self, *items: object) -> None:
        """Play pictures and numbers, each where they belong."""
        for item in items:
            is_picture = isinstance(item, dict) and "width" in item
            (self.pictures if is_picture else self.numbers).put(item)

    def release(self) -> None:
        self.gate.set()
        self.reset()
        self.gate.set()


script = Play()
numbers = script.numbers.source(Number)
picture = script.pictures.source(Picture)


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


def quits(message: Number) -> Number:
    raise (SystemExit, asyncio.CancelledError, KeyboardInterrupt, GeneratorExit)[message["value"]]


def anything(message: Any) -> Number:
    """Take a value of any structure."""
    del message
    return {"value": 1}
