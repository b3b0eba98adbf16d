"""What a viewer publishes to one input: opened when it is advertised, kept in order."""

from __future__ import annotations

import asyncio
from collections import deque
from collections.abc import Callable

from uoarm.errors import UoarmError
from uoarm.model import LeaseHolder
from uoarm.server.front_end import (
    Backend,
    BusyError,
    Charge,
    Client,
    Feed,
    FeedKey,
    InputSender,
    MemoryUse,
    Read,
)
from uoarm_foxglove._catalogue import InputTopic

__all__ = ["ViewerPublication"]


class ViewerPublication:
    """Messages of one viewer on their way into one input; in the loop's thread.

    Args:
        topic: the input.
        read: decodes a message by the input's structure.
        client: who publishes, and commands what has a lease as its session.
        backend: where the function is opened.
        fail: takes each error; the publication goes on unless it has ended.
        on_end: called when it cannot be opened, or has ended, with the error.
    """

    def __init__(
        self,
        topic: InputTopic,
        read: Read,
        client: Client,
        backend: Backend,
        *,
        fail: Callable[[BaseException], None],
        on_end: Callable[[BaseException], None],
    ) -> None:
        self._topic, self._read = topic, read
        self._account, self._backend = client.account, backend
        self._holder = LeaseHolder(f"session {client.identity}", client.role.name)
        self._fail, self._on_end = fail, on_end
        self._most = client.limits.queue_messages
        self._waiting: deque[tuple[bytes, Charge]] = deque()
        self._feed: Feed | None = None
        self._sender: InputSender | None = None
        self._opening = asyncio.ensure_future(self._open())

    def publish(self, payload: bytes) -> None:
        """Send one message after those before it.

        Raises:
            BusyError: too many wait.
            LimitError: the client has too much memory held.
        """
        if self._sender is not None:
            self._sender.send(payload, self._topic.port or None, self._done, len(payload))
        elif len(self._waiting) >= self._most:
            raise BusyError(f"{self._most} messages to {self._topic.function} wait already")
        else:
            charge = self._account.charge(MemoryUse.SENDING, len(payload))
            self._waiting.append((payload, charge))

    def close(self) -> None:
        """Let go of the function after what was published."""
        if self._sender is not None:
            self._sender.after(self._leave)
        else:
            self.abandon()

    def abandon(self) -> None:
        """Let go of the function now."""
        self._opening.cancel()
        while self._waiting:
            self._waiting.popleft()[1].release()
        self._leave()

    def offer(self, envelope: object) -> None:
        """Take nothing: this connection only sends."""

    def refuse(self, envelope: object, error: Exception) -> None:
        """Take nothing: this connection only sends."""

    def ended(self, state: str, cause: str) -> None:
        """Give the function back, whose provider has gone."""
        self._leave()
        self._on_end(UoarmError(f"{self._topic.function} has {state}: {cause or 'killed'}"))

    async def _open(self) -> None:
        try:
            feed = await self._backend.join(FeedKey(self._topic.function, receive=False))
        except Exception as error:  # noqa: BLE001 - said to the viewer
            self._on_end(error)
            return
        assert feed.connection is not None, "join returns feeds that are open"
        self._feed = feed
        self._sender = self._backend.sender(
            feed.connection, self._account, self._read, self._holder
        )
        feed.add(self)
        while self._waiting:
            payload, charge = self._waiting.popleft()
            charge.release()
            try:
                self.publish(payload)
            except UoarmError as error:
                self._fail(error)

    def _done(self, error: BaseException | None) -> None:
        if error is not None:
            self._fail(error)

    def _leave(self) -> None:
        feed, self._feed = self._feed, None
        sender, self._sender = self._sender, None
        if sender is not None:
            sender.close()  # what waits is not sent, and its leases are given back
        if feed is not None:
            feed.remove(self)
            self._backend.leave(feed)
