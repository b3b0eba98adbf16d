"""Components that the tests play on; what a bridge is handed is listed."""

from __future__ import annotations

import threading
from typing import Annotated, TypedDict

from uoarm.local import Range
from uoarm.testing import Script, patience

CONFIGURATION = """
version: 1
bridges: {python: {}}
functions:
  numbers:
    description: what a test plays
    components:
      - {name: numbers, bridge: python, output: {endpoint: ["components:numbers"]}}
  picture:
    components:
      - {name: picture, bridge: python, output: {endpoint: ["components:picture"]}}
  add:
    description: adds two numbers
    components:
      - {name: adder, bridge: python, service: {endpoint: ["components:add"]}}
  diary:
    approve: true
    components:
      - {name: diary, bridge: python, service: {endpoint: ["components:add"]}}
  many:
    components:
      - {name: many, bridge: python, service: {endpoint: ["components:many"]}}
  slow:
    components:
      - {name: slow, bridge: python, service: {endpoint: ["components:slow"]}}
  broken:
    components:
      - {name: broken, bridge: python, service: {endpoint: ["components:broken"]}}
  cuff:
    description: the arm cuff presses
    components:
      - name: cuff
        bridge: python
        priority: 2
        service: {endpoint: ["components:cuff"], lifetime: 30}
      - name: spare
        bridge: python
        priority: 1
        service: {endpoint: ["components:spare"], lifetime: 30}
  drive:
    description: the base
    components:
      - name: base
        bridge: python
        input:
          endpoint: ["components:drive"]
          lifetime: 1.5
          stop: {message: {speed: 0.0}}
          limits: {speed: {minimum: -1.0, maximum: 1.0}}
        output: {endpoint: ["components:drive"]}
  missing:
    components:
      - {name: missing, bridge: python, output: {endpoint: ["components:nothing"]}}
"""


class Number(TypedDict):
    value: int


class Picture(TypedDict):
    width: int
    height: int
    data: bytes


class Pair(TypedDict):
    a: Annotated[int, Range(0, 100)]
    b: int


class Pressure(TypedDict):
    pressure: Annotated[float, Range(0, 300)]


class Speed(TypedDict):
    speed: float


class Many(TypedDict):
    values: list[float]


class Count(TypedDict):
    count: Annotated[int, Range(0, 1_000_000)]


class Play:
    """What the sources emit, what came to components, and what holds up who waits."""

    def __init__(self) -> None:
        self.gate = threading.Event()
        self.numbers = Script()
        self.pictures = Script()
        self.came: list[object] = []
        self.is_loose = False

    def reset(self) -> None:
        self.gate = threading.Event()
        self.numbers.reset()
        self.pictures.reset()
        self.came.clear()
        self.is_loose = False

    def release(self) -> None:
        self.gate.set()
        self.numbers.reset()
        self.pictures.reset()


script = Play()
numbers = script.numbers.source(Number)
picture = script.pictures.source(Picture)


def add(request: Pair) -> Number:
    script.came.append(dict(request))
    return {"value": request["a"] + request["b"]}


def many(request: Count) -> Many:
    return {"values": [float(number) for number in range(request["count"])]}


def slow(request: Number) -> Number:
    script.came.append(dict(request))
    script.gate.wait(patience())
    return request


def broken(request: Number) -> Number:
    raise ValueError("the wire is loose")


def cuff(request: Pressure) -> Number:
    if script.is_loose:
        raise ValueError("the hose is loose")
    script.came.append(dict(request))
    return {"value": int(request["pressure"])}


def spare(request: Pressure) -> Number:
    script.came.append(dict(request))
    return {"value": int(request["pressure"])}


def drive(request: Speed) -> Speed:
    script.came.append(dict(request))
    return request
