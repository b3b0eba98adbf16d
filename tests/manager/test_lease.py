"""An input that one sender at a time may command, and stops that a sender asks for."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator
from contextlib import ExitStack

import pytest
from tests.leases import lease, leased_robot

from uoarm import RobotManager
from uoarm._parts._application_ports import _Command
from uoarm.bridge import boot_seconds
from uoarm.errors import (
    BridgeError,
    CommandRefusedError,
    ConnectionClosedError,
    UsageError,
)
from uoarm.model import LeaseHolder, StatusEvent
from uoarm.testing import Background, MemoryBridge, patience, wait

SAFETY = LeaseHolder("fence", "safety")


def open_robot(memory: MemoryBridge) -> RobotManager:
    lamp = "lamp: {components: [{name: lamp, bridge: memory, input: {endpoint: [base]}}]}"
    return leased_robot(memory, more=lamp)


def refused(act: Callable[[], object]) -> str:
    with pytest.raises(CommandRefusedError) as caught:
        act()
    assert caught.value.reason == "leased"
    return str(caught.value)


def test_who_sends_first_commands_and_any_other_learns_who_does(memory: MemoryBridge) -> None:
    base = memory.taker("base", {"type": "number"})
    events: list[StatusEvent] = []
    with open_robot(memory) as manager:
        manager.listen(events.append)
        first, second = manager.request("drive"), manager.request("drive")
        first.send(1)
        text = refused(lambda: second.send(2))
        assert f"base.default: connection {first.id} holds its lease" in text
        assert lease(manager).holder == LeaseHolder(f"connection {first.id}")
        assert f"connection {first.id}, 3" in str(manager.status())
        second.send(3, take_over=True)
        refused(lambda: first.send(4))
        first.send(5, sender=SAFETY)
        refused(lambda: second.send(6, take_over=True))
        assert lease(manager).priority == 10
        assert base.taken.messages == [1, 3, 5]
        wait(lambda: [event.change for event in events].count("leased") == 3)
        cause = f"base.default: {SAFETY} holds its lease, who took it over from connection"
        assert events[-1].cause == f"{cause} {second.id}"
        assert events[-1].function == "drive"


def test_who_leaves_gives_it_back_and_what_it_moved_is_stopped(memory: MemoryBridge) -> None:
    base = memory.taker("base", {"type": "number"})
    with open_robot(memory) as manager:
        first, second = manager.request("drive"), manager.request("drive")
        first.send(1)
        first.kill()
        wait(lambda: base.taken.messages == [1, 0])
        second.send(2)
        second.stop(timeout=patience())
        assert lease(manager).holder is None
        second.send(3, sender=SAFETY)
        second.leave(LeaseHolder("another client"))
        assert lease(manager).holder == SAFETY
        second.leave(SAFETY)
        assert lease(manager).holder is None
        wait(lambda: base.taken.messages == [1, 0, 2, 0, 3, 0])


def test_a_stop_by_who_was_taken_over_from_stops_no_other(memory: MemoryBridge) -> None:
    base = memory.taker("base", {"type": "number"})
    with open_robot(memory) as manager:
        first, second = manager.request("drive"), manager.request("drive")
        first.send(1)
        second.send(2, take_over=True)
        first.stop()
        assert base.taken.messages == [1, 2]
        assert lease(manager).holder == LeaseHolder(f"connection {second.id}")


def test_a_stop_that_cannot_be_is_reported(memory: MemoryBridge) -> None:
    memory.taker("base", {"type": "number"})
    text = "no stop message in the configuration"
    with open_robot(memory) as manager, pytest.raises(UsageError, match=text):
        manager.request("lamp").stop()


def test_what_waits_for_a_sink_that_hangs_is_not_sent_after_a_stop(memory: MemoryBridge) -> None:
    base = memory.taker("base", {"type": "number"}, blocking=True)
    with open_robot(memory) as manager:
        drive = manager.request("drive")
        with base.stalled() as hang:
            drive.send(1)
            assert hang.entered.wait(patience())
            drive.send(2)
            with pytest.raises(BridgeError, match="has not taken its stop message"):
                drive.stop(timeout=0)
        assert not drive.flush(patience()), "one was not taken"
        drive.stop(timeout=patience())
        assert 2 not in base.taken.messages
        assert base.taken.messages[0] == 1
        assert set(base.taken.messages[1:]) == {0}
        (route,) = drive.routes()
        assert dict(route.dropped) == {"stopped": 1}


def test_what_waits_while_another_takes_over_is_not_sent_behind_it(memory: MemoryBridge) -> None:
    base = memory.taker("base", {"type": "number"}, blocking=True)
    with open_robot(memory) as manager:
        first, second = manager.request("drive"), manager.request("drive")
        with base.stalled() as hang:
            first.send(1)
            assert hang.entered.wait(patience())
            first.send(2)
            second.send(3, take_over=True)
        assert not first.flush(patience()), "one was not taken"
        assert second.flush(patience())
        assert base.taken.messages == [1, 3]
        (route,) = first.routes()
        assert dict(route.dropped) == {"leased": 1}


def test_a_command_is_renewed_while_it_is_held_and_stopped_then(
    memory: MemoryBridge, caplog: pytest.LogCaptureFixture
) -> None:
    base = memory.taker("base", {"type": "number"})
    with open_robot(memory) as manager:
        first, second = manager.request("drive"), manager.request("drive")
        with first.hold(1, period=0.001) as held:
            wait(lambda: base.taken.messages.count(1) >= 3)
            held.message = 2
            wait(lambda: 2 in base.taken.messages)
        assert base.taken.messages[-1] == 0
        held_by_first = ExitStack()
        held = held_by_first.enter_context(first.hold(3, period=0.001))
        second.send(4, take_over=True)
        wait(lambda: held.error is not None)
        with pytest.raises(CommandRefusedError, match="holds its lease"):
            held_by_first.close()
        assert base.taken.messages[-1] == 4, "who was taken over from stops no other"
        with second.hold(5, period=3600):
            assert base.taken.messages[-1] == 5
        with pytest.raises(ConnectionClosedError), second.hold(6, period=3600):
            second.kill()
        assert base.taken.messages[-1] == 0
    text = "commands live for 3600 s, and are renewed every 3600 s: it stops in between"
    assert f"base.default: {text}" in caplog.text


class HeldNumbers:
    """Numbers of an input of which the first waits until the test lets it go."""

    def __init__(self, numbers: Iterator[int]) -> None:
        self.numbers = numbers
        self.is_held, self.go_on = threading.Event(), threading.Event()

    def __next__(self) -> int:
        number = next(self.numbers)
        if not self.is_held.is_set():
            self.is_held.set()
            assert self.go_on.wait(patience())
        return number


def test_of_two_stops_at_once_no_command_before_the_later_one_passes(memory: MemoryBridge) -> None:
    memory.taker("base", {"type": "number"})
    with open_robot(memory) as robot:
        connection = robot.request("drive")
        connection.send(5)
        way = connection._ports().sender(None)
        way._numbers = numbers = HeldNumbers(way._numbers)  # type: ignore[assignment]
        first = Background(lambda: connection.stop(timeout=patience()))
        assert numbers.is_held.wait(patience())
        waits = _Command(7, LeaseHolder("me"), next(numbers), boot_seconds())
        later = Background(lambda: connection.stop(timeout=patience()))
        wait(lambda: not later._thread.is_alive() or way._stopping.locked())
        numbers.go_on.set()
        first.result()
        later.result()
        with pytest.raises(CommandRefusedError, match="stopped the input while the command waited"):
            way._admit(waits)


@pytest.mark.parametrize("raised", [OSError("no link"), SystemExit(1)])
def test_a_command_that_failed_behind_a_stop_is_stopped_again(
    memory: MemoryBridge, raised: BaseException
) -> None:
    base = memory.taker("base", {"type": "number"})
    with open_robot(memory) as robot:
        connection = robot.request("drive")
        connection.send(5)
        way = connection._ports().sender(None)

        def arrive_late(command: _Command) -> None:
            connection.stop(timeout=patience())
            way._live._sinks["default"].send(command.message)
            raise raised

        way._pass_on = arrive_late
        with pytest.raises(type(raised)):
            way._hand_command(_Command(7, LeaseHolder("me"), 0, boot_seconds()))
        assert base.taken.messages == [5, 0, 7, 0]
