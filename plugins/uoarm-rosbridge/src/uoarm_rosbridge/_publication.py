"""What one client publishes into one function: opened with the first message, kept in order."""

from __future__ import annotations

import asyncio
from collections import deque
from collections.abc import Callable

from attrs import frozen

from uoarm.errors import UoarmError
from uoarm.model import Message, MessageStructure, message_octets
from uoarm.server.front_end import (
    Account,
    Backend,
    BusyError,
    Charge,
    Client,
    Done,
    Feed,
    MemoryUse,
    check_message,
)
from uoarm.server.publication import InputPublication
from uoarm_rosbridge._hub import Hub
from uoarm_rosbridge._names import NamedPort
from uoarm_rosbridge._types import TopicType, read_arguments


def publish_into(
    place: NamedPort,
    kind: TopicType,
    backend: Backend,
    client: Client,
    on_failed: Callable[[BaseException], None],
) -> InputPublication:
    """Return what publishes into an input of a function.

    Args:
        place: the function and its input.
        kind: the type that the client states. Another than the input's is an error.
        backend: where the function is opened.
        client: who publishes.
        on_failed: called with why it could not be opened, or that it ended.
    """

    def check(feed: Feed) -> None:
        assert feed.connection is not None, "join returns feeds that are open"
        provider = feed.connection.plan.provider
        inputs = [input_.name for input_ in provider.component.inputs if input_.source is None]
        port = place.port or (inputs[0] if len(inputs) == 1 else "")
        structure = provider.structures.get(f"input.{port}")
        if structure is not None:
            kind.find(structure.native_type)

    return InputPublication(
        place.name,
        place.function,
        place.port,
        read_arguments,
        backend,
        client,
        on_ended=on_failed,
        check=check,
    )


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
        kind: the type that the client states; empty: that of the topic, where others stated one.

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

        `done` is called with how it went, where that is not known when this returns.

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
        except Exception as error:  # noqa: BLE001 - reported to its publisher
            return error

    def _checked(self, message: Message) -> Message:
        if self._structure is None:
            return message
        return check_message(self._structure, message, read_arguments, self._name)

    def _share(self, message: Message, octets: int, latch: Account | None) -> None:
        if self._structure is not None:  # what was left out is there now
            octets = message_octets(message)
        self._hub.publish(self._name, message, self, octets, latch)
