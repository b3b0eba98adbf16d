"""What one client publishes into one function: opened with the publication, kept in order.

For front ends whose clients publish to topics.
"""

from __future__ import annotations

import asyncio
from collections import deque
from collections.abc import Callable

from uoarm._raised import on_failure
from uoarm.errors import UoarmError
from uoarm.model import LeaseHolder, Message
from uoarm.server.front_end import (
    Backend,
    BusyError,
    Charge,
    Client,
    Done,
    Feed,
    FeedKey,
    InputSender,
    MemoryUse,
    Read,
)

__all__ = ["InputPublication"]


class InputPublication:
    """Messages of one client on their way into one input; all in the loop's thread.

    What is published while the function opens waits for it.

    Args:
        name: of the topic, as errors have it.
        function: that takes the messages.
        port: its input; empty: the only one.
        read: makes the logical value of a message.
        backend: where the function is opened.
        client: who publishes, and commands what has a lease as its session.
        on_ended: called with why it could not be opened, or that it ended.
        check: is given the open feed; what it raises is why it could not be opened.
    """

    def __init__(
        self,
        name: str,
        function: str,
        port: str,
        read: Read,
        backend: Backend,
        client: Client,
        *,
        on_ended: Callable[[BaseException], None],
        check: Callable[[Feed], object] = lambda _: None,
    ) -> None:
        self._name, self._function, self._port = name, function, port
        self._read, self._check, self._on_ended = read, check, on_ended
        self._backend, self._account = backend, client.account
        self._holder = LeaseHolder(f"session {client.identity}", client.role.name)
        self._limit = client.limits.queue_messages
        self._waiting: deque[tuple[Message, Done, Charge]] = deque()
        self._feed: Feed | None = None
        self._sender: InputSender | None = None
        self._failure: BaseException | None = None  # once nothing more can be published
        self._closing = False
        self._opening = asyncio.ensure_future(self._open())

    def publish(self, message: Message, done: Done, octets: int) -> None:
        """Send one message of so many octets after those before it.

        Args:
            message: as it came.
            done: called once, with how it went.
            octets: of memory that the message holds.

        Raises:
            BusyError: too many wait.
            LimitError: the client has too much memory held.
            UoarmError: the function could not be opened, or has ended.
        """
        if self._failure is not None:
            raise self._failure
        if self._sender is not None:
            self._sender.send(message, self._port or None, done, octets)
        elif len(self._waiting) >= self._limit:
            raise BusyError(f"{self._limit} messages to {self._name} wait already")
        else:
            charge = self._account.charge(MemoryUse.SENDING, octets)
            self._waiting.append((message, done, charge))

    def close(self) -> None:
        """Let go of the function after what was published."""
        self._closing = True
        if self._sender is not None:
            self._sender.after(self._leave)

    def abandon(self) -> None:
        """Let go of the function now; what waits for it is not sent."""
        self._opening.cancel()
        while self._waiting:
            self._waiting.popleft()[2].release()
        self._leave()

    def offer(self, envelope: object) -> None:
        """Take nothing: this connection only sends."""

    def ended(self, state: str, cause: str) -> None:
        """Give the function back, whose provider has gone."""
        self._fail(UoarmError(f"{self._name} has {state}: {cause or 'killed'}"))

    async def _open(self) -> None:
        try:
            feed = await self._backend.join(FeedKey(self._function, receive=False))
            with on_failure(self._backend.leave, feed):
                self._check(feed)
        except Exception as error:  # noqa: BLE001 - said to the one who publishes
            self._fail(error)
            self._send_waiting()
            return
        assert feed.connection is not None, "join returns feeds that are open"
        self._feed = feed
        self._sender = self._backend.sender(
            feed.connection, self._account, self._read, self._holder
        )
        feed.add(self)  # a feed that has ended meanwhile says so before this returns
        self._send_waiting()
        if self._closing and self._sender is not None:
            self._sender.after(self._leave)

    def _send_waiting(self) -> None:
        """Send what waited for the function, or fail it where there is none."""
        waiting, self._waiting = self._waiting, deque()
        for message, done, charge in waiting:
            octets = charge.octets
            charge.release()
            if self._failure is not None:
                done(self._failure)
                continue
            try:
                self.publish(message, done, octets)
            except UoarmError as error:
                done(error)

    def _fail(self, error: BaseException) -> None:
        self._failure = error
        self._leave()
        self._on_ended(error)

    def _leave(self) -> None:
        sender, self._sender = self._sender, None
        feed, self._feed = self._feed, None
        if sender is not None:
            sender.close()  # what waits is not sent, and its leases are given back
        if feed is not None:
            feed.remove(self)
            self._backend.leave(feed)
