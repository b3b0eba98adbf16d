"""The end of a source: a closed manager leaves no thread of it in foreign code."""

from __future__ import annotations

import sys
import threading
import traceback
from collections.abc import Callable, Iterator
from pathlib import Path
from types import ModuleType
from typing import ClassVar, TypedDict

import pytest

from uoarm import RobotManager
from uoarm._support.workers import WorkerPool
from uoarm.config import loads
from uoarm.local import PythonBridge, PythonOptions
from uoarm.local._instance import IteratedSource
from uoarm.model import Endpoint, Message, MessageStructure, Role
from uoarm.testing import Background, patience, wait

ANY = MessageStructure({})

ROBOT = """
version: 1
bridges: {python: {}}
functions:
  numbers:
    components:
      - {name: counter, bridge: python, output: {endpoint: ["ending_source:numbers"]}}
"""


class Number(TypedDict):
    value: int


@pytest.fixture
def left(monkeypatch: pytest.MonkeyPatch) -> threading.Event:
    """Set when the source has ended, which takes it a moment."""
    ended = threading.Event()

    def numbers() -> Iterator[Number]:
        try:
            while True:
                yield {"value": 1}
        finally:
            threading.Event().wait(0.02)
            ended.set()

    module = ModuleType("ending_source")
    module.__dict__["numbers"] = numbers
    monkeypatch.setitem(sys.modules, "ending_source", module)
    return ended


def test_a_source_has_ended_when_the_manager_is_closed(
    left: threading.Event, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("uoarm.local._bridge._SOURCE_SECONDS", patience())
    with (
        RobotManager(loads(ROBOT, str(tmp_path / "robot.yaml"))) as robot,
        robot.request("numbers") as numbers,
    ):
        assert numbers.get(timeout=patience()) == {"value": 1}
    assert left.is_set()


def at(name: str, role: Role) -> Endpoint:
    return Endpoint("python", name, role, (f"ending_source:{name}",))


def test_what_comes_of_a_message_that_was_taken_is_counted_when_its_output_is_closed(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    begun, free = threading.Event(), threading.Event()

    def double(value: int) -> int:
        begun.set()
        assert free.wait(patience())
        return 2 * value

    module = ModuleType("ending_source")
    module.__dict__["double"] = double
    monkeypatch.setitem(sys.modules, "ending_source", module)
    bridge, got = PythonBridge("python", PythonOptions()), list[Message]()
    sink = bridge.open_sink(at("double", Role.INPUT), ANY)
    source = bridge.open_source(at("double", Role.OUTPUT), ANY, got.append)
    sending = Background(lambda: sink.send(1))
    assert begun.wait(patience())
    source.close()
    free.set()
    sending.result()
    assert (got, source.refused) == ([], 1)
    sink.send(2)  # what comes of this is not wanted, and its output was closed before
    assert source.refused == 1
    bridge.close()


def test_a_source_whose_last_listener_leaves_emits_a_message_or_sees_that_it_was_not_taken() -> (
    None
):
    emitted: list[int] = []
    not_taken: list[int] = []
    ended = threading.Event()

    def numbers() -> Iterator[int]:
        for number in range(3):
            try:
                yield number
            except GeneratorExit:
                not_taken.append(number)
                raise

    def emitter() -> Callable[[int], None]:
        """Return who receives now; the last one leaves before or after they are asked for."""
        if len(emitted) == 1:
            source.remove_listener("only")
        return emitted.append

    workers = WorkerPool("uoarm-test", 1)
    source = IteratedSource(numbers, emitter, "numbers", workers)
    source.add_listener("only", lambda _: ended.set())
    workers.close(drop=False)
    wait(lambda: not workers.busy)
    assert (emitted, not_taken) == ([0], [1])
    assert not ended.is_set()


def test_what_a_source_raises_is_logged_with_where_it_was_raised(
    monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    def numbers() -> Iterator[Number]:
        yield {"value": int("x")}

    module = ModuleType("ending_source")
    module.__dict__["numbers"] = numbers
    monkeypatch.setitem(sys.modules, "ending_source", module)
    bridge = PythonBridge("python", PythonOptions())
    causes: list[str] = []
    bridge.watch(lambda event: causes.append(event.cause))
    bridge.open_source(at("numbers", Role.OUTPUT), ANY, lambda _: None, timeout=patience())
    wait(lambda: causes)
    bridge.close(timeout=patience())
    [record] = [item for item in caplog.records if item.name == "uoarm.component.numbers"]
    [cause] = causes
    assert cause.startswith("its source raised ValueError: invalid literal for int()")
    assert record.getMessage() == f"component numbers: {cause}"
    assert record.exc_info is not None
    assert "in numbers" in "".join(traceback.format_tb(record.exc_info[2]))


class Plugged:
    """A device that one at a time may hold, and that is unplugged at the first message of each."""

    held: ClassVar[list[Plugged]] = []
    made = 0

    def __init__(self) -> None:
        assert not Plugged.held, "it is held still"
        Plugged.held.append(self)
        Plugged.made += 1

    def __iter__(self) -> Iterator[Number]:
        yield {"value": Plugged.made}
        raise OSError(f"unplugged {Plugged.made}")

    def close(self) -> None:
        Plugged.held.remove(self)


def test_what_comes_in_the_place_of_what_died_is_a_new_instance_and_holds_what_it_held(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """The one that died is still open, as it is in a connection until another plan takes over."""
    monkeypatch.setattr(Plugged, "made", 0)
    bridge, got = PythonBridge("python", PythonOptions()), list[Message]()
    causes: list[str] = []
    bridge.watch(lambda event: causes.append(event.cause))
    endpoint = Endpoint("python", "sensor", Role.OUTPUT, (f"{__name__}:Plugged",))
    first = bridge.open_source(endpoint, ANY, got.append, timeout=patience())
    wait(lambda: len(causes) == 1)
    second = bridge.open_source(endpoint, ANY, got.append, timeout=patience())
    wait(lambda: len(causes) == 2)
    assert causes == [f"its source raised OSError: unplugged {n}" for n in (1, 2)]
    assert got == [{"value": 1}, {"value": 2}]
    first.close()
    assert len(Plugged.held) == 1, "the second one is open"
    second.close()
    assert not Plugged.held
    bridge.close(timeout=patience())


def test_a_listener_that_comes_as_a_source_raises_gets_the_failure_and_nothing_begins_again() -> (
    None
):
    begun: list[int] = []
    failures: list[Exception | None] = []

    def numbers() -> Iterator[int]:
        begun.append(1)
        yield from map(int, ["none"])

    workers = WorkerPool("uoarm-test", 1)
    source = IteratedSource(numbers, lambda: begun.append, "numbers", workers)
    source.add_listener("first", failures.append)
    wait(lambda: len(failures) == 1)
    source.add_listener("late", failures.append)
    assert failures == [failures[0]] * 2
    assert isinstance(failures[0], ValueError)
    assert begun == [1]
    workers.close(drop=False)
    wait(lambda: not workers.busy)
