"""Components that the tests play on."""

from __future__ import annotations

import threading
from collections import Counter, deque
from collections.abc import Iterator
from typing import Annotated, TypedDict

from uoarm.local import Emit, Range
from uoarm.testing import patience

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
  doubled:
    components:
      - name: doubled
        bridge: python
        input: {from: numbers, endpoint: ["components:double"]}
        output: {endpoint: ["components:double"]}
  echo:
    components:
      - name: echo
        bridge: python
        input: {endpoint: ["components:echo"], queue: {length: 1000}}
        output: {endpoint: ["components:echo"]}
  add:
    components:
      - {name: adder, bridge: python, service: {endpoint: ["components:add"]}}
  slow:
    components:
      - {name: slow, bridge: python, service: {endpoint: ["components:slow"]}}
  broken:
    components:
      - {name: broken, bridge: python, service: {endpoint: ["components:broken"]}}
  late:
    components:
      - {name: late, bridge: python, output: {endpoint: ["components:late"]}}
  typed:
    components:
      - name: typed
        bridge: python
        input: {endpoint: ["components:typed"]}
        output: {endpoint: ["components:typed"]}
  navigate:
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


class Typed(TypedDict):
    data: int


Typed.__name__ = "std_msgs/msg/Int32"


class GoalId(TypedDict):
    goal_id: str


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
        self.cancelled: list[str] = []

    def reset(self) -> None:
        with self._changed:
            self.gate = threading.Event()
            self._items = {name: deque() for name in self._items}
            self._newest.clear()
            self.started.clear()
            self.cancelled = []
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


def typed(message: Typed) -> Typed:
    return message


def add(message: Pair) -> Number:
    return {"value": int(message["a"] + message["b"])}


def slow(message: Number) -> Number:
    script.gate.wait(patience())
    return message


def broken(message: Number) -> Number:
    raise ValueError(f"cannot do {message['value']}")


class Walker:
    """An action: walks as many steps as its goal says; with none it waits to be cancelled.

    Where it is in a hurry, its feedback and result come before the status that accepts the goal.
    Where it goes far, its steps have numbers that rosbridge cannot write.
    """

    HURRY, FAR = 7, 8

    def __init__(self) -> None:
        self._goals = 0

    def __call__(self, message: Number) -> None:
        """Take nothing: its inputs are goal and cancel."""

    def goal(self, message: Number) -> Iterator[Emit]:
        steps = message["value"]
        self._goals += 1
        goal = {"goal_id": f"goal {self._goals}"}
        accepted = Emit("status", {**goal, "status": "rejected" if steps < 0 else "accepted"})
        if steps != self.HURRY:
            yield accepted
        for step in range(steps):
            number = step + (2**70 if steps == self.FAR else 0)
            yield Emit("feedback", {**goal, "feedback": {"step": number}})
        if steps > 0:
            yield Emit("result", {**goal, "status": "succeeded", "result": {"walked": steps}})
            if steps == self.HURRY:
                yield accepted
            yield Emit("status", {**goal, "status": "succeeded"})

    def cancel(self, message: GoalId) -> Iterator[Emit]:
        script.cancelled.append(message["goal_id"])
        result = {"walked": 0}
        yield Emit(
            "result", {"goal_id": message["goal_id"], "status": "canceled", "result": result}
        )
        yield Emit("status", {"goal_id": message["goal_id"], "status": "canceled"})
