"""The connections that one client holds: opened, sent to, killed, and given back when it goes."""

from __future__ import annotations

import asyncio
import functools
import math
import time
from collections import deque
from collections.abc import Callable, Mapping
from typing import Any

from uoarm._control import Connection
from uoarm._dataplane import Clock
from uoarm._support.aio_deadlines import result_within
from uoarm._wire import Form
from uoarm.errors import BridgeTimeoutError, MessageError, UsageError
from uoarm.model import LeaseHolder, Message, OverflowPolicy, QueuePolicy, ValidationMode
from uoarm.server._failures import LimitError, UnknownError
from uoarm.server._limits import Limits
from uoarm.server.streams._encoder import Encoder
from uoarm.server.streams._feed import Envelope, Feed, FeedKey, Write
from uoarm.server.streams._feed_registry import FeedRegistry
from uoarm.server.streams._input_sender import Done, InputSender, read_message
from uoarm.server.streams._memory import Account
from uoarm.server.streams._outbox import Lane, Outbox
from uoarm.server.streams._pending_feeds import OnAbsent

__all__ = ["ClientStreams", "Stream", "feed_key"]


class Stream:
    """Hands the messages of a feed to one client.

    Args:
        feed: an open feed.
        outbox: the client's.
        form: in which messages are written.
        lane: the client's own queue for this feed.
        every: least seconds between two messages; those between are left out.
        clock: seconds.
        on_refused: called once for each reason for which a message could not be written.
        on_end: called when the feed has ended, with state and cause.
    """

    def __init__(
        self,
        feed: Feed,
        outbox: Outbox,
        form: Form,
        lane: Lane,
        *,
        every: float,
        clock: Clock,
        on_refused: Callable[[MessageError], None],
        on_end: Callable[[str, str], None],
    ) -> None:
        assert feed.connection is not None, "a stream is made when its feed is open"
        self.feed = feed
        self.connection = feed.connection
        self.lane = lane
        self.skipped = 0
        self._outbox = outbox
        self._key = form.name
        self._write = functools.partial(form.write_data, feed.connection.id)
        self._write_standing = functools.partial(self._write, standing=True)
        self._pace = Pace(every) if every else None
        self._clock = clock
        self._on_refused = on_refused
        self._on_end = on_end

    def prepare(self, encoder: Encoder, envelope: Envelope) -> asyncio.Future[object] | None:
        """Have a long message written beside the loop, unless it comes too soon anyway."""
        if (
            self._pace is not None
            and envelope.joiner is None
            and not self._pace.is_due(self._clock())
        ):
            return None
        return envelope.prepare(*self._form_of(envelope), encoder)

    def offer(self, envelope: Envelope) -> None:
        """Take one message unless it comes too soon after the last."""
        if self._pace is not None and envelope.joiner is None:
            now = self._clock()
            if not self._pace.is_due(now):
                self.skipped += 1
                return
            self._pace.take(now)
        self._outbox.put(self.lane, envelope.written(*self._form_of(envelope)))

    def _form_of(self, envelope: Envelope) -> tuple[str, Write]:
        """Return in which form a message is written; one that is for this client alone stood."""
        return self._key, self._write if envelope.joiner is None else self._write_standing

    def miss(self) -> None:
        """Count a message that was let go of before it came here."""
        self._outbox.miss(self.lane)

    def refuse(self, envelope: Envelope, error: MessageError) -> None:
        """Count a message that has no form, and report why."""
        del envelope
        if self.lane.refuse(error):
            self._on_refused(error)

    def ended(self, state: str, cause: str) -> None:
        """Pass the end on."""
        self._on_end(state, cause)


class Pace:
    """Says which messages to pass on, so that as many a second pass as are asked for; no clock.

    Each is due one period after the last one was due, not after it came: of a source of 12 a second
    10 pass, and not every other one. What is left out is made up for by no burst: one that was
    slower than a period begins anew.

    Args:
        every: the period in seconds.
    """

    def __init__(self, every: float) -> None:
        self._every = every
        self._due = -math.inf

    def is_due(self, now: float) -> bool:
        """Say whether a message that comes now passes."""
        return now >= self._due

    def take(self, now: float) -> None:
        """Count one that passes."""
        late = now - self._due
        self._due = now + self._every - (late if late < self._every else 0.0)


class ClientStreams:
    """Streams and input senders of one client by connection id, in the loop's thread.

    Args:
        registry: where feeds are shared.
        outbox: the client's.
        account: the client's.
        form: in which its messages are.
        limits: bounds.
        holder: as whom it commands inputs that have a lease.
        on_refused: called with the connection, and why one of its messages could not be written.
        shown: returns a text as the client may read it.
    """

    def __init__(
        self,
        registry: FeedRegistry,
        outbox: Outbox,
        account: Account,
        form: Form,
        limits: Limits,
        holder: LeaseHolder,
        on_refused: Callable[[str, MessageError], None],
        shown: Callable[[str], str],
    ) -> None:
        self._registry = registry
        self._outbox = outbox
        self._account = account
        self._form = form
        self._limits = limits
        self._holder = holder
        self._on_refused = on_refused
        self._shown = shown
        self._streams: dict[str, Stream] = {}
        self._sendings: dict[str, InputSender] = {}
        # The last ends, for a client that comes back: those of more streams than it may have are
        # old.
        self._ends: deque[tuple[Lane, bytes]] = deque(maxlen=limits.streams)
        # By connection, who waits for its end; set before the kill begins, so that a second one
        # joins it.
        self._killing: dict[str, list[Callable[[], None]]] = {}
        # Requests under way: they count against the limit, or many at once would pass it.
        self._opening = 0

    async def open(
        self, wanted: FeedKey, options: Mapping[str, Any], on_absent: OnAbsent
    ) -> Stream:
        """Open a function. Its messages wait until `begin`.

        Args:
            wanted: the function.
            options: of the Request.
            on_absent: gets the reason why it cannot be had yet, where the options say to wait.

        Raises:
            LimitError: the client holds as many as it may.
            UsageError: it holds this one already.
            BridgeTimeoutError: it could not be had within the seconds that the options name.
            UoarmError: as `RobotManager.request`.
        """
        if len(self._streams) + self._opening >= self._limits.streams:
            raise LimitError(f"{self._limits.streams} connections are open; kill one first")
        self._opening += 1
        try:
            feed = await self._join(wanted, options.get("wait", 0), on_absent)
            while (killed := self._killed(feed)) is not None:
                # This client gives the same connection back: it is had again once that is done.
                self._registry.leave(feed)
                await killed
                feed = await self._join(wanted, options.get("wait", 0), on_absent)
        finally:
            self._opening -= 1
        connection = feed.connection
        assert connection is not None, "join returns feeds that are open"
        # After the opening, since only then the connection has a name: two requests at the same
        # time get the same feed, and the second gives its claim back.
        if connection.id in self._streams:
            self._registry.leave(feed)
            raise UsageError(f"this client has {wanted.name!r} open as {connection.id}")
        stream = self._streams[connection.id] = self._stream(feed, connection, options)
        return stream

    def _killed(self, feed: Feed) -> asyncio.Future[None] | None:
        """Return what has the end of a kill of this client's that is under way; None: none is."""
        assert feed.connection is not None, "join returns feeds that are open"
        pending = self._killing.get(feed.connection.id)
        if pending is None:
            return None
        killed: asyncio.Future[None] = asyncio.get_running_loop().create_future()

        def end() -> None:
            if not killed.done():
                killed.set_result(None)

        pending.append(end)
        return killed

    async def _join(self, wanted: FeedKey, seconds: float, on_absent: OnAbsent) -> Feed:
        if not seconds:
            return await self._registry.join(wanted)
        last = ["it is being opened still"]

        def notify(cause: str) -> None:
            last[0] = cause
            on_absent(cause)

        try:
            return await result_within(seconds, self._registry.join(wanted, notify))
        except asyncio.TimeoutError:
            text = f"{wanted.name!r} could not be had within {seconds:g} s: {last[0]}"
            raise BridgeTimeoutError(text) from None

    def begin(self, stream: Stream) -> None:
        """Let the messages of a stream come, first those that wait."""
        prepare = functools.partial(stream.prepare, self._registry.encoder)
        stream.feed.add(stream, prepare, None if stream.lane.wants_all else stream.miss)

    def own(self, identity: str) -> Stream:
        """Return the client's stream of a connection.

        Raises:
            UnknownError: it has none of this id; those of others are refused in the same words.
        """
        stream = self._streams.get(identity)
        if stream is None:
            raise UnknownError(f"this client has no connection {identity[:100]!r}")
        return stream

    def send(
        self,
        stream: Stream,
        message: Message,
        port: str | None,
        done: Done,
        octets: int,
        *,
        take_over: bool = False,
    ) -> None:
        """Hand one message to an input; raises as `InputSender.send`."""
        self._sending(stream).send(message, port, done, octets, take_over=take_over)

    def stop(self, stream: Stream, port: str | None, done: Done) -> None:
        """Stop an input; raises as `InputSender.stop`."""
        self._sending(stream).stop(port, done)

    def _sending(self, stream: Stream) -> InputSender:
        identity = stream.connection.id
        sending = self._sendings.get(identity)
        if sending is None:
            read = functools.partial(read_message, self._form)
            sending = self._sendings[identity] = self._registry.sender(
                stream.connection, self._account, read, self._holder
            )
        return sending

    def kill(self, stream: Stream, done: Callable[[], None]) -> None:
        """Give a connection back after what was sent to it; what waits of it is discarded.

        While that is under way, another kill of it waits for the same end.

        Raises:
            LimitError: too many kills of it wait already.
        """
        identity = stream.connection.id
        pending = self._killing.get(identity)
        if pending is not None:
            if len(pending) >= self._limits.calls:
                raise LimitError(f"{len(pending)} kills of {identity} wait already")
            pending.append(done)
            return

        def end() -> None:
            self._remove(identity, f"killed by {self._holder}, who used it last")
            self._outbox.discard(stream.lane)
            for report in self._killing.pop(identity):
                report()

        # Before `after`, which may call `end` at once.
        self._killing[identity] = [done]
        sending = self._sendings.get(identity)
        if sending is None:
            end()
        else:
            sending.after(end)

    def close(self) -> None:
        """Give everything back."""
        # A copy: removing one takes it out.
        for identity in list(self._streams):
            self._remove(identity, f"{self._holder} has gone, who used it last")

    def counters(self) -> list[dict[str, object]]:
        """Return what came and what was lost, for each connection."""
        return [
            {
                "connection": identity,
                "received": stream.feed.number,
                "sent": stream.lane.sent,
                "waiting": len(stream.lane.waiting),
                "dropped": stream.lane.dropped,
                "left_out": stream.skipped,
            }
            for identity, stream in self._streams.items()
        ]

    def repeat_ends(self) -> None:
        """Send the last ends once more: after a drop the client may not have received them."""
        for lane, frame in self._ends:
            # One whose end waits still will be sent anyway, and must not be sent twice.
            if not lane.waiting:
                self._outbox.finish(lane, frame)

    def _stream(self, feed: Feed, connection: Connection, options: Mapping[str, Any]) -> Stream:
        return Stream(
            feed,
            self._outbox,
            self._form,
            self._lane(options.get("queue")),
            every=options.get("every", 0),
            clock=time.monotonic,
            on_refused=lambda error: self._on_refused(connection.id, error),
            on_end=lambda state, cause: self._ended(connection.id, state, cause),
        )

    def _lane(self, options: Mapping[str, Any] | None) -> Lane:
        """Return the queue that a client asks for; one that names its length wants all of it."""
        limits, text = self._limits, self._form.text
        if options is None:
            return Lane(QueuePolicy(limits.queue_messages), text, limits.queue_seconds)
        queue = QueuePolicy(
            min(options.get("length", limits.queue_messages), limits.queue_messages),
            options.get("policy", OverflowPolicy.DROP_OLDEST),
        )
        wants_all = queue.policy is not OverflowPolicy.LATEST
        return Lane(queue, text, options.get("age", math.inf), wants_all=wants_all)

    def _ended(self, identity: str, state: str, cause: str) -> None:
        """Send the end after the last message, and free the name."""
        cause = cause or ("killed by the program that serves it" if state == "closed" else "")
        stream = self._remove(identity)
        if stream is not None:
            fields = {"connection": identity, "state": state, "cause": self._shown(cause)}
            frame = self._form.write({"op": "Status", "type": "connection", "jsonMessage": fields})
            # Through the stream's own queue: the end comes after its last message.
            self._outbox.finish(stream.lane, frame)
            self._ends.append((stream.lane, frame))

    def _remove(self, identity: str, cause: str = "") -> Stream | None:
        stream = self._streams.pop(identity, None)
        sending = self._sendings.pop(identity, None)
        # Before the claim is given back: with the last one the connection ends, and what still
        # waits to be sent should fail as ended, not as refused by a closed input.
        if sending is not None:
            sending.close()
        if stream is not None:
            stream.feed.remove(stream)
            self._registry.leave(stream.feed, cause)
        return stream


def feed_key(name: str, options: Mapping[str, Any]) -> FeedKey:
    """Return what a Request with these options asks for."""
    return FeedKey(
        name, ValidationMode(options.get("validate", "sampled")), options.get("receive", True)
    )
