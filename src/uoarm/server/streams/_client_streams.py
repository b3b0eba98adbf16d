"""The connections that one client holds: opened, sent to, killed, and given back when it goes."""

from __future__ import annotations

import asyncio
import functools
import math
from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

from attrs import define, field, frozen

from uoarm._control import Connection
from uoarm._support.aio_deadlines import result_within
from uoarm._support.ordered import keep_newest
from uoarm._wire import Form
from uoarm.errors import BridgeTimeoutError, MessageError, UsageError
from uoarm.model import LeaseHolder, Message, OverflowPolicy, QueuePolicy, ValidationMode
from uoarm.server._failures import LimitError, UnknownError
from uoarm.server.streams._feed import Feed, FeedKey
from uoarm.server.streams._feed_registry import FeedRegistry
from uoarm.server.streams._input_sender import InputSender, read_message
from uoarm.server.streams._outbox import Lane
from uoarm.server.streams._pending_feeds import OnAbsent
from uoarm.server.streams._subscription import MessageForm, Subscriber, Subscription, Throttle


@frozen(eq=False)
class Stream:
    """A connection that a client has.

    Attributes:
        connection: open.
        subscription: what hands them to the client.
    """

    connection: Connection
    feed: Feed
    subscription: Subscription

    def begin(self) -> None:
        """Let its messages come, first those that wait."""
        self.subscription.begin(self.feed)

    @property
    def number(self) -> int | None:
        """The number of the last message that was sent or lost; None while others wait."""
        # First: in another thread than the loop's, the next one may wait by the time of the look.
        number = self.subscription.number
        is_waiting = self.subscription.lane.waiting or self.feed.is_writing
        return None if is_waiting else number


class _End(NamedTuple):
    """The end of a connection, as it was sent."""

    lane: Lane
    frame: bytes


@define(eq=False)
class ClientStreams:
    """Streams and input senders of one client by connection id, in the loop's thread.

    Args:
        form: in which its messages are.
        holder: as whom it commands inputs that have a lease.
        on_refused: called with the connection, and why one of its messages could not be written.
        shown: returns a text as the client may read it.
    """

    _registry: FeedRegistry
    _client: Subscriber
    _form: Form
    _holder: LeaseHolder
    _on_refused: Callable[[str, MessageError], None]
    _shown: Callable[[str], str]
    _streams: dict[str, Stream] = field(factory=dict, init=False)
    _sendings: dict[str, InputSender] = field(factory=dict, init=False)
    # The last ends by connection, for a client that comes back: those of more streams than it
    # may have are old.
    _ends: dict[str, _End] = field(factory=dict, init=False)
    # By connection, who waits for its end; set before the kill begins, so that a second one
    # joins it.
    _killing: dict[str, list[Callable[[], None]]] = field(factory=dict, init=False)
    # Requests under way: they count against the limit, or many at once would pass it.
    _opening: int = field(default=0, init=False)

    async def open(
        self, wanted: FeedKey, options: Mapping[str, Any], on_absent: OnAbsent
    ) -> Stream:
        """Open a function. Its messages wait until `Stream.begin`.

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
        if len(self._streams) + self._opening >= self._client.limits.streams:
            raise LimitError(f"{self._client.limits.streams} connections are open; kill one first")
        # Counted before the wait, and given back however it ends, also when the client has gone.
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
        # Or it had it until just now: a second stream's end would come before what waits of that.
        if connection.id in self._streams or connection.id in self._ends:
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
            # It is cancelled where this client has gone, or waits no longer.
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

    def own(self, identity: str) -> Stream:
        """Return the client's stream of a connection.

        Raises:
            UnknownError: it has none of this id; those of others are refused in the same words.
        """
        stream = self._streams.get(identity)
        if stream is None:
            raise UnknownError(f"this client has no connection {identity[:100]!r}")
        return stream

    def sender(self, stream: Stream) -> InputSender:
        """Return what hands messages to the inputs of a stream, and stops them."""
        identity = stream.connection.id
        sending = self._sendings.get(identity)
        if sending is None:
            read = functools.partial(read_message, self._form)
            sending = self._sendings[identity] = self._registry.sender(
                stream.connection, self._client.account, read, self._holder
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
            if len(pending) >= self._client.limits.calls:
                raise LimitError(f"{len(pending)} kills of {identity} wait already")
            pending.append(done)
            return

        def end() -> None:
            # Removed before the lane is emptied: no more messages are put into it then.
            self._remove(identity, f"killed by {self._holder}, who used it last")
            self._client.outbox.discard(stream.subscription.lane)
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
        # A copy: removing one takes it out.
        for identity in list(self._streams):
            self._remove(identity, f"{self._holder} has gone, who used it last")

    def connections(self) -> list[str]:
        """Return their ids. From any thread."""
        return list(self._streams)

    def counters(self) -> list[dict[str, object]]:
        """Return what came and what was lost, for each connection. From any thread."""
        return [
            {
                "connection": identity,
                "received": stream.feed.number,
                "sent": stream.subscription.lane.sent,
                "waiting": len(stream.subscription.lane.waiting),
                "dropped": stream.subscription.lane.dropped,
                "left_out": stream.subscription.skipped,
                "number": stream.number,
            }
            for identity, stream in tuple(self._streams.items())
        ]

    def repeat_ends(self) -> None:
        """Send the last ends once more: after a drop the client may not have received them."""
        for end in self._ends.values():
            # One whose end waits still will be sent anyway, and must not be sent twice.
            if not end.lane.waiting:
                self._client.outbox.finish(end.lane, end.frame)

    def _stream(self, feed: Feed, connection: Connection, options: Mapping[str, Any]) -> Stream:
        every = options.get("every", 0)
        subscription = Subscription(
            self._client,
            self._few(feed, connection) if every else self._all(connection),
            lane=self._lane(options.get("queue")),
            throttle=Throttle(every, is_even=True),
            on_refused=lambda error: self._on_refused(connection.id, error),
            on_end=lambda state, cause: self._ended(connection.id, state, cause),
        )
        return Stream(connection, feed, subscription)

    def _all(self, connection: Connection) -> MessageForm:
        """Return the form of a client that gets all messages, which are the same for all these."""
        write = functools.partial(self._form.write_data, connection.id)
        standing = functools.partial(write, standing=True)
        return MessageForm(self._form.name, write, self._form.text, standing)

    def _few(self, feed: Feed, connection: Connection) -> MessageForm:
        """Return the form of a client for which messages are left out, with numbers of its own."""
        form, identity, before = self._form, connection.id, feed.before_newcomer

        def frames(content: bytes, number: int) -> tuple[bytes]:
            # The message alone is written once for all such clients; this head is each one's own.
            skipped = self._streams[identity].subscription.skipped
            head = {"op": "Data", "type": identity, "x-number": number - skipped}
            head |= {"x-standing": True} if number <= before else {}
            parts = {name: form.write(value) for name, value in head.items()}
            return (form.map_of({**parts, "jsonMessage": content}),)

        def write(number: int, message: Message) -> bytes:
            del number
            return form.write(message)

        return MessageForm(f"{form.name} message", write, form.text, frames=frames)

    def _lane(self, options: Mapping[str, Any] | None) -> Lane | None:
        """Return the queue that a client asks for; one that names its length wants all of it."""
        if options is None:
            return None
        limits = self._client.limits
        queue = QueuePolicy(
            min(options.get("length", limits.queue_messages), limits.queue_messages),
            options.get("policy", OverflowPolicy.DROP_OLDEST),
        )
        wants_all = queue.policy is not OverflowPolicy.LATEST
        return Lane(queue, self._form.text, options.get("age", math.inf), wants_all=wants_all)

    def _ended(self, identity: str, state: str, cause: str) -> None:
        """Send the end after the last message, and free the name."""
        cause = cause or ("killed by the program that serves it" if state == "closed" else "")
        # Freed first: a client that has the end may ask for the same function at once. One that
        # has just killed it gets the answer to that, and no end.
        stream = self._remove(identity)
        if stream is not None:
            fields = {
                "connection": identity,
                "state": state,
                "cause": self._shown(cause),
                "number": stream.subscription.number,
            }
            frame = self._form.write({"op": "Status", "type": "connection", "jsonMessage": fields})
            # Through the stream's own queue: the end comes after its last message.
            lane = stream.subscription.lane
            self._client.outbox.finish(lane, frame)
            keep_newest(self._ends, identity, _End(lane, frame), self._client.limits.streams)

    def _remove(self, identity: str, cause: str = "") -> Stream | None:
        stream = self._streams.pop(identity, None)
        sending = self._sendings.pop(identity, None)
        # Before the claim is given back: with the last one the connection ends, and what still
        # waits to be sent should fail as ended, not as refused by a closed input.
        if sending is not None:
            sending.close()
        if stream is not None:
            stream.feed.remove(stream.subscription)
            self._registry.leave(stream.feed, cause)
        return stream


def feed_key(name: str, options: Mapping[str, Any]) -> FeedKey:
    """Return what a Request with these options asks for."""
    return FeedKey(
        name, ValidationMode(options.get("validate", "sampled")), options.get("receive", True)
    )
