"""Components that the tests play on."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TypedDict

from tests.server.robot import (  # type: ignore[import-not-found] # noqa: F401 - named in the text
    Number,
    add,
    broken,
    double,
    echo,
    numbers,
    picture,
    script,
    slow,
)

from uoarm.local import Emit

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
  add: {components: [{name: adder, bridge: python, service: {endpoint: ["components:add"]}}]}
  slow: {components: [{name: slow, bridge: python, service: {endpoint: ["components:slow"]}}]}
  broken: {components: [{name: broken, bridge: python, service: {endpoint: ["components:broken"]}}]}
  late: {components: [{name: late, bridge: python, output: {endpoint: ["components:late"]}}]}
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


class Typed(TypedDict):
    data: int


Typed.__name__ = "std_msgs/msg/Int32"


class GoalId(TypedDict):
    goal_id: str


cancelled: list[str] = []


def typed(message: Typed) -> Typed:
    return message


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
            number = step + (10**5000 if steps == self.FAR else 0)
            yield Emit("feedback", {**goal, "feedback": {"step": number}})
        if steps > 0:
            yield Emit("result", {**goal, "status": "succeeded", "result": {"walked": steps}})
            if steps == self.HURRY:
                yield accepted
            yield Emit("status", {**goal, "status": "succeeded"})

    def cancel(self, message: GoalId) -> Iterator[Emit]:
        cancelled.append(message["goal_id"])
        result = {"walked": 0}
        yield Emit(
            "result", {"goal_id": message["goal_id"], "status": "canceled", "result": result}
        )
        yield Emit("status", {"goal_id": message["goal_id"], "status": "canceled"})
