"""Calls both ways: actions of the robot as calls, and functions that are offered to it.

Actions of ROS 2 are as rosbridge has them, those of ROS 1 by the topics of actionlib.
"""

from __future__ import annotations

import os
import threading
import time
from abc import abstractmethod
from collections.abc import Callable, Mapping
from contextlib import AbstractContextManager, suppress
from functools import partial
from itertools import count
from typing import Any, ClassVar

from attrs import define, field

from uoarm.bridge import Channel, Handler, ServedRequests, on_failure, text_of
from uoarm.errors import BridgeError, BridgeTimeoutError, FailureReason, MessageError
from uoarm.model import Endpoint, Health, Message
from uoarm_rosbridge.client._channels import Report
from uoarm_rosbridge.client._connection import Fields, ServerConnection
from uoarm_rosbridge.client._types import RosType, compression_for, reader, writer

Cancelling = Callable[[Callable[[], object]], AbstractContextManager[None]]

_SUCCEEDED, _CANCELED, _ABORTED = 4, 5, 6
_OUTCOMES = {_CANCELED: "canceled", _ABORTED: "aborted"}

# Of actionlib_msgs/GoalStatus, which has numbers of its own.
_DONE = 3
_WORDS = {2: "preempted", 4: "aborted", 5: "rejected", 8: "recalled", 9: "lost"}
_ENDED = {_DONE, *_WORDS}
_AGAIN_SECONDS = 0.5
_MOST_GOALS = 256


def call_action(
    connection: ServerConnection,
    endpoint: Endpoint,
    name: str,
    kind: str,
    types: tuple[RosType, RosType] | None,
    message: Message,
    timeout: float,
    cancelling: Cancelling,
) -> Message:
    """Send a goal of ROS 2 and return its result; a goal that is given up is cancelled.

    Raises:
        BridgeError: the connection breaks, or the goal was refused, aborted or canceled.
        BridgeTimeoutError: no result within `timeout` seconds.
    """
    identity = connection.new_id("goal")
    cancel = {"op": "cancel_action_goal", "id": identity, "action": name}
    fields = {
        "op": "send_action_goal", "id": identity, "action": name, "action_type": kind,
        "args": writer(types and types[0])(message), "feedback": False,
    }  # fmt: skip
    try:
        with cancelling(lambda: connection.send(cancel)):
            answer = connection.request(fields, timeout)
    except BridgeTimeoutError:
        with suppress(BridgeError):
            connection.send(cancel)
        text = f"{endpoint}: no reply within {timeout:g} s"
        raise BridgeTimeoutError(text) from None
    values, status = answer.get("values"), answer.get("status")
    if answer.get("result") is False or status != _SUCCEEDED:
        word = _OUTCOMES.get(status, "refused") if isinstance(status, int) else "refused"
        why = f": {values[:1000]}" if isinstance(values, str) else ""
        raise BridgeError(f"{endpoint}: the goal was {word}{why}")
    return values if types is None else reader(types[1])(values)


@define
class ActionlibTypes:
    """The types of an action of ROS 1.

    Attributes:
        goal: with header and id.
        result: with header and status.
        status: of all goals.
        cancel: a goal's id.
    """

    goal: RosType
    result: RosType
    status: RosType
    cancel: RosType

    def request(self) -> RosType:
        """Return the type of what is asked for."""
        return self._inner(self.goal, "goal")

    def reply(self) -> RosType:
        """Return the type of what comes of it."""
        return self._inner(self.result, "result")

    @staticmethod
    def _inner(outer: RosType, name: str) -> RosType:
        inner = outer.fields.get(name)
        if not isinstance(inner, RosType):
            raise BridgeError(f"{outer.name} has no member {name!r}", FailureReason.BAD_MESSAGE)
        return inner


@define(eq=False)
class _Goal:
    """A goal that was sent and has not ended.

    Attributes:
        changed: is set when there is news of it.
        is_known: whether its server has said that it knows it.
        status: as its server said last.
        text: that goes with it.
        result: once it came.
        ended_at: when its server said that it has ended.
        failure: why nothing more will come.
    """

    changed: threading.Event = field(factory=threading.Event)
    is_known: bool = False
    status: int = 0
    text: str = ""
    result: Any = None
    has_result: bool = False
    ended_at: float | None = None
    failure: str = ""


class ActionlibCaller:
    """A client of one action of ROS 1; several goals at a time.

    Nothing says when the topics of a server and of a client are connected. So a goal is sent again,
    with its id, until the server's status lists it: an id is one goal to actionlib, however often
    it comes. From then on it is not sent again.
    """

    def __init__(self, connection: ServerConnection, name: str, types: ActionlibTypes) -> None:
        self._connection, self.name = connection, name
        self._read_result, self._read_status = reader(types.result), reader(types.status)
        self._write = writer(types.request())
        # Guards the goals under way, between those who call and the connection's thread.
        self._lock = threading.Lock()
        self._goals: dict[str, _Goal] = {}
        self._own, self._numbers = f"uoarm-{os.urandom(6).hex()}", count(1)
        self._status_at = time.monotonic()
        self._advertised = [
            (connection.new_id("advertise"), f"{name}/{part}", kind.name)
            for part, kind in (("goal", types.goal), ("cancel", types.cancel))
        ]
        with on_failure(self.close):
            for part, kind, take in (
                ("result", types.result, self._take_result),
                ("status", types.status, self._take_status),
            ):
                fields = {
                    "op": "subscribe", "id": connection.new_id("subscribe"),
                    "topic": f"{name}/{part}", "type": kind.name,
                    "compression": compression_for(kind, "cbor"),
                }  # fmt: skip
                connection.subscribe(fields, take)
            for identity, topic, kind_name in self._advertised:
                fields = {"op": "advertise", "id": identity, "topic": topic, "type": kind_name}
                connection.stand(fields)
            connection.settle()

    def call(
        self, endpoint: Endpoint, message: Message, timeout: float, cancelling: Cancelling
    ) -> Message:
        """Send a goal and return its result; a goal that is given up is cancelled.

        Raises:
            BridgeError: the goal was rejected, aborted, preempted or lost, or the connection broke.
            BridgeTimeoutError: no result within `timeout` seconds.
            MessageError: the goal does not fit its type.
        """
        deadline = time.monotonic() + timeout
        request, goal = self._write(message), _Goal()
        identity = f"{self._own}-{next(self._numbers)}"
        stamp = self._connection.rosapi("get_time").get("time")
        fields = {
            "op": "publish", "topic": f"{self.name}/goal",
            "msg": {"goal_id": {"stamp": stamp, "id": identity}, "goal": request},
        }  # fmt: skip
        with self._lock:
            if len(self._goals) >= _MOST_GOALS:
                text = f"{endpoint}: {_MOST_GOALS} goals are under way already"
                raise BridgeError(text, FailureReason.UNAVAILABLE)
            self._goals[identity] = goal
        self._status_at = time.monotonic()
        try:
            with cancelling(lambda: self._cancel(identity)):
                self._wait(endpoint, goal, fields, deadline, timeout)
        except BridgeTimeoutError:
            with suppress(BridgeError):
                self._cancel(identity)
            raise
        finally:
            with self._lock:
                self._goals.pop(identity, None)
        if goal.failure:
            raise BridgeError(f"{endpoint}: {goal.failure}", FailureReason.UNAVAILABLE)
        if goal.status == _DONE:
            return goal.result
        word = _WORDS.get(goal.status, f"ended with status {goal.status}")
        why = f": {goal.text}" if goal.text else ""
        raise BridgeError(f"{endpoint}: the goal was {word}{why}", FailureReason.RAISED)

    def fail(self, cause: str) -> None:
        """Give up the goals under way: what became of them will not be known."""
        with self._lock:
            goals = list(self._goals.values())
        for goal in goals:
            goal.failure = goal.failure or f"the goal was lost: {cause}"
            goal.changed.set()

    def close(self) -> None:
        """End it; goals under way are lost."""
        connection = self._connection
        for identity, topic, _ in self._advertised:
            connection.withdraw(identity, {"op": "unadvertise", "id": identity, "topic": topic})
        connection.unsubscribe(f"{self.name}/result", self._take_result)
        connection.unsubscribe(f"{self.name}/status", self._take_status)
        self.fail("the client was closed")

    def _wait(
        self,
        endpoint: Endpoint,
        goal: _Goal,
        fields: dict[str, Any],
        deadline: float,
        timeout: float,
    ) -> None:
        options, again_at = self._connection.options, 0.0
        while not (goal.has_result or goal.failure):
            now = time.monotonic()
            if now >= deadline:
                raise BridgeTimeoutError(f"{endpoint}: no result within {timeout:g} s")
            if not goal.is_known and now >= again_at:
                self._connection.send(fields)
                again_at = now + _AGAIN_SECONDS
            if goal.ended_at is not None and now - goal.ended_at > options.wait:
                word = _WORDS.get(goal.status, f"ended with status {goal.status}")
                goal.failure = f"the goal was {word}, and its result did not come"
            elif now - self._status_at > options.silence:
                goal.failure = f"the goal was lost: no status for {options.silence:g} s"
            goal.changed.wait(min(_AGAIN_SECONDS, deadline - now))
            goal.changed.clear()

    def _cancel(self, identity: str) -> None:
        message = {"stamp": {"secs": 0, "nsecs": 0}, "id": identity}
        self._connection.send({"op": "publish", "topic": f"{self.name}/cancel", "msg": message})

    def _take_result(self, came: Any) -> None:
        try:
            message: Any = self._read_result(came)
        except MessageError as error:
            self.fail(f"what the server sends cannot be read: {error}")
            return
        status = message["status"]
        goal = self._goals.get(status["goal_id"]["id"])
        if goal is not None and not goal.has_result:
            goal.status, goal.text = status["status"], status["text"][:1000]
            goal.result, goal.has_result = message["result"], True
            goal.changed.set()

    def _take_status(self, came: Any) -> None:
        try:
            message: Any = self._read_status(came)
        except MessageError as error:
            self.fail(f"what the server sends cannot be read: {error}")
            return
        self._status_at = time.monotonic()
        listed = {status["goal_id"]["id"]: status for status in message["status_list"]}
        with self._lock:
            goals = dict(self._goals)
        for identity, goal in goals.items():
            status = listed.get(identity)
            if status is not None:
                goal.is_known = True
                if status["status"] in _ENDED and goal.ended_at is None:
                    goal.status, goal.ended_at = status["status"], self._status_at
            elif goal.is_known and goal.ended_at is None:
                goal.failure = "the goal was lost: its server does not know it any more"
                goal.changed.set()


class ServedTypes:
    """How requests are read and replies written.

    Args:
        kinds: of the request and the reply; None: the server describes them not.
    """

    def __init__(self, kinds: tuple[RosType, RosType] | None) -> None:
        self.read: Callable[[Any], Message] = writer(None) if kinds is None else reader(kinds[0])
        self.write = writer(kinds and kinds[1])


@define(eq=False)
class ServedRequest:
    """What a client asks, and whether it has cancelled it."""

    fields: Fields
    is_canceled: bool = False


class _Served(Channel):
    """What comes is handled a few at a time; the others wait."""

    what: ClassVar[str]
    """Of the operations: what is served."""

    def __init__(
        self,
        endpoint: Endpoint,
        connection: ServerConnection,
        name: str,
        kind: str,
        types: ServedTypes,
        handler: Handler,
        at_once: int,
        report: Report,
    ) -> None:
        super().__init__(endpoint)
        self.name, self._types = name, types
        self._connection, self._handler, self._report = connection, handler, report
        self._requests: ServedRequests[ServedRequest] = ServedRequests(
            f"{self.what} {name}", self._handle, self._refuse, at_once, partial(report, self)
        )
        self._is_open = False
        self._why = ""
        self._identity = connection.new_id("serve")
        key = (self.what, name)
        if key in connection.serving:
            raise BridgeError(f"{endpoint}: it is served here already", FailureReason.REFUSED)
        connection.serving[key] = self._take
        connection.on_status(self._identity, self._status)
        with on_failure(self._close):
            operation = f"advertise_{self.what}"
            fields = {"op": operation, "id": self._identity, self.what: name, "type": kind}
            connection.stand(fields)
            connection.settle()
        if self._why:
            self._close()
            text = f"{endpoint}: the server refuses to have it served: {self._why}"
            raise BridgeError(text, FailureReason.REFUSED)
        self._is_open = True

    def facts(self) -> Mapping[str, object]:
        """Return counters of requests."""
        return self._requests.facts()

    def _status(self, text: str) -> None:
        """Take note of what the server says of it: it was refused, perhaps after a break."""
        self._why = text
        if self._is_open and not self.closed:
            self._report(self, Health.LOST, f"{self.name}: the server says: {text}")

    def _take(self, fields: Fields) -> None:
        self._requests.put(ServedRequest(fields))

    def _handle(self, request: ServedRequest) -> None:
        arguments = self._types.read(request.fields.get("args") or {})
        self._answer(request, self._types.write(self._handler(arguments)))

    def _refuse(self, request: ServedRequest, error: Exception) -> None:
        named = text_of(error)
        self._fail(request, str(error) if isinstance(error, BridgeError) else named)

    @abstractmethod
    def _answer(self, request: ServedRequest, values: object) -> None:
        """Say that a request was answered."""

    @abstractmethod
    def _fail(self, request: ServedRequest, why: str) -> None:
        """Say that it was not."""

    def _say(self, request: ServedRequest, **answer: object) -> None:
        head = {"id": request.fields.get("id"), self.what: self.name}
        with suppress(BridgeError):  # who asked is gone with the connection
            self._connection.send({**answer, **head})

    def _close(self) -> None:
        connection = self._connection
        self._requests.close()
        connection.forget_status(self._identity)
        connection.serving.pop((self.what, self.name), None)
        operation = f"unadvertise_{self.what}"
        connection.withdraw(self._identity, {"op": operation, self.what: self.name})


class AdvertisedService(_Served):
    """A function that clients of the server call."""

    what = "service"

    def _answer(self, request: ServedRequest, values: object) -> None:
        self._say(request, op="service_response", values=values, result=True)

    def _fail(self, request: ServedRequest, why: str) -> None:
        self._say(request, op="service_response", values=why, result=False)


class AdvertisedAction(_Served):
    """A function that answers goals of ROS 2, from rosbridge 2.1 on.

    A goal that waits ends at once when it is cancelled. One whose function runs goes on, as a
    function cannot be interrupted, and ends as canceled.
    """

    what = "action"

    def _take(self, fields: Fields) -> None:
        if fields.get("op") == "send_action_goal":
            super()._take(fields)
            return
        identity = fields.get("id")
        waiting, running = self._requests.withdraw(lambda goal: goal.fields.get("id") == identity)
        for goal in running:
            goal.is_canceled = True
        for goal in waiting:
            self._finish(goal, {}, _CANCELED)

    def _answer(self, request: ServedRequest, values: object) -> None:
        self._finish(request, values, _CANCELED if request.is_canceled else _SUCCEEDED)

    def _fail(self, request: ServedRequest, why: str) -> None:
        # rosbridge_suite takes no text for values, and leaves a goal with one open for ever.
        values = {"error": why}
        self._say(request, op="action_result", values=values, status=_ABORTED, result=False)

    def _finish(self, request: ServedRequest, values: object, status: int) -> None:
        self._say(request, op="action_result", values=values, status=status, result=True)
