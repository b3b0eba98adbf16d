"""Actions as calls: of ROS 2 as rosbridge has them, of ROS 1 by the topics of actionlib."""

from __future__ import annotations

import os
import threading
import time
from collections.abc import Callable
from contextlib import AbstractContextManager, suppress
from itertools import count
from typing import Any

from attrs import define, field

from uoarm.bridge import on_failure
from uoarm.errors import BridgeError, BridgeTimeoutError, FailureReason, MessageError
from uoarm.model import Endpoint, Message
from uoarm_rosbridge.client._connection import ServerConnection
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
