"""The goals of one action that is offered: which wait, run and end, and what clients are told."""

from __future__ import annotations

import threading
import time
from collections import deque
from collections.abc import Callable
from typing import Any, Protocol

from attrs import define

from uoarm.model import Message
from uoarm_ros2._middleware import GoalRequest

__all__ = ["GoalTable"]

_MOST_WAITING = 256
_MOST_RUNNING = 1024
_MOST_EARLY = 64
_ANSWER_SECONDS = 10.0
_RESULT_SECONDS = 2.0
_ENDS = frozenset({"succeeded", "canceled", "aborted"})


class Server(Protocol):
    """What tells clients of their goals."""

    def accept(self, request: GoalRequest) -> None:
        """Answer a goal's client that it is accepted."""

    def reject(self, request: GoalRequest) -> None:
        """Answer a goal's client that it is rejected."""

    def feed(self, goal_id: bytes, feedback: Any) -> None:
        """Publish feedback."""

    def end(self, goal_id: bytes, status: str, result: Any = None) -> None:
        """End a goal with its result."""


@define(eq=False)
class _Asked:
    """A goal that the function has not answered."""

    request: GoalRequest
    message: Message
    due: float = 0.0


@define(eq=False)
class _Running:
    """A goal that the function has accepted; `ended` with which status, while its result is due."""

    id: bytes
    ended: str = ""
    due: float = 0.0


class GoalTable:
    """Which goals wait, run and end, and what their clients are told; from any thread.

    Every goal that was asked is answered, and every one that was accepted ends once: with what the
    function says; as aborted when it is `lost`, or when the offer goes; with the type's own values
    where the function says how a goal ended and gives no result within two seconds.

    Args:
        server: tells the clients.
        clock: a monotonic clock, in seconds.
    """

    def __init__(self, server: Server, clock: Callable[[], float] = time.monotonic) -> None:
        self._server = server
        self._clock = clock
        self._lock = threading.RLock()
        self._waiting: deque[_Asked] = deque()
        self._asked: _Asked | None = None
        self._running: dict[str, _Running] = {}
        self._names: dict[bytes, str] = {}
        self._early: deque[tuple[str, dict[str, Any]]] = deque(maxlen=_MOST_EARLY)
        self.takes_goals = False
        self.gives_results = False
        self.accepted = self.rejected = self.ended = 0

    def ask(self, request: GoalRequest, message: Message) -> None:
        """Have a goal wait for its turn, if there is room and somebody to take it."""
        with self._lock:
            known = any(asked.request.id == request.id for asked in self._unanswered())
            has_room = len(self._waiting) < _MOST_WAITING and len(self._running) < _MOST_RUNNING
            if known or not has_room or not self.takes_goals:
                self._reject(request)
            else:
                self._waiting.append(_Asked(request, message))

    def next(self) -> _Asked | None:
        """Return the goal to hand over now; None while one is unanswered, or none waits."""
        with self._lock:
            if self._asked is not None or not self._waiting:
                return None
            self._asked = self._waiting.popleft()
            self._asked.due = self._clock() + _ANSWER_SECONDS
            self._early.clear()
            return self._asked

    def name(self, goal_id: bytes) -> str | None:
        """Return how the function calls a goal that has not ended; None: there is none."""
        return self._names.get(goal_id)

    def hear_status(self, message: dict[str, Any]) -> None:
        """Take what the function says of how a goal stands."""
        name, status = message["goal_id"], message["status"]
        with self._lock:
            goal = self._running.get(name)
            if goal is not None and status == "lost":
                self._end(name, "aborted")
            elif goal is not None and status in _ENDS and not self.gives_results:
                self._end(name, status)
            elif goal is not None and status in _ENDS:
                goal.ended, goal.due = status, self._clock() + _RESULT_SECONDS
            elif goal is None and self._asked is not None:
                self._decide(self._asked, name, status, message)

    def hear_feedback(self, message: dict[str, Any], native: Any) -> None:
        """Take feedback, as a native object."""
        with self._lock:
            goal = self._running.get(message["goal_id"])
            if goal is not None:
                self._server.feed(goal.id, native)
            elif self._asked is not None:
                self._early.append(("feedback", {**message, "native": native}))

    def hear_result(self, message: dict[str, Any], native: Any) -> None:
        """Take a result, as a native object; None: it cannot be made one."""
        name, status = message["goal_id"], message["status"]
        with self._lock:
            if name in self._running:
                ended = status if status in _ENDS and native is not None else "aborted"
                self._end(name, ended, native)
            elif self._asked is not None:
                self._early.append(("result", {**message, "native": native}))

    def tick(self) -> None:
        """Look at the clock: what is not answered in time is rejected, what has ended ends."""
        now = self._clock()
        with self._lock:
            if self._asked is not None and now >= self._asked.due:
                self._reject(self._asked.request)
                self._asked = None
            late = [item for item in self._running.items() if item[1].ended and now >= item[1].due]
            for name, goal in late:
                self._end(name, goal.ended)

    def end_all(self) -> None:
        """Reject what is unanswered and abort what runs."""
        with self._lock:
            for asked in self._unanswered():
                self._reject(asked.request)
            self._waiting.clear()
            self._asked = None
            for name in list(self._running):
                self._end(name, "aborted")

    def facts(self) -> dict[str, object]:
        """Return how many goals there are and were."""
        return {
            "waiting": len(self._waiting) + (self._asked is not None),
            "running": len(self._running),
            "accepted": self.accepted,
            "rejected": self.rejected,
            "ended": self.ended,
        }

    def _unanswered(self) -> list[_Asked]:
        return [*([] if self._asked is None else [self._asked]), *self._waiting]

    def _decide(self, asked: _Asked, name: str, status: str, message: dict[str, Any]) -> None:
        if status in {"rejected", "lost"}:
            self._asked = None
            self._reject(asked.request)
        elif status == "accepted":
            self._asked = None
            self.accepted += 1
            self._running[name] = _Running(asked.request.id)
            self._names[asked.request.id] = name
            self._server.accept(asked.request)
            early = [pair for pair in self._early if pair[1]["goal_id"] == name]
            self._early.clear()
            for part, item in early:
                if part == "feedback":
                    self.hear_feedback(item, item["native"])
                elif part == "result":
                    self.hear_result(item, item["native"])
                else:
                    self.hear_status(item)
        else:
            self._early.append(("status", message))

    def _reject(self, request: GoalRequest) -> None:
        self.rejected += 1
        self._server.reject(request)

    def _end(self, name: str, status: str, result: Any = None) -> None:
        goal = self._running.pop(name)
        self._names.pop(goal.id, None)
        self.ended += 1
        self._server.end(goal.id, status, result)
