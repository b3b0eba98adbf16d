"""One client's share in a feed: how often, in which form, through which queue."""

from __future__ import annotations

import asyncio
import functools
from collections.abc import Callable

from uoarm._dataplane import Clock
from uoarm._wire import Form
from uoarm.errors import MessageError
from uoarm.model import QueuePolicy
from uoarm.server._encoder import Encoder
from uoarm.server._feed import Envelope, Feed
from uoarm.server._outbox import Lane, Outbox

__all__ = ["Stream"]


class Stream:
    """Hands the messages of a feed to one client.

    Args:
        feed: an open feed.
        outbox: the client's.
        form: in which messages are written.
        queue: the client's own queue for this feed.
        every: least seconds between two messages; those between are left out.
        clock: seconds.
        on_refused: hears once of each reason for which a message could not be written.
        on_end: called when the feed has ended, with state and cause.
    """

    def __init__(
        self,
        feed: Feed,
        outbox: Outbox,
        form: Form,
        queue: QueuePolicy,
        *,
        every: float,
        clock: Clock,
        on_refused: Callable[[MessageError], None],
        on_end: Callable[[str, str], None],
    ) -> None:
        assert feed.connection is not None, "a stream is made when its feed is open"
        self.feed = feed
        self.connection = feed.connection
        self.lane = Lane(queue, form.text)
        self.skipped = 0
        self._outbox = outbox
        self._key = form.name
        self._write = functools.partial(form.write_data, feed.connection.id)
        self._every = every
        self._clock = clock
        self._due = 0.0
        self._on_refused = on_refused
        self._on_end = on_end

    def prepare(self, encoder: Encoder, envelope: Envelope) -> asyncio.Future[object] | None:
        """Have a long message written beside the loop, unless it comes too soon anyway."""
        if self._every and self._clock() < self._due:
            return None
        return envelope.prepare(self._key, self._write, encoder)

    def offer(self, envelope: Envelope) -> None:
        """Take one message unless it comes too soon after the last."""
        if self._every:
            now = self._clock()
            if now < self._due:
                self.skipped += 1
                return
            self._due = now + self._every
        self._outbox.put(self.lane, envelope.written(self._key, self._write))

    def refuse(self, envelope: Envelope, error: MessageError) -> None:
        """Count a message that has no form, and tell why."""
        del envelope
        if self.lane.refuse(error):
            self._on_refused(error)

    def ended(self, state: str, cause: str) -> None:
        """Pass the end on."""
        self._on_end(state, cause)
