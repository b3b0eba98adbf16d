"""A viewer's subscription to one channel, from the function's feed to the socket."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Callable

from uoarm.errors import MessageError
from uoarm.model import Message, QueuePolicy
from uoarm.server.front_end import Backend, Client, Envelope, Feed, FeedKey, Lane, error_text
from uoarm_foxglove._catalogue import OutputChannel
from uoarm_foxglove._protocol import message_data

__all__ = ["ChannelSubscription"]

_AGAIN_SECONDS = 1.0
_FAILED = "failed"


class ChannelSubscription:
    """Hands the messages of a channel to one viewer until it is closed; in the loop's thread.

    A function that cannot be had yet, or whose provider fails, is asked for again.

    Args:
        number: by which the viewer knows the subscription.
        channel: whose messages.
        client: the viewer.
        backend: where the function is opened.
        warn: takes what the viewer should know, each text once.
        on_end: called when there is nothing to wait for any more, with the cause.
    """

    def __init__(
        self,
        number: int,
        channel: OutputChannel,
        client: Client,
        backend: Backend,
        *,
        warn: Callable[[str], None],
        on_end: Callable[[str], None],
    ) -> None:
        self.channel = channel
        self._number = number
        self._outbox, self._backend = client.outbox, backend
        self._warn, self._on_end = warn, on_end
        self._warned = ""
        limits = client.limits
        self._lane = Lane(QueuePolicy(limits.queue_messages), text=False, age=limits.queue_seconds)
        # Viewers of one channel share what is encoded once; only the head is each one's own.
        self._key = f"foxglove:{channel.number}"
        self._feed: Feed | None = None
        self._opening = asyncio.ensure_future(self._open(0.0))

    def offer(self, envelope: Envelope) -> None:
        """Send one message."""
        payload = envelope.written(self._key, self._write)
        self._outbox.put(self._lane, message_data(self._number, time.time_ns(), payload))

    def miss(self) -> None:
        """Count a message that was let go of before it came here."""
        self._outbox.miss(self._lane)

    def refuse(self, envelope: Envelope, error: MessageError) -> None:
        """Count a message that has no form in the channel's encoding, and say why."""
        del envelope
        if self._lane.refuse(error):
            self._say(str(error))

    def ended(self, state: str, cause: str) -> None:
        """Wait for a provider that failed to come back; what ended in another way has ended."""
        self._leave()
        if state != _FAILED:
            self._on_end(f"{state}: {cause or 'killed'}")
            return
        self._say(f"failed: {cause}; it is waited for")
        self._opening = asyncio.ensure_future(self._open(_AGAIN_SECONDS))

    def close(self) -> None:
        """Give back what is held."""
        self._opening.cancel()
        self._outbox.discard(self._lane)
        self._leave()

    async def _open(self, pause: float) -> None:
        try:
            await asyncio.sleep(pause)
            feed = await self._backend.join(
                FeedKey(self.channel.wanted),
                lambda cause: self._say(f"cannot be had yet: {cause}; it is waited for"),
            )
        except Exception as error:  # noqa: BLE001 - said to the viewer
            self._on_end(error_text(error))
            return
        self._feed = feed
        feed.add(self, missed=self.miss)

    def _write(self, number: int, message: Message) -> bytes:
        del number
        return self.channel.codec.write(message)

    def _say(self, text: str) -> None:
        if text != self._warned:
            self._warned = text
            self._warn(text)

    def _leave(self) -> None:
        feed, self._feed = self._feed, None
        if feed is not None:
            feed.remove(self)
            self._backend.leave(feed)
