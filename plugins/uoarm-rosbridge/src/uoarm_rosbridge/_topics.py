"""Topics of one rosbridge client: those it publishes, and its subscriptions to the others.

A subscription has a rate, a queue and a compression of its own.
"""

from __future__ import annotations

import struct
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from typing import Any

from attrs import define, field, frozen

from uoarm import cdr
from uoarm.errors import ControlMessageError, MessageError, UoarmError, UsageError
from uoarm.model import Message, MessageStructure, Role
from uoarm.server.front_end import (
    Backend,
    Client,
    Feed,
    FeedKey,
    LimitError,
    MessageForm,
    Operation,
    Subscription,
    Throttle,
    write_binary,
)
from uoarm.server.publication import InputPublication
from uoarm_rosbridge._hub import Hub
from uoarm_rosbridge._names import Addresses, NamedPort, find_place
from uoarm_rosbridge._publication import SharedPublication, publish_into
from uoarm_rosbridge._types import TopicType
from uoarm_rosbridge._wire import (
    clock_now,
    fragment_size,
    split,
    write_publish,
    write_publish_cbor,
    write_publish_png,
)

_head = struct.Struct(">BI").pack
_BYTE_STRING = 0x5A  # of CBOR, behind which its length stands in four octets


class RawWriter:
    """Writes a topic's messages for those who read the serialised form themselves.

    Args:
        topic: as the client named it.
        structure: says what the messages are like now; a takeover may change it.
    """

    def __init__(self, topic: str, structure: Callable[[], MessageStructure]) -> None:
        self._topic = topic
        self._structure = structure
        self._known: MessageStructure | None = None
        self._serialise: Callable[[Message], Sequence[cdr.Part]] | None = None

    def __call__(self, number: int, message: Message) -> bytes:
        """Return a publish message.

        Raises:
            MessageError: the message does not fit, or its structure has no fixed layout.
        """
        del number
        seconds, nanoseconds = clock_now()
        parts = self.prepare()(message)
        raw = {"secs": seconds, "nsecs": nanoseconds, "bytes": b""}
        before = write_binary({"op": "publish", "topic": self._topic, "msg": raw})
        length = sum(memoryview(part).nbytes for part in parts)
        return b"".join((before[:-1], _head(_BYTE_STRING, length), *parts))

    def prepare(self) -> Callable[[Message], Sequence[cdr.Part]]:
        """Read the structure, unless it is known, and return what serialises its messages.

        Raises:
            MessageError: the structure has no fixed layout.
        """
        structure = self._structure()
        if self._serialise is None or structure is not self._known:
            try:
                self._serialise = cdr.Codec(structure).encode_parts
            except MessageError as error:
                raise MessageError(f"{error}; ask for cbor instead of cbor-raw") from None
            self._known = structure
        return self._serialise


_RAW = "cbor-raw"
_TEXTS = {"none": write_publish, "png": write_publish_png}
_COMPRESSIONS = (*_TEXTS, "cbor", _RAW)  # of several subscriptions the last one holds
_MOST = 100_000


@frozen
class SubscribeOptions:
    """What one subscribe message asks for.

    Attributes:
        every: least seconds between two messages.
        length: messages kept while the client must not have them yet; 0: only the newest goes.
        fragment: longest text of one frame in characters; 0: any.
        compression: `none`, `png`, `cbor` or `cbor-raw`.
        kind: the type that it states; empty: none.
    """

    every: float = 0.0
    length: int = 0
    fragment: int = 0
    compression: str = "none"
    kind: str = ""


def read_options(fields: Mapping[str, Any]) -> SubscribeOptions:
    """Return what a subscribe message asks for.

    Raises:
        ControlMessageError: it asks for a compression that is not served.
    """
    compression = fields.get("compression") or "none"
    if compression not in _COMPRESSIONS:
        raise ControlMessageError(
            f"subscribe: compression {compression!r:.60} is not served; "
            f"use {', '.join(_COMPRESSIONS[:-1])} or {_RAW}"
        )
    return SubscribeOptions(
        every=float(fields.get("throttle_rate") or 0) / 1000,
        length=min(int(fields.get("queue_length") or 0), _MOST),
        fragment=fragment_size(fields),
        compression=compression,
        kind=_type_in(fields),
    )


class RosbridgeSubscription(Subscription):
    """The subscription of one client to one topic, as its subscribe messages together ask.

    The highest rate, the longest queue, the shortest fragments and the densest compression hold.

    Args:
        topic: as the client named it.
        kind: of the topic's messages.
        identity: of the first subscribe message.
        options: of that message.
        structure: says what the messages are like, for `cbor-raw`.
        on_refused: called once with each reason for which a message could not be written.
        on_end: called with why no more will come.
    """

    def __init__(
        self,
        topic: str,
        kind: TopicType,
        identity: str,
        options: SubscribeOptions,
        client: Client,
        *,
        structure: Callable[[], MessageStructure],
        on_refused: Callable[[MessageError], None],
        on_end: Callable[[str, str], None],
    ) -> None:
        self.kind = kind
        self.asked = {identity: options}
        self._topic = topic
        self._raw = RawWriter(topic, structure)
        throttle = Throttle(options.every, is_even=False)
        super().__init__(
            client, self._form_asked(), throttle=throttle, on_refused=on_refused, on_end=on_end
        )
        self.set_rate(options.every, options.length)

    def check_form(self, options: SubscribeOptions) -> None:
        """Refuse a wish for messages, whose structure is known now.

        Raises:
            MessageError: they have no form in the compression that it asks for.
        """
        if options.compression == _RAW:
            self._raw.prepare()

    def set_options(self, identity: str, options: SubscribeOptions) -> None:
        """Add or replace a wish."""
        self.asked[identity] = options
        self._settle()

    def drop(self, identity: str | None) -> bool:
        """Take a wish back, or all; True when none is left."""
        if identity is None:
            self.asked.clear()
        else:
            self.asked.pop(identity, None)
        if self.asked:
            self._settle()
        return not self.asked

    def _settle(self) -> None:
        asked = self.asked.values()
        self.set_rate(
            min(options.every for options in asked), max(options.length for options in asked)
        )
        self.set_form(self._form_asked())

    def _form_asked(self) -> MessageForm:
        asked = self.asked.values()
        compression = max((options.compression for options in asked), key=_COMPRESSIONS.index)
        fragment = min((options.fragment for options in asked if options.fragment), default=0)
        text = compression in _TEXTS
        write = _TEXTS.get(compression, write_publish_cbor)
        return MessageForm(
            f"ros-{compression}:{self._topic}",
            self._raw if compression == _RAW else partial(write, self._topic),
            text,
            frames=partial(_pieces, self._topic, fragment) if text and fragment else None,
        )


def _pieces(topic: str, size: int, frame: bytes, number: int) -> list[bytes]:
    return split(frame, size, f"uoarm:{topic}:{number}")


Fields = Mapping[str, Any]
_WISHES = 256  # of one topic; all are looked at when one changes
_WISHES_PER_STREAM = 64


@define(eq=False)
class _Published:
    """What one client publishes on one topic.

    Attributes:
        publication: takes the messages.
        kind: their type.
        is_latched: whether the last message is kept for those who come.
        advertised: the ids of the advertisements that were not taken back; None: without one.
    """

    publication: InputPublication | SharedPublication
    kind: TopicType
    is_latched: bool
    advertised: set[str | None] = field(factory=set)


@define(eq=False)
class Topics:
    """Publications and subscriptions of one client by topic, in the loop's thread.

    Args:
        addresses: of functions, which clients may ask for by them.
        fail: reports to the client what went wrong with a message of its.
        warn: reports to the client what it should know of a message of its.
        write_failure: returns what `fail` sends; None where the client wants no such report.
    """

    _client: Client
    _backend: Backend
    _hub: Hub
    _addresses: Addresses
    _fail: Callable[[Fields, BaseException], None]
    _warn: Callable[[Fields, str], None]
    _write_failure: Callable[[Fields, BaseException], bytes | None]
    _published: dict[str, _Published] = field(factory=dict, init=False)
    # By the topic as the client named it, with a slash or without: so it knows its messages.
    _subscriptions: dict[str, RosbridgeSubscription] = field(factory=dict, init=False)

    def advertise(self, fields: Fields) -> None:
        """Open a topic for publishing; a function's input, or a topic between clients."""
        place = find_place(fields["topic"])
        advertised, identity = self._open(place, fields).advertised, _identity(fields)
        if len(advertised) >= _WISHES_PER_STREAM and identity not in advertised:
            raise LimitError(f"{place.name!r} has {len(advertised)} advertisements of this client")
        advertised.add(identity)

    def unadvertise(self, fields: Fields) -> None:
        """Take an advertisement back by its id, or all of a topic without one.

        With the last of them the topic is closed, after what was published.
        """
        place, identity = find_place(fields["topic"]), _identity(fields)
        published = self._published.get(place.name)
        if published is None:
            raise UsageError(f"this client does not publish {place.name!r}")
        others = published.advertised - {identity}
        if identity is None or not others:
            self._published.pop(place.name).publication.close()
        elif identity in published.advertised:
            published.advertised = others
        else:
            raise UsageError(f"this client does not advertise {place.name!r} as {identity!r:.200}")

    def publish(self, fields: Fields) -> None:
        """Publish one message; a topic that was not advertised is opened."""
        place, message = find_place(fields["topic"]), fields["msg"]
        published = self._published.get(place.name) or self._open(place, fields)
        publication = published.publication
        done = partial(self._done, fields)
        if isinstance(publication, InputPublication):
            publication.publish(message, done, self._client.in_hand)
            return
        if not isinstance(message, dict):
            raise ControlMessageError("publish: msg: expected an object")
        latch = bool(fields.get("latch")) or published.is_latched
        account = self._client.account if latch else None
        publication.publish(message, done, self._client.in_hand, account)

    def subscribe(self, fields: Fields) -> None:
        """Listen to a topic, or add a wish to a subscription that there is."""
        place, options = find_place(fields["topic"]), read_options(fields)
        self._client.require(Operation.REQUEST, place.right)
        stated = _identity(fields)
        identity = place.name if stated is None else stated
        subscription = self._subscriptions.get(fields["topic"])
        if subscription is None:
            if len(self._subscriptions) >= self._client.limits.streams:
                raise LimitError(f"{self._client.limits.streams} topics are subscribed already")
            self._admit_subscription()
            self._listen(place, identity, options, fields)
            return
        self._check_type(place, subscription.kind, fields)
        if subscription.feed is not None or not place.function:
            subscription.check_form(options)
        if identity in subscription.asked:
            subscription.set_options(identity, options)
            return
        if len(subscription.asked) >= _WISHES:
            raise LimitError(f"{place.name!r} has {_WISHES} subscriptions of this client")
        self._admit_subscription()
        subscription.set_options(identity, options)
        # The part of the client that subscribes now waits for what stands, too.
        if place.function:
            subscription.repeat()
        else:
            self._hub.listen(place.name, _type_in(fields), subscription, self._client.account)

    def unsubscribe(self, fields: Fields) -> None:
        """End one subscription of a topic by its id, or all without one."""
        topic = fields["topic"]
        subscription = self._subscriptions.get(topic)
        if subscription is None:
            raise UsageError(f"this client has not subscribed {topic!r}")
        if subscription.drop(_identity(fields)):
            self._stop(topic)

    def close(self) -> None:
        """Give everything back."""
        for published in self._published.values():
            published.publication.abandon()
        self._published.clear()
        for topic in list(self._subscriptions):
            self._stop(topic)

    def _admit_subscription(self) -> None:
        """Refuse one more subscription where the client has as many as it may, on all topics."""
        most = _WISHES_PER_STREAM * self._client.limits.streams
        if sum(len(subscription.asked) for subscription in self._subscriptions.values()) >= most:
            raise LimitError(f"{most} subscriptions are held already; end one first")

    def _open(self, place: NamedPort, fields: Fields) -> _Published:
        self._client.require(Operation.SEND, place.right)
        known = self._published.get(place.name)
        if known is not None:
            self._check_type(place, known.kind, fields)
            return known
        if len(self._published) >= self._client.limits.streams:
            raise LimitError(f"{self._client.limits.streams} topics are published already")
        publication: InputPublication | SharedPublication
        kind = TopicType(place.name, _type_in(fields))
        if place.function:
            if place.function not in self._backend.robot.config.functions:
                raise UsageError(f"there is no function {place.function!r}")
            failed = partial(self._publication_failed, place, fields)
            publication = publish_into(place, kind, self._backend, self._client, failed)
        else:
            publication = SharedPublication(
                place.name, _type_in(fields), self._hub, self._backend, self._client
            )
            self._hint(place, Role.INPUT, fields)
        published = _Published(publication, kind, bool(fields.get("latch")))
        self._published[place.name] = published
        return published

    def _check_type(self, place: NamedPort, kind: TopicType, fields: Fields) -> None:
        """Refuse another type of what is open already; raises MessageError."""
        kind.check(_type_in(fields))
        if not place.function:
            self._hub.check_type(place.name, _type_in(fields))

    def _hint(self, place: NamedPort, role: Role, fields: Fields) -> None:
        """Report to the client where a function is which it asks for by its own address."""
        hint = self._addresses.hint(place.name, role, self._client)
        if hint:
            self._warn(fields, hint)

    def _publication_failed(self, place: NamedPort, fields: Fields, error: BaseException) -> None:
        self._published.pop(place.name, None)
        self._fail(fields, error)

    def _listen(
        self, place: NamedPort, identity: str, options: SubscribeOptions, fields: Fields
    ) -> None:
        topic = fields["topic"]

        def on_end(state: str, cause: str) -> None:
            ended = self._subscriptions.pop(topic, None)
            if ended is not None:
                error = UoarmError(f"{place.name} has {state}: {cause or 'killed'}")
                report = self._write_failure(fields, error)
                ended.finish(*(() if report is None else (report,)))

        def on_failed(error: BaseException) -> None:
            if topic in self._subscriptions:
                self._stop(topic)
                self._fail(fields, error)

        def check(feed: Feed) -> None:
            subscription.kind.find(_structure_of(place, feed).native_type)
            for name, asked in [*subscription.asked.items()]:
                try:  # what was asked for before the structure was known
                    subscription.kind.check(asked.kind)
                    subscription.check_form(asked)
                except MessageError as error:
                    if subscription.drop(name):
                        raise
                    named = {} if name == place.name else {"id": name}
                    self._fail({"op": "subscribe", "topic": topic, **named}, error)

        subscription = RosbridgeSubscription(
            topic,
            TopicType(place.name, _type_in(fields)),
            identity,
            options,
            self._client,
            structure=lambda: _structure_of(place, subscription.feed),
            on_refused=partial(self._fail, fields),
            on_end=on_end,
        )
        if place.function:
            subscription.follow(
                self._backend,
                FeedKey(place.wanted),
                on_open=check,
                on_waiting=lambda text: self._warn(fields, f"{place.name} {text}"),
                on_failed=on_failed,
            )
        else:
            subscription.check_form(options)
            self._hub.listen(place.name, _type_in(fields), subscription, self._client.account)
            self._hint(place, Role.OUTPUT, fields)
        self._subscriptions[topic] = subscription

    def _stop(self, topic: str) -> None:
        subscription = self._subscriptions.pop(topic)
        subscription.close()
        place = find_place(topic)
        if not place.function:
            self._hub.leave(place.name, subscription)

    def _done(self, fields: Fields, error: BaseException | None) -> None:
        if error is not None:
            self._fail(fields, error)


def _identity(fields: Fields) -> str | None:
    """Return the id of a subscription, which ends by what it was begun with."""
    return None if fields.get("id") is None else str(fields["id"])


def _type_in(fields: Fields) -> str:
    return str(fields.get("type") or "")


def _structure_of(place: NamedPort, feed: Feed | None) -> MessageStructure:
    if feed is None or feed.connection is None:
        raise MessageError(
            f"{place.name}: messages between clients have no stated structure; "
            "ask for cbor instead of cbor-raw"
        )
    provider = feed.connection.plan.provider
    port = place.port or next((output.name for output in provider.component.outputs), "")
    structure = provider.structures.get(f"output.{port}")
    if structure is None:
        raise MessageError(f"{place.name}: the function has no output {port!r}")
    return structure
