"""Inboxes: one reader, by taking or by callback, and an end that is reported."""

from __future__ import annotations

import threading
from collections.abc import Callable
from typing import Any

import pytest

from uoarm._dataplane import Inbox, QueueClosed
from uoarm.errors import UsageError
from uoarm.model import Message, QueuePolicy
from uoarm.testing import patience


def make(length: int = 8) -> tuple[Inbox, list[str]]:
    drops: list[str] = []
    return Inbox(QueuePolicy(length), drops.append), drops


def test_messages_wait_until_they_are_taken() -> None:
    inbox, _ = make()
    inbox.put(1)
    inbox.put(2)
    assert [inbox.get(0), inbox.get(0)] == [1, 2]


def test_nothing_in_time_is_a_timeout() -> None:
    inbox, _ = make()
    with pytest.raises(TimeoutError, match=r"no message within 0\.01 s"):
        inbox.get(0.01)


def test_a_callback_first_receives_what_waits() -> None:
    inbox, drops = make()
    seen: list[Message] = []
    inbox.put(1)
    end = inbox.subscribe(seen.append)
    inbox.put(2)
    end()
    inbox.put(3)
    assert seen == [1, 2]
    assert inbox.get(0) == 3
    assert not drops


def test_callbacks_of_two_inboxes_may_end_both_subscriptions_at_once() -> None:
    inboxes, both = (make()[0], make()[0]), threading.Barrier(2)
    ends: list[Callable[[], None]] = []

    def take(message: Message) -> None:
        both.wait(patience())
        for end in ends[::message]:
            end()

    ends += [inbox.subscribe(take) for inbox in inboxes]
    threads = [
        threading.Thread(target=inbox.put, args=(direction,), daemon=True)
        for inbox, direction in zip(inboxes, (1, -1), strict=True)
    ]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join(patience())
    assert not any(thread.is_alive() for thread in threads)


def test_one_cannot_take_while_callbacks_receive() -> None:
    inbox, _ = make()
    inbox.subscribe(lambda _: None)
    with pytest.raises(UsageError, match="callbacks receive"):
        inbox.get(0)


def test_a_callback_that_raises_is_logged_once_and_stays(caplog: pytest.LogCaptureFixture) -> None:
    inbox, _ = make()
    seen: list[Message] = []

    def fail(message: Message) -> None:
        seen.append(message)
        raise ValueError("no")

    inbox.subscribe(fail)
    others: list[Message] = []
    inbox.subscribe(others.append)
    for message in range(3):
        inbox.put(message)
    assert seen == others == [0, 1, 2]
    assert len(caplog.records) == 1


def test_closing_leaves_what_waits_readable_unless_discarded() -> None:
    inbox, drops = make()
    inbox.put(1)
    inbox.close()
    assert inbox.get() == 1
    with pytest.raises(QueueClosed):
        inbox.get()
    other, lost = make()
    other.put(1)
    other.close(discard=True)
    with pytest.raises(QueueClosed):
        other.get()
    assert (drops, lost) == ([], ["closed"])


class _Before:
    """A lock or a queue, before whose first use something else happens."""

    def __init__(self, real: Any, happens: Callable[[], object]) -> None:
        self._real = real
        self._happens: list[Callable[[], object]] = [happens]

    def put(self, message: Message) -> None:
        self._now()
        self._real.put(message)

    def __getattr__(self, name: str) -> Any:
        return getattr(self._real, name)

    def __enter__(self) -> Any:
        self._now()
        return self._real.__enter__()

    def __exit__(self, *error: object) -> None:
        self._real.__exit__(*error)

    def _now(self) -> None:
        if self._happens:
            self._happens.pop()()


def test_a_message_that_comes_as_the_first_callback_does_is_not_left_behind(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    inbox, drops = make()
    seen: list[Message] = []
    before = _Before(inbox._queue, lambda: inbox.subscribe(seen.append))
    monkeypatch.setattr(inbox, "_queue", before)
    inbox.put(1)
    assert (seen, drops) == ([1], [])


def test_a_message_that_comes_as_the_last_callback_leaves_waits(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    inbox, drops = make()
    seen: list[Message] = []
    end = inbox.subscribe(seen.append)
    monkeypatch.setattr(inbox, "_lock", _Before(inbox._lock, end))
    inbox.put(1)
    assert inbox.get(0) == 1
    assert (seen, drops) == ([], [])
