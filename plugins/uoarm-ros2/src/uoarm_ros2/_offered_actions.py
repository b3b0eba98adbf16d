"""Actions that are offered: goals of ROS clients go to a function, which decides on each goal.

The function has the streams of an action, as those of the bridge: `goal` and `cancel` go in,
`status`, `feedback` and `result` come out with its own id of the goal. The status that answers a
goal carries that id, and goals are answered in their order; so they are handed over one at a time.
"""

from __future__ import annotations

import threading
import time
from collections import deque
from collections.abc import Callable
from typing import Any

from attrs import define

from uoarm.bridge import Channel, Sink, Source
from uoarm.errors import BridgeError, FailureReason, MessageError
from uoarm.model import Deliver, Endpoint, Message
from uoarm_ros2._conversion import reader, writer
from uoarm_ros2._middleware import GoalRequest, GoalServer, NodeRunner
from uoarm_ros2._services import ServedFunction
from uoarm_ros2._types import action_records, import_type

_MOST_WAITING = 256
_MOST_RUNNING = 1024
_MOST_EARLY = 64
_ANSWER_SECONDS = 10.0
_RESULT_SECONDS = 2.0
_ENDS = frozenset({"succeeded", "canceled", "aborted"})


@define(eq=False)
class _PendingGoal:
    """A goal that the function has not answered."""

    request: GoalRequest
    message: Message
    due: float = 0.0


@define(eq=False)
class _RunningGoal:
    """A goal that the function has accepted; `ended` with which status, while its result is due."""

    id: bytes
    ended: str = ""
    due: float = 0.0


class GoalTable:
    """Which goals wait, run and end, and what their clients are sent; from any thread.

    Every goal that was asked is answered, and every one that was accepted ends once: with what the
    function says; as aborted when it is `lost`, or when the offer goes; with the type's own values
    where the function says how a goal ended and gives no result within two seconds.
    """

    def __init__(self, server: GoalServer, clock: Callable[[], float] = time.monotonic) -> None:
        self._server = server
        self._clock = clock
        # Guards all tables, between the runner's thread (new goals, `tick`) and those in which the
        # function reports. The server is called under it, so that answers leave in the order of
        # decisions. Reentrant, as early reports are replayed within the report that accepts a goal.
        self._lock = threading.RLock()
        self._waiting: deque[_PendingGoal] = deque()
        self._asked: _PendingGoal | None = None
        self._running: dict[str, _RunningGoal] = {}
        self._names: dict[bytes, str] = {}
        self._early: deque[tuple[str, dict[str, Any]]] = deque(maxlen=_MOST_EARLY)
        self.takes_goals = False
        self.gives_results = False
        self.accepted = self.rejected = self.ended = 0

    def ask(self, request: GoalRequest, message: Message) -> None:
        """Have a goal wait for its turn, if there is room and a provider."""
        with self._lock:
            known = any(asked.request.id == request.id for asked in self._unanswered())
            has_room = len(self._waiting) < _MOST_WAITING and len(self._running) < _MOST_RUNNING
            if known or not has_room or not self.takes_goals:
                self._reject(request)
            else:
                self._waiting.append(_PendingGoal(request, message))

    def next(self) -> _PendingGoal | None:
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

    def receive_status(self, message: dict[str, Any]) -> None:
        """Take a status of a goal from the function."""
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

    def receive_feedback(self, message: dict[str, Any], native: Any) -> None:
        """Take feedback, as a native object."""
        with self._lock:
            goal = self._running.get(message["goal_id"])
            if goal is not None:
                self._server.feed(goal.id, native)
            elif self._asked is not None:
                self._early.append(("feedback", {**message, "native": native}))

    def receive_result(self, message: dict[str, Any], native: Any) -> None:
        """Take a result, as a native object; None: it cannot be made one."""
        name, status = message["goal_id"], message["status"]
        with self._lock:
            if name in self._running:
                ended = status if status in _ENDS and native is not None else "aborted"
                self._end(name, ended, native)
            elif self._asked is not None:
                self._early.append(("result", {**message, "native": native}))

    def tick(self) -> None:
        """Reject the goal that is not answered in time; end goals whose result is overdue."""
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

    def _unanswered(self) -> list[_PendingGoal]:
        return [*([] if self._asked is None else [self._asked]), *self._waiting]

    def _decide(self, asked: _PendingGoal, name: str, status: str, message: dict[str, Any]) -> None:
        if status in {"rejected", "lost"}:
            self._asked = None
            self._reject(asked.request)
        elif status == "accepted":
            self._asked = None
            self.accepted += 1
            self._running[name] = _RunningGoal(asked.request.id)
            self._names[asked.request.id] = name
            self._server.accept(asked.request)
            early = [pair for pair in self._early if pair[1]["goal_id"] == name]
            self._early.clear()
            for part, item in early:
                if part == "feedback":
                    self.receive_feedback(item, item["native"])
                elif part == "result":
                    self.receive_result(item, item["native"])
                else:
                    self.receive_status(item)
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


_LINGER_SECONDS = 2.0
_UNREAD_SECONDS = 30.0


class OfferedAction:
    """One action on the graph, shared by the channels of its parts.

    It outlives the last of them for two seconds, and for half a minute while clients have not asked
    for the results of what was aborted with it. An offer that is opened again meanwhile is the same
    server to them.

    Args:
        runner: where it is offered; goals and cancellations are handed over in its thread.
    """

    def __init__(self, runner: NodeRunner, name: str, type_name: str) -> None:
        goal, feedback, result = action_records(type_name)
        self.name = name
        self._runner = runner
        self._read_goal = reader(goal)
        self._write_feedback = writer(feedback)
        self._write_result = writer(result)
        self._parts: dict[str, Channel] = {}
        self._deliver: dict[str, Deliver] = {}
        self._unused_since = time.monotonic()
        native = import_type(type_name)
        self._server = runner.goal_server(
            native,
            name,
            self._take_goal,
            may_cancel=self._may_cancel,
            cancel=self._take_cancel,
        )
        self.goals = GoalTable(self._server)

    @property
    def is_unused(self) -> bool:
        """Whether no channel has used it for a while."""
        limit = _UNREAD_SECONDS if self._server.has_unread else _LINGER_SECONDS
        return not self._parts and time.monotonic() - self._unused_since > limit

    def join(self, part: str, channel: Channel, deliver: Deliver | None = None) -> None:
        """Have a channel take or give a part.

        Raises:
            BridgeError: another channel does so.
        """
        if part in self._parts:
            text = f"the {part} of action {self.name} is offered already"
            raise BridgeError(text, FailureReason.REFUSED)
        self._parts[part] = channel
        if deliver is not None:
            self._deliver[part] = deliver
        self._settle()

    def leave(self, part: str) -> None:
        """Take a part back; without its goals or their status, all goals end."""
        self._parts.pop(part, None)
        self._deliver.pop(part, None)
        self._settle()
        if not self.goals.takes_goals:
            self.goals.end_all()
        self._unused_since = time.monotonic()

    def send(self, part: str, message: Any) -> None:
        """Take a status, feedback or a result from the function.

        Raises:
            MessageError: feedback or a result that is none of its type; such a goal is aborted.
        """
        if part == "status":
            self.goals.receive_status(message)
            self._runner.call_soon(self._hand_over)
        elif part == "feedback":
            self.goals.receive_feedback(message, self._write_feedback(message["feedback"]))
        else:
            try:
                native = self._write_result(message["result"])
            except MessageError:
                self.goals.receive_result(message, None)
                raise
            self.goals.receive_result(message, native)

    def tick(self) -> None:
        """Look at the clock a few times a second, in the runner's thread."""
        self.goals.tick()
        self._hand_over()

    def destroy(self) -> None:
        """Put the server away."""
        self.goals.end_all()
        self._runner.discard(self._server)

    def _settle(self) -> None:
        self.goals.takes_goals = {"goal", "status"} <= set(self._parts)
        self.goals.gives_results = "result" in self._parts

    def _may_cancel(self, goal_id: bytes) -> bool:
        return "cancel" in self._deliver and self.goals.name(goal_id) is not None

    def _take_goal(self, request: GoalRequest) -> None:
        self.goals.ask(request, self._read_goal(request.goal))
        self._hand_over()

    def _take_cancel(self, goal_id: bytes) -> None:
        name, deliver = self.goals.name(goal_id), self._deliver.get("cancel")
        if name is not None and deliver is not None:
            deliver({"goal_id": name})

    def _hand_over(self) -> None:
        """Hand over goals until one is unanswered; in the runner's thread alone."""
        while (asked := self.goals.next()) is not None:
            deliver = self._deliver.get("goal")
            if deliver is not None:
                deliver(asked.message)


class OfferedSource(Source):
    """Goals or cancellations of ROS clients."""

    def __init__(
        self, endpoint: Endpoint, action: OfferedAction, part: str, deliver: Deliver
    ) -> None:
        super().__init__(endpoint)
        self._action = action
        self._part = part
        action.join(part, self, deliver)

    def facts(self) -> dict[str, object]:
        """Return how many goals wait, run, and were accepted, rejected and ended."""
        return self._action.goals.facts()

    def _close(self) -> None:
        self._action.leave(self._part)


class OfferedSink(Sink):
    """Status, feedback or results, for ROS clients."""

    blocking = False

    def __init__(self, endpoint: Endpoint, action: OfferedAction, part: str) -> None:
        super().__init__(endpoint)
        self._action = action
        self._part = part
        action.join(part, self)

    def _send(self, message: Message) -> None:
        """Send it to the clients; what concerns no goal of theirs is dropped.

        Raises:
            MessageError: it does not fit the native type.
        """
        self._action.send(self._part, message)

    def _close(self) -> None:
        self._action.leave(self._part)


class OfferedCall(ServedFunction[tuple[bytes, Message]]):
    """A service of a function as an action: its reply is the result, and there is no feedback.

    Goals are accepted while there is room. One that fails is aborted; a call cannot be cancelled.
    """

    def _serve(self, type_name: str) -> None:
        goal, _, result = action_records(type_name)
        self._read = reader(goal)
        self._write = writer(result)
        # Guards the goals that run, between the runner's thread, those that handle, and `close`:
        # each is ended once.
        self._lock = threading.Lock()
        self._running: set[bytes] = set()
        self._server = self._runner.goal_server(
            import_type(type_name),
            self._name,
            self._ask,
            may_cancel=lambda _: False,
            cancel=lambda _: None,
        )

    def _close(self) -> None:
        self.requests.close()
        for goal_id in list(self._running):
            self._end(goal_id, "aborted")
        self._runner.discard(self._server)

    def _ask(self, request: GoalRequest) -> None:
        if self._closed or self.requests.is_full:
            self._server.reject(request)
            return
        self._server.accept(request)
        self._running.add(request.id)
        self.requests.put((request.id, self._read(request.goal)))

    def _answer(self, request: tuple[bytes, Message]) -> None:
        goal_id, goal = request
        self._end(goal_id, "succeeded", self._write(self._handler(goal)))

    def _refuse(self, request: tuple[bytes, Message], error: Exception) -> None:
        del error  # ROS 2 has no word for it; the status of the offer has
        self._end(request[0], "aborted")

    def _end(self, goal_id: bytes, status: str, result: Any = None) -> None:
        with self._lock:
            is_first = goal_id in self._running
            self._running.discard(goal_id)
        if is_first:
            self._server.end(goal_id, status, result)
