"""What one client publishes into one function: opened with the first message, kept in order."""

from __future__ import annotations

import asyncio
from collections import deque
from collections.abc import Callable

from uoarm.errors import MessageError, UoarmError
from uoarm.model import LeaseHolder, Message
from uoarm.server.front_end import (
    Backend,
    BusyError,
    Charge,
    Client,
    Done,
    Feed,
    FeedKey,
    Held,
    InputSender,
)
from uoarm_rosbridge._arguments import read_arguments
from uoarm_rosbridge._names import Place
from uoarm_rosbridge._typedefs import check_type

__all__ = ["Publication"]


class Publication:
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
        place: Place,
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
            charge = self._account.charge(Held.SENDING, octets)
            self._waiting.append((message, done, charge))

    def close(self) -> None:
        """Let go of the function after what was published."""
        self._closing = True
        if self._sending is not None:
            self._sending.after(self._leave)

    def abandon(self) -> None:
        """Let go of the function now."""
        self._opening.cancel()
        self._waiting.clear()
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
