"""One vehicle that is in use: its states, its health, its transport orders, and their channels."""

from __future__ import annotations

import math
import threading
import time
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from contextlib import AbstractContextManager
from functools import partial
from typing import Any

from attrs import asdict, frozen
from uoarm_mqtt.connection import (
    BrokerConnection,
    ConnectionOptions,
    ReceivedMessage,
    Receiver,
)

from uoarm.bridge import (
    ChannelHealth,
    ChannelReport,
    Delivery,
    Log,
    ReceiveQueue,
    Sink,
    Source,
    on_failure,
)
from uoarm.errors import BridgeError, BridgeTimeoutError, FailureReason, MessageError
from uoarm.model import Budget, Endpoint, Health, Message
from uoarm_vda5050._messages import HEADER_IDS, VdaCodec
from uoarm_vda5050._orders import words_of
from uoarm_vda5050._transport_state import Action, Feedback, GoalEnded, Send, Status, TransportState

_MOST_STATES = 1000

_log = Log("uoarm.vda5050")


@frozen
class StateRead:
    """That a state came: why it cannot be read, empty where it can."""

    unreadable: str = ""


News = Status | Feedback | GoalEnded | StateRead
_Event = ReceivedMessage | tuple[bool, str] | str


class VehicleFollower:
    """Follows one vehicle in a thread of its own, from its opening on.

    Args:
        topic: of the vehicle's, up to the last level.
        transport: what becomes of its orders; touched under the lock only.
        state_timeout: seconds without a state that can be read after which that is reported.
        codecs: of `order`, `instantActions` and `state`.
        on_health: is called with health, cause, and the component that it is for; "": all of it.
        most_octets: of states that may wait to be taken.

    Attributes:
        octets: of the state that is being taken.
    """

    def __init__(
        self,
        link: BrokerConnection,
        topic: str,
        transport: TransportState,
        state_timeout: float,
        codecs: Mapping[str, VdaCodec],
        on_health: Callable[[Health, str, str], object],
        most_octets: int = 8 * Budget().octets,
    ) -> None:
        self._link, self._topic, self._codecs, self._on_health = link, topic, codecs, on_health
        self._transport, self._timeout = transport, state_timeout
        # Of a vehicle that is there, anew with each coming; touched by the thread only. That it
        # has gone is reported by what watches its connection.
        self._health: ChannelHealth | None = self._new_health()
        self._reported = Health.OK, ""
        # Guards the orders and the listeners, and is held while news is announced: what listeners
        # receive is in the order in which it came about, whichever thread brought it.
        self._lock = threading.Lock()
        self._listeners: tuple[Callable[[News], object], ...] = ()
        self._unreadable = self._missed = 0
        self._last_id: int | None = None
        self.octets = 0
        # What is no state, and gave way to later states before it was taken: however many these
        # are, that it came or went is not lost.
        self._overtaken: deque[_Event] = deque()
        self._inbox: ReceiveQueue[_Event] = ReceiveQueue(
            f"uoarm-vda5050-{topic}",
            self._take_next,
            _MOST_STATES,
            most_size=most_octets,
            size=_octets_of,
            dropped=self._drop,
            wake=self._wake,
        )
        self._receiver = Receiver(f"{topic}/state", self._inbox.put, qos=0)

    def open(self) -> None:
        """Subscribe to its states."""
        with on_failure(self._inbox.close):
            self._link.subscribe(self._receiver)

    def close(self) -> None:
        """Follow no more; nothing is sent, and a goal that is under way is lost."""
        self._link.unsubscribe(self._receiver)
        self._inbox.close()
        with self._lock:
            self._do(self._transport.connection(False, "the bridge was closed"))

    def connection(self, online: bool, why: str) -> None:  # noqa: FBT001
        """Take the news that it came or went; returns at once."""
        self._inbox.put((online, why))

    def greet(self, component: str) -> None:
        """Report to a component that opens how the vehicle is, where it is not well."""
        self._inbox.put(component)

    def facts(self) -> Mapping[str, object]:
        """Return how many states its header counters skipped, and how many could not be read."""
        return {"states_missed": self._missed, "states_unreadable": self._unreadable}

    def unread_states(self) -> str:
        """Say what came since the last state and could not be read, for the end of a sentence."""
        with self._lock:
            return self._transport.unread_states()

    def goal(self, goal: Mapping[str, Any]) -> str:
        """Take a goal; return its identifier. What becomes of it is reported to listeners.

        Raises:
            MessageError: it can be no order.
            BridgeError: the vehicle or the broker is away.
        """
        self._link.require_up()
        with self._lock:
            goal_id, actions = self._transport.goal(goal, time.monotonic())
            self._do(actions)
        self._inbox.poke()
        return goal_id

    def cancel(self, goal_id: str) -> None:
        """Cancel a goal, or whichever is under way where the identifier is empty."""
        with self._lock:
            self._do(self._transport.cancel(goal_id, time.monotonic()))
        self._inbox.poke()

    def join(self, listener: Callable[[News], object]) -> None:
        """Report news of goals to a listener, which must return at once."""
        with self._lock:
            self._listeners += (listener,)

    def leave(self, listener: Callable[[News], object]) -> None:
        """Notify a listener no more."""
        with self._lock:
            self._listeners = tuple(
                callback for callback in self._listeners if callback != listener
            )

    def _drop(self, event: _Event) -> None:
        if isinstance(event, tuple | str):
            self._overtaken.append(event)

    def _take_next(self, event: _Event) -> None:
        while self._overtaken:
            self._take(self._overtaken.popleft())
        self._take(event)

    def _take(self, event: _Event) -> None:
        now = time.monotonic()
        self.octets = _octets_of(event)
        if isinstance(event, str):
            if self._reported[0] is not Health.OK:
                self._on_health(*self._reported, event)
            return
        if isinstance(event, tuple):
            online, why = event
            self._last_id = None
            # One that says so again is as it was, until its next state says how it is now.
            if not online:
                self._health = None
            elif self._health is None:
                self._health = self._new_health()
                # What this thread reported of it late, after its coming was, is over.
                self._say(Health.OK, f"its {why}")
            with self._lock:
                self._do(self._transport.connection(online, why))
            return
        try:
            self._take_state(event, now)
        except (MessageError, LookupError, TypeError, ValueError) as error:
            if not event.payload:  # what was retained there was cleared
                return
            # A schema of the user's may allow what the rules of the standard cannot do without.
            self._unreadable += 1
            why = str(error) if isinstance(error, MessageError) else repr(error)
            with self._lock:
                self._transport.unreadable(why)
                self._announce(StateRead(why))
            self._judge("state", f"its state cannot be read: {why}"[:500])

    def _take_state(self, event: ReceivedMessage, now: float) -> None:
        header, body = self._codecs["state"].split(event.payload)
        self._count_gap(header.get("headerId"))
        state: Any = body
        fatal = [words_of(error) for error in state["errors"] if error["errorLevel"] == "FATAL"]
        with self._lock:
            self._do(self._transport.state(state, now))
            self._announce(StateRead())
        self._judge("vehicle", f"fatal: {'; '.join(fatal)[:500]}" if fatal else "")
        self._judge("state", "")
        if self._health is not None:
            self._report(self._health.passed(now))

    def _new_health(self) -> ChannelHealth:
        # It is never lost by silence: it may drive on, and is well with its next state.
        what = f"vehicle {'/'.join(self._topic.split('/')[-2:])}"
        return ChannelHealth(what, time.monotonic(), stale_after=self._timeout, grace=math.inf)

    def _judge(self, about: str, problem: str) -> None:
        """Report what the vehicle says of itself by its states; empty: nothing is wrong."""
        if self._health is not None:
            health = Health.DEGRADED if problem else Health.OK
            cause = problem or "its states are well again"
            now = time.monotonic()
            self._report(self._health.peer_reported(now, health, cause, about))

    def _count_gap(self, header_id: object) -> None:
        """Count the states between the last one and this one; a counter that went back is none."""
        if not isinstance(header_id, int):
            return
        step = 1 if self._last_id is None else (header_id - self._last_id) % HEADER_IDS
        self._last_id = header_id
        if 1 < step < HEADER_IDS // 2:
            self._missed += step - 1

    def _wake(self) -> float | None:
        now = time.monotonic()
        due: float | None = None
        if self._health is not None:
            self._report(self._health.tick(now, " that can be read"))
            due = self._health.wake_at()
        with self._lock:
            self._do(self._transport.tick(now))
            times = [self._transport.wake_at(), due]
        return min((value for value in times if value is not None), default=None)

    def _report(self, report: ChannelReport | None) -> None:
        if report is not None:
            self._say(report.health, report.cause)

    def _say(self, health: Health, cause: str) -> None:
        if health is not self._reported[0] or health is not Health.OK:
            self._reported = health, cause
            self._on_health(health, cause, "")

    def _announce(self, news: News) -> None:
        """Have every listener take in news, under the lock."""
        for listener in self._listeners:
            listener(news)

    def _do(self, actions: Sequence[Action]) -> None:
        """Do what is to be done, under the lock, so that news keeps its order."""
        for action in actions:
            if not isinstance(action, Send):
                self._announce(action)
                continue
            try:
                payload = self._codecs[action.topic].encode(action.body)
                self._link.publish(f"{self._topic}/{action.topic}", payload, qos=0)
            except BridgeError:
                continue  # the broker is away, which is reported; it is sent again
            except Exception as error:  # noqa: BLE001 - the MQTT client's own would end the thread
                why = str(error) if isinstance(error, MessageError) else repr(error)
                if action.topic == "order":
                    self._do(self._transport.unsendable(why))
                else:
                    _log.warning("%s/%s cannot be sent: %s", self._topic, action.topic, why)


def _octets_of(event: _Event) -> int:
    return 0 if isinstance(event, tuple | str) else len(event.payload)


_PARTS: Mapping[str, type[News]] = {"status": Status, "feedback": Feedback, "result": GoalEnded}


class TransportSource(Source):
    """Status changes, feedback or results of the transport orders of one vehicle."""

    def __init__(
        self,
        endpoint: Endpoint,
        part: str,
        follower: VehicleFollower,
        deliver: Delivery,
        limits: ConnectionOptions,
    ) -> None:
        super().__init__(endpoint)
        self._kind, self._follower, self._deliver = _PARTS[part], follower, deliver
        # With each the octets of the state that it was read from.
        self._inbox: ReceiveQueue[tuple[News, int]] = ReceiveQueue(
            f"uoarm-vda5050-{part}",
            lambda came: self._hand_over(came[0]),
            limits.backlog,
            most_size=limits.backlog_octets,
            size=lambda came: came[1],
        )
        follower.join(self._take)

    def facts(self) -> Mapping[str, object]:
        """Return counters of this channel, and of the states that all of it is read from."""
        mine = {"under_way": len(self._inbox), "lost_on_link": self._inbox.dropped}
        return {**mine, **self._follower.facts()}

    def _take(self, news: News) -> None:
        is_reading = isinstance(news, StateRead) and bool(news.unreadable or self.unreadable)
        if is_reading or isinstance(news, self._kind):
            self._inbox.put((news, self._follower.octets))

    def _hand_over(self, news: News) -> None:
        if not isinstance(news, StateRead):
            self._deliver(asdict(news, recurse=False))
        elif news.unreadable:
            self._deliver.unreadable(news.unreadable)
        else:
            self._deliver.readable()

    def _close(self) -> None:
        self._follower.leave(self._take)
        self._inbox.close()


class TransportSink(Sink):
    """Goals or cancellations for one vehicle; what becomes of them is a status, then a result."""

    blocking = False

    def __init__(
        self, endpoint: Endpoint, part: str, follower: VehicleFollower, link: BrokerConnection
    ) -> None:
        super().__init__(endpoint)
        self._part, self._follower, self._link = part, follower, link

    def drain(self, timeout: float) -> bool:
        """Wait until the broker has what was sent."""
        return self._link.drain(timeout)

    def _send(self, message: Message) -> None:
        if not isinstance(message, dict):
            raise MessageError(f"expected an object, got {type(message).__name__}")
        if self._part == "goal":
            self._follower.goal(message)
        else:
            self._follower.cancel(str(message.get("goal_id", "")))

    def _close(self) -> None:
        """Nothing is held: what was asked for goes its way."""


def call(
    endpoint: Endpoint,
    follower: VehicleFollower,
    message: Message,
    timeout: float,
    cancelling: Callable[[Callable[[], object]], AbstractContextManager[None]],
) -> Message:
    """Give a goal and return its result; one that is given up is cancelled.

    Raises:
        BridgeError: it ended in another way than well.
        BridgeTimeoutError: it did not end within `timeout` seconds.
        MessageError: it can be no order.
    """
    if not isinstance(message, dict):
        raise MessageError(f"expected an object, got {type(message).__name__}")
    changed = threading.Condition()
    ended: dict[str, GoalEnded] = {}

    def listen(news: News) -> None:
        if isinstance(news, GoalEnded):
            with changed:
                ended[news.goal_id] = news
                changed.notify()

    follower.join(listen)
    try:
        goal_id = follower.goal(message)
        with cancelling(partial(follower.cancel, goal_id)), changed:
            is_over = changed.wait_for(lambda: goal_id in ended, timeout)
        if not is_over:
            follower.cancel(goal_id)
            text = f"{endpoint}: order {goal_id!r} did not end in {timeout:g} s"
            raise BridgeTimeoutError(text + follower.unread_states())
    finally:
        follower.leave(listen)
    end = ended[goal_id]
    if end.status != "succeeded":
        reason = FailureReason.UNAVAILABLE if end.status == "lost" else FailureReason.REFUSED
        text = f"{endpoint}: order {goal_id!r} ended {end.status}: {end.result['reason']}"
        raise BridgeError(text, reason)
    return end.result
