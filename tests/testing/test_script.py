"""What a test puts is emitted by the source that is open, whenever the threads get their turn."""

from __future__ import annotations

import math
import threading
from array import array
from collections.abc import Iterator
from types import SimpleNamespace
from typing import Any, TypedDict

import pytest

from uoarm import ConnectionClosedError, RobotManager
from uoarm.config import loads
from uoarm.local import _instance
from uoarm.testing import Background, Script, _waiting, patience, same, wait

ROBOT = """
version: 1
bridges: {python: {}}
functions:
  numbers:
    components:
      - name: numbers
        bridge: python
        output: {endpoint: ["tests.testing.test_script:numbers"]}
"""


class Number(TypedDict):
    value: int


script = Script()
numbers = script.source(Number)


@pytest.fixture
def robot() -> Iterator[RobotManager]:
    script.reset()
    with RobotManager(loads(ROBOT)) as robot:
        yield robot
        script.reset()


def test_a_instance_whose_thread_has_not_begun_takes_what_is_put(
    robot: RobotManager, monkeypatch: pytest.MonkeyPatch
) -> None:
    first = robot.request("numbers", validate="always")
    script.put({"value": 1})
    assert first.get(patience()) == {"value": 1}
    first.kill()
    work, gate = _instance._Run.work, threading.Event()

    def late(run: _instance._Run) -> None:
        gate.wait(patience())
        work(run)

    monkeypatch.setattr(_instance._Run, "work", late)
    second = robot.request("numbers", validate="always")
    script.put({"value": 2})
    gate.set()
    assert second.get(patience()) == {"value": 2}


def test_a_closed_instance_takes_nothing_and_leaves_it_to_the_next() -> None:
    script.reset()
    source = numbers()
    messages = iter(source)
    waiting = Background(lambda: next(messages, "nothing"))
    source.close()
    script.put({"value": 3}, Script.END)
    assert waiting.result() == "nothing"
    assert list(numbers()) == [{"value": 3}]


def test_after_another_has_opened_a_instance_takes_nothing() -> None:
    script.reset()
    former = iter(numbers())
    waiting = Background(lambda: list(former))
    latter = iter(numbers())
    script.put({"value": 4}, Script.END)
    assert list(latter) == [{"value": 4}]
    assert waiting.result() == []


def test_an_exception_is_raised_by_the_instance(robot: RobotManager) -> None:
    with robot.request("numbers") as connection:
        script.put(RuntimeError("the cable is out"))
        with pytest.raises(ConnectionClosedError, match="the cable is out"):
            connection.get(patience())


@pytest.mark.parametrize(
    ("value", "equal", "different"),
    [
        ([1, 2.0, "a"], (1.0, 2, "a"), [1, 2, "b"]),
        (bytes(range(3)), array("B", [0, 1, 2]), bytearray(3)),
        ([1, 0], memoryview(b"\1\0"), [True, False]),
        ([math.nan, [1]], [float("nan"), [1]], [math.nan, [True]]),
        ({"a": [1, 2]}, {"a": (1, 2)}, {"a": [1, 2, 3]}),
    ],
)
def test_messages_are_the_same_by_value_except_true_and_1(
    value: Any, equal: Any, different: Any
) -> None:
    assert same(value, equal)
    assert same(equal, value)
    assert not same(value, different)
    assert not same(different, value)


def test_what_takes_long_is_looked_at_less_and_less_often(monkeypatch: pytest.MonkeyPatch) -> None:
    pauses: list[float] = []
    event = SimpleNamespace(wait=pauses.append)
    monkeypatch.setattr(_waiting, "threading", SimpleNamespace(Event=lambda: event))
    wait(lambda: len(pauses) == 40)
    assert pauses == sorted(pauses)
    assert (pauses[0], pauses[-1]) == (0.005, 0.02)
