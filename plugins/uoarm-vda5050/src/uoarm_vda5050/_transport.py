"""Transport orders as channels and calls: goals and cancellations in, what becomes of them out."""

from __future__ import annotations

import threading
from collections.abc import Mapping

from attrs import asdict
from uoarm_mqtt.connection import BrokerConnection

from uoarm.bridge import Delivery, Sink, Source
from uoarm.errors import BridgeError, BridgeTimeoutError, FailureReason, MessageError
from uoarm.model import Endpoint, Message
from uoarm_vda5050._follower import Follower, News, StateRead
from uoarm_vda5050._inbox import Inbox
from uoarm_vda5050._transport_state import Ended, Feedback, Status

__all__ = ["TransportSink", "TransportSource", "call"]

_PARTS: Mapping[str, type[News]] = {"status": Status, "feedback": Feedback, "result": Ended}


class TransportSource(Source):
    """Status changes, feedback or results of the transport orders of one vehicle."""

    def __init__(
        self, endpoint: Endpoint, part: str, follower: Follower, deliver: Delivery, most: int
    ) -> None:
        super().__init__(endpoint)
        self._kind, self._follower, self._deliver = _PARTS[part], follower, deliver
        self._inbox: Inbox[News] = Inbox(f"uoarm-vda5050-{part}", self._hand_over, most)
        follower.join(self._take)

    def facts(self) -> Mapping[str, object]:
        """Return counters of this channel, and of the states that all of it is read from."""
        mine = {"under_way": len(self._inbox), "lost_on_link": self._inbox.dropped}
        return {**mine, **self._follower.facts()}

    def _take(self, news: News) -> None:
        is_reading = isinstance(news, StateRead) and bool(news.unreadable or self.unreadable)
        if is_reading or isinstance(news, self._kind):
            self._inbox.put(news)

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
        self, endpoint: Endpoint, part: str, follower: Follower, link: BrokerConnection
    ) -> None:
        super().__init__(endpoint)
        self._part, self._follower, self._link = part, follower, link

    def drain(self, timeout: float) -> bool:
        """Wait until the broker has what was sent."""
        del timeout
        self._link.barrier()
        return True

    def _send(self, message: Message) -> None:
        if not isinstance(message, dict):
            raise MessageError(f"expected an object, got {type(message).__name__}")
        if self._part == "goal":
            self._follower.goal(message)
        else:
            self._follower.cancel(str(message.get("goal_id", "")))

    def _close(self) -> None:
        """Nothing is held: what was asked for goes its way."""


def call(endpoint: Endpoint, follower: Follower, message: Message, timeout: float) -> Message:
    """Give a goal and return its result; one that is given up is cancelled.

    Raises:
        BridgeError: it ended in another way than well.
        BridgeTimeoutError: it did not end within `timeout` seconds.
        MessageError: it can be no order.
    """
    if not isinstance(message, dict):
        raise MessageError(f"expected an object, got {type(message).__name__}")
    changed = threading.Condition()
    ended: dict[str, Ended] = {}

    def listen(news: News) -> None:
        if isinstance(news, Ended):
            with changed:
                ended[news.goal_id] = news
                changed.notify()

    follower.join(listen)
    try:
        goal_id = follower.goal(message)
        with changed:
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
