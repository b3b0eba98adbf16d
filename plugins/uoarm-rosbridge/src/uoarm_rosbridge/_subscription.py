"""One client's subscription to one topic: its rate, its queue, its compression."""

from __future__ import annotations

import asyncio
import functools
import math
import struct
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from typing import Any

from attrs import frozen

from uoarm import cdr
from uoarm.errors import ControlMessageError, MessageError
from uoarm.model import Message, MessageStructure, QueuePolicy
from uoarm.server.front_end import Client, Envelope, Lane, MemoryUse, write_binary
from uoarm_rosbridge._wire import (
    clock_now,
    fragment_size,
    split,
    write_publish,
    write_publish_cbor,
    write_publish_png,
)

__all__ = ["RawWriter", "SubscribeOptions", "Subscription", "read_options"]

_head = struct.Struct(">BI").pack
_BYTE_STRING = 0x5A  # of CBOR, behind which its length is told in four octets


class RawWriter:
    """Writes a topic's messages for those who read the serialised form themselves.

    Args:
        topic: as the client named it.
        structure: tells what the messages are like now; a takeover may change it.
    """

    def __init__(self, topic: str, structure: Callable[[], MessageStructure]) -> None:
        self._topic = topic
        self._structure = structure
        self._known: MessageStructure | None = None
        self._serialise: Callable[[Message], Sequence[cdr.Part]] | None = None

    def __call__(self, message: Message) -> bytes:
        """Return a publish message.

        Raises:
            MessageError: the message does not fit, or its structure has no fixed layout.
        """
        seconds, nanoseconds = clock_now()
        parts = self.prepare()(message)
        raw = {"secs": seconds, "nsecs": nanoseconds, "bytes": b""}
        before = write_binary({"op": "publish", "topic": self._topic, "msg": raw})
        length = sum(memoryview(part).nbytes for part in parts)
        return b"".join((before[:-1], _head(_BYTE_STRING, length), *parts))

    def prepare(self) -> Callable[[Message], Sequence[cdr.Part]]:
        """Read the structure, unless it is known, and return what serialises its messages.

        Raises:
            MessageError: the structure has no fixed layout.
        """
        structure = self._structure()
        if self._serialise is None or structure is not self._known:
            try:
                self._serialise = cdr.Codec(structure).encode_parts
            except MessageError as error:
                raise MessageError(f"{error}; ask for cbor instead of cbor-raw") from None
            self._known = structure
        return self._serialise


_RAW = "cbor-raw"
_TEXTS = {"none": write_publish, "png": write_publish_png}
_COMPRESSIONS = (*_TEXTS, "cbor", _RAW)
_MOST = 100_000


@frozen
class SubscribeOptions:
    """What one subscribe message asks for.

    Attributes:
        every: least seconds between two messages.
        length: messages kept while the client must not have them yet; 0: only the newest goes.
        fragment: longest text of one frame in characters; 0: any.
        compression: `none`, `png`, `cbor` or `cbor-raw`.
    """

    every: float = 0.0
    length: int = 0
    fragment: int = 0
    compression: str = "none"


def read_options(fields: Mapping[str, Any]) -> SubscribeOptions:
    """Return what a subscribe message asks for.

    Raises:
        ControlMessageError: it asks for a compression that is not served.
    """
    compression = fields.get("compression") or "none"
    if compression not in _COMPRESSIONS:
        raise ControlMessageError(
            f"subscribe: compression {compression!r:.60} is not served; "
            f"use {', '.join(_COMPRESSIONS[:-1])} or {_RAW}"
        )
    return SubscribeOptions(
        every=float(fields.get("throttle_rate") or 0) / 1000,
        length=min(int(fields.get("queue_length") or 0), _MOST),
        fragment=fragment_size(fields),
        compression=compression,
    )


class Subscription:
    """Hands a topic's messages to one client, as its subscribe messages together ask.

    Several subscriptions of one client to one topic are one here: the highest rate and the longest
    queue hold; the compression is that of the first.

    Args:
        topic: as the client named it.
        options: of the first subscribe message.
        client: who listens.
        structure: tells what the messages are like, for `cbor-raw`.
        clock: seconds.
        on_refused: hears once of each reason for which a message could not be written.
        on_end: hears why no more will come.
    """

    def __init__(
        self,
        topic: str,
        options: SubscribeOptions,
        client: Client,
        *,
        structure: Callable[[], MessageStructure],
        clock: Callable[[], float],
        on_refused: Callable[[MessageError], None],
        on_end: Callable[[str, str], None],
    ) -> None:
        self.asked: dict[str, SubscribeOptions] = {}
        self._topic = topic
        self._outbox = client.outbox
        self._account = client.account
        self._clock = clock
        self._on_refused = on_refused
        self._on_end = on_end
        self._due = -math.inf
        self._held: deque[Envelope] = deque()
        self._charge = client.account.hold(MemoryUse.THROTTLED)
        self._timer: asyncio.TimerHandle | None = None
        text = options.compression in _TEXTS
        limits = client.limits
        self.lane = Lane(QueuePolicy(limits.queue_messages), text, limits.queue_seconds)
        self._key = f"ros-{options.compression}:{topic}"
        self._raw = RawWriter(topic, structure) if options.compression == _RAW else None
        write = _TEXTS.get(options.compression, write_publish_cbor)
        self._write = functools.partial(_numberless, self._raw or functools.partial(write, topic))
        self._every = options.every
        self._length = options.length
        self._fragment = options.fragment if text else 0

    def prepare(self) -> None:
        """Make ready for messages, whose structure is known now.

        Raises:
            MessageError: they have no form in the compression that was asked for.
        """
        if self._raw is not None:
            self._raw.prepare()

    def set_options(self, identity: str, options: SubscribeOptions) -> None:
        """Add or replace a wish."""
        self.asked[identity] = options
        self._settle()

    def drop(self, identity: str | None) -> bool:
        """Take a wish back, or all; True when none is left."""
        if identity is None:
            self.asked.clear()
        else:
            self.asked.pop(identity, None)
        self._settle()
        return not self.asked

    def close(self) -> None:
        """Send nothing more."""
        if self._timer is not None:
            self._timer.cancel()
        self._held.clear()
        self._charge.release()
        self._outbox.discard(self.lane)

    def offer(self, envelope: Envelope) -> None:
        """Take one message: to the client, into the hold, or nowhere."""
        now = self._clock()
        if envelope.joiner is not None:
            self._send(envelope)
        elif now >= self._due and not self._held:
            self._due = now + self._every
            self._send(envelope)
        elif self._length:
            self._hold(envelope)
            self._set_timer(now)
        else:
            self.lane.dropped += 1

    def miss(self) -> None:
        """Count a message that was let go of before it came here."""
        self._outbox.miss(self.lane)

    def refuse(self, envelope: Envelope, error: MessageError) -> None:
        """Count a message that has no form, and tell why."""
        del envelope
        if self.lane.refuse(error):
            self._on_refused(error)

    def ended(self, state: str, cause: str) -> None:
        """Pass the end on."""
        self._on_end(state, cause)

    def _settle(self) -> None:
        asked = self.asked.values()
        self._every = min((options.every for options in asked), default=0.0)
        self._length = max((options.length for options in asked), default=0)

    def _set_timer(self, now: float) -> None:
        if self._timer is None:
            loop = asyncio.get_running_loop()
            self._timer = loop.call_later(max(0.0, self._due - now), self._release)

    def _release(self) -> None:
        self._timer = None
        if self._held:
            now = self._clock()
            self._due = now + self._every
            envelope = self._let_go()
            try:
                self._send(envelope)
            except MessageError as error:
                self.refuse(envelope, error)
            if self._held:
                self._set_timer(now)

    def _hold(self, envelope: Envelope) -> None:
        """Keep a message until it is due; the oldest are lost where there are too many."""
        self._held.append(envelope)
        self._charge.resize(self._charge.octets + envelope.message_octets)
        while len(self._held) > 1 and (
            len(self._held) > self._length
            or self._charge.octets > self._outbox.max_bytes
            or not self._account.has_room(0)
        ):
            self._let_go()
            self.lane.dropped += 1

    def _let_go(self) -> Envelope:
        envelope = self._held.popleft()
        self._charge.resize(self._charge.octets - envelope.message_octets)
        return envelope

    def _send(self, envelope: Envelope) -> None:
        frame = envelope.written(self._key, self._write)
        identity = f"uoarm:{self._topic}:{envelope.number}"
        self._outbox.put(self.lane, *split(frame, self._fragment, identity))


def _numberless(write: Callable[[Any], bytes], number: int, message: Any) -> bytes:
    del number
    return write(message)
