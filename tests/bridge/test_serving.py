"""Requests for an offered function: some at a time, the rest waits, and each has one end."""

from __future__ import annotations

import threading
from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager

import pytest
from hypothesis import given
from hypothesis import strategies as st

from uoarm.bridge import ServedRequests
from uoarm.model import Health
from uoarm.testing import patience, wait


class Function:
    """Handles numbers; odd ones fail, and each waits until it may end."""

    kind: type[BaseException] = ValueError

    def __init__(self, at_once: int, most: int = 256, *, is_open: bool = True) -> None:
        self.answered: list[int] = []
        self.refused: list[tuple[int, str]] = []
        self.reports: list[tuple[Health, str]] = []
        self.begun = threading.Semaphore(0)
        self.gate = threading.Event()
        self.most_inside = self._inside = 0
        self._lock = threading.Lock()
        if is_open:
            self.gate.set()
        self.requests: ServedRequests[int] = ServedRequests(
            "service /a",
            self.handle,
            lambda request, error: self.refused.append((request, str(error))),
            at_once,
            lambda health, cause: self.reports.append((health, cause)),
            most=most,
        )

    def handle(self, request: int) -> None:
        with self._lock:
            self._inside += 1
            self.most_inside = max(self.most_inside, self._inside)
        self.begun.release()
        assert self.gate.wait(patience())
        with self._lock:
            self._inside -= 1
        if request % 2:
            raise self.kind(f"{request} is odd")
        self.answered.append(request)

    def wait_begun(self, count: int) -> None:
        for _ in range(count):
            assert self.begun.acquire(timeout=patience())


@contextmanager
def function(at_once: int, most: int = 256, *, is_open: bool = True) -> Iterator[Function]:
    made = Function(at_once, most, is_open=is_open)
    try:
        yield made
    finally:
        made.gate.set()
        made.requests.close()


def test_so_many_are_handled_at_once_and_the_rest_is_not_lost() -> None:
    with function(3, is_open=False) as served:
        for number in range(0, 20, 2):
            served.requests.put(number)
        served.wait_begun(3)
        assert served.requests.facts()["waiting"] == 7
        served.gate.set()
        wait(lambda: served.requests.facts()["answered"] == 10)
    assert served.most_inside == 3
    assert sorted(served.answered) == list(range(0, 20, 2))
    assert served.reports == []


def test_what_finds_no_room_is_refused_and_the_framework_does_not_wait() -> None:
    with function(1, 2, is_open=False) as served:
        served.requests.put(0)
        served.wait_begun(1)
        for number in (2, 4, 6):
            assert served.requests.is_full is (number == 6)
            served.requests.put(number)
        assert served.refused == [(6, "2 requests wait already")]
        served.gate.set()
        wait(lambda: served.answered == [0, 2, 4])
        assert served.requests.facts()["refused"] == 1


@pytest.mark.parametrize("kind", [ValueError, SystemExit])
def test_one_that_fails_is_refused_and_reported_until_one_succeeds(
    kind: type[BaseException],
) -> None:
    with function(1) as served:
        served.kind = kind
        for number in (1, 3, 4):
            served.requests.put(number)
        wait(lambda: served.requests.facts()["answered"] == 1)
        wait(lambda: len(served.reports) == 2)
        assert [request for request, _ in served.refused] == [1, 3]
        assert served.refused[0][1].endswith("1 is odd")
        assert served.requests.facts()["failed"] == 2
    assert served.reports == [
        (Health.DEGRADED, f"refused: service /a: {kind.__name__}: 1 is odd"),
        (Health.OK, "service /a: a message passed"),
    ]


def test_a_client_that_cannot_be_refused_ends_no_thread() -> None:
    answered = threading.Event()

    def handle(request: int) -> None:
        if request:
            raise ValueError
        answered.set()

    def refuse(request: int, error: Exception) -> None:
        raise OSError("it is gone")

    requests: ServedRequests[int] = ServedRequests("a", handle, refuse, 1, lambda *_: None)
    requests.put(1)
    requests.put(0)
    assert answered.wait(patience())


def test_what_waits_is_withdrawn_and_what_is_handled_is_named() -> None:
    with function(1, is_open=False) as served:
        for number in (0, 2, 4):
            served.requests.put(number)
        served.wait_begun(1)
        assert served.requests.withdraw(lambda number: number in {0, 4}) == ([4], [0])
        served.gate.set()
        wait(lambda: served.requests.facts()["answered"] == 2)
    assert served.answered == [0, 2]


def test_nothing_is_handled_or_reported_once_it_is_closed() -> None:
    with function(1, is_open=False) as served:
        served.requests.put(1)
        served.requests.put(2)
        served.wait_begun(1)
        served.requests.close()
        served.requests.put(4)
        served.gate.set()
        wait(lambda: len(served.refused) == 2)
    assert sorted(served.refused) == [(1, "1 is odd"), (4, "it is closed")]
    assert (served.answered, served.reports) == ([], [])


@given(
    at_once=st.integers(1, 4),
    most=st.integers(1, 8),
    callers=st.lists(st.lists(st.integers(0, 99), max_size=8), min_size=1, max_size=4),
)
def test_each_request_has_one_end_whichever_threads_bring_them(
    at_once: int, most: int, callers: list[list[int]]
) -> None:
    with function(at_once, most) as served:
        threads = [
            threading.Thread(target=lambda mine=mine: [*map(served.requests.put, mine)])
            for mine in callers
        ]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join(patience())
        every = Counter(number for mine in callers for number in mine)
        wait(lambda: len(served.answered) + len(served.refused) == every.total())
        assert Counter(served.answered) + Counter(number for number, _ in served.refused) == every
        assert served.most_inside <= at_once
