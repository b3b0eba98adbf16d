"""Servers and clients of actions over rclpy's handles, safe to use from several threads."""

from __future__ import annotations

import threading
from collections.abc import Callable
from contextlib import suppress
from typing import Any

from attrs import field, frozen
from rclpy.action import ActionClient
from rclpy.impl.implementation_singleton import rclpy_implementation as _rclpy
from rclpy.qos import QoSProfile, qos_profile_action_status_default
from rclpy.type_support import check_for_type_support
from rclpy.waitable import NumberOfEntities
from typing_extensions import Self

from uoarm_ros2._middleware._translation import rclpy_errors, server_profile
from uoarm_ros2._middleware._wait_set import Entity

_KEPT_SECONDS = 60  # of the result of a goal that has ended
_FEEDBACK_DEPTH = 10  # as rclpy has it
_UNKNOWN = 0
_CANCEL_REJECTED = 1
_ENDS = {
    "succeeded": _rclpy.GoalEvent.SUCCEED,
    "canceled": _rclpy.GoalEvent.CANCELED,
    "aborted": _rclpy.GoalEvent.ABORT,
}
_NUMBERS = {"succeeded": 4, "canceled": 5, "aborted": 6}
_CANCELING = 3


@frozen(eq=False)
class GoalRequest:
    """A goal that a client sent and that is not answered yet.

    Attributes:
        id: 16 octets, which the client chose.
        goal: a native object of the action's goal type.
    """

    id: bytes
    goal: Any
    _header: Any = field(repr=False)
    _uuid: Any = field(repr=False)


class GoalServer:
    """The three services, two topics and the timer of one action, over rclpy's handles.

    rclpy's own `ActionServer` runs goals as tasks of an executor, of which there is none here.
    Once it is destroyed no client is answered: a function may end a goal while its offer closes.

    Args:
        name: its full name.
        ask: takes each goal, which is answered by `accept` or `reject`, from any thread.
        may_cancel: says of a goal's id whether its end may be asked for at all.
        cancel: takes the id of each goal whose end a client has asked for.
    """

    def __init__(
        self,
        node: Any,
        native: Any,
        name: str,
        ask: Callable[[GoalRequest], None],
        may_cancel: Callable[[bytes], bool],
        cancel: Callable[[bytes], None],
    ) -> None:
        check_for_type_support(native)
        self._native = native
        self._clock = node.get_clock()
        self._ask = ask
        self._may_cancel = may_cancel
        self._cancel = cancel
        # The C library of actions has no locks: guards every use of the handle but the publishing
        # of feedback, and the tables of goals, from the runner's thread and those that end goals.
        # Nothing that is handed on is called with it.
        self._lock = threading.Lock()
        self._is_destroyed = False
        self._ready: tuple[bool, ...] = ()
        self._goals: dict[bytes, Any] = {}
        self._results: dict[bytes, Any] = {}
        self._waiting: dict[bytes, list[Any]] = {}
        self._unread: set[bytes] = set()
        services = server_profile().get_c_qos_profile()
        feedback = QoSProfile(depth=_FEEDBACK_DEPTH).get_c_qos_profile()
        status = qos_profile_action_status_default.get_c_qos_profile()
        with node.handle, self._clock.handle:
            self._handle = _rclpy.ActionServer(
                node.handle,
                self._clock.handle,
                native,
                name,
                services,
                services,
                services,
                feedback,
                status,
                _KEPT_SECONDS,
            )

    def accept(self, request: GoalRequest) -> None:
        """Answer a goal's client that it is accepted, and count it as executing."""
        from action_msgs.msg import GoalInfo  # noqa: PLC0415 - there is rclpy without it

        stamp = self._clock.now().to_msg()
        info = GoalInfo(goal_id=request._uuid, stamp=stamp)  # noqa: SLF001 - made here
        with self._lock:
            if self._is_destroyed:
                return
            self._goals[request.id] = goal = _rclpy.ActionGoalHandle(self._handle, info)
            self._waiting[request.id] = []
            self._answer_goal(request, stamp)
            goal.update_goal_state(_rclpy.GoalEvent.EXECUTE)
            self._publish_status()

    def reject(self, request: GoalRequest) -> None:
        """Answer a goal's client that it is rejected."""
        with self._lock:
            if not self._is_destroyed:
                self._answer_goal(request, None)

    def feed(self, goal_id: bytes, feedback: Any) -> None:
        """Publish feedback of a goal that is executing.

        Raises:
            BridgeError: the middleware takes none.
        """
        message = self._native.Impl.FeedbackMessage()
        message.goal_id.uuid = list(goal_id)
        message.feedback = feedback
        with rclpy_errors("publishing feedback"):
            if not self._is_destroyed:
                self._handle.publish_feedback(message)

    def end(self, goal_id: bytes, status: str, result: Any = None) -> None:
        """End an accepted goal and send its result to the clients that ask for it, now or later.

        Args:
            goal_id: of the goal, which has not ended.
            status: `succeeded`, `canceled` or `aborted`.
            result: a native object; None: one with the type's own values.
        """
        response = self._native.Impl.GetResultService.Response()
        response.status = _NUMBERS[status]
        if result is not None:
            response.result = result
        with self._lock:
            if self._is_destroyed:
                return
            goal = self._goals[goal_id]
            if status == "canceled" and goal.get_status() != _CANCELING:
                goal.update_goal_state(_rclpy.GoalEvent.CANCEL_GOAL)  # the provider's decision
            goal.update_goal_state(_ENDS[status])
            self._results[goal_id] = response
            headers = self._waiting.pop(goal_id)
            if not headers:
                self._unread.add(goal_id)
            for header in headers:
                self._answer_result(header, response)
            self._publish_status()
            with suppress(_rclpy.RCLError):  # the context is gone, and results with it
                self._handle.notify_goal_done()

    @property
    def has_unread(self) -> bool:
        """Whether no client has asked yet for the result of a goal that has ended."""
        return bool(self._unread)

    def destroy(self) -> None:
        """Put the server away; idempotent."""
        with self._lock:
            for goal in self._goals.values():
                goal.destroy_when_not_in_use()
            self._goals.clear()
            if not self._is_destroyed:
                self._is_destroyed = True
                self._handle.destroy_when_not_in_use()

    def __enter__(self) -> Self:
        """Keep the handle from being freed."""
        self._handle.__enter__()
        return self

    def __exit__(self, *error: object) -> None:
        """Let it be freed."""
        self._handle.__exit__(*error)

    def get_num_entities(self) -> NumberOfEntities:
        """Return how many of each kind stand in a wait set."""
        return NumberOfEntities(*self._handle.get_num_entities())

    def add_to_wait_set(self, wait_set: Any) -> None:
        """Stand in a wait set."""
        with self._lock:
            self._handle.add_to_waitset(wait_set)

    def is_ready(self, wait_set: Any) -> bool:
        """Look whether anything came."""
        with self._lock:
            self._ready = self._handle.is_ready(wait_set)
        return any(self._ready)

    def take(self) -> None:
        """Take what the last look found, and hand it on."""
        has_goal, has_cancel, has_result, has_expired = self._ready
        if has_goal:
            self._take_goal()
        if has_cancel:
            self._take_cancel()
        if has_result:
            self._take_result()
        if has_expired:
            self._forget()

    def _take_goal(self) -> None:
        from action_msgs.msg import GoalInfo  # noqa: PLC0415 - there is rclpy without it

        with self._lock:
            header, asked = self._handle.take_goal_request(
                self._native.Impl.SendGoalService.Request
            )
            if header is None:
                return
            goal_id = bytes(asked.goal_id.uuid)
            request = GoalRequest(goal_id, asked.goal, header, asked.goal_id)
            if self._handle.goal_exists(GoalInfo(goal_id=asked.goal_id)):
                self._answer_goal(request, None)
                return
        self._ask(request)

    def _take_cancel(self) -> None:
        service = self._native.Impl.CancelGoalService
        with self._lock:
            header, asked = self._handle.take_cancel_request(service.Request)
            if header is None:
                return
            response = self._handle.process_cancel_request(asked, service.Response)
            wanted, chosen = response.goals_canceling, []
            for info in wanted:
                goal_id = bytes(info.goal_id.uuid)
                if self._may_cancel(goal_id):
                    with suppress(_rclpy.RCLError):  # it ended in that moment
                        self._goals[goal_id].update_goal_state(_rclpy.GoalEvent.CANCEL_GOAL)
                        chosen.append(info)
            response.goals_canceling = chosen
            if wanted and not chosen:
                response.return_code = _CANCEL_REJECTED
            with suppress(_rclpy.RCLError):  # the client is gone
                self._handle.send_cancel_response(header, response)
            if chosen:
                self._publish_status()
        for info in chosen:
            self._cancel(bytes(info.goal_id.uuid))

    def _take_result(self) -> None:
        service = self._native.Impl.GetResultService
        with self._lock:
            header, asked = self._handle.take_result_request(service.Request)
            if header is None:
                return
            goal_id = bytes(asked.goal_id.uuid)
            if goal_id in self._waiting:
                self._waiting[goal_id].append(header)
                return
            self._unread.discard(goal_id)
            response = self._results.get(goal_id)
            if response is None:
                response = service.Response(status=_UNKNOWN)
            self._answer_result(header, response)

    def _forget(self) -> None:
        """Forget goals whose results were kept for long enough."""
        with self._lock:
            for info in self._handle.expire_goals(len(self._goals)):
                goal_id = bytes(info.goal_id.uuid)
                self._results.pop(goal_id, None)
                self._unread.discard(goal_id)
                self._goals.pop(goal_id).destroy_when_not_in_use()

    def _publish_status(self) -> None:
        with suppress(_rclpy.RCLError):  # the context is gone
            self._handle.publish_status()

    def _answer_goal(self, request: GoalRequest, accepted: Any) -> None:
        response = self._native.Impl.SendGoalService.Response(accepted=accepted is not None)
        if accepted is not None:
            response.stamp = accepted
        with suppress(_rclpy.RCLError):  # the client is gone
            self._handle.send_goal_response(request._header, response)  # noqa: SLF001 - made here

    def _answer_result(self, header: Any, response: Any) -> None:
        with suppress(_rclpy.RCLError):  # the client is gone
            self._handle.send_result_response(header, response)


class GoalEntity(Entity):
    """A server of an action, which is several entities under one name."""

    at_once = 1  # what it takes is what the last wait found

    def take(self) -> bool:
        """Hand on what the last look found ready."""
        self.handle.take()
        return True


class SharedActionClient(ActionClient):  # type: ignore[misc]  # rclpy has no types
    """A client whose every answer finds what waits for it.

    rclpy notes what it waits for after it has sent the request. An answer that another thread takes
    in between finds no pending request, and is thrown away: the goal, its result or its end would
    never be reported. So nothing is taken while something is sent. Callbacks run without the lock.
    """

    def __init__(self, node: Any, native: Any, name: str) -> None:
        # Held while a request is sent and noted, and while an answer is taken: see above.
        self._sending = threading.Lock()
        super().__init__(node, native, name)

    def take_data(self) -> Any:
        with self._sending:
            return super().take_data()

    def send_goal_async(self, *args: Any, **keywords: Any) -> Any:
        with self._sending:
            return super().send_goal_async(*args, **keywords)

    def _cancel_goal_async(self, goal: Any) -> Any:
        with self._sending:
            return super()._cancel_goal_async(goal)

    def _get_result_async(self, goal: Any) -> Any:
        with self._sending:
            return super()._get_result_async(goal)
