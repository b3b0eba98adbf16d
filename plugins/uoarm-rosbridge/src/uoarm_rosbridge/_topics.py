"""Topics of one rosbridge client: those it publishes and those it listens to."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Callable, Mapping
from typing import Any

from attrs import define

from uoarm.errors import ControlMessageError, MessageError, UoarmError, UsageError
from uoarm.model import MessageStructure, Role
from uoarm.server.front_end import (
    Backend,
    Client,
    Feed,
    FeedKey,
    LimitError,
    Operation,
)
from uoarm.server.publication import InputPublication
from uoarm_rosbridge._hub import Hub
from uoarm_rosbridge._names import Addresses, NamedPort, find_place
from uoarm_rosbridge._publication import SharedPublication, publish_into
from uoarm_rosbridge._subscription import SubscribeOptions, Subscription, read_options
from uoarm_rosbridge._types import check_type

__all__ = ["Topics"]

Fields = Mapping[str, Any]
_FAILED = "failed"
_AGAIN_SECONDS = 1.0
_WISHES = 256  # of one topic; all are looked at when one changes
_WISHES_PER_STREAM = 64


@define
class _Listening:
    """A subscription and where its messages come from; `last_warning` is the last warning of it."""

    subscription: Subscription
    feed: Feed | None = None
    opening: asyncio.Task[None] | None = None
    last_warning: str = ""

    def warn(self, warn: Callable[[Fields, str], None], fields: Fields, text: str) -> None:
        """Tell the client, unless this was the last that it was told."""
        if text != self.last_warning:
            self.last_warning = text
            warn(fields, f"{text}; it is waited for")


class Topics:
    """Publications and subscriptions of one client by topic, in the loop's thread.

    Args:
        client: its limits and its outbox.
        backend: where functions are opened.
        hub: where clients publish to one another.
        addresses: of functions, which clients may ask for by them.
        fail: tells the client what went wrong with a message of its.
        warn: tells the client what it should know of a message of its.
    """

    def __init__(
        self,
        client: Client,
        backend: Backend,
        hub: Hub,
        addresses: Addresses,
        fail: Callable[[Fields, BaseException], None],
        warn: Callable[[Fields, str], None],
    ) -> None:
        self._client = client
        self._backend = backend
        self._hub = hub
        self._addresses = addresses
        self._fail = fail
        self._warn = warn
        self._publications: dict[str, InputPublication | SharedPublication] = {}
        self._latched: set[str] = set()
        self._listening: dict[str, _Listening] = {}

    def advertise(self, fields: Fields) -> None:
        """Open a topic for publishing; a function's input, or a topic between clients."""
        self._open(find_place(fields["topic"]), fields)

    def unadvertise(self, fields: Fields) -> None:
        """Close a topic that was advertised, after what was published."""
        place = find_place(fields["topic"])
        if place.name not in self._publications:
            raise UsageError(f"this client does not publish {place.name!r}")
        self._latched.discard(place.name)
        self._publications.pop(place.name).close()

    def publish(self, fields: Fields) -> None:
        """Publish one message; a topic that was not advertised is opened."""
        place, message = find_place(fields["topic"]), fields["msg"]
        if place.name not in self._publications:
            self._open(place, fields)
        publication = self._publications[place.name]
        done = lambda error: self._done(fields, error)  # noqa: E731
        if isinstance(publication, InputPublication):
            publication.publish(message, done, self._client.in_hand)
            return
        if not isinstance(message, dict):
            raise ControlMessageError("publish: msg: expected an object")
        latch = fields.get("latch") is True or place.name in self._latched
        account = self._client.account if latch else None
        publication.publish(message, done, self._client.in_hand, account)

    def subscribe(self, fields: Fields) -> None:
        """Listen to a topic, or add a wish to a subscription that there is."""
        place, options = find_place(fields["topic"]), read_options(fields)
        self._client.require(Operation.REQUEST, place.right)
        stated = _identity(fields)
        identity = place.name if stated is None else stated
        listening = self._listening.get(place.name)
        if listening is None:
            if len(self._listening) >= self._client.limits.streams:
                raise LimitError(f"{self._client.limits.streams} topics are subscribed already")
            self._admit_subscription()
            listening = self._listen(place, options, fields)
        elif identity not in listening.subscription.asked:
            if len(listening.subscription.asked) >= _WISHES:
                raise LimitError(f"{place.name!r} has {_WISHES} subscriptions of this client")
            self._admit_subscription()
        listening.subscription.set_options(identity, options)

    def unsubscribe(self, fields: Fields) -> None:
        """End one subscription of a topic by its id, or all without one."""
        place = find_place(fields["topic"])
        listening = self._listening.get(place.name)
        if listening is None:
            raise UsageError(f"this client has not subscribed {place.name!r}")
        if listening.subscription.drop(_identity(fields)):
            self._stop(place)

    def close(self) -> None:
        """Give everything back."""
        for publication in self._publications.values():
            publication.abandon()
        self._publications.clear()
        for name in list(self._listening):
            self._stop(find_place(name))

    def _admit_subscription(self) -> None:
        """Refuse one more subscription where the client has as many as it may, on all topics."""
        most = _WISHES_PER_STREAM * self._client.limits.streams
        if sum(len(listening.subscription.asked) for listening in self._listening.values()) >= most:
            raise LimitError(f"{most} subscriptions are held already; end one first")

    def _open(self, place: NamedPort, fields: Fields) -> None:
        self._client.require(Operation.SEND, place.right)
        if place.name in self._publications:
            return
        if len(self._publications) >= self._client.limits.streams:
            raise LimitError(f"{self._client.limits.streams} topics are published already")
        if place.function:
            if place.function not in self._backend.robot.config.functions:
                raise UsageError(f"there is no function {place.function!r}")
            failed = lambda error: self._publication_failed(place, fields, error)  # noqa: E731
            self._publications[place.name] = publish_into(
                place, _type_in(fields), self._backend, self._client, failed
            )
        else:
            self._publications[place.name] = SharedPublication(
                place.name, _type_in(fields), self._hub, self._backend, self._client
            )
            self._hint(place, Role.INPUT, fields)
        if fields.get("latch") is True:
            self._latched.add(place.name)

    def _hint(self, place: NamedPort, role: Role, fields: Fields) -> None:
        """Tell the client where a function is which it asks for by its own address."""
        hint = self._addresses.hint(place.name, role, self._client)
        if hint:
            self._warn(fields, hint)

    def _publication_failed(self, place: NamedPort, fields: Fields, error: BaseException) -> None:
        self._publications.pop(place.name, None)
        self._fail(fields, error)

    def _listen(self, place: NamedPort, options: SubscribeOptions, fields: Fields) -> _Listening:
        subscription = Subscription(
            place.name if fields["topic"].startswith("/") else fields["topic"],
            options,
            self._client,
            structure=lambda: _structure_of(place, listening.feed),
            clock=time.monotonic,
            on_refused=lambda error: self._fail(fields, error),
            on_end=lambda state, cause: self._ended(place, fields, state, cause or "killed"),
        )
        listening = _Listening(subscription)
        if not place.function:
            subscription.prepare()
        if place.function:
            listening.opening = asyncio.ensure_future(self._join(place, listening, fields))
        else:
            self._hub.listen(place.name, _type_in(fields), subscription, self._client.account)
            self._hint(place, Role.OUTPUT, fields)
        self._listening[place.name] = listening
        return listening

    async def _join(
        self, place: NamedPort, listening: _Listening, fields: Fields, pause: float = 0.0
    ) -> None:
        def notify(cause: str) -> None:
            listening.warn(self._warn, fields, f"{place.name} cannot be had yet: {cause}")

        try:
            await asyncio.sleep(pause)
            feed = await self._backend.join(FeedKey(place.wanted), notify)
        except Exception as error:  # noqa: BLE001 - told to the one who listens
            self._listening.pop(place.name, None)
            self._fail(fields, error)
            return
        listening.feed, listening.opening = feed, None
        try:
            actual = _structure_of(place, feed).native_type
            check_type(f"topic {place.name!r}", _type_in(fields), actual)
            listening.subscription.prepare()
        except MessageError as error:
            self._stop(place)
            self._fail(fields, error)
            return
        feed.add(listening.subscription, missed=listening.subscription.miss)

    def _ended(self, place: NamedPort, fields: Fields, state: str, cause: str) -> None:
        """Wait for a provider that failed to come back; what ended in another way has ended."""
        listening = self._listening.get(place.name)
        if listening is None:
            return
        if state != _FAILED:
            self._stop(place)
            self._fail(fields, UoarmError(f"{place.name} has {state}: {cause}"))
            return
        self._give_back(listening)
        listening.warn(self._warn, fields, f"{place.name} has failed: {cause}")
        joining = self._join(place, listening, fields, _AGAIN_SECONDS)
        listening.opening = asyncio.ensure_future(joining)

    def _stop(self, place: NamedPort) -> None:
        listening = self._listening.pop(place.name)
        listening.subscription.close()
        if not place.function:
            self._hub.leave(place.name, listening.subscription)
        elif listening.opening is not None:
            listening.opening.cancel()
        else:
            self._give_back(listening)

    def _give_back(self, listening: _Listening) -> None:
        feed, listening.feed = listening.feed, None
        if feed is not None:
            feed.remove(listening.subscription)
            self._backend.leave(feed)

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
