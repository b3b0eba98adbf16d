"""What clients offer to one another, without any framework behind it."""

from __future__ import annotations

import asyncio
import itertools
from collections.abc import Callable
from typing import Protocol

from attrs import define, field

from uoarm.errors import BridgeError, BridgeTimeoutError, FailureReason, MessageError
from uoarm.model import Message
from uoarm.server._failures import LimitError, UnknownError
from uoarm.server._feed import Listener, Parcel
from uoarm.server.rosbridge._action_hub import ActionHub

__all__ = ["Hub", "Provider", "Topic"]

_MOST_TOPICS = 10_000


class Provider(Protocol):
    """A client that provides services."""

    def ask(self, identity: str, service: str, message: Message) -> None:
        """Send a request to the client; its answer comes to `Hub.answer`."""


@define(eq=False)
class Topic:
    """One topic between clients; it lives while someone publishes or listens."""

    name: str
    type: str = ""
    number: int = 0
    publishers: set[object] = field(factory=set)
    listeners: dict[Listener, None] = field(factory=dict)
    latched: Parcel | None = None


class Hub:
    """All topics and services between the clients of one server, in the loop's thread.

    Attributes:
        actions: all actions.
    """

    def __init__(self) -> None:
        self._topics: dict[str, Topic] = {}
        self._services: dict[str, tuple[str, Provider]] = {}
        self._numbers = itertools.count(1)
        self._waiting: dict[str, tuple[Provider, asyncio.Future[Message]]] = {}
        self.actions = ActionHub()

    @property
    def topics(self) -> dict[str, str]:
        """Types by topic."""
        return {topic.name: topic.type for topic in self._topics.values()}

    @property
    def services(self) -> dict[str, str]:
        """Types by service."""
        return {name: kind for name, (kind, _) in self._services.items()}

    def advertise(self, name: str, kind: str, publisher: object) -> None:
        """Count a publisher of a topic.

        Raises:
            MessageError: the topic has another type.
            LimitError: there are too many topics.
        """
        topic = self._topic(name)
        if kind and topic.type and topic.type != kind:
            self._drop_if_unused(topic)
            raise MessageError(f"topic {name!r} has the type {topic.type!r}, not {kind!r}")
        topic.type = topic.type or kind
        topic.publishers.add(publisher)

    def unadvertise(self, name: str, publisher: object) -> None:
        """Take a publisher back."""
        topic = self._topics.get(name)
        if topic is not None:
            topic.publishers.discard(publisher)
            if not topic.publishers:
                topic.latched = None
            self._drop_if_unused(topic)

    def publish(self, name: str, message: Message, *, latch: bool) -> None:
        """Hand a message to every listener of a topic."""
        topic = self._topic(name)
        topic.number += 1
        parcel = Parcel(topic.number, message)
        topic.latched = parcel if latch else topic.latched
        for listener in tuple(topic.listeners):
            _offer(listener, parcel)

    def listen(self, name: str, kind: str, listener: Listener) -> None:
        """Hand a topic's messages to a listener, first the one that is latched.

        Raises:
            LimitError: there are too many topics.
        """
        topic = self._topic(name)
        topic.type = topic.type or kind
        topic.listeners[listener] = None
        if topic.latched is not None:
            _offer(listener, topic.latched)

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
        for name in [name for name, (_, one) in self._services.items() if one is provider]:
            del self._services[name]
        for one, future in list(self._waiting.values()):
            if one is provider and not future.done():
                gone = BridgeError("the client that provides it has gone", FailureReason.CLOSED)
                future.set_exception(gone)

    def provides(self, name: str) -> bool:
        """Say whether a client provides a service."""
        return name in self._services

    async def call(self, name: str, message: Message, timeout: float) -> Message:
        """Ask the client that provides a service.

        Raises:
            UnknownError: there is none.
            BridgeError: it failed, has gone, or did not answer in time.
        """
        found = self._services.get(name)
        if found is None:
            raise UnknownError(f"there is no service {name!r:.200}")
        identity = f"uoarm:{name}:{next(self._numbers)}"
        future: asyncio.Future[Message] = asyncio.get_running_loop().create_future()
        self._waiting[identity] = (found[1], future)
        try:
            found[1].ask(identity, name, message)
            return await asyncio.wait_for(future, timeout)
        except asyncio.TimeoutError:
            raise BridgeTimeoutError(f"{name!r} did not answer within {timeout:g} s") from None
        finally:
            del self._waiting[identity]

    def answer(self, identity: str, provider: Provider, conclude: Callable[..., None]) -> None:
        """Take a client's answer; `conclude` sets the future's result or error.

        Raises:
            UnknownError: nobody waits for it, or another client was asked.
        """
        one, future = self._waiting.get(identity, (None, None))
        if one is not provider or future is None or future.done():
            raise UnknownError(f"nobody waits for the answer {identity!r:.200}")
        conclude(future)

    def _topic(self, name: str) -> Topic:
        topic = self._topics.get(name)
        if topic is None:
            if len(self._topics) >= _MOST_TOPICS:
                raise LimitError(f"there are {_MOST_TOPICS:,} topics already")
            topic = self._topics[name] = Topic(name)
        return topic

    def _drop_if_unused(self, topic: Topic) -> None:
        if not topic.publishers and not topic.listeners:
            self._topics.pop(topic.name, None)


def _offer(listener: Listener, parcel: Parcel) -> None:
    try:
        listener.offer(parcel)
    except MessageError as error:
        listener.refuse(parcel, error)
