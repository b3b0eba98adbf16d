"""The profile on one line: frames, sequence numbers, heartbeat, and the catalogue at the start."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from typing import Protocol

from attrs import frozen

from uoarm.errors import BridgeError, BridgeTimeoutError
from uoarm_rocos._catalogue import (
    CatalogueMessage,
    DescribeMessage,
    DeviceCatalogue,
    ErrorMessage,
    HeartbeatMessage,
    WireMessage,
)
from uoarm_rocos._codec import MessageCodec
from uoarm_rocos._framing import Framer, LineError, WireError
from uoarm_rocos._health import ConversationIds, HeartbeatWatch, SequenceCheck
from uoarm_rocos._line import DeviceLine
from uoarm_rocos._transport import LineTransport

__all__ = ["Conversation", "ConversationListener", "LineParts"]

_FIRST_HEARTBEAT = 1.0
_CATALOGUE_SECONDS = 3.0
_WRAP = 2**32


@frozen
class LineParts:
    """The replaceable parts of a line: makers of what carries, frames and codes messages.

    Attributes:
        prompt: whether nothing of them ever waits but `open`, `read` and `write` of the transport,
            which then has `write_now` as well: calls are made in the caller's own thread.
    """

    transport: Callable[[], LineTransport]
    framer: Callable[[], Framer]
    codec: MessageCodec
    prompt: bool = False


class ConversationListener(Protocol):
    """What takes events of a conversation; always in the line's thread."""

    def on_ready(self, catalogue: DeviceCatalogue) -> None:
        """The device is there and offers this."""

    def on_message(self, message: WireMessage) -> None:
        """A message that is neither heartbeat nor catalogue."""

    def on_tick(self, now: float) -> None:
        """Time passes."""

    def on_lost(self, cause: str) -> None:
        """The line is gone, or could not be opened."""


class Conversation:
    """One side of the conversation, begun anew whenever the line is.

    Attributes:
        line: set by the owner before the line starts.
        ids: where ids of conversations come from.
    """

    line: DeviceLine

    def __init__(
        self, wire: LineParts, fixed: DeviceCatalogue | None, listener: ConversationListener
    ) -> None:
        self.ids = ConversationIds()
        self._wire = wire
        self._fixed = fixed
        self._listener = listener
        # Guards number, framer and line between the threads that send: messages go out in the order
        # of their numbers, and a number whose message was not sent is given again.
        self._sending = threading.Lock()
        self._seq = 0
        self._began = 0.0
        self._asked = 0
        self._framer = wire.framer()
        self._incoming = SequenceCheck()
        self._watch = HeartbeatWatch(_FIRST_HEARTBEAT, 0.0, 0.0)
        self._refused = self._refused_before = 0
        self._why = ""
        self._lost_before = 0

    def send(self, build: Callable[[int], WireMessage], within: float | None = None) -> None:
        """Number and send a message; any thread.

        Args:
            build: makes the message of its number.
            within: seconds to wait at most, over a prompt line; None: as long as the line does.

        Raises:
            LineError: the line is not open.
            WireError: the message cannot be written; nothing was sent.
            BridgeTimeoutError: the line was busy all the time; nothing was sent.
        """
        end = 0.0 if within is None else time.monotonic() + within
        if not self._sending.acquire(timeout=-1 if within is None else max(0.0, within)):
            raise BridgeTimeoutError(f"{self.line.name} took nothing within {within:g} s")
        try:
            seq = self._seq
            frame = self._framer.frame(self._wire.codec.write(build(seq)))
            self._seq = (seq + 1) % _WRAP  # before, so that no number is ever there twice
            try:
                if within is None:
                    self.line.send(frame)
                else:
                    self.line.send_within(frame, max(0.0, end - time.monotonic()))
            except BridgeError:
                self._seq = seq
                raise
            self._watch.sent = time.monotonic()
        finally:
            self._sending.release()

    @property
    def refused(self) -> int:
        """How many messages of the device could not be read."""
        return self._refused

    def refused_since(self, count: int) -> str:
        """Say what came since there were so many that could not be read, to end a sentence."""
        more = self._refused - count
        if more <= 0:
            return ""
        came = "a message came" if more == 1 else f"{more:,} messages came"
        return f"; {came} that cannot be read, the last: {self._why}"

    def _came(self) -> str:
        """Say what came instead of what is waited for, to end a sentence."""
        damaged = self._framer.discarded
        return self.refused_since(self._refused_before) + (
            f"; {damaged:,} frames came damaged" if damaged else ""
        )

    def facts(self) -> dict[str, object]:
        """Return counters: messages lost on the way, frames damaged, messages refused."""
        return {
            "lost": self._lost_before + self._incoming.lost,
            "damaged": self._framer.discarded,
            "refused": self._refused,
        }

    def connected(self) -> None:
        """Begin anew."""
        now = time.monotonic()
        with self._sending:
            self._seq = 0
            self._framer = self._wire.framer()
            self._lost_before += self._incoming.lost
            self._incoming = SequenceCheck()
            period = self._fixed.heartbeat if self._fixed else _FIRST_HEARTBEAT
            self._watch = HeartbeatWatch(period, now, now)
        self._began = now
        self._refused_before = self._refused
        if self._fixed is not None:
            self._asked = 0
            self.send(HeartbeatMessage)
            self._listener.on_ready(self._fixed)
        else:
            self._asked = self.ids.next()
            self.send(lambda seq: DescribeMessage(seq, self._asked))

    def received(self, data: bytes) -> None:
        """Take octets of the line."""
        framer = self._framer
        for frame in framer.feed(data):
            try:
                message = self._wire.codec.read(frame)
            except WireError as error:
                if not framer.resynchronises:
                    raise
                self._refused += 1
                self._why = str(error)
                continue
            if self._incoming.take(message.seq):
                raise LineError("the device has begun anew")
            self._watch.received_at = time.monotonic()
            if not self._asked:
                self._refused_before = self._refused
            self._take(message)

    def tick(self, now: float) -> None:
        """Keep the heartbeat, and notice that the device has none."""
        silent = self._watch.dead(now)
        if silent:
            text = f"the device said nothing for {silent:.1f} s"
            raise LineError(text + self._came())
        if self._asked and now - self._began > _CATALOGUE_SECONDS:
            text = f"the device sent no catalogue within {_CATALOGUE_SECONDS:g} s"
            raise LineError(text + self._came())
        if self._watch.is_heartbeat_due(now):
            self.send(HeartbeatMessage)
        self._listener.on_tick(now)

    def lost(self, cause: str) -> None:
        """Pass on that the line is gone."""
        self._listener.on_lost(cause)

    def _take(self, message: WireMessage) -> None:
        if isinstance(message, CatalogueMessage):
            if message.id == self._asked:
                self._asked = 0
                self._watch.period = message.catalogue.heartbeat
                self._listener.on_ready(message.catalogue)
        elif isinstance(message, ErrorMessage) and self._asked and message.id == self._asked:
            text = f"the device gives no catalogue: {message.code.value}: {message.text}"
            raise LineError(text)
        elif not isinstance(message, HeartbeatMessage):
            self._listener.on_message(message)
