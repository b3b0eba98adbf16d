"""Bounded queues: order, policies, closing, and that nothing is lost without being counted."""

from __future__ import annotations

import threading
from collections import Counter
from contextlib import suppress
from queue import Empty

import pytest
from hypothesis import given
from hypothesis import strategies as st

from uoarm._dataplane import BoundedQueue, QueueClosed
from uoarm.errors import ConfigurationError
from uoarm.model import OverflowPolicy, QueuePolicy
from uoarm.testing import patience


def make(
    length: int, policy: OverflowPolicy, timeout: float = 0.01
) -> tuple[BoundedQueue[int], Counter[str]]:
    drops: Counter[str] = Counter()

    def count(reason: str) -> None:
        drops[reason] += 1

    return BoundedQueue(QueuePolicy(length, policy, timeout), count), drops


def drained(queue: BoundedQueue[int]) -> list[int]:
    items = []
    while True:
        try:
            items.append(queue.get(0))
        except (Empty, QueueClosed):
            return items


@given(st.integers(1, 5), st.lists(st.integers(), max_size=20))
def test_drop_oldest_keeps_the_newest_in_order_and_counts_the_rest(
    length: int, items: list[int]
) -> None:
    queue, drops = make(length, OverflowPolicy.DROP_OLDEST)
    for item in items:
        queue.put(item)
    assert drained(queue) == items[-length:]
    assert drops["queue-full"] == max(0, len(items) - length)


@given(st.lists(st.integers(), min_size=1, max_size=20))
def test_latest_holds_one_whatever_its_length_says(items: list[int]) -> None:
    queue, drops = make(7, OverflowPolicy.LATEST)
    for item in items:
        queue.put(item)
    assert drained(queue) == items[-1:]
    assert drops["replaced"] == len(items) - 1


def test_block_gives_up_after_its_timeout_and_counts_the_new_message() -> None:
    queue, drops = make(1, OverflowPolicy.BLOCK)
    queue.put(1)
    queue.put(2)
    assert drained(queue) == [1]
    assert drops == {"blocked-too-long": 1}


def test_block_lets_the_producer_on_as_soon_as_there_is_room() -> None:
    queue, drops = make(1, OverflowPolicy.BLOCK, timeout=patience())
    queue.put(1)
    producer = threading.Thread(target=queue.put, args=(2,))
    producer.start()
    assert [queue.get(patience()), queue.get(patience())] == [1, 2]
    producer.join(patience())
    assert not producer.is_alive()
    assert not drops


def test_closing_frees_a_blocked_producer_and_counts_its_message() -> None:
    queue, drops = make(1, OverflowPolicy.BLOCK, timeout=patience())
    queue.put(1)
    producer = threading.Thread(target=queue.put, args=(2,))
    producer.start()
    queue.close(discard=False)
    producer.join(patience())
    assert not producer.is_alive()
    assert drained(queue) == [1]
    assert drops == {"closed": 1}


def test_closing_frees_a_waiting_reader() -> None:
    queue, _ = make(1, OverflowPolicy.BLOCK)
    seen: list[str] = []

    def read() -> None:
        try:
            queue.get()
        except QueueClosed:
            seen.append("closed")

    reader = threading.Thread(target=read)
    reader.start()
    queue.close(discard=True)
    reader.join(patience())
    assert seen == ["closed"]


def test_discarding_counts_what_was_inside() -> None:
    queue, drops = make(5, OverflowPolicy.DROP_OLDEST)
    for item in range(3):
        queue.put(item)
    queue.close(discard=True)
    assert drops == {"closed": 3}
    with pytest.raises(QueueClosed):
        queue.get()


def test_drain_waits_until_taken_items_are_done() -> None:
    queue, _ = make(5, OverflowPolicy.DROP_OLDEST)
    queue.put(1)
    queue.get()
    assert not queue.drain(0.01)
    queue.done()
    assert queue.drain(0.01)


def test_replaced_items_do_not_hold_up_a_drain() -> None:
    queue, _ = make(1, OverflowPolicy.LATEST)
    for item in range(5):
        queue.put(item)
    queue.get()
    queue.done()
    assert queue.drain(0.01)


@pytest.mark.parametrize("policy", list(OverflowPolicy))
def test_two_threads_lose_nothing_uncounted(policy: OverflowPolicy) -> None:
    queue, drops = make(3, policy, timeout=patience())
    total = 2000
    got: list[int] = []

    def read() -> None:
        while True:
            try:
                got.append(queue.get(patience()))
            except QueueClosed:
                return

    reader = threading.Thread(target=read)
    reader.start()
    for item in range(total):
        queue.put(item)
    queue.close(discard=False)
    reader.join(patience())
    assert got == sorted(got)
    assert len(got) + sum(drops.values()) == total


sized = st.lists(st.one_of(st.integers(1, 40), st.just("get")), max_size=40)


@given(sized, st.sampled_from([OverflowPolicy.DROP_OLDEST, OverflowPolicy.LATEST]))
def test_what_waits_is_bounded_in_octets_too_and_every_loss_is_counted(
    plan: list[int | str], policy: OverflowPolicy
) -> None:
    """Each number is an item of so many octets."""
    drops: Counter[str] = Counter()
    queue: BoundedQueue[int] = BoundedQueue(
        QueuePolicy(5, policy, octets=50), lambda reason: drops.update([reason]), measure=int
    )
    waiting: list[int] = []
    expected: Counter[str] = Counter()
    length = 1 if policy is OverflowPolicy.LATEST else 5
    for step in plan:
        if isinstance(step, str):
            with suppress(Empty):
                assert queue.get(0) == waiting.pop(0)
        else:
            queue.put(step)
            while waiting and (len(waiting) >= length or sum(waiting) + step > 50):
                full = len(waiting) >= length
                expected[
                    "replaced" if length == 1 else "queue-full" if full else "queue-octets"
                ] += 1
                waiting.pop(0)
            waiting.append(step)
        assert queue.octets == sum(waiting)
        assert drops == expected
    assert drained(queue) == waiting


def test_a_producer_waits_for_octets_too() -> None:
    drops: Counter[str] = Counter()
    policy = QueuePolicy(5, OverflowPolicy.BLOCK, timeout=0.01, octets=50)
    queue: BoundedQueue[int] = BoundedQueue(policy, lambda item: drops.update([item]), measure=int)
    queue.put(70)
    queue.put(1)
    assert drops == {"blocked-too-long": 1}
    assert drained(queue) == [70]


def test_items_that_a_reader_keeps_up_with_are_not_measured() -> None:
    measured: list[int] = []

    def measure(item: int) -> int:
        measured.append(item)
        return 1

    queue: BoundedQueue[int] = BoundedQueue(QueuePolicy(5), lambda _: None, measure)
    for item in range(10):
        queue.put(item)
        assert queue.get() == item
    assert not measured


def test_a_policy_may_be_named_and_an_unknown_name_is_refused_with_the_choices() -> None:
    assert QueuePolicy(policy="block").policy is OverflowPolicy.BLOCK
    text = "policy 'blok': expected latest, drop-oldest or block; did you mean 'block'"
    with pytest.raises(ConfigurationError, match=text):
        QueuePolicy(policy="blok")
