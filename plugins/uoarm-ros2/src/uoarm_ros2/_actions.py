"""Actions: a call that returns the result, or four streams: goal and cancel in, the rest out."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from contextlib import AbstractContextManager, suppress
from typing import Any

from uoarm.bridge import Channel, Description, Sink, Source
from uoarm.errors import BridgeError, FailureReason
from uoarm.model import Deliver, Endpoint, Health, Message, MessageStructure
from uoarm_ros2._graph import Graph
from uoarm_ros2._middleware import Station, rclpy_errors
from uoarm_ros2._read import reader
from uoarm_ros2._schema import schema_of, structure_of
from uoarm_ros2._services import answered
from uoarm_ros2._shape import Record, shape_of
from uoarm_ros2._types import import_type
from uoarm_ros2._write import writer

__all__ = ["Action", "ActionSink", "ActionSource", "described", "part_structure", "records"]

_STATUS = {
    1: "accepted",
    2: "executing",
    3: "canceling",
    4: "succeeded",
    5: "canceled",
    6: "aborted",
}
_STATES = ["accepted", "rejected", "succeeded", "canceled", "aborted", "lost"]
_MOST_GOALS = 256


def described(type_name: str) -> Description:
    """Return an action as a call: the goal as request, the result as reply."""
    goal, _, result = records(type_name)
    return Description(request=structure_of(goal), reply=structure_of(result))


def part_structure(type_name: str, part: str) -> MessageStructure:
    """Return the structure of one stream of an action."""
    goal, feedback, result = records(type_name)
    if part == "goal":
        return structure_of(goal)
    members: dict[str, object] = {"goal_id": {"type": "string"}}
    if part in {"status", "result"}:
        members["status"] = {"type": "string", "enum": _STATES}
    if part in {"feedback", "result"}:
        members[part] = schema_of(feedback if part == "feedback" else result)
    schema = {
        "type": "object",
        "properties": members,
        "required": list(members),
        "additionalProperties": False,
    }
    return MessageStructure(schema, native_type=f"{type_name}.{part}")


def records(type_name: str) -> tuple[Record, Record, Record]:
    """Return the shapes of the goal, the feedback and the result of an action type."""
    native: Any = import_type(type_name)
    return (
        shape_of(native.Goal, f"{type_name}_Goal"),
        shape_of(native.Feedback, f"{type_name}_Feedback"),
        shape_of(native.Result, f"{type_name}_Result"),
    )


class Action:
    """A client of one action, shared by its channels and calls.

    Callbacks run in the station's thread. A goal that is under way when its server disappears
    ends with the status `lost`.
    """

    def __init__(self, station: Station, graph: Graph, name: str, type_name: str) -> None:
        goal, feedback, result = records(type_name)
        self.name = name
        self._graph = graph
        self._write_goal = writer(goal)
        self._read_feedback = reader(feedback)
        self._read_result = reader(result)
        self._lock = threading.Lock()
        self._goals: dict[str, Any] = {}
        self._listeners: tuple[ActionSource, ...] = ()
        self._client = station.action_client(import_type(type_name), name)
        self._was_ready = False

    def ready(self) -> bool:
        """Whether a server is matched."""
        return bool(self._client.server_is_ready())

    def wait(self, limit: float) -> None:
        """Wait for a server.

        Raises:
            BridgeError: there is none within `limit` seconds.
        """
        if not self._graph.until(self.ready, limit):
            text = f"action {self.name} has no server"
            raise BridgeError(text, FailureReason.UNAVAILABLE)
        if not self._was_ready:
            self._graph.greet(f"{self.name}/_action/send_goal", limit)
        self._was_ready = True

    def call(
        self,
        message: Message,
        timeout: float,
        wait: float,
        cancelling: Callable[[Callable[[], object]], AbstractContextManager[None]],
    ) -> Message:
        """Send a goal and return its result; a goal that is given up is cancelled.

        Raises:
            BridgeError: no server, or the goal was rejected, aborted or cancelled.
            BridgeTimeoutError: no result within `timeout` seconds.
            MessageError: the goal does not fit its native type.
        """
        deadline = time.monotonic() + timeout
        what = f"action {self.name}"
        goal = self._write_goal(message)
        with rclpy_errors(what):
            self.wait(min(wait, timeout))
            pursuit = _Pursuit(self._client, what)
            with cancelling(pursuit.cancel):
                sent = pursuit.begin(goal)
                try:
                    handle = answered(sent, deadline, self.ready, what)
                    if handle.accepted:
                        reply = answered(handle.get_result_async(), deadline, self.ready, what)
                except BridgeError:
                    pursuit.cancel()
                    raise
            if not handle.accepted:
                raise BridgeError(f"{what} rejected the goal", FailureReason.REFUSED)
        status = _STATUS.get(reply.status, "unknown")
        if status != "succeeded":
            result = self._read_result(reply.result)
            raise BridgeError(f"{what} ended {status}: {result!r:.200}", FailureReason.REFUSED)
        return self._read_result(reply.result)

    def send(self, message: Message) -> None:
        """Send a goal without waiting for anything.

        Raises:
            MessageError: the goal does not fit its native type.
            BridgeError: there is no server, or too many goals are under way.
        """
        if not self.ready():
            text = f"action {self.name} has no server"
            raise BridgeError(text, FailureReason.UNAVAILABLE)
        if len(self._goals) >= _MOST_GOALS:
            text = f"action {self.name} has {_MOST_GOALS} goals under way already"
            raise BridgeError(text, FailureReason.REFUSED)
        future = self._client.send_goal_async(self._write_goal(message), self._on_feedback)
        future.add_done_callback(self._on_response)

    def cancel(self, message: Message) -> None:
        """Ask the server to cancel one goal, or all of ours when the id is empty."""
        wanted = message["goal_id"]
        with self._lock:
            goals = [goal for name, goal in self._goals.items() if wanted in {"", name}]
        for goal in goals:
            _cancel(goal)

    def join(self, listener: ActionSource) -> None:
        """Have messages of the listener's part delivered to it."""
        with self._lock:
            self._listeners += (listener,)

    def leave(self, listener: ActionSource) -> None:
        """Deliver no more to a listener."""
        with self._lock:
            self._listeners = tuple(each for each in self._listeners if each is not listener)

    def tick(self) -> None:
        """Notice a server that went away or came back."""
        ready = self.ready()
        if ready == self._was_ready:
            return
        self._was_ready = ready
        for listener in self._listeners:
            listener.server_changed(ready=ready)
        if not ready:
            with self._lock:
                lost, self._goals = list(self._goals), {}
            for goal_id in lost:
                self._emit("status", {"goal_id": goal_id, "status": "lost"})

    def _emit(self, part: str, message: Message) -> None:
        for listener in self._listeners:
            if listener.part == part:
                listener.take(message)

    def _on_feedback(self, native: Any) -> None:
        feedback = self._read_feedback(native.feedback)
        self._emit("feedback", {"goal_id": _id(native.goal_id), "feedback": feedback})

    def _on_response(self, future: Any) -> None:
        handle = future.result()
        goal_id = _id(handle.goal_id)
        if not handle.accepted:
            self._emit("status", {"goal_id": goal_id, "status": "rejected"})
            return
        with self._lock:
            self._goals[goal_id] = handle
        self._emit("status", {"goal_id": goal_id, "status": "accepted"})
        handle.get_result_async().add_done_callback(
            lambda result: self._on_result(goal_id, result.result())
        )

    def _on_result(self, goal_id: str, reply: Any) -> None:
        with self._lock:
            self._goals.pop(goal_id, None)
        ended = {"goal_id": goal_id, "status": _STATUS.get(reply.status, "aborted")}
        self._emit("result", {**ended, "result": self._read_result(reply.result)})
        self._emit("status", ended)


class _Pursuit:
    """The goal of one call, which any thread may cancel from before it is sent until it ends.

    A goal that waits for its acceptance has no handle to cancel it by: it is cancelled by the
    thread in which the acceptance comes, whatever has become of the call by then.
    """

    def __init__(self, client: Any, what: str) -> None:
        self._client = client
        self._what = what
        self._lock = threading.Lock()
        self._is_cancelled = False
        self._sent: Any = None

    def begin(self, goal: Any) -> Any:
        """Send the goal; return the future of its handle.

        Raises:
            BridgeError: it was cancelled before, and is not sent.
        """
        with self._lock:
            if self._is_cancelled:
                text = f"{self._what}: the goal was cancelled before it was sent"
                raise BridgeError(text, FailureReason.REFUSED)
            self._sent = self._client.send_goal_async(goal)
            return self._sent

    def cancel(self) -> bool:
        """Cancel the goal now or once it is accepted; False: the server cannot be told."""
        with self._lock:
            self._is_cancelled = True
            sent = self._sent
        if sent is None:
            return True
        if sent.done():
            return _cancel_accepted(sent)
        sent.add_done_callback(_cancel_accepted)
        with suppress(BridgeError), rclpy_errors(self._what):
            return bool(self._client.server_is_ready())
        return False


def _cancel_accepted(sent: Any) -> bool:
    """Cancel a goal whose answer has come, unless that was a rejection."""
    handle = sent.result()
    return handle is None or not handle.accepted or _cancel(handle)


def _cancel(goal: Any) -> bool:
    """Ask the server to cancel a goal; False: it cannot be told, since the bridge was closed."""
    with suppress(BridgeError), rclpy_errors("cancelling a goal"):
        goal.cancel_goal_async()
        return True
    return False


def _id(goal_id: Any) -> str:
    return bytes(goal_id.uuid).hex()


class ActionSource(Source):
    """Feedback, results or status changes of an action."""

    def __init__(
        self,
        endpoint: Endpoint,
        action: Action,
        part: str,
        deliver: Deliver,
        report: Callable[[Channel, Health, str], None],
    ) -> None:
        super().__init__(endpoint)
        self.part = part
        self._action = action
        self._deliver = deliver
        self._report = report
        action.join(self)

    def take(self, message: Message) -> None:
        """Deliver one message, unless closed."""
        if not self._closed:
            self._deliver(message)

    def server_changed(self, *, ready: bool) -> None:
        """Tell the manager that the server is gone or back."""
        if ready:
            self._report(self, Health.OK, f"a server of {self._action.name} is there")
        else:
            self._report(self, Health.LOST, f"the server of {self._action.name} is gone")

    def _close(self) -> None:
        self._action.leave(self)


class ActionSink(Sink):
    """Goals or cancellations for an action."""

    blocking = False

    def __init__(self, endpoint: Endpoint, action: Action, part: str) -> None:
        super().__init__(endpoint)
        self._action = action
        self._do = action.send if part == "goal" else action.cancel

    def _send(self, message: Message) -> None:
        """Send one goal, or cancel one.

        Raises:
            MessageError: it does not fit the native type.
            BridgeError: too many goals are under way.
        """
        self._do(message)

    def _close(self) -> None:
        pass
