"""Actions that are offered: goals of ROS clients go to a function, which says what becomes of them.

The function has the streams of an action, as those of the bridge: `goal` and `cancel` go in,
`status`, `feedback` and `result` come out with its own id of the goal. It tells that id with the
status that answers a goal, and answers goals in their order; so they are handed over one at a time.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

from uoarm.bridge import Channel, Handler, Sink, Source
from uoarm.errors import BridgeError, FailureReason, MessageError
from uoarm.model import Deliver, Endpoint, Health, Message
from uoarm_ros2._action_types import records
from uoarm_ros2._goal_table import GoalTable
from uoarm_ros2._middleware import GoalRequest, Station
from uoarm_ros2._read import reader
from uoarm_ros2._services import Workers
from uoarm_ros2._types import import_type
from uoarm_ros2._write import writer

__all__ = ["OfferedAction", "OfferedCall", "OfferedSink", "OfferedSource"]

_LINGER_SECONDS = 2.0
_UNREAD_SECONDS = 30.0


class OfferedAction:
    """One action on the graph, shared by the channels of its parts.

    It outlives the last of them for two seconds, and for half a minute while clients have not asked
    for the results of what was aborted with it. An offer that is opened again meanwhile is the same
    server to them.

    Args:
        station: where it is offered; goals and cancellations are handed over in its thread.
        name: the full name.
        type_name: the action's type.
    """

    def __init__(self, station: Station, name: str, type_name: str) -> None:
        goal, feedback, result = records(type_name)
        self.name = name
        self._station = station
        self._read_goal = reader(goal)
        self._write_feedback = writer(feedback)
        self._write_result = writer(result)
        self._parts: dict[str, Channel] = {}
        self._deliver: dict[str, Deliver] = {}
        self._unused_since = time.monotonic()
        native = import_type(type_name)
        self._server = station.goal_server(
            native,
            name,
            self._take_goal,
            may_cancel=lambda goal_id: "cancel" in self._deliver and self._knows(goal_id),
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
        """Take what the function says.

        Raises:
            MessageError: feedback or a result that is none of its type; such a goal is aborted.
        """
        if part == "status":
            self.goals.hear_status(message)
            self._station.call_soon(self._hand_over)
        elif part == "feedback":
            self.goals.hear_feedback(message, self._write_feedback(message["feedback"]))
        else:
            try:
                native = self._write_result(message["result"])
            except MessageError:
                self.goals.hear_result(message, None)
                raise
            self.goals.hear_result(message, native)

    def tick(self) -> None:
        """Look at the clock a few times a second, in the station's thread."""
        self.goals.tick()
        self._hand_over()

    def destroy(self) -> None:
        """Put the server away."""
        self.goals.end_all()
        self._station.discard(self._server)

    def _settle(self) -> None:
        self.goals.takes_goals = {"goal", "status"} <= set(self._parts)
        self.goals.gives_results = "result" in self._parts

    def _knows(self, goal_id: bytes) -> bool:
        return self.goals.name(goal_id) is not None

    def _take_goal(self, request: GoalRequest) -> None:
        self.goals.ask(request, self._read_goal(request.goal))
        self._hand_over()

    def _take_cancel(self, goal_id: bytes) -> None:
        name, deliver = self.goals.name(goal_id), self._deliver.get("cancel")
        if name is not None and deliver is not None:
            deliver({"goal_id": name})

    def _hand_over(self) -> None:
        """Hand over goals until one is unanswered; in the station's thread alone."""
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
        """Tell the clients; what concerns no goal of theirs goes nowhere.

        Raises:
            MessageError: it does not fit the native type.
        """
        self._action.send(self._part, message)

    def _close(self) -> None:
        self._action.leave(self._part)


class OfferedCall(Workers):
    """A service of a function as an action: its reply is the result, and there is no feedback.

    Goals are accepted while there is room. One that fails is aborted; a call cannot be cancelled.

    Args:
        station: where it is offered.
        endpoint: as it was configured.
        name: the full name.
        type_name: the action's type.
        handler: called by `at_once` threads at most.
        at_once: how many.
        report: takes changes of health.
    """

    def __init__(
        self,
        station: Station,
        endpoint: Endpoint,
        name: str,
        type_name: str,
        handler: Handler,
        at_once: int,
        report: Callable[[Channel, Health, str], None],
    ) -> None:
        super().__init__(endpoint, name, handler, at_once, report)
        goal, _, result = records(type_name)
        self._read = reader(goal)
        self._write = writer(result)
        self._running: set[bytes] = set()
        self._station = station
        self._server = station.goal_server(
            import_type(type_name),
            name,
            self._ask,
            may_cancel=lambda _: False,
            cancel=lambda _: None,
        )

    def _close(self) -> None:
        self._forget_waiting()
        for goal_id in list(self._running):
            self._end(goal_id, "aborted")
        self._station.discard(self._server)

    def _ask(self, request: GoalRequest) -> None:
        if self._closed or self.is_full:
            self._server.reject(request)
            return
        self._server.accept(request)
        self._running.add(request.id)
        self._take(request.id, self._read(request.goal))

    def _reply(self, asked: bytes, reply: Message) -> None:
        self._end(asked, "succeeded", self._write(reply))

    def _refuse(self, asked: bytes, error: Exception) -> None:
        del error  # ROS 2 has no word for it; the status of the offer has
        self._end(asked, "aborted")

    def _end(self, goal_id: bytes, status: str, result: Any = None) -> None:
        with self._lock:
            is_first = goal_id in self._running
            self._running.discard(goal_id)
        if is_first:
            self._server.end(goal_id, status, result)
