"""Components that the tests play on; what a bridge is handed is listed."""

from __future__ import annotations

import itertools
import threading
from collections.abc import Iterator
from typing import Annotated, TypedDict

from uoarm.local import Emit, Range
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
  many: {components: [{name: many, bridge: python, service: {endpoint: ["components:many"]}}]}
  slow: {components: [{name: slow, bridge: python, service: {endpoint: ["components:slow"]}}]}
  odd:
    components:
      - name: odd
        bridge: python
        service:
          endpoint: ["components:odd"]
          request: &odd
            type: object
            properties:
              number: {type: number}
              most: {type: integer, maximum: 1180591620717411303424}
              inner: {type: array, items: {$ref: "#"}}
          reply: *odd
  broken: {components: [{name: broken, bridge: python, service: {endpoint: ["components:broken"]}}]}
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
  walk:
    description: walks so many steps
    components:
      - name: walker
        bridge: python
        inputs:
          goal: {endpoint: ["components:Walker"]}
          cancel: {endpoint: ["components:Walker"]}
        outputs:
          status: {endpoint: ["components:Walker"], structure: {type: object}}
          feedback: {endpoint: ["components:Walker"], structure: {type: object}}
          result: {endpoint: ["components:Walker"], structure: {type: object}}
  press:
    description: an action that moves something
    components:
      - name: presser
        bridge: python
        inputs:
          goal:
            endpoint: ["components:Walker"]
            lifetime: 30
            stop: {message: {value: 0}}
            limits: {value: {minimum: 0, maximum: 5}}
          cancel: {endpoint: ["components:Walker"]}
        outputs:
          status: {endpoint: ["components:Walker"], structure: {type: object}}
          result: {endpoint: ["components:Walker"], structure: {type: object}}
  digit:
    components:
      - name: digit
        bridge: python
        input: {from: numbers, endpoint: ["components:digit"]}
        output: {endpoint: ["components:digit"]}
  missing:
    components:
      - {name: missing, bridge: python, output: {endpoint: ["components:nothing"]}}
"""


class Number(TypedDict):
    value: int


class Digit(TypedDict):
    value: Annotated[int, Range(0, 9)]


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


def digit(message: Digit) -> Digit:
    return message


def add(request: Pair) -> Number:
    script.came.append(dict(request))
    return {"value": request["a"] + request["b"]}


def many(request: Count) -> Many:
    return {"values": [float(number) for number in range(request["count"])]}


def slow(request: Number) -> Number:
    script.came.append(dict(request))
    script.gate.wait(patience())
    return request


def odd(message: object) -> dict[str, object]:
    del message
    return {"number": float("nan"), "most": 2**70, "inner": [{"number": float("-inf")}]}


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


class GoalId(TypedDict):
    goal_id: str


class Walker:
    """An action: walks as many steps as its goal says, at once; 98 and 99 wait to be cancelled."""

    def __init__(self) -> None:
        self._numbers = itertools.count(1)
        self._waiting: set[str] = set()

    def goal(self, message: Number) -> Iterator[Emit]:
        script.came.append(dict(message))
        goal = {"goal_id": str(next(self._numbers))}
        steps = message["value"]
        if steps < 0:
            yield Emit("status", {**goal, "status": "rejected"})
            return
        yield Emit("status", {**goal, "status": "accepted"})
        if steps in (98, 99):
            self._waiting.add(goal["goal_id"])
            feedback = {"step": 1} if steps == 99 else {"steps": [0.5] * 20_000}
            yield Emit("feedback", {**goal, "feedback": feedback})
            return
        state = "aborted" if steps == 13 else "succeeded"
        yield Emit("result", {**goal, "status": state, "result": {"walked": steps}})

    def cancel(self, message: GoalId) -> Iterator[Emit]:
        script.came.append(dict(message))
        if message["goal_id"] in self._waiting:
            self._waiting.discard(message["goal_id"])
            result = {"walked": 1}
            yield Emit("result", {**message, "status": "canceled", "result": result})
