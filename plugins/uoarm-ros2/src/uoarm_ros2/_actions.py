"""Actions: a call that returns the result, or four streams: goal and cancel in, the rest out."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from contextlib import AbstractContextManager, suppress
from typing import Any
from uuid import uuid4

from attrs import define, field

from uoarm.bridge import HealthReason, Sink, Source, on_failure
from uoarm.errors import BridgeError, FailureReason
from uoarm.model import Deliver, Endpoint, Health, Message
from uoarm_ros2._conversion import reader, writer
from uoarm_ros2._discovery import Ros2Graph, ServerPresence
from uoarm_ros2._health import Report, monitored
from uoarm_ros2._middleware import NodeRunner, rclpy_errors
from uoarm_ros2._services import Disagreement, ServerComparison, answered, require_agreement
from uoarm_ros2._types import action_records, import_type

_STATUS = {
    1: "accepted",
    2: "executing",
    3: "canceling",
    4: "succeeded",
    5: "canceled",
    6: "aborted",
}
_MOST_GOALS = 256
_UUID = "unique_identifier_msgs/msg/UUID"


@define(eq=False)
class _Goal:
    """A goal that was sent as a stream and has not ended.

    Attributes:
        sender: the input to which it was sent.
        servers: those that were there when it was sent.
        sent: the future of rclpy's handle.
        handle: rclpy's, once it was accepted.
        is_cancelled: whether its end was asked for.
    """

    sender: object
    servers: ServerPresence = field(factory=ServerPresence)
    sent: Any = None
    handle: Any = None
    is_cancelled: bool = False


class Action:
    """A client of one action, shared by its channels and calls.

    Callbacks run in the runner's thread. A goal that is under way, or not answered yet, when its
    server disappears ends with the status `lost`, also where another server has taken its place.
    """

    def __init__(self, runner: NodeRunner, graph: Ros2Graph, name: str, type_name: str) -> None:
        goal, feedback, result = action_records(type_name)
        self.name = name
        self._graph = graph
        self._sending = f"{name}/_action/send_goal"
        self._write_goal = writer(goal)
        self._read_feedback = reader(feedback)
        self._read_result = reader(result)
        # Guards goals and listeners, between the threads that send and the runner's. A goal leaves
        # the table once, under it: of the reports of its end (result, rejection, loss of the
        # server) only that of the thread that took it out is emitted.
        self._lock = threading.Lock()
        self._goals: dict[str, _Goal] = {}
        self._listeners: tuple[ActionSource, ...] = ()
        self._new_id = import_type(_UUID)
        self._runner = runner
        self._client = runner.action_client(import_type(type_name), name)
        self._was_ready = False
        services = (f"{name}/_action/{text}" for text in ("send_goal", "get_result"))
        self.comparison = ServerComparison(runner, f"action {name}", services)

    def ready(self) -> bool:
        """Whether a server is matched."""
        return bool(self._client.server_is_ready())

    def wait(self, limit: float) -> None:
        """Wait for a server.

        Raises:
            BridgeError: there is none within `limit` seconds, or none has our definition.
        """
        if not self._graph.until(self.ready, limit):
            text = f"action {self.name} has no server"
            raise BridgeError(text, FailureReason.UNAVAILABLE)
        if not self._was_ready:
            self._graph.await_match(self._sending, limit)
        self._was_ready = True
        require_agreement(self.comparison)

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
        with self._runner.calling(what):
            self.wait(min(wait, timeout))
            first = ServerPresence()

            def there() -> bool:
                return self.ready() and first.holds(self._graph.servers(self._sending))

            call_goal = _CallGoal(self._client, what)
            with cancelling(call_goal.cancel):
                sent = call_goal.begin(goal)
                with on_failure(call_goal.cancel):
                    handle = answered(sent, deadline, there, what)
                    if handle.accepted:
                        reply = answered(handle.get_result_async(), deadline, there, what)
            if not handle.accepted:
                raise BridgeError(f"{what} rejected the goal", FailureReason.REFUSED)
        status = _STATUS.get(reply.status, "unknown")
        if status != "succeeded":
            result = self._read_result(reply.result)
            raise BridgeError(f"{what} ended {status}: {result!r:.200}", FailureReason.REFUSED)
        return self._read_result(reply.result)

    def send(self, message: Message, sender: object) -> None:
        """Send a goal without waiting for anything; `abandon` of its sender cancels it.

        Raises:
            MessageError: the goal does not fit its native type.
            BridgeError: there is no server, or too many goals are under way.
        """
        native = self._write_goal(message)
        if not self.ready():
            text = f"action {self.name} has no server"
            raise BridgeError(text, FailureReason.UNAVAILABLE)
        goal, own = _Goal(sender), uuid4().bytes
        goal.servers.holds(self._graph.servers(self._sending))
        with self._lock:
            if len(self._goals) >= _MOST_GOALS:
                text = f"action {self.name} has {_MOST_GOALS} goals under way already"
                raise BridgeError(text, FailureReason.REFUSED)
            self._goals[own.hex()] = goal
        with on_failure(self._forget, own.hex()):
            goal.sent = self._client.send_goal_async(
                native, self._on_feedback, goal_uuid=self._new_id(uuid=list(own))
            )
        goal.sent.add_done_callback(lambda sent: self._on_response(own.hex(), sent))

    def cancel(self, message: Message) -> None:
        """Ask the server to cancel one goal, or all of ours when the id is empty."""
        wanted = message["goal_id"]
        self._cancel_those(lambda name, _: wanted in {"", name})

    def abandon(self, sender: object) -> None:
        """Cancel the goals of a sender that is gone, as soon as each is accepted."""
        self._cancel_those(lambda _, goal: goal.sender is sender)

    def _cancel_those(self, are_meant: Callable[[str, _Goal], bool]) -> None:
        with self._lock:
            goals = [goal for name, goal in self._goals.items() if are_meant(name, goal)]
            for goal in goals:
                goal.is_cancelled = True
            accepted = [goal.handle for goal in goals if goal.handle is not None]
        for handle in accepted:
            _cancel(handle)

    def join(self, listener: ActionSource) -> None:
        """Have messages of the listener's part delivered to it."""
        with self._lock:
            self._listeners += (listener,)

    def leave(self, listener: ActionSource) -> None:
        """Deliver no more to a listener."""
        with self._lock:
            self._listeners = tuple(
                action_source for action_source in self._listeners if action_source is not listener
            )

    def tick(self) -> None:
        """Notice a server that went away or came back."""
        ready, listeners = self.ready(), self._listeners
        self._was_ready = ready
        found = self.comparison.look() if ready and listeners else Disagreement()
        for listener in listeners:
            listener.judge(found, ready=ready)
        goals = list(self._goals.items())
        servers = self._graph.servers(self._sending) if goals else frozenset[bytes]()
        for goal_id, goal in goals:
            if not (ready and goal.servers.holds(servers)) and self._forget(goal_id):
                if goal.sent is not None and not goal.sent.done():
                    goal.sent.cancel()  # else rclpy keeps it for an answer that never comes
                self._emit("status", {"goal_id": goal_id, "status": "lost"})

    def _forget(self, goal_id: str) -> bool:
        """Take a goal off the list; False: it has ended before, and that was reported."""
        with self._lock:
            return self._goals.pop(goal_id, None) is not None

    def _emit(self, part: str, message: Message) -> None:
        for listener in self._listeners:
            if listener.part == part:
                listener.take(message)

    def _on_feedback(self, native: Any) -> None:
        feedback = self._read_feedback(native.feedback)
        self._emit("feedback", {"goal_id": bytes(native.goal_id.uuid).hex(), "feedback": feedback})

    def _on_response(self, goal_id: str, sent: Any) -> None:
        if sent.cancelled():
            return
        handle = sent.result()
        with self._lock:
            goal = self._goals.get(goal_id)
            if goal is not None and handle.accepted:
                goal.handle = handle
            is_wanted = goal is not None and not goal.is_cancelled
        if handle.accepted and not is_wanted:
            _cancel(handle)
        if goal is None:
            return  # it was reported as lost
        if not handle.accepted:
            self._forget(goal_id)
            self._emit("status", {"goal_id": goal_id, "status": "rejected"})
        else:
            self._emit("status", {"goal_id": goal_id, "status": "accepted"})
            handle.get_result_async().add_done_callback(
                lambda result: self._on_result(goal_id, result.result())
            )

    def _on_result(self, goal_id: str, reply: Any) -> None:
        if self._forget(goal_id):
            ended = {"goal_id": goal_id, "status": _STATUS.get(reply.status, "aborted")}
            self._emit("result", {**ended, "result": self._read_result(reply.result)})
            self._emit("status", ended)


class _CallGoal:
    """The goal of one call, which any thread may cancel from before it is sent until it ends.

    A goal that waits for its acceptance has no handle to cancel it by: it is cancelled by the
    thread in which the acceptance comes, whatever has become of the call by then.
    """

    def __init__(self, client: Any, what: str) -> None:
        self._client = client
        self._what = what
        # Orders `cancel` and `begin`: a goal is sent before, and then cancelled by its handle, or
        # it is not sent at all.
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
        """Cancel the goal now or once it is accepted; False: the server cannot be reached."""
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
    """Ask the server to cancel a goal; False: the bridge was closed."""
    with suppress(BridgeError), rclpy_errors("cancelling a goal"):
        goal.cancel_goal_async()
        return True
    return False


class ActionSource(Source):
    """Feedback, results or status changes of an action."""

    def __init__(
        self,
        endpoint: Endpoint,
        action: Action,
        part: str,
        deliver: Deliver,
        report: Report,
    ) -> None:
        super().__init__(endpoint)
        self.part = part
        self._action = action
        self._deliver = deliver
        self._health = monitored(f"action {action.name}", self, report)
        self._health.connected(int(action.ready()))
        action.join(self)

    def take(self, message: Message) -> None:
        """Deliver one message, unless closed."""
        if not self._closed:
            self._deliver(message)

    def judge(self, found: Disagreement, *, ready: bool) -> None:
        """Report whether a server is there, and what of the servers has another definition."""
        self._health.connected(int(ready), "" if ready else "its server is gone")
        if ready:
            unwell = Health.LOST if found.is_total else Health.DEGRADED
            health = unwell if found.text else Health.OK
            cause = found.text or "every server has our definition"
            self._health.judged(HealthReason.REFUSED, health, cause, "definition")

    def _close(self) -> None:
        self._action.leave(self)


class ActionSink(Sink):
    """Goals or cancellations for an action."""

    blocking = False

    def __init__(self, endpoint: Endpoint, action: Action, part: str) -> None:
        super().__init__(endpoint)
        self._action = action
        self._part = part

    def _send(self, message: Message) -> None:
        """Send one goal, or cancel one.

        Raises:
            MessageError: it does not fit the native type.
            BridgeError: too many goals are under way.
        """
        if self._part == "goal":
            self._action.send(message, self)
        else:
            self._action.cancel(message)

    def _close(self) -> None:
        self._action.abandon(self)  # no one is left who could cancel them
