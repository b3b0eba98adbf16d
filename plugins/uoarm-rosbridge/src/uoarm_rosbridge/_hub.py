"""Where clients meet: topics, services and parameters of theirs, and the actions of all."""

from __future__ import annotations

import asyncio
import itertools
from collections.abc import Callable, Hashable
from typing import Protocol

import orjson
from attrs import define, field

from uoarm.errors import (
    BridgeError,
    BridgeTimeoutError,
    FailureReason,
    MessageError,
    UsageError,
)
from uoarm.model import Message
from uoarm.server.front_end import (
    Account,
    Charge,
    Envelope,
    LimitError,
    Listener,
    MemoryUse,
    Shares,
    UnknownError,
)
from uoarm_rosbridge._actions import ActionHub
from uoarm_rosbridge._names import find_place
from uoarm_rosbridge._types import is_same_type

_MOST_PARAMETERS = 1_000
_MOST_OCTETS = 1 << 20


class Parameters:
    """JSON texts by name, kept until they are deleted or the server ends; in the loop's thread.

    Names have a leading slash, as topics have; a missing one is added.
    """

    def __init__(self) -> None:
        self._texts: dict[str, str] = {}
        self._owners: dict[str, Hashable] = {}
        self._named = Shares(_MOST_PARAMETERS)
        self._octets = Shares(_MOST_OCTETS)

    @property
    def names(self) -> list[str]:
        """All names, in the order in which they were set first."""
        return list(self._texts)

    def get(self, name: str) -> str | None:
        """Return a parameter's JSON text; None: there is none."""
        return self._texts.get(name)

    def set(self, name: str, text: str, owner: Hashable) -> None:
        """Set a parameter, which may be there already.

        Args:
            name: of the parameter.
            text: of its value.
            owner: as whose it counts: something that stays the same when a client comes again.

        Raises:
            UsageError: the name is that of a function, whose parameters are not the clients'.
            MessageError: the text is no JSON.
            LimitError: there are too many parameters, or they are too long, and the owner has its
                share of them.
        """
        if find_place(name).function:
            raise UsageError(f"{name!r:.200} belongs to the server: it is in the configuration")
        owner = self._owners.get(name, owner)
        before = self._texts.get(name)
        if before is None and not self._named.admits(owner):
            raise LimitError(f"there are {_MOST_PARAMETERS:,} parameters already")
        more = _size(name, text) - (0 if before is None else _size(name, before))
        if more > 0 and not self._octets.admits(owner, more):
            raise LimitError(f"all parameters together may have {_MOST_OCTETS:,} octets")
        try:
            orjson.loads(text)
        except orjson.JSONDecodeError as error:
            raise MessageError(f"set_param: value: expected a JSON text: {error}") from None
        self._texts[name], self._owners[name] = text, owner
        self._octets.take(owner, more)
        if before is None:
            self._named.take(owner)

    def delete(self, name: str) -> bool:
        """Delete a parameter; False: there was none."""
        text = self._texts.pop(name, None)
        if text is None:
            return False
        owner = self._owners.pop(name)
        self._octets.take(owner, -_size(name, text))
        self._named.take(owner, -1)
        return True


def _size(name: str, text: str) -> int:
    return len(name.encode()) + len(text.encode())


_MOST_TOPICS = 10_000


class Provider(Protocol):
    """A client that provides services."""

    def ask(self, identity: str, service: str, message: Message) -> None:
        """Send a request to the client; its answer comes to `Hub.answer`."""


@define(eq=False)
class Latched:
    """The last message of a publisher, kept for listeners that are still to come."""

    envelope: Envelope
    charge: Charge
    account: Account

    def offer(self, listener: Listener) -> None:
        """Hand it to a listener; its written forms are kept where the publisher has room."""
        self.envelope.joiner = listener  # in this call: what stands has no part in its rate
        listener.offer(self.envelope)
        self.envelope.joiner = None
        self.charge.resize(self.envelope.octets)
        if not self.account.has_room(0):
            self.envelope.forget_written()
            self.charge.resize(self.envelope.octets)


@define(eq=False)
class ClientTopic:
    """One topic between clients; it lives while a client publishes or subscribes.

    Attributes:
        owner: the account of the client that named it first, whose topic it counts as.
        type: as its publishers state it; the first of them decides while any of them stays.
        stated: as the first subscriber named it, which binds no other.
        latched: the last message of each publisher that latches.
    """

    name: str
    owner: object
    type: str = ""
    stated: str = ""
    number: int = 0
    publishers: set[object] = field(factory=set)
    listeners: dict[Listener, None] = field(factory=dict)
    latched: dict[object, Latched] = field(factory=dict)

    def unlatch(self, publisher: object) -> None:
        """Keep no message of a publisher for listeners that are still to come."""
        latched = self.latched.pop(publisher, None)
        if latched is not None:
            latched.charge.release()


class Hub:
    """All topics, services and parameters between the clients of one server, in the loop's thread.

    Attributes:
        actions: all actions.
        parameters: all parameters.
    """

    def __init__(self) -> None:
        self._topics: dict[str, ClientTopic] = {}
        self._named = Shares(_MOST_TOPICS)
        self._services: dict[str, tuple[str, Provider]] = {}
        self._numbers = itertools.count(1)
        self._waiting: dict[str, tuple[Provider, asyncio.Future[Message]]] = {}
        self._refusals: dict[str, str] = {}  # of answers that came, by the call that waits
        self.actions = ActionHub()
        self.parameters = Parameters()

    @property
    def topics(self) -> dict[str, str]:
        """Types by topic; for any thread, as of one moment."""
        return {topic.name: topic.type or topic.stated for topic in tuple(self._topics.values())}

    @property
    def published(self) -> list[str]:
        """The topics that clients publish."""
        return [topic.name for topic in tuple(self._topics.values()) if topic.publishers]

    @property
    def subscribed(self) -> list[str]:
        """The topics that clients listen to."""
        return [topic.name for topic in tuple(self._topics.values()) if topic.listeners]

    @property
    def services(self) -> dict[str, str]:
        """Types by service; for any thread, as of one moment."""
        return {name: kind for name, (kind, _) in tuple(self._services.items())}

    def advertise(self, name: str, kind: str, publisher: object, owner: object) -> None:
        """Count a publisher of a topic.

        Raises:
            MessageError: other publishers of the topic state another type.
            LimitError: there are too many topics, and the owner has its share of them.
        """
        topic = self._topic(name, owner)
        self._check_type(topic, kind)
        topic.type = topic.type or kind
        topic.publishers.add(publisher)

    def type_of(self, name: str) -> str:
        """Return the type that a topic's publishers state; empty where none does."""
        topic = self._topics.get(name)
        return "" if topic is None else topic.type

    def check_type(self, name: str, kind: str) -> None:
        """Refuse another type than that of a topic's publishers; raises MessageError."""
        topic = self._topics.get(name)
        if topic is not None:
            self._check_type(topic, kind)

    def unadvertise(self, name: str, publisher: object) -> None:
        """Take a publisher back."""
        topic = self._topics.get(name)
        if topic is not None:
            topic.publishers.discard(publisher)
            topic.unlatch(publisher)
            if not topic.publishers:
                topic.type = ""
            self._drop_if_unused(topic)

    def publish(
        self,
        name: str,
        message: Message,
        publisher: object,
        octets: int,
        latch: Account | None = None,
    ) -> None:
        """Hand a message to every listener of a topic.

        Args:
            name: of the topic.
            message: an object.
            publisher: who has advertised it.
            octets: of memory that the message holds.
            latch: what is charged for keeping the message for those who come; None: it is not kept.

        Raises:
            LimitError: the publisher has too much memory held; the message went nowhere.
            BusyError: all clients together have.
        """
        topic = self._topics.get(name)
        if topic is None:  # its publisher has given it back
            return
        envelope = Envelope(topic.number + 1, message, octets)
        if latch is not None:
            topic.unlatch(publisher)
            charge = latch.charge(MemoryUse.LATCHED, envelope.octets)
            topic.latched[publisher] = Latched(envelope, charge, latch)
        topic.number += 1
        for listener in tuple(topic.listeners):
            listener.offer(envelope)

    def listen(self, name: str, kind: str, listener: Listener, owner: object) -> None:
        """Hand a topic's messages to a listener, first those that are latched.

        Raises:
            MessageError: its publishers state another type.
            LimitError: there are too many topics, and the owner has its share of them.
        """
        topic = self._topic(name, owner)
        self._check_type(topic, kind)
        topic.stated = topic.stated or kind
        topic.listeners[listener] = None
        for latched in tuple(topic.latched.values()):
            latched.offer(listener)

    def leave(self, name: str, listener: Listener) -> None:
        """Hand a listener no more."""
        topic = self._topics.get(name)
        if topic is not None:
            topic.listeners.pop(listener, None)
            self._drop_if_unused(topic)

    def provide(self, name: str, kind: str, provider: Provider) -> None:
        """Let a client answer a service's requests.

        Raises:
            LimitError: another client does so already.
        """
        if name in self._services and self._services[name][1] is not provider:
            raise LimitError(f"another client provides {name!r}")
        self._services[name] = (kind, provider)

    def withdraw(self, name: str, provider: Provider) -> None:
        """Take a service back."""
        if name in self._services and self._services[name][1] is provider:
            del self._services[name]

    def forget(self, provider: Provider) -> None:
        """Take back every service of a client that has gone, and fail what waits for it."""
        for name in [name for name, (_, item) in self._services.items() if item is provider]:
            del self._services[name]
        for item, future in list(self._waiting.values()):
            if item is provider and not future.done():
                gone = BridgeError("the client that provides it has gone", FailureReason.CLOSED)
                future.set_exception(gone)

    def provides(self, name: str) -> bool:
        """Say whether a client provides a service."""
        return name in self._services

    async def call(self, name: str, kind: str, message: Message, timeout: float) -> Message:
        """Ask the client that provides a service, which has a type, or any where it is empty.

        Raises:
            UnknownError: there is none.
            MessageError: its provider states another type.
            BusyError: the client that provides it does not read its requests.
            BridgeError: it failed, has gone, or did not answer in time.
        """
        found = self._services.get(name)
        if found is None:
            raise UnknownError(f"there is no service {name!r:.200}")
        if kind and found[0] and not is_same_type(kind, found[0]):
            text = f"service {name!r:.200} has the type {found[0]!r:.100}, not {kind!r:.100}"
            raise MessageError(text)
        identity = f"uoarm:{name}:{next(self._numbers)}"
        future: asyncio.Future[Message] = asyncio.get_running_loop().create_future()
        future.add_done_callback(lambda done: done.cancelled() or done.exception())
        self._waiting[identity] = (found[1], future)
        try:
            found[1].ask(identity, name, message)
            # Not `wait_for`: it may lose a cancellation before CPython 3.12.
            await asyncio.wait({future}, timeout=timeout)
            if not future.done():
                text = f"{name!r} did not answer within {timeout:g} s"
                refusal = self._refusals.get(identity)
                raise BridgeTimeoutError(f"{text}; {refusal}" if refusal else text)
            return future.result()
        finally:
            del self._waiting[identity]
            self._refusals.pop(identity, None)

    def refused(self, identity: object, provider: Provider, why: str) -> None:
        """Take in that an answer of a client was refused: who waits for one is notified.

        Without the name of a call that waits, each that waits for this client is.
        """
        own = [name for name, (asked, _) in self._waiting.items() if asked is provider]
        for name in [str(identity)] if identity in own else own:
            self._refusals[name] = f"the last answer of the client that provides it: {why}"[:500]

    def answer(self, identity: str, provider: Provider, conclude: Callable[..., None]) -> None:
        """Take a client's answer; `conclude` sets the future's result or error.

        Raises:
            UnknownError: no call waits for it, or another client was asked.
        """
        one, future = self._waiting.get(identity, (None, None))
        if one is not provider or future is None or future.done():
            raise UnknownError(f"no call waits for the answer {identity!r:.200}")
        conclude(future)

    def _topic(self, name: str, owner: object) -> ClientTopic:
        topic = self._topics.get(name)
        if topic is None:
            if not self._named.admits(owner):
                raise LimitError(
                    f"there are {_MOST_TOPICS:,} topics already, {self._named.of(owner):,} of them "
                    "of this client"
                )
            self._named.take(owner)
            topic = self._topics[name] = ClientTopic(name, owner)
        return topic

    def _check_type(self, topic: ClientTopic, kind: str) -> None:
        if kind and topic.type and not is_same_type(topic.type, kind):
            self._drop_if_unused(topic)
            raise MessageError(f"topic {topic.name!r} has the type {topic.type!r}, not {kind!r}")

    def _drop_if_unused(self, topic: ClientTopic) -> None:
        if not topic.publishers and not topic.listeners and topic.name in self._topics:
            del self._topics[topic.name]
            self._named.take(topic.owner, -1)
