"""The queue between the thread of a framework and the thread of a channel."""

from __future__ import annotations

import math
import threading
import time

from uoarm.bridge import ReceiveQueue
from uoarm.testing import patience, wait


class Taker:
    """Takes things; the first is held until it may go on."""

    def __init__(self) -> None:
        self.taken: list[int] = []
        self.begun = threading.Event()
        self.may_go_on = threading.Event()

    def __call__(self, thing: int) -> None:
        self.begun.set()
        assert self.may_go_on.wait(patience())
        self.taken.append(thing)


def test_what_waits_is_bounded_and_the_oldest_are_dropped_and_counted() -> None:
    taker, dropped = Taker(), list[int]()
    queue = ReceiveQueue("q", taker, 2, dropped=dropped.append)
    queue.put(0)
    assert taker.begun.wait(patience())
    for thing in (1, 2, 3, 4):
        queue.put(thing)
    assert (len(queue), queue.dropped, dropped) == (2, 2, [1, 2])
    taker.may_go_on.set()
    wait(lambda: taker.taken == [0, 3, 4])
    queue.close()


def test_what_is_large_makes_room_but_the_newest_is_always_kept() -> None:
    taker = Taker()
    queue = ReceiveQueue("q", taker, 10, most_size=10, size=lambda thing: thing)
    queue.put(1)
    assert taker.begun.wait(patience())
    for thing in (4, 5, 6, 99):
        queue.put(thing)
    assert (len(queue), queue.dropped) == (1, 3)
    taker.may_go_on.set()
    wait(lambda: taker.taken == [1, 99])
    queue.put(10)
    wait(lambda: taker.taken == [1, 99, 10])
    assert queue.dropped == 3, "what was taken has no size any more"
    queue.close()


def test_a_close_waits_for_nothing_and_ends_the_thread() -> None:
    taker = Taker()
    queue = ReceiveQueue("ends with its queue", taker, 10)
    queue.put(0)
    assert taker.begun.wait(patience())
    queue.put(1)
    queue.close()
    queue.put(2)
    taker.may_go_on.set()
    wait(lambda: all(thread.name != "ends with its queue" for thread in threading.enumerate()))
    assert taker.taken == [0]


def test_a_take_may_close_the_queue() -> None:
    ended = threading.Event()

    def take(_: int) -> None:
        queue.close()
        ended.set()

    queue = ReceiveQueue("q", take, 10)
    queue.put(0)
    assert ended.wait(patience())


def test_it_wakes_at_the_time_that_it_was_given_and_when_it_is_poked() -> None:
    woken, due = list[float](), [time.monotonic() + 0.01]

    def wake() -> float | None:
        woken.append(time.monotonic())
        return due.pop() if due else None

    queue = ReceiveQueue[int]("q", lambda _: None, 1, wake=wake)
    wait(lambda: len(woken) == 2)
    assert woken[1] - woken[0] > 0
    queue.poke()
    wait(lambda: len(woken) == 3)
    queue.put(0)
    wait(lambda: len(woken) == 4)
    due.append(math.inf)
    queue.poke()
    wait(lambda: len(woken) == 5)
    queue.poke()
    wait(lambda: len(woken) == 6)
    queue.close()
