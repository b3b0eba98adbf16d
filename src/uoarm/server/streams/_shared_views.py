"""What is made of the whole robot: beside the loop, and once for all who ask at the same time."""

from __future__ import annotations

import asyncio
import threading
import time
from collections import deque
from collections.abc import Callable, Collection, Hashable, Mapping
from typing import Any, TypeAlias, TypeVar

from uoarm._workers import WorkerPool
from uoarm.server._failures import BusyError
from uoarm.server.streams._loop_mailbox import LoopMailbox

__all__ = ["Make", "SharedViews"]

Q = TypeVar("Q", bound=Hashable)
A = TypeVar("A")
Make: TypeAlias = Callable[[Collection[Q]], Mapping[Q, A | Exception]]
"""Answers different questions from one look at the robot, in the thread of the views."""

_AT_ONCE = 2
_LONG_SECONDS = 0.005
_MOST_REST_SECONDS = 0.25


class SharedViews:
    """Answers questions whose cost grows with the robot, so that the loop does not do that work.

    An answer is never of before its question: what is asked while a view is being made waits for
    the next one, together with everything else that is asked until that begins. So however many
    clients ask, each view is made twice at most for all of them.

    There is one thread, since several would only take the interpreter's lock from the loop; it
    rests as long as it has worked. The loop hands out a few answers in each of its turns, since a
    client may get much with each.

    Args:
        mailbox: brings answers back into the loop.
    """

    def __init__(self, mailbox: LoopMailbox) -> None:
        self._mailbox = mailbox
        self._pool = WorkerPool("uoarm-serve-view", 1)
        # Held between the loop, which adds questions, and the thread, which takes all of a view:
        # one that was added later than that must not be lost.
        self._lock = threading.Lock()
        self._asked: dict[Make[Any, Any], dict[Any, list[asyncio.Future[Any]]]] = {}
        self._answered: deque[tuple[asyncio.Future[Any], Any]] = deque()
        self._closed = threading.Event()

    def get(self, make: Make[Q, A], question: Q) -> asyncio.Future[A]:
        """Return the answer to a question; from the loop's thread.

        Args:
            make: answers all questions that have come; the same for all who shall share it. An
                exception in the place of an answer is raised to who asked that.
            question: what is asked.

        Raises:
            BusyError: the server is closing.
        """
        if self._pool.closed:
            raise BusyError("the server is closing")
        future: asyncio.Future[A] = asyncio.get_running_loop().create_future()
        with self._lock:
            is_new = make not in self._asked
            self._asked.setdefault(make, {}).setdefault(question, []).append(future)
        if is_new:
            self._pool.submit(lambda: self._make(make))
        return future

    def close(self) -> None:
        """Make nothing more; who waits gets a BusyError."""
        self._closed.set()
        self._pool.close()
        with self._lock:
            asked, self._asked = self._asked, {}
        for questions in asked.values():
            error = BusyError("the server is closing")
            self._take(questions, dict.fromkeys(questions, error))

    def _make(self, make: Make[Any, Any]) -> None:
        with self._lock:
            questions = self._asked.pop(make, {})
        began = time.perf_counter()
        answers: Mapping[Any, Any]
        try:
            answers = make(questions.keys())
        except BaseException as error:  # noqa: BLE001 - raised to those who asked
            answers = dict.fromkeys(questions, error)
        self._mailbox.put(lambda: self._take(questions, answers))
        took = time.perf_counter() - began
        if took > _LONG_SECONDS:
            self._closed.wait(min(took, _MOST_REST_SECONDS))

    def _take(
        self, questions: Mapping[Any, list[asyncio.Future[Any]]], answers: Mapping[Any, Any]
    ) -> None:
        is_idle = not self._answered
        self._answered.extend(
            (future, answers[question])
            for question, futures in questions.items()
            for future in futures
        )
        if is_idle:
            self._hand_out()

    def _hand_out(self) -> None:
        """Wake some of those who wait, and the others in the loop's next turns."""
        for _ in range(min(_AT_ONCE, len(self._answered))):
            future, answer = self._answered.popleft()
            if future.done():  # its client has gone
                continue
            if isinstance(answer, BaseException):
                future.set_exception(answer)
            else:
                future.set_result(answer)
        if self._answered:
            asyncio.get_running_loop().call_soon(self._hand_out)
