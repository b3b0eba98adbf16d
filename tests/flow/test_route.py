"""Routes: planned once, counted always, closed without waiting for long."""

from __future__ import annotations

import threading

import pytest

from uoarm._dataplane import MessageCheck, Outlet, Route
from uoarm.errors import BridgeError, FailureReason, MessageError
from uoarm.model import Message, OverflowPolicy, QueuePolicy
from uoarm.testing import patience


class Clock:
    """Seconds that move only when a test moves them."""

    def __init__(self) -> None:
        self.now = 100.0

    def __call__(self) -> float:
        return self.now


def test_a_message_is_handed_over_in_the_thread_in_which_it_arrived() -> None:
    seen: list[tuple[Message, int]] = []
    route = Route("a.out", "b.in", lambda m: seen.append((m, threading.get_ident())), clock=Clock())
    route.deliver("hello")
    assert seen == [("hello", threading.get_ident())]
    assert (route.status().received, route.status().delivered) == (1, 1)


def test_the_adapter_is_applied() -> None:
    seen: list[Message] = []
    route = Route("a", "b", seen.append, clock=Clock(), transfer=lambda m: m * 2)
    route.deliver(21)
    assert seen == [42]


def test_a_consumer_that_raises_is_counted_and_named_and_harms_no_other() -> None:
    def refuse(message: Message) -> None:
        raise RuntimeError(f"cannot take {message}")

    route = Route("a", "b", refuse, clock=Clock())
    route.deliver(7)
    status = route.status()
    assert status.dropped == (("failed", 1),)
    assert status.last_error == "RuntimeError: cannot take 7"
    assert status.delivered == 0


def test_a_traceback_is_logged_only_where_a_program_went_wrong(
    caplog: pytest.LogCaptureFixture,
) -> None:
    misfit, wrapped = MessageError("the field 'a' is missing"), MessageError("no image")
    away = BridgeError("no connection to the broker", FailureReason.UNAVAILABLE)
    failed = BridgeError("the component raised", FailureReason.RAISED)
    wrapped.__cause__ = ValueError("truncated")
    away.__cause__ = ConnectionResetError()
    for raised in (misfit, away, wrapped, failed, RuntimeError("a mistake")):

        def refuse(_: Message, raised: Exception = raised) -> None:
            raise raised

        Route("a", "b", refuse, clock=Clock()).deliver(7)
    assert [bool(record.exc_info) for record in caplog.records] == [False, False, True, True, True]


def test_an_invalid_message_is_not_forwarded() -> None:
    seen: list[Message] = []

    def check(message: Message) -> None:
        if message < 0:
            raise MessageError("negative")

    route = Route("a", "b", seen.append, clock=Clock(), check=MessageCheck(check))
    for message in (1, -1, 2):
        route.deliver(message)
    assert seen == [1, 2]
    assert route.status().invalid == 1
    assert route.status().dropped == (("invalid", 1),)


def test_a_queue_takes_the_consumer_into_another_thread() -> None:
    threads: list[int] = []
    arrived = threading.Event()

    def take(_: Message) -> None:
        threads.append(threading.get_ident())
        arrived.set()

    route = Route("a", "b", take, clock=Clock(), queue=QueuePolicy())
    route.deliver(1)
    assert arrived.wait(patience())
    route.close()
    assert threads != [threading.get_ident()]


def test_a_stuck_consumer_loses_old_messages_and_says_how_many() -> None:
    gate = threading.Event()
    started = threading.Event()
    seen: list[Message] = []

    def take(message: Message) -> None:
        seen.append(message)
        started.set()
        assert gate.wait(patience())

    policy = QueuePolicy(2, OverflowPolicy.DROP_OLDEST)
    route = Route("a", "b", take, clock=Clock(), queue=policy)
    route.deliver(0)
    assert started.wait(patience())
    for message in range(1, 6):
        route.deliver(message)
    gate.set()
    assert route.drain(patience())
    assert seen == [0, 4, 5]
    status = route.status()
    assert status.received == status.delivered + sum(count for _, count in status.dropped) == 6
    route.close()


def test_closing_from_within_the_consumer_does_not_wait_for_itself() -> None:
    closed = threading.Event()
    routes: list[Route] = []

    def take(_: Message) -> None:
        routes[0].close()
        closed.set()

    routes.append(Route("a", "b", take, clock=Clock(), queue=QueuePolicy()))
    routes[0].deliver(1)
    assert closed.wait(patience())


@pytest.mark.parametrize(
    ("interval", "still", "silent"), [(0.01, 0.9, 1.1), (0.2, 0.9, 1.1), (5.0, 14.0, 15.5)]
)
def test_the_rate_is_zero_once_several_messages_are_late(
    interval: float, still: float, silent: float
) -> None:
    clock = Clock()
    route = Route("a", "b", lambda _: None, clock=clock)
    for _ in range(max(4, int(3 / interval))):
        clock.now += interval
        route.deliver(1)
    last = route.status().rate
    assert last == pytest.approx(1 / interval, rel=0.15)
    clock.now += still
    assert route.status().rate == last
    clock.now += silent - still
    assert route.status().rate == 0


def test_rate_and_age_follow_the_clock() -> None:
    clock = Clock()
    route = Route("a", "b", lambda _: None, clock=clock)
    assert route.status().rate is None
    assert route.status().age is None
    for _ in range(31):
        route.deliver(1)
        clock.now += 0.1
    status = route.status()
    assert status.rate == pytest.approx(10, rel=0.15)
    assert status.age == pytest.approx(0.1)
    clock.now += 1000
    assert route.status().rate == pytest.approx(0, abs=0.1)


def test_taking_back_moves_a_message_from_delivered_to_dropped() -> None:
    route = Route("a", "b", lambda _: None, clock=Clock())
    route.deliver(1)
    route.deliver(2)
    route.take_back("replaced")
    status = route.status()
    assert (status.delivered, status.dropped) == (1, (("replaced", 1),))


def test_an_outlet_feeds_its_routes_in_order_until_they_are_detached() -> None:
    seen: list[str] = []
    outlet = Outlet()
    first = Route("a", "b", lambda m: seen.append(f"first {m}"), clock=Clock())
    second = Route("a", "c", lambda m: seen.append(f"second {m}"), clock=Clock())
    outlet.attach(first)
    outlet.attach(second)
    outlet.deliver(1)
    outlet.detach(first)
    outlet.deliver(2)
    assert seen == ["first 1", "second 1", "second 2"]


def test_a_closed_route_counts_what_is_lost_until_another_takes_its_place() -> None:
    seen: list[Message] = []
    outlet = Outlet()
    dead = Route("a", "b", seen.append, clock=Clock())
    outlet.attach(dead)
    dead.stop()
    outlet.deliver(1)
    outlet.attach(Route("a", "c", seen.append, clock=Clock()))
    outlet.deliver(2)
    assert dict(dead.status().dropped) == {"closed": 1}
    assert seen == [2]
