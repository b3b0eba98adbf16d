"""What one client publishes into one function: opened with the first message, kept in order."""

from __future__ import annotations

import asyncio
from collections import deque
from collections.abc import Callable

from attrs import frozen

from uoarm.errors import MessageError, UoarmError
from uoarm.model import LeaseHolder, Message, MessageStructure, message_octets
from uoarm.server.front_end import (
    Account,
    Backend,
    BusyError,
    Charge,
    Client,
    Done,
    Feed,
    FeedKey,
    InputSender,
    MemoryUse,
    check_message,
)
from uoarm_rosbridge._hub import Hub
from uoarm_rosbridge._names import NamedPort
from uoarm_rosbridge._types import check_type, read_arguments

__all__ = ["ClientPublication", "SharedPublication"]


class ClientPublication:
    """Messages of one client on their way into one input; all in the loop's thread.

    Args:
        place: the function and its input.
        kind: the type that the client states; empty: none.
        backend: where the function is opened.
        client: who publishes, and commands what has a lease as its session.
        on_failed: hears why it could not be opened, or that it ended.
    """

    def __init__(
        self,
        place: NamedPort,
        kind: str,
        backend: Backend,
        client: Client,
        on_failed: Callable[[BaseException], None],
    ) -> None:
        self._place = place
        self._kind = kind
        self._backend = backend
        self._account = client.account
        self._holder = LeaseHolder(f"session {client.identity}", client.role.name)
        self._on_failed = on_failed
        self._limit = backend.limits.queue_messages
        self._waiting: deque[tuple[Message, Done, Charge]] = deque()
        self._feed: Feed | None = None
        self._sending: InputSender | None = None
        self._closing = False
        self._opening = asyncio.ensure_future(self._open())

    def publish(self, message: Message, done: Done, octets: int) -> None:
        """Send one message of so many octets after those before it; `done` hears how it went.

        Raises:
            BusyError: too many wait.
            LimitError: the client has too much memory held.
        """
        if self._sending is not None:
            self._sending.send(message, self._place.port or None, done, octets)
        elif len(self._waiting) >= self._limit:
            raise BusyError(f"{self._limit} messages to {self._place.name} wait already")
        else:
            charge = self._account.charge(MemoryUse.SENDING, octets)
            self._waiting.append((message, done, charge))

    def close(self) -> None:
        """Let go of the function after what was published."""
        self._closing = True
        if self._sending is not None:
            self._sending.after(self._leave)

    def abandon(self) -> None:
        """Let go of the function now."""
        self._opening.cancel()
        while self._waiting:
            self._waiting.popleft()[2].release()
        self._leave()

    async def _open(self) -> None:
        try:
            feed = await self._backend.join(FeedKey(self._place.function, receive=False))
            self._check_type(feed)
        except Exception as error:  # noqa: BLE001 - told to the one who publishes
            self._on_failed(error)
            while self._waiting:
                _, done, charge = self._waiting.popleft()
                charge.release()
                done(error)
            return
        assert feed.connection is not None, "join returns feeds that are open"
        self._feed = feed
        self._sending = self._backend.sender(
            feed.connection, self._account, read_arguments, self._holder
        )
        feed.add(self)
        while self._waiting:
            message, done, charge = self._waiting.popleft()
            octets = charge.octets
            charge.release()
            try:
                self.publish(message, done, octets)
            except UoarmError as error:
                done(error)
        if self._closing:
            self._sending.after(self._leave)

    def offer(self, envelope: object) -> None:
        """Take nothing: this connection only sends."""

    def refuse(self, envelope: object, error: Exception) -> None:
        """Take nothing: this connection only sends."""

    def ended(self, state: str, cause: str) -> None:
        """Hear that the function's provider has gone."""
        self._leave()
        self._on_failed(UoarmError(f"{self._place.name} has {state}: {cause or 'killed'}"))

    def _check_type(self, feed: Feed) -> None:
        assert feed.connection is not None, "join returns feeds that are open"
        provider = feed.connection.plan.provider
        inputs = [input_.name for input_ in provider.component.inputs if input_.source is None]
        port = self._place.port or (inputs[0] if len(inputs) == 1 else "")
        structure = provider.structures.get(f"input.{port}")
        if structure is not None:
            try:
                check_type(f"topic {self._place.name!r}", self._kind, structure.native_type)
            except MessageError:
                self._backend.leave(feed)
                raise

    def _leave(self) -> None:
        if self._sending is not None:
            self._sending.close()
        if self._feed is not None:
            self._feed.remove(self)
            self._backend.leave(self._feed)
            self._feed = None


_SHORT_OCTETS = 8_192
_BATCH = 256
_BATCH_OCTETS = 1_048_576


@frozen(eq=False)
class _Waiting:
    message: Message
    latch: Account | None
    done: Done
    charge: Charge


class SharedPublication:
    """Messages of one client on their way to other clients; all in the loop's thread.

    They go on in their order: after the type is known, or known to be unknown, and with it each
    after its check. Short ones are checked at once, long ones in a worker.

    Args:
        name: of the topic.
        kind: the type that the client states; empty: that of the topic, where others stated one.
        hub: where clients publish to one another.
        backend: knows types.
        client: who publishes.

    Raises:
        MessageError: other publishers of the topic state another type.
        LimitError: there are too many topics.
    """

    def __init__(self, name: str, kind: str, hub: Hub, backend: Backend, client: Client) -> None:
        self._name = name
        self._hub = hub
        self._backend = backend
        self._account = client.account
        self._limit = backend.limits.queue_messages
        self._structure: MessageStructure | None = None
        self._waiting: deque[_Waiting] = deque()
        self._closing = False
        hub.advertise(name, kind, self, client.account)
        stated = hub.type_of(name)
        self._working = asyncio.ensure_future(self._begin(stated)) if stated else None

    def publish(self, message: Message, done: Done, octets: int, latch: Account | None) -> None:
        """Share one message of so many octets after those before it.

        `done` hears how it went, where that is not known when this returns.

        Raises:
            MessageError: it is not of the type.
            BusyError: too many wait.
            LimitError: the client has too much memory held.
        """
        if self._working is None and (self._structure is None or octets <= _SHORT_OCTETS):
            self._share(self._checked(message), octets, latch)
            return
        if len(self._waiting) >= self._limit:
            raise BusyError(f"{self._limit} messages to {self._name} wait already")
        charge = self._account.charge(MemoryUse.SENDING, octets)
        self._waiting.append(_Waiting(message, latch, done, charge))
        if self._working is None:
            self._working = asyncio.ensure_future(self._work())

    def close(self) -> None:
        """Leave the topic after what was published."""
        self._closing = True
        if self._working is None:
            self._hub.unadvertise(self._name, self)

    def abandon(self) -> None:
        """Leave the topic now."""
        if self._working is not None:
            self._working.cancel()
        while self._waiting:
            self._waiting.popleft().charge.release()
        self._hub.unadvertise(self._name, self)

    async def _begin(self, kind: str) -> None:
        self._structure = await self._backend.structure_of_type(kind)
        await self._work()

    async def _work(self) -> None:
        """Share what waits, a batch at a time, until nothing does."""
        while self._waiting:
            batch = self._next_batch()
            for waiting, outcome in zip(batch, await self._outcomes(batch), strict=True):
                octets = waiting.charge.octets
                waiting.charge.release()
                self._conclude(waiting, outcome, octets)
        self._working = None
        if self._closing:
            self._hub.unadvertise(self._name, self)

    async def _outcomes(self, batch: list[_Waiting]) -> list[Message | Exception]:
        """Return each message as it is shared, or the error that says why it is not."""
        messages = [waiting.message for waiting in batch]
        if self._structure is None:
            return messages
        try:
            return await self._backend.in_worker(
                lambda: [self._outcome(message) for message in messages]
            )
        except BusyError as error:  # the server is closing
            return [error] * len(batch)

    def _conclude(self, one: _Waiting, outcome: Message | Exception, octets: int) -> None:
        error = outcome if isinstance(outcome, Exception) else None
        if error is None:
            try:
                self._share(outcome, octets, one.latch)
            except UoarmError as refused:
                error = refused
        one.done(error)

    def _next_batch(self) -> list[_Waiting]:
        batch: list[_Waiting] = []
        octets = 0
        while self._waiting and len(batch) < _BATCH and octets < _BATCH_OCTETS:
            batch.append(self._waiting.popleft())
            octets += batch[-1].charge.octets
        return batch

    def _outcome(self, message: Message) -> Message | Exception:
        try:
            return self._checked(message)
        except Exception as error:  # noqa: BLE001 - told to the one who published it
            return error

    def _checked(self, message: Message) -> Message:
        if self._structure is None:
            return message
        return check_message(self._structure, message, read_arguments, self._name)

    def _share(self, message: Message, octets: int, latch: Account | None) -> None:
        if self._structure is not None:  # what was left out is there now
            octets = message_octets(message)
        self._hub.publish(self._name, message, self, octets, latch)
