"""What an output's consumers get: each message once, and where it retains the last one first."""

from __future__ import annotations

import itertools
import random
import threading
from collections.abc import Callable

import pytest

from uoarm._dataplane import Outlet, Route
from uoarm._dataplane._outlet import _MOST_OCTETS, _MOST_WRITERS
from uoarm.model import Message
from uoarm.testing import Background, Hang, ManualClock, patience, wait


class Consumer:
    """A route that keeps what it was handed, or drops it while it is to."""

    def __init__(self) -> None:
        self.got: list[Message] = []
        self.drops = False
        self.route = Route("p.out", "c.in", self._take, clock=ManualClock())

    def _take(self, message: Message) -> None:
        if not self.drops:
            self.got.append(message)


@pytest.fixture
def outlet() -> Outlet:
    return Outlet()


def test_who_joins_a_source_that_retains_gets_the_last_message_first(outlet: Outlet) -> None:
    outlet.retain(True)
    for number in (1, 2):
        outlet.deliver(number)
    consumer = Consumer()
    outlet.attach(consumer.route)
    outlet.deliver(3)
    assert consumer.got == [2, 3]


def test_who_joins_any_other_source_gets_the_next_message_first(outlet: Outlet) -> None:
    outlet.deliver(0)
    outlet.retain(False)
    outlet.deliver(1)
    consumer = Consumer()
    outlet.attach(consumer.route)
    outlet.deliver(2)
    assert consumer.got == [2]
    assert outlet.undelivered == 2


def test_what_comes_while_a_source_opens_is_retained(outlet: Outlet) -> None:
    """A framework may hand over what it retained before `open_source` has returned."""
    first, second = Consumer(), Consumer()
    outlet.attach(first.route)
    outlet.deliver(1)
    outlet.attach(second.route)
    assert (first.got, second.got) == ([1], [])
    outlet.retain(True)
    assert (first.got, second.got) == ([1], [1])


def test_nothing_is_handed_to_who_joins_before_there_was_a_message(outlet: Outlet) -> None:
    outlet.retain(True)
    consumer = Consumer()
    outlet.attach(consumer.route)
    assert consumer.got == []


def test_none_is_a_message_that_is_retained_like_any_other(outlet: Outlet) -> None:
    outlet.retain(True)
    outlet.deliver(None)
    consumer = Consumer()
    outlet.attach(consumer.route)
    assert consumer.got == [None]


def test_who_left_gets_nothing_more(outlet: Outlet) -> None:
    outlet.retain(True)
    consumer = Consumer()
    outlet.attach(consumer.route)
    outlet.detach(consumer.route)
    outlet.deliver(1)
    assert consumer.got == []
    assert outlet.undelivered == 1


def test_who_was_dropping_gets_the_last_message_when_it_is_let_through(outlet: Outlet) -> None:
    outlet.retain(True)
    consumer = Consumer()
    consumer.drops = True
    outlet.attach(consumer.route)
    outlet.deliver(1)
    with outlet.letting_through(consumer.route):
        consumer.drops = False
    outlet.deliver(2)
    assert consumer.got == [1, 2]


def test_who_is_let_through_on_any_other_source_gets_the_next_message(outlet: Outlet) -> None:
    outlet.retain(False)
    consumer = Consumer()
    consumer.drops = True
    outlet.attach(consumer.route)
    outlet.deliver(1)
    with outlet.letting_through(consumer.route):
        consumer.drops = False
    assert consumer.got == []


@pytest.mark.parametrize("retains", [False, True, None])
def test_what_more_than_one_route_got_counts_as_a_copy_for_all_but_the_first(
    outlet: Outlet, retains: bool | None
) -> None:
    if retains is not None:
        outlet.retain(retains)
    outlet.deliver(0)
    consumers = [Consumer() for _ in range(3)]
    for number, consumer in enumerate(consumers):
        outlet.attach(consumer.route)
        outlet.deliver(2 * number + 1)
        if number == 1:
            consumer.route.stop()  # it counts what it drops until another one is there
            outlet.deliver(4)
    outlet.detach(consumers[0].route)
    outlet.deliver(6)
    received = [item.route.status().received for item in consumers]
    copies = [item.route.status().copies for item in consumers]
    assert received == ([5, 3, 3] if retains else [4, 2, 2])
    assert copies == ([1, 3, 2] if retains else [0, 2, 1])
    sent = 6
    assert sent + sum(copies) == sum(received) + outlet.undelivered


def test_a_message_that_emits_in_its_own_thread_does_not_hang(outlet: Outlet) -> None:
    outlet.retain(True)
    got: list[Message] = []

    def take(message: Message) -> None:
        got.append(message)
        if message < 3:
            outlet.deliver(message + 1)

    outlet.attach(Route("p.out", "c.in", take, clock=ManualClock()))
    Background(lambda: outlet.deliver(1)).result(patience())
    assert got == [1, 2, 3]


def test_a_newer_message_waits_for_the_retained_one_that_is_being_handed_over(
    outlet: Outlet,
) -> None:
    outlet.retain(True)
    outlet.deliver(1)
    hang, got = Hang(), list[Message]()

    def take(message: Message) -> None:
        if message == 1:
            hang.wait()
        got.append(message)

    joining = Background(lambda: outlet.attach(Route("p.out", "c.in", take, clock=ManualClock())))
    assert hang.entered.wait(patience())
    newer = Background(lambda: outlet.deliver(2))
    wait(lambda: outlet._last == (2, 2))
    hang.release()
    joining.result(patience())
    newer.result(patience())
    assert got == [1, 2]


def test_the_retained_message_is_left_out_when_a_newer_one_was_faster(outlet: Outlet) -> None:
    outlet.retain(True)
    outlet.deliver(1)
    consumer = Consumer()
    outlet._lock = Overtaking(lambda: outlet.deliver(2))  # type: ignore[assignment] # a lock
    outlet.attach(consumer.route)
    assert consumer.got == [2]


class Overtaking:
    """A lock after whose first use something else happens at once."""

    def __init__(self, then: Callable[[], None]) -> None:
        self._lock = threading.Lock()
        self._then = [then]

    def __enter__(self) -> None:
        self._lock.acquire()

    def __exit__(self, *_: object) -> None:
        self._lock.release()
        if self._then:
            self._then.pop()()


@pytest.mark.parametrize("seed", range(8))
def test_who_joins_while_messages_come_gets_them_once_and_in_order(seed: int) -> None:
    """The newest message at the time of joining, or a later one, then every one without a gap."""
    chance = random.Random(seed)
    outlet, ended = Outlet(), threading.Event()
    outlet.retain(True)
    outlet.deliver(0)
    numbers = itertools.count(1)

    def emit() -> None:
        while not ended.is_set():
            outlet.deliver(next(numbers))

    emitting = Background(emit)
    consumers = [Consumer() for _ in range(60)]
    lowest: list[int] = []
    for consumer in consumers:
        lowest.append(outlet._last[0] - 1)
        if chance.random() < 0.5:
            consumer.drops = True
            outlet.attach(consumer.route)
            lowest[-1] = outlet._last[0] - 1
            with outlet.letting_through(consumer.route):
                consumer.drops = False
        else:
            outlet.attach(consumer.route)
    ended.set()
    emitting.result(patience())
    last = outlet._last[1]
    for consumer, least in zip(consumers, lowest, strict=True):
        assert consumer.got == list(range(consumer.got[0], last + 1))
        assert consumer.got[0] >= least


class _Said:
    """A lock; while the first thread waits for it, another says that nothing is retained."""

    def __init__(self, outlet: Outlet) -> None:
        self._lock = threading.Lock()
        self._outlet: Outlet | None = outlet

    def __enter__(self) -> None:
        outlet, self._outlet = self._outlet, None
        if outlet is not None:
            Background(lambda: outlet.retain(False)).result()
        self._lock.acquire()

    def __exit__(self, *_: object) -> None:
        self._lock.release()


def test_a_message_that_comes_as_its_source_says_that_it_retains_nothing_arrives(
    outlet: Outlet, monkeypatch: pytest.MonkeyPatch
) -> None:
    consumer = Consumer()
    outlet.attach(consumer.route)
    monkeypatch.setattr(outlet, "_lock", _Said(outlet))
    outlet.deliver(1)
    assert (consumer.got, outlet.undelivered) == ([1], 0)
    assert consumer.route.copies == 0


def test_the_last_of_each_writer_stand(outlet: Outlet) -> None:
    outlet.retain(True, depth=2)
    for writer, number in (("a", 1), ("b", 2), ("a", 3), ("a", 4), ("c", 5)):
        outlet.deliver(number, writer)
    consumer = Consumer()
    outlet.attach(consumer.route)
    outlet.deliver(6, "b")
    assert consumer.got == [2, 3, 4, 5, 6]
    assert outlet.standing() == (2, 3, 4, 5, 6)


def test_what_came_of_several_writers_while_a_source_opens_stands(outlet: Outlet) -> None:
    first, second = Consumer(), Consumer()
    outlet.attach(first.route)
    for number, writer in enumerate("aabb"):
        outlet.deliver(number, writer)
    outlet.attach(second.route)
    outlet.deliver(4, "b")
    outlet.retain(True)
    assert first.got == [0, 1, 2, 3, 4]
    assert second.got == [4, 1], "not what is older than what it has of the same writer"
    assert outlet.standing() == (1, 4)


def test_nothing_stands_of_a_writer_that_was_let_go(outlet: Outlet) -> None:
    outlet.retain(True)
    outlet.deliver(1, "a")
    outlet.deliver(2, "b")
    outlet.let_go("a")
    outlet.let_go("stranger")
    consumer = Consumer()
    outlet.attach(consumer.route)
    with outlet.letting_through(consumer.route):
        pass
    assert consumer.got == [2, 2]


def test_what_stands_is_bounded_in_writers_and_octets(outlet: Outlet) -> None:
    outlet.retain(True, depth=3)
    for number in range(3 * _MOST_WRITERS):
        outlet.deliver(number, str(number))
    assert outlet.standing() == tuple(range(2 * _MOST_WRITERS, 3 * _MOST_WRITERS))
    picture = bytes(_MOST_OCTETS // 2 + 1)
    for writer in "abc":
        outlet.deliver(picture, writer)
    assert outlet.standing() == (picture,), "the newest is kept, whatever it holds"
