"""What waits for the writer: in order, bounded, counted, whatever is slow."""

from __future__ import annotations

import itertools
import threading
from collections import Counter
from typing import Any

import pytest
from attrs import define

from uoarm.cdr import forget_octets, note_octets
from uoarm.model import QueuePolicy
from uoarm.record._arrivals import Arrivals, ReadOctets
from uoarm.testing import Background, patience, wait


@define(eq=False)
class Function:
    received: int = 0
    taken: int = 0
    octets: int = 0
    definition: str = ""


class World:
    """One function's arrivals, and what was lost."""

    def __init__(self, policy: QueuePolicy, functions: int = 1) -> None:
        self.lost: Counter[str] = Counter()
        self.functions = [Function() for _ in range(functions)]
        self.arrivals = Arrivals(policy, self.functions, lambda reason: self.lost.update([reason]))
        ticks = itertools.count()
        self.takers = [
            self.arrivals.taker(function, lambda: (next(ticks), 0)) for function in self.functions
        ]

    def numbers(self) -> list[int]:
        return [number for *_, number in self.arrivals.take_waiting()]


def test_all_is_taken_in_order_with_its_number_and_time() -> None:
    world = World(QueuePolicy(length=1000), 2)
    for n in range(10):
        world.takers[n % 2]({"n": n})
    taken = world.arrivals.take_waiting()
    assert [(at, message["n"], number) for _, at, _, message, number in taken] == [
        (n, n, n // 2 + 1) for n in range(10)
    ]
    assert [function.taken for function in world.functions] == [5, 5]


@pytest.mark.parametrize("length", [1, 3, 255])
def test_the_oldest_are_dropped_and_counted(length: int) -> None:
    world = World(QueuePolicy(length=length))
    for n in range(length + 7):
        world.takers[0](n)
    assert world.numbers() == list(range(8, length + 8))
    assert world.lost == {"queue-full": 7}


def test_a_long_queue_is_bounded_within_sixteen() -> None:
    world = World(QueuePolicy(length=1000))
    for n in range(5000):
        world.takers[0](n)
    assert 1000 <= len(world.arrivals) < 1016
    assert world.lost["queue-full"] + len(world.arrivals) == 5000


def test_the_latest_replaces_the_one_before() -> None:
    world = World(QueuePolicy(policy="latest"))
    for n in range(5):
        world.takers[0](n)
    assert world.numbers() == [5]
    assert world.lost == {"replaced": 4}


def test_large_messages_are_bounded_by_their_octets() -> None:
    world = World(QueuePolicy(length=10_000, octets=5_000_000))
    for n in range(100):
        world.takers[0]({"n": n, "data": bytes(1_000_000)})
    assert world.numbers() == [97, 98, 99, 100]
    assert world.lost == {"queue-octets": 96}


def test_what_was_read_of_octets_waits_as_these() -> None:
    world = World(QueuePolicy(length=100))
    world.functions[0].definition = "int32 n\n"
    take, message = world.takers[0], {"n": 1}
    octets = b"\0\1\0\0\1\0\0\0"
    note_octets(message, octets, "int32 n\n")
    take(message)  # the very one
    take({"n": 1})  # one like it
    note_octets(message, b"\0\0\0\0\0\0\0\1", "int32 n\n")
    take(message)  # of a machine that writes numbers in the other order
    note_octets(message, octets, "int32 m\n")
    take(message)  # of another type
    forget_octets()
    take(message)
    taken = [message for *_, message, _ in world.arrivals.take_waiting()]
    assert taken == [ReadOctets(octets), *[message] * 4]


def test_a_source_waits_for_room() -> None:
    world = World(QueuePolicy(length=2, policy="block", timeout=patience()))

    def send() -> None:
        for n in range(50):
            world.takers[0](n)

    sending = Background(send)
    taken: list[int] = []

    def all_came() -> bool:
        taken.extend(world.numbers())
        return len(taken) == 50

    wait(all_came)
    sending.result(patience())
    assert taken == list(range(1, 51))
    assert not world.lost


def test_a_source_that_waits_too_long_loses_its_message() -> None:
    world = World(QueuePolicy(length=1, policy="block", timeout=0.01))
    world.takers[0]("first")
    world.takers[0]("second")
    assert world.numbers() == [1]
    assert world.lost == {"blocked-too-long": 1}


def test_what_comes_after_the_end_is_counted_and_a_source_that_waits_goes_on() -> None:
    world = World(QueuePolicy(length=1, policy="block", timeout=patience()))
    world.takers[0]("first")
    waiting = Background(lambda: world.takers[0]("second"))
    wait(lambda: world.functions[0].received == 2)
    world.arrivals.close()
    waiting.result(patience())
    world.takers[0]("third")
    assert world.numbers() == [1]
    assert world.lost == {"closed": 2}


def test_the_writer_is_woken_and_loses_nothing() -> None:
    world = World(QueuePolicy(length=100, policy="block", timeout=patience()), 4)
    taken: list[Any] = []

    def write() -> None:
        while not (world.arrivals.is_closed and not len(world.arrivals)):
            world.arrivals.wait(patience())
            taken.extend(world.arrivals.take_waiting())

    writing = Background(write)

    def send(taker: Any) -> None:
        for n in range(500):
            taker(n)

    senders = [threading.Thread(target=send, args=(taker,)) for taker in world.takers]
    for sender in senders:
        sender.start()
    for sender in senders:
        sender.join(patience())
    world.arrivals.close()
    writing.result(patience())
    for function in world.functions:
        mine = [number for owner, _, _, _, number in taken if owner is function]
        assert mine == list(range(1, 501))
    assert not world.lost
