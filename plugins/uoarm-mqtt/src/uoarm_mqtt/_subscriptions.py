"""The table of subscriptions, and which receivers get a message; without a connection."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterator

from attrs import define, field, frozen
from paho.mqtt.client import topic_matches_sub

_FIRST_ID = 1
_KEPT_IDS = 16  # of one filter: messages on their way carry the last, or one shortly before it
_KNOWN_TOPICS = 10_000  # of one receiver, whose last payload is known again


@frozen
class ReceivedMessage:
    """A message as it came.

    Attributes:
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
        lapses: whether what stood on a topic ends, as an empty payload says, where it is not said
            again within `grace` after a break: a broker may have forgotten it with its writer gone.
        id: of the subscription made for this receiver.
    """

    topic: str
    give: Callable[[ReceivedMessage], None]
    qos: int = 1
    retained: bool = False
    refused: Callable[[str], None] = lambda _: None
    lapses: bool = False
    id: int = field(default=0, init=False)
    _last: dict[str, int] = field(factory=dict, init=False)  # hash of each topic's last payload
    _unsaid: set[str] = field(factory=set, init=False)  # topics of it, since the last break

    def is_new(self, message: ReceivedMessage) -> bool:
        """Note what stands on a topic; False where it is said once more, as after a break."""
        mark = hash(message.payload)
        self._unsaid.discard(message.topic)
        before = self._last.pop(message.topic, None)
        self._last[message.topic] = mark
        if len(self._last) > _KNOWN_TOPICS:
            del self._last[next(iter(self._last))]
        return not message.retain or mark != before

    def begin_again(self) -> None:
        """Note that what stands is said again from now on, where it still does."""
        self._unsaid = set(self._last) if self.lapses else set()

    def lapsed(self) -> list[str]:
        """Return once the topics of which nothing was said since."""
        topics, self._unsaid = sorted(self._unsaid), set()
        for topic in topics:
            self._last.pop(topic, None)
        return topics


class Subscriptions:
    """The receivers of one connection; one thread at a time.

    The broker holds one subscription for each filter: a second receiver of the same one
    subscribes again, under an identifier of its own. Messages carry the identifier of the last
    one. What was published is then for every receiver of that filter, and what was retained, which
    the broker sends for each subscribing, for the receiver that has just subscribed. Where
    filters overlap, each receiver gets a message once, whether the broker sends one copy or more.

    After a break all are subscribed to again, also in a session that outlived it: what was
    published with QoS 0 meanwhile is in no session, but stands where it was retained.
    """

    def __init__(self) -> None:
        self._ids = itertools.count(_FIRST_ID)
        self._receivers: dict[str, list[Receiver]] = {}
        self._filters: dict[int, str] = {}
        self._ids_of: dict[str, list[int]] = {}  # of each filter, the newest last
        # Filters from which the broker has not yet confirmed that it unsubscribed, and the
        # identifier under which it was asked: a session that outlives a break still has them.
        self._leaving: dict[str, int] = {}

    def __iter__(self) -> Iterator[Receiver]:
        return iter([receiver for several in self._receivers.values() for receiver in several])

    def add(self, receiver: Receiver) -> int:
        """Add a receiver, or give it a new identifier; return the QoS to be subscribed with."""
        receiver.id = next(self._ids)
        self._filters[receiver.id] = receiver.topic
        ids = self._ids_of.setdefault(receiver.topic, [])
        ids.append(receiver.id)
        if len(ids) > _KEPT_IDS:
            del self._filters[ids.pop(0)]
        self._leaving.pop(receiver.topic, None)
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
        for known in self._ids_of.pop(receiver.topic):
            del self._filters[known]
        self._leaving[receiver.topic] = receiver.id
        return True

    def left(self, topic: str, id_: int) -> None:
        """Take the broker's word that it unsubscribed from a filter, as it was asked with an id."""
        if self._leaving.get(topic) == id_:
            del self._leaving[topic]

    def resume(self, *, is_same: bool) -> list[tuple[str, int]]:
        """Return the filters to be left again, with their identifiers, once it is connected.

        Args:
            is_same: whether the session is the one before, with all that it had.
        """
        if not is_same:
            self._leaving.clear()
        for receiver in self:
            receiver.begin_again()
        return list(self._leaving.items())

    def route(self, message: ReceivedMessage) -> list[Receiver]:
        """Return the receivers of a message."""
        ids = set(getattr(message.properties, "SubscriptionIdentifier", ()))
        if ids:
            topics = {self._filters[id_] for id_ in ids if id_ in self._filters}
        else:  # the broker has no identifiers
            topics = {topic for topic in self._receivers if _matches(topic, message.topic)}
        found = [receiver for topic in topics for receiver in self._receivers.get(topic, ())]
        if message.retain:
            found = [
                receiver
                for receiver in found
                if receiver.retained and (receiver.id in ids or not ids)
            ]
        return [receiver for receiver in found if not receiver.retained or receiver.is_new(message)]


def _matches(topic: str, name: str) -> bool:
    if topic.startswith("$share/"):
        topic = topic.split("/", 2)[2]
    return topic_matches_sub(topic, name)
