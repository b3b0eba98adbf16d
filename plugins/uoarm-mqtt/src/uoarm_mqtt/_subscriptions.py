"""The table of subscriptions, and which receivers get a message; without a connection."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterator

from attrs import define, field, frozen
from paho.mqtt.client import topic_matches_sub

_FIRST_ID = 1
_KEPT_IDS = 16  # of one filter: messages on their way carry the last, or one shortly before it


@frozen
class ReceivedMessage:
    """A message as it came.

    Attributes:
        topic: that it was published on.
        payload: its octets.
        retain: whether it comes because something was subscribed to, and was published before.
        properties: of MQTT 5, as attributes.
    """

    topic: str
    payload: bytes
    retain: bool = False
    properties: object = None


@define(eq=False)
class Receiver:
    """Something that a topic filter was subscribed to for.

    Attributes:
        topic: filter, with $share and its group where the subscription is shared.
        give: takes each message, in the thread of the network: must return at once.
        retained: whether the last message of each topic is wanted first.
        refused: takes why the broker does not subscribe it again after a break.
        id: of the subscription made for this receiver.
    """

    topic: str
    give: Callable[[ReceivedMessage], None]
    qos: int = 1
    retained: bool = False
    refused: Callable[[str], None] = lambda _: None
    id: int = field(default=0, init=False)


class Subscriptions:
    """The receivers of one connection; one thread at a time.

    The broker holds one subscription for each filter: a second receiver of the same one
    subscribes again, under an identifier of its own. Messages carry the identifier of the last
    one. What was published is then for every receiver of that filter, and what was retained, which
    the broker sends for each subscribing, for the receiver that has just subscribed. Where
    filters overlap, each receiver gets a message once, whether the broker sends one copy or more.
    """

    def __init__(self) -> None:
        self._ids = itertools.count(_FIRST_ID)
        self._receivers: dict[str, list[Receiver]] = {}
        self._filters: dict[int, str] = {}

    def __iter__(self) -> Iterator[Receiver]:
        return iter([receiver for several in self._receivers.values() for receiver in several])

    def add(self, receiver: Receiver) -> int:
        """Add a receiver, or give it a new identifier; return the QoS to be subscribed with."""
        receiver.id = next(self._ids)
        self._filters[receiver.id] = receiver.topic
        ids = [known for known, topic in self._filters.items() if topic == receiver.topic]
        for old in ids[:-_KEPT_IDS]:
            del self._filters[old]
        receivers = self._receivers.setdefault(receiver.topic, [])
        if receiver not in receivers:
            receivers.append(receiver)
        return max(receiver.qos for receiver in receivers)

    def remove(self, receiver: Receiver) -> bool:
        """Remove a receiver; return whether its filter is to be unsubscribed from."""
        several = self._receivers.get(receiver.topic, [])
        if receiver not in several:
            return False
        several.remove(receiver)
        if several:
            return False
        del self._receivers[receiver.topic]
        self._filters = {k: v for k, v in self._filters.items() if v != receiver.topic}
        return True

    def route(self, message: ReceivedMessage) -> list[Receiver]:
        """Return the receivers of a message."""
        ids = set(getattr(message.properties, "SubscriptionIdentifier", ()))
        if ids:
            topics = {self._filters[id_] for id_ in ids if id_ in self._filters}
        else:  # the broker has no identifiers
            topics = {topic for topic in self._receivers if _matches(topic, message.topic)}
        found = [receiver for topic in topics for receiver in self._receivers.get(topic, ())]
        if message.retain:
            return [
                receiver
                for receiver in found
                if receiver.retained and (receiver.id in ids or not ids)
            ]
        return found


def _matches(topic: str, name: str) -> bool:
    if topic.startswith("$share/"):
        topic = topic.split("/", 2)[2]
    return topic_matches_sub(topic, name)
