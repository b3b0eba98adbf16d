"""Actions of actionlib: five topics as one call, and functions that answer goals in ROS 1."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Mapping
from contextlib import AbstractContextManager
from functools import partial
from itertools import count
from typing import Any

from attrs import define, field

from uoarm.bridge import (
    Channel,
    Description,
    Handler,
    ServedRequests,
    did_you_mean,
    on_failure,
    text_of,
)
from uoarm.errors import BridgeError, BridgeTimeoutError, FailureReason, MessageError
from uoarm.model import Endpoint, Health, Message, MessageStructure
from uoarm_ros1._definitions import RosRecord
from uoarm_ros1._discovery import Graph
from uoarm_ros1._master import GraphState
from uoarm_ros1._node import Node
from uoarm_ros1._options import Ros1Address, Ros1Options
from uoarm_ros1._publication import TopicPublication
from uoarm_ros1._subscription import PublisherHeader, TopicSubscription
from uoarm_ros1._types import ActionType, TypeStore, framed_writer, reader

PENDING, ACTIVE, PREEMPTED, SUCCEEDED, ABORTED, REJECTED = range(6)
PREEMPTING, RECALLING, RECALLED, LOST = range(6, 10)
_WORDS = {
    PREEMPTED: "preempted",
    ABORTED: "aborted",
    REJECTED: "rejected",
    RECALLED: "recalled",
    LOST: "lost",
}
_GOAL_ID, _STATUS_ARRAY = "actionlib_msgs/GoalID", "actionlib_msgs/GoalStatusArray"
_STATUS_SECONDS = 0.2
_KEEP_SECONDS = 5.0
_MOST_GOALS = 256


def described_action(
    graph: Graph,
    types: TypeStore,
    endpoint: Endpoint,
    name: str,
    address: Ros1Address,
    port: Ros1Options,
) -> Description:
    """Return an action as a call: the goal is the request, the result the reply.

    Raises:
        BridgeError: no server of it is there, or its type is not known here.
    """
    if not endpoint.is_offered and port.peer_required:
        require_server(graph, endpoint, name)
    kinds = action_type(graph, types, endpoint, name, address)
    return Description(
        request=_structure(kinds.goal, "goal"),
        reply=_structure(kinds.result, "result"),
    )


def require_server(graph: Graph, endpoint: Endpoint, name: str) -> None:
    """Raise BridgeError where no node that lives serves an action."""
    servers = _servers(graph.state, name)
    if not servers:
        goals = (topic for topic in graph.state.subscribers if topic.endswith("/goal"))
        meant = did_you_mean(name, (topic.removesuffix("/goal") for topic in goals))
        text = f"{endpoint}: there is no server of action {name}{meant}"
        raise BridgeError(text, FailureReason.NOT_FOUND)
    if not graph.living(servers):
        text = f"{endpoint}: of the servers of action {name} none answers: {', '.join(servers)}"
        raise BridgeError(text, FailureReason.UNAVAILABLE)


def action_type(
    graph: Graph, types: TypeStore, endpoint: Endpoint, name: str, address: Ros1Address
) -> ActionType:
    """Return the type of an action: as the address says, or the type of its goals."""
    kind = address.type
    if not kind:
        goals = graph.types.get(f"{name}/goal", "")
        if not goals.endswith("ActionGoal"):
            text = f"{endpoint}: the type of action {name} is not known: add it to the address"
            raise BridgeError(text, FailureReason.UNSUPPORTED)
        kind = goals.removesuffix("Goal")
    return types.action(kind)


def _servers(state: GraphState, name: str) -> list[str]:
    publishers = state.publishers.get(f"{name}/status", ())
    subscribers = state.subscribers.get(f"{name}/goal", ())
    return [node for node in publishers if node in subscribers]


def _member(record: RosRecord, name: str) -> dict[str, Any]:
    schema: dict[str, Any] = record.schema["properties"].get(name, {})
    if schema.get("type") != "object":
        raise BridgeError(f"{record.name} has no member {name!r}", FailureReason.UNSUPPORTED)
    return schema


def _structure(record: RosRecord, name: str) -> MessageStructure:
    schema = _member(record, name)
    return MessageStructure(schema, native_type=schema["x-native-type"])


@define(eq=False)
class _Goal:
    """A goal that was sent and has not ended."""

    ended: threading.Event = field(factory=threading.Event)
    status: int = LOST
    text: str = ""
    result: Message = None


class ActionCaller:
    """A client of one action; several goals at a time."""

    def __init__(
        self,
        node: Node,
        types: TypeStore,
        endpoint: Endpoint,
        name: str,
        address: Ros1Address,
        port: Ros1Options,
    ) -> None:
        self._node, self._name = node, name
        self._wait = node.options.wait if port.wait is None else port.wait
        kinds = action_type(Graph(node), types, endpoint, name, address)
        budget = node.options.budget
        self._write_goal = framed_writer(kinds.goal)
        self._read_result = reader(kinds.result, budget)
        cancel = types.require(_GOAL_ID)
        self._write_cancel = framed_writer(cancel)
        # Guards the goals under way, between threads that call, and those in which results come.
        self._lock = threading.Lock()
        self._goals: dict[str, _Goal] = {}
        self._numbers = count(1)
        self._subscription = TopicSubscription(
            node.wanted(f"{name}/result", kinds.result),
            node.peers,
            self._take_result,
            lambda _: None,
            self._went,
        )
        self._publications: list[TopicPublication] = []
        with on_failure(self.close):
            node.subscribe(self._subscription)
            self._publications.append(node.advertise(f"{name}/goal", kinds.goal))
            self._publications.append(node.advertise(f"{name}/cancel", cancel))

    def call(
        self,
        endpoint: Endpoint,
        message: Message,
        timeout: float,
        cancelling: Callable[[Callable[[], object]], AbstractContextManager[None]],
    ) -> Message:
        """Send a goal and return its result; a goal that is given up is cancelled.

        Raises:
            BridgeError: no server, or the goal was rejected, aborted, preempted or lost.
            BridgeTimeoutError: no result within `timeout` seconds.
            MessageError: the goal does not fit its type.
        """
        deadline = time.monotonic() + timeout
        self._require_server(endpoint, min(deadline, time.monotonic() + self._wait))
        now = self._node.stamp()
        number = next(self._numbers)
        identity = f"{self._node.name}-{number}-{now['secs']}.{now['nsecs']:09d}"
        goal_id = {"stamp": now, "id": identity}
        header = {"seq": number, "stamp": now, "frame_id": ""}
        frame = self._write_goal({"header": header, "goal_id": goal_id, "goal": message})
        goal = _Goal()
        with self._lock:
            if len(self._goals) >= _MOST_GOALS:
                text = f"{endpoint}: {_MOST_GOALS} goals are under way already"
                raise BridgeError(text, FailureReason.UNAVAILABLE)
            self._goals[identity] = goal
        try:
            with cancelling(lambda: self._cancel(identity)):
                self._publications[0].send(frame)
                if not goal.ended.wait(max(0.0, deadline - time.monotonic())):
                    self._cancel(identity)
                    raise BridgeTimeoutError(f"{endpoint}: no result within {timeout:g} s")
        finally:
            with self._lock:
                self._goals.pop(identity, None)
        if goal.status == SUCCEEDED:
            return goal.result
        word = _WORDS.get(goal.status, f"ended with status {goal.status}")
        lost = goal.status == LOST
        reason = FailureReason.UNAVAILABLE if lost else FailureReason.RAISED
        why = f": {goal.text}" if goal.text else ""
        raise BridgeError(f"{endpoint}: the goal was {word}{why}", reason)

    def close(self) -> None:
        """End it; goals under way are lost."""
        self._node.unsubscribe(self._subscription)
        for publication in self._publications:
            self._node.withdraw(publication)
        self._end_all("the client was closed")

    def _require_server(self, endpoint: Endpoint, deadline: float) -> None:
        """Wait until one server has all: it sends results, and takes goals and their ends."""

        def servers() -> set[str]:
            found = {header.node for header in self._subscription.connected}
            for publication in self._publications:
                found &= set(publication.callers)
            return found

        while not servers():
            left = deadline - time.monotonic()
            if left <= 0:
                require_server(Graph(self._node), endpoint, self._name)
                why = "; ".join(self._subscription.failures)
                text = f"{endpoint}: the server of action {self._name} did not connect in time"
                raise BridgeError(f"{text}{f': {why}' if why else ''}", FailureReason.UNAVAILABLE)
            self._publications[0].wait(lambda _: bool(servers()), min(left, 0.02))

    def _cancel(self, identity: str) -> bool:
        goal_id = {"stamp": {"secs": 0, "nsecs": 0}, "id": identity}
        self._publications[1].send(self._write_cancel(goal_id))
        return bool(self._publications[1].callers)

    def _take_result(self, frame: bytes | bytearray, _: str) -> None:
        try:
            message = self._read_result(frame)
        except MessageError as error:
            self._end_all(f"what its server sends cannot be read: {error}")
            return
        status = message["status"]
        with self._lock:
            goal = self._goals.get(status["goal_id"]["id"])
        if goal is not None and not goal.ended.is_set():
            goal.status, goal.text = status["status"], status["text"][:1000]
            goal.result = message["result"]
            goal.ended.set()

    def _went(self, name: str, cause: str, was_connected: bool, _: bool) -> None:  # noqa: FBT001 - of the subscription
        if was_connected and not self._subscription.connected:
            self._end_all(f"its server is gone: {name}: {cause}")

    def _end_all(self, why: str) -> None:
        with self._lock:
            goals = [goal for goal in self._goals.values() if not goal.ended.is_set()]
        for goal in goals:
            goal.status, goal.text = LOST, why
            goal.ended.set()


@define(eq=False)
class _Served:
    """A goal that came.

    Attributes:
        goal_id: as its client gave it.
        status: as actionlib numbers it.
        until: when it is forgotten, once it has ended.
    """

    goal_id: Message
    status: int = PENDING
    text: str = ""
    until: float = float("inf")

    @property
    def message(self) -> Message:
        return {"goal_id": self.goal_id, "status": self.status, "text": self.text}


class ServedAction(Channel):
    """A function that answers goals: as many at a time as are allowed, the others wait.

    A goal that waits is recalled when it is cancelled. One that runs goes on, as a function cannot
    be interrupted, and ends as preempted.
    """

    def __init__(
        self,
        endpoint: Endpoint,
        node: Node,
        types: TypeStore,
        name: str,
        kinds: ActionType,
        handler: Handler,
        at_once: int,
        report: Callable[[Channel, Health, str], None],
    ) -> None:
        super().__init__(endpoint)
        self._node, self._handler = node, handler
        self._requests: ServedRequests[tuple[_Served, Message]] = ServedRequests(
            f"action {name}", self._run, self._abort, at_once, partial(report, self)
        )
        budget = node.options.budget
        goal_id, status = types.require(_GOAL_ID), types.require(_STATUS_ARRAY)
        self._read_goal, self._read_cancel = reader(kinds.goal, budget), reader(goal_id, budget)
        self._write_result = framed_writer(kinds.result)
        self._write_status = framed_writer(status)
        # Guards the goals, and the order in which their states are published.
        self._lock = threading.Lock()
        self._goals: dict[str, _Served] = {}
        self._cancelled_up_to = (0, 0)  # all goals with a time
        self._numbers = count(1)
        self._refused = 0
        self._publications: list[TopicPublication] = []
        self._subscriptions: list[TopicSubscription] = []
        self._stopped = threading.Event()
        with on_failure(self._close):
            for part, record in (("result", kinds.result), ("feedback", kinds.feedback)):
                self._publications.append(node.advertise(f"{name}/{part}", record))
            self._publications.append(node.advertise(f"{name}/status", status, latch=1))
            for part, kind, take in (
                ("goal", kinds.goal, self._take_goal),
                ("cancel", goal_id, self._take_cancel),
            ):
                wanted = node.wanted(f"{name}/{part}", kind)
                made = TopicSubscription(wanted, node.peers, take, _ignore_header, _ignore_end)
                self._subscriptions.append(made)
                node.subscribe(made)
            threading.Thread(
                target=self._publish_status, name=f"uoarm-ros1-{name}-status", daemon=True
            ).start()

    def facts(self) -> Mapping[str, object]:
        """Return counters of goals."""
        return {**self._requests.facts(), "refused": self._refused, "goals": len(self._goals)}

    def _take_goal(self, frame: bytes | bytearray, _: str) -> None:
        try:
            message = self._read_goal(frame)
        except MessageError:
            self._refused += 1
            return
        goal_id = message["goal_id"]
        identity = goal_id["id"] or f"{self._node.name}-{next(self._numbers)}"
        with self._lock:
            # A cancellation may come before its goal, by another connection.
            if identity in self._goals:
                served = self._goals[identity]
                is_new = served.status == RECALLING
            else:
                is_late = (0, 0) < _moment(goal_id["stamp"]) <= self._cancelled_up_to
                status = RECALLING if is_late else PENDING
                served, is_new = _Served({**goal_id, "id": identity}, status), True
                self._goals[identity] = served
            is_full = sum(goal.until == float("inf") for goal in self._goals.values()) > _MOST_GOALS
        if not is_new:
            return
        if served.status == RECALLING:
            self._end(served, RECALLED, None, "it was cancelled before it came")
        elif is_full:
            self._refused += 1
            self._end(served, REJECTED, None, f"{_MOST_GOALS} goals are under way already")
        else:
            self._requests.put((served, message["goal"]))

    def _take_cancel(self, frame: bytes | bytearray, _: str) -> None:
        try:
            message = self._read_cancel(frame)
        except MessageError:
            return
        identity, at = message["id"], _moment(message["stamp"])
        with self._lock:
            self._cancelled_up_to = max(self._cancelled_up_to, at)
            if identity and identity not in self._goals and len(self._goals) < _MOST_GOALS:
                until = time.monotonic() + _KEEP_SECONDS
                self._goals[identity] = _Served(message, RECALLING, "", until)
            for served in self._goals.values():
                # An empty id and no time: all of them; a time: those up to it.
                is_meant = served.goal_id["id"] == identity if identity else not any(at)
                if not is_meant and any(at):
                    is_meant = _moment(served.goal_id["stamp"]) <= at
                if is_meant and served.status in {PENDING, ACTIVE}:
                    served.status = RECALLING if served.status == PENDING else PREEMPTING

    def _run(self, request: tuple[_Served, Message]) -> None:
        served, goal = request
        with self._lock:
            is_cancelled = served.status != PENDING
            if not is_cancelled:
                served.status = ACTIVE
        if is_cancelled:
            self._end(served, RECALLED, None, "it was cancelled before it began")
            return
        self._say_status()
        result = self._handler(goal)
        was_cancelled = served.status == PREEMPTING
        self._end(served, PREEMPTED if was_cancelled else SUCCEEDED, result, "")

    def _abort(self, request: tuple[_Served, Message], error: Exception) -> None:
        self._end(request[0], ABORTED, None, text_of(error))

    def _end(self, served: _Served, status: int, result: Message | None, text: str) -> None:
        with self._lock:
            served.status, served.text = status, text
            served.until = time.monotonic() + _KEEP_SECONDS
            value = self._empty_result() if result is None else result
            message = {"header": self._header(), "status": served.message, "result": value}
            frame = self._write_result(message)
            self._publications[0].send(frame)
        self._say_status()

    def _empty_result(self) -> Message:
        return _zero(_member(self._publications[0].record, "result"))

    def _header(self) -> Message:
        return {"seq": next(self._numbers), "stamp": self._node.stamp(), "frame_id": ""}

    def _say_status(self) -> None:
        with self._lock:
            now = time.monotonic()
            for identity in [key for key, goal in self._goals.items() if goal.until < now]:
                del self._goals[identity]
            statuses = [goal.message for goal in self._goals.values()]
            message = {"header": self._header(), "status_list": statuses}
            self._publications[2].send(self._write_status(message))

    def _publish_status(self) -> None:
        while not self._stopped.wait(_STATUS_SECONDS):
            self._say_status()

    def _close(self) -> None:
        self._stopped.set()
        self._requests.close()
        for subscription in self._subscriptions:
            self._node.unsubscribe(subscription)
        for publication in self._publications:
            self._node.withdraw(publication)


def _ignore_header(_: PublisherHeader) -> None:
    """Clients come and go."""


def _ignore_end(*_: object) -> None:
    """Clients come and go."""


def _moment(stamp: Message) -> tuple[int, int]:
    return stamp["secs"], stamp["nsecs"]


def _zero(schema: Mapping[str, Any]) -> Any:
    """Return the value of a structure in which everything is zero or empty."""
    kind = schema["type"]
    if kind == "object":
        return {name: _zero(member) for name, member in schema["properties"].items()}
    if kind == "array":
        return [_zero(schema["items"]) for _ in range(schema.get("minItems", 0))]
    return {"string": "", "boolean": False, "integer": 0, "number": 0.0}[kind]
