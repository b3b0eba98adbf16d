"""One flow of messages over a link: numbered, in order, with a window and counted losses.

The receiving end confirms what it has handled, so the sending end never has more than a window
of messages under way: a slow consumer slows its producer, and after a death it is known how
many messages may be lost.
"""

from __future__ import annotations

import logging
import struct
import threading
import time
from collections.abc import Callable
from functools import partial

import msgpack
from attrs import astuple, frozen

from uoarm._host.transport.codec import Frame, pack, unpack
from uoarm._host.transport.shared_counters import HANDLING, SharedCounter
from uoarm._host.transport.transport import Transport
from uoarm._raised import LimitedLog, Log, foreign, is_raised, text_of
from uoarm.bridge import Outcomes
from uoarm.errors import BridgeError, CommandRefusedError, FailureReason, MessageError
from uoarm.model import Message

_HEADER = struct.Struct("<4sQQq")
"""What it is, number, skipped, and when it was sent.

Behind it, in msgpack: of the last frame the ending; or a writer, with whether this is a message of
its, or its messages stand no more; or why a message could not be read, nothing where it could.
"""
_IS_HEADER = b"flow"
_WRITER = "writer"
_UNREADABLE = "unreadable"
_WINDOW = 64
_CONFIRM_EACH = _WINDOW // 4
_CONFIRM_SECONDS = 0.2
_TRY_SECONDS = 0.2
_GLANCE_SECONDS = 0.005
_ERROR_LENGTH = 1000
_log = Log("uoarm")


@frozen
class FlowEnding:
    """The last thing that a flow says: how it ended, as `Health` has it, and why."""

    health: str
    cause: str


@frozen
class Handled:
    """How far a receiving end is.

    Attributes:
        number: of the last message it handled.
        failed: how many its consumer raised on.
        last_error: what it raised last.
        lost: how many were lost on the way to it.
        raised: how many of the failed are the component's own failure.
        wrong: how many of the failed did not match: the failure of what gave them.
    """

    number: int
    failed: int
    last_error: str
    lost: int
    raised: int
    wrong: int


class FlowSender:
    """The sending end of a flow. `send` is called by one thread at a time, `finish` by any.

    Args:
        key: name of the flow on the link.
        patience: seconds that `send` waits while a whole window is under way; an attribute, too.
    """

    def __init__(self, transport: Transport, key: str, patience: float) -> None:
        self._transport = transport
        self._key = key
        self.patience = patience
        # Held from a frame's number until it is out: the end may be said by another thread than
        # that which sends, and the other end drops a number that is late.
        self._putting = threading.Lock()
        # Written with it, or by the one thread that sends, and read by that which takes
        # confirmations.
        self._number = 0
        self._skipped = 0
        self._handled = 0
        self._next_try: float | None = None
        self._cut = ""
        # Guards what confirmations change, and `_cut`: from the thread that sends against the
        # link's, which confirms, and the one that finds the other end dead. Confirmations come by
        # two ways, at once and with heartbeats, in two threads.
        self._room = threading.Condition()
        self._taken = 0
        self._raised = 0
        self._wrong = 0
        self._report: Outcomes | None = None
        self.failed = 0
        self.last_error = ""
        self.lost = 0
        self._end = transport.listen(f"{key}/handled", self._read_confirmation)

    @property
    def sent(self) -> int:
        return self._number

    @property
    def skipped(self) -> int:
        """How many messages were given up, of which the other end learns with the next one."""
        return self._skipped

    @property
    def unconfirmed(self) -> int:
        """How many messages were sent and are not known to be handled."""
        return self._number - self._handled

    def send(self, message: Message, writer: str = "") -> None:
        """Send one message, waiting for room if need be.

        Raises:
            MessageError: it cannot be written.
            BridgeError: the flow is cut, or a whole window has been under way for too long;
                the message was not sent.
        """
        sent_at = self._now()  # before the wait for room, so that its end knows how old it is
        frame = pack(message)
        # Without the lock: `_handled` only grows, so there is at least as much room as this sees.
        # Nor is it held for `_cut`: a message that goes out as the other end dies is never
        # confirmed, and counts among those under way.
        if self._number - self._handled >= _WINDOW or self._cut:
            self._wait_for_room()
        self._put(frame, (_WRITER, writer, True) if writer else None, sent_at)

    def send_read(self, why: str) -> None:
        """Send why a message could not be read, nothing where something could; waits as `send`.

        Raises:
            BridgeError: as by `send`; it was not sent.
        """
        if self._number - self._handled >= _WINDOW or self._cut:
            self._wait_for_room()
        self._put(b"", (_UNREADABLE, why), self._now())

    def let_go(self, writer: str) -> None:
        """Send that nothing of a writer stands any more, after everything that was sent before.

        Raises:
            BridgeError: the link is closed.
        """
        self._put(b"", (_WRITER, writer, False), self._now(), must_arrive=True)

    def watch(self, report: Outcomes) -> None:
        """Have reported what became of the messages that were sent."""
        self._report = report

    def skip(self) -> None:
        """Give up one message; the other end counts it as lost when the next one arrives."""
        # By the thread that sends, as `_put` is: the next frame carries a sum that no other
        # changes.
        self._skipped += 1

    def finish(self, ending: FlowEnding) -> None:
        """Send the end of the flow, after everything that was sent before.

        Raises:
            BridgeError: the link is closed.
        """
        self._put(b"", (ending.health, ending.cause), self._now(), must_arrive=True)

    def cut(self, cause: str) -> None:
        """Have every later `send`, and one that waits, fail with this cause."""
        with self._room:
            self._cut = cause
            self._room.notify_all()

    def close(self) -> None:
        """Send nothing more. Idempotent."""
        # First: who waits for room is let go, however long it takes to end the listening.
        self.cut("it is closed")
        self._end()

    def _now(self) -> int:
        """Return the time by the other end's clock, nanoseconds."""
        return self._transport.clock() + self._transport.ahead()

    def _put(
        self,
        frame: bytes,
        more: tuple[str | bool, ...] | None,
        sent_at: int,
        *,
        must_arrive: bool = False,
    ) -> None:
        with self._putting:
            # Before it is published: its confirmation may come before `publish` returns.
            self._number += 1
            header = _HEADER.pack(_IS_HEADER, self._number, self._skipped, sent_at)
            if more is not None:
                header += msgpack.packb(more)
            try:
                self._transport.publish(self._key, frame, header, must_arrive=must_arrive)
            except BridgeError:
                self._number -= 1  # who gets the error counts it: as sent, it would be lost as well
                raise

    def _wait_for_room(self) -> None:
        """Return when there is room; without any, let one message a while through as a try.

        The try is what finds out that the other end goes on after all, when messages or
        confirmations were lost on the way.
        """
        with self._room:
            # The whole patience is waited once; after that the other end is known to hang, and only
            # a try goes out now and then, so that the producer is not held up by each message.
            if self._next_try is None:
                self._room.wait_for(self._has_room, self.patience)
            if self._cut:
                raise BridgeError(f"{self._key}: {self._cut}", FailureReason.CLOSED)
            now = time.monotonic()
            if self._has_room() or self._next_try is None or now >= self._next_try:
                self._next_try = None if self._has_room() else now + _TRY_SECONDS
                return
        raise BridgeError(
            f"{self._key}: the other end has handled none of the last {_WINDOW} messages",
            FailureReason.UNAVAILABLE,
        )

    def _has_room(self) -> bool:
        return bool(self._cut) or self._number - self._handled < _WINDOW

    def confirm(self, handled: Handled) -> None:
        """Take what the other end says it has handled so far."""
        with self._room:
            # A heartbeat may say less than a confirmation that overtook it, or be written between
            # the count of a failure and that of its message: sums that only grow stand both.
            self._handled = max(self._handled, handled.number)
            self.lost = max(self.lost, handled.lost)
            if handled.failed > self.failed:
                self.failed, self.last_error = handled.failed, handled.last_error
            raised = max(0, handled.raised - self._raised)
            self._raised += raised
            wrong = max(0, handled.wrong - self._wrong)
            self._wrong += wrong
            taken = max(0, handled.number - handled.failed - handled.lost - self._taken)
            self._taken += taken
            self._next_try = None
            self._room.notify_all()
        # Outside of the lock: a report may close the flow.
        if self._report is not None and (taken or raised or wrong):
            self._report(taken, raised, wrong, handled.last_error)

    def _read_confirmation(self, header: bytes) -> None:
        match _plain(header):
            # One that claims more than was sent would open the window for ever.
            case [int(number), int(failed), str(error), int(lost), int(raised), int(wrong)] if (
                number <= self._number
            ):
                text = error[:_ERROR_LENGTH]
                self.confirm(Handled(number, failed, text, lost, raised, wrong))
            case answer:
                _log.debug("%s: no confirmation: %.40s", self._key, answer)


class FlowReceiver:
    """The receiving end of a flow: takes one message after the other.

    Args:
        key: name of the flow on the link.
        name: of the consumer, for records and for a thread of its own.
        take: the consumer, also of the writer's name where the sending end said one; what it
            raises is counted and reported to the sending end.
        ended: called, after the last message, with how the flow ended.
        counter: where how many messages the consumer has taken is written down.
        let_go: called with the writer whose messages stand no more.
        read: takes why a message could not be read at the sending end, nothing where one could.
    """

    def __init__(
        self,
        transport: Transport,
        key: str,
        *,
        name: str,
        take: Callable[..., None],
        ended: Callable[[FlowEnding], None],
        counter: SharedCounter | None = None,
        let_go: Callable[[str], None] = lambda _: None,
        read: Callable[[str], None] = lambda _: None,
    ) -> None:
        self._transport = transport
        self._key = key
        self._name = name
        self._take = take
        self._let_go = let_go
        self._read = read
        self._ended = ended
        self._counter = counter
        self._closed = False
        # All counts are written by the thread in which frames are taken, one after the other; the
        # heartbeat's reads them, and may see a message counted whose number is not written yet.
        self._number = 0
        self.skipped = 0
        self._confirmed = 0
        self._confirmed_at = 0.0
        self.received = 0
        self.lost = 0
        self.failed = 0
        self.raised = 0
        self.wrong = 0
        self.last_error = ""
        self._records = LimitedLog(_log)
        self.latency = 0.0
        # Last: frames may come before this returns. Twice the window, since tries exceed it.
        self._end = transport.subscribe(key, 2 * _WINDOW, self._receive, f"uoarm-from-{name}")

    def handled(self) -> Handled:
        """Return how far it is, for the sending end."""
        return Handled(
            self._number, self.failed, self.last_error, self.lost, self.raised, self.wrong
        )

    def close(self) -> None:
        """Begin no other `take`; one under way finishes alone. Idempotent."""
        # Looked at before each frame: those that wait in the transport are not taken any more.
        self._closed = True
        self._end()

    def drain(self, number: int, timeout: float) -> bool:
        """Wait until the message of this number is handled; False when time ran out."""
        deadline = time.monotonic() + timeout
        # By looking: to notify would cost each message a lock, for a wait that comes once.
        pause = threading.Event()
        while self._number < number and time.monotonic() < deadline:
            pause.wait(_GLANCE_SECONDS)
        return self._number >= number

    def _receive(self, frame: Frame, header: bytes) -> None:
        if self._closed:
            return
        try:
            self._handle(frame, header)
        except BridgeError as error:
            _log.debug("%s ended with its link: %s", self._key, error)
            self.close()

    def _handle(self, frame: Frame, header: bytes) -> None:
        read = self._header(header)
        # Damaged, or sent once more by another client that received it.
        if read is None or read[0] <= self._number:
            self.failed += 1
            self.last_error = "a frame without a header of its own, or one that came before"
            return
        number, skipped, sent_at, writer, act = read
        before = self.raised, self.wrong
        # A gap in the numbers was lost on the link; what was skipped never had a number.
        self.lost += number - self._number - 1 + skipped - self.skipped
        self.skipped = skipped
        now = self._transport.clock() + self._transport.ahead()
        self.latency = max(0.0, (now - sent_at) / 1e9)
        if act is not None:
            act()
        else:
            self.received += 1
            # For what the component emits in this thread: before that leaves, the message counts as
            # taken (`Handling.answered`). Else a death between the two would have it both lost and
            # answered.
            HANDLING.counter, HANDLING.number = self._counter, self.received
            try:
                foreign(self._take, unpack(frame), *(writer,) if writer else ())
            except Exception as error:  # noqa: BLE001 - a consumer may raise anything
                self._fail(error)
            HANDLING.counter = None
            if self._counter is not None:
                self._counter.set(self.received)
        # After the call: a message counts as handled when its consumer is through with it, so a
        # death in between leaves it among those under way.
        self._number = number
        # The first of each kind at once: a component is degraded, or a producer looked at.
        after = self.raised, self.wrong
        self._confirm(
            at_once=any(count > 0 == old for old, count in zip(before, after, strict=True))
        )

    def _header(self, octets: bytes) -> tuple[int, int, int, str, Callable[[], None] | None] | None:
        """Return number, skipped and time of a frame, its writer, and what it does if no message.

        None where it is no header of a flow.
        """
        if len(octets) < _HEADER.size:
            return None
        kind, number, skipped, sent_at = _HEADER.unpack_from(octets)
        if kind != _IS_HEADER:
            return None
        if len(octets) == _HEADER.size:
            return number, skipped, sent_at, "", None
        match _plain(octets[_HEADER.size :]):
            case ["unreadable", str(why)]:
                return number, skipped, sent_at, "", partial(self._read, why)
            case [str(health), str(cause)]:
                return number, skipped, sent_at, "", partial(self._ended, FlowEnding(health, cause))
            case ["writer", str(writer), True]:
                return number, skipped, sent_at, writer, None
            case ["writer", str(writer), False]:
                return number, skipped, sent_at, "", partial(self._let_go, writer)
        return None

    def _fail(self, error: Exception) -> None:
        """Count a message; the manager has its own record, the traceback is only here."""
        self.failed += 1
        self.raised += is_raised(error)
        self.wrong += isinstance(error, MessageError)
        self.last_error = text_of(error)
        trace = None if isinstance(error, CommandRefusedError) else error
        self._records.write(logging.INFO, f"{self._name} raised {self.last_error}", trace)

    def _confirm(self, *, at_once: bool) -> None:
        """Send how far it is: every few messages or moments, and the first failure at once."""
        now = time.monotonic()
        few = self._number - self._confirmed < _CONFIRM_EACH
        if few and not at_once and now - self._confirmed_at < _CONFIRM_SECONDS:
            return
        self._confirmed, self._confirmed_at = self._number, now
        # Sums and no differences: where one is lost the next says it all, as does a heartbeat.
        header = msgpack.packb(astuple(self.handled()))
        self._transport.notify(f"{self._key}/handled", header)


def _plain(octets: bytes) -> object:
    """Return what msgpack holds, None where it holds nothing that can be read."""
    try:
        return msgpack.unpackb(octets)
    except (ValueError, TypeError, msgpack.UnpackException):
        return None
