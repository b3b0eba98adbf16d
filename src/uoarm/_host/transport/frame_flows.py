"""The frames of all flows of a link, over a socket for each way: who writes and who takes them.

One thread reads and, as a rule, takes what it read by itself. Where a `take` lasts, another thread
reads on, and the one that is in it goes on as the thread of that flow: so no flow waits long for
another one, and no message for the wake-up of a second thread.
"""

from __future__ import annotations

import logging
import socket
import threading
import time
from collections.abc import Callable
from contextlib import suppress
from queue import Empty, SimpleQueue

from uoarm._host.transport.codec import Frame
from uoarm._host.transport.frames import FrameReader, FrameWriter, Received
from uoarm._raised import LimitedLog, Log, foreign, on_failure
from uoarm.errors import BridgeTimeoutError

Take = Callable[[Frame, bytes], object]
"""Takes the payload and the header of one frame."""

_QUICK_SECONDS = 0.001
_FAST_OCTETS = 2**16  # as much more takes long to decode
_CREDIT = 150
_COST = 50  # of one that was not quick: three in a row, or more than two in a hundred, are too many
_RETURN = 100
_FRAME = 0
_SHORT_OCTETS = 2**14  # as much is written whole or not at all
_STUCK_SECONDS = 0.02
_LOOK_SECONDS = 0.02
_IDLE_LOOKS = 50  # then it sleeps until there is something to look at
_JOIN_SECONDS = 2.0
_log = Log("uoarm")


class FlowSubscription:
    """Frames of one key, each handed to `take` after the one before.

    `begin` and `run_here` are for the thread that reads, and `hand_over` for who takes its place.

    Args:
        take: may block; what it raises is logged.
        length: how many frames may wait; the oldest are lost first.
        name: for its thread.
    """

    def __init__(self, take: Take, length: int, name: str) -> None:
        self._records = LimitedLog(_log)
        self._consume = take
        self._length = length
        self._name = name
        self._waiting: SimpleQueue[tuple[Frame, bytes] | None] = SimpleQueue()
        # Guards `_has_thread`, `_ended` and the order of `_waiting`: from the thread that reads
        # against that of the flow. Without it a frame could be put behind the last look of a thread
        # that gives the taking back, or be taken by both.
        self._lock = threading.Lock()
        self._has_thread = False
        self._ended = False
        # Written by the thread whose turn it is; `hand_over` only takes it away, which may be lost.
        self._credit = _CREDIT

    def begin(self, payload: Frame, header: bytes) -> bool:
        """Say whether the thread that read a frame is to take it; else it waits for another."""
        with self._lock:
            if self._ended:
                return False
            if not self._has_thread:
                if self._credit > 0 and len(payload) <= _FAST_OCTETS:
                    return True
                try:
                    threading.Thread(target=self.run_here, name=self._name, daemon=True).start()
                except RuntimeError:  # there are too many
                    return True
                self._has_thread = True
            # The reader of the queue may be faster, which is as good: there is room then.
            if self._waiting.qsize() >= self._length:
                with suppress(Empty):
                    self._waiting.get_nowait()
            self._waiting.put((payload, header))
        return False

    def take(self, payload: Frame, header: bytes) -> None:
        """Have one frame taken, by the thread whose turn it is, and learn how long that takes."""
        begun = time.monotonic()
        try:
            foreign(self._consume, payload, header)
        except Exception as error:  # noqa: BLE001 - the thread must go on
            self._records.write(logging.ERROR, "what came over the link could not be taken", error)
        if len(payload) <= _FAST_OCTETS and time.monotonic() - begun < _QUICK_SECONDS:
            self._credit = min(_CREDIT, self._credit + 1)
        else:
            self._credit = max(0, self._credit - _COST)

    def hand_over(self) -> None:
        """Have all that comes from now on wait for the thread that takes a frame now."""
        with self._lock:
            self._has_thread = True
            self._credit = 0

    def run_here(self) -> None:
        """Take what waits, in this thread, until the end, or until all is taken quickly again."""
        while (frame := self._waiting.get()) is not None and not self._ended:
            self.take(*frame)
            if self._credit >= _RETURN and self._return():
                return

    def end(self) -> None:
        """Begin no other `take`; one under way finishes alone. Idempotent."""
        with self._lock:
            self._ended = True
            self._waiting.put(None)  # wakes the flow's thread, where there is one

    def _return(self) -> bool:
        """Give the taking back to the thread that reads, unless more waits."""
        with self._lock:
            # With the lock, in which `begin` puts: what comes after this look finds no thread, and
            # is taken by the one that reads, behind all that this one took.
            if not self._waiting.empty():
                return False
            self._has_thread = False
            return True


class FrameFlows:
    """One end of the flows. All methods may be called from any thread.

    Args:
        incoming: the socket that is read here, and nowhere else.
        outgoing: the socket that is written.
        name: for its threads.
        ended: called when no more comes, in the thread that read.
    """

    def __init__(
        self,
        incoming: socket.socket,
        outgoing: socket.socket,
        name: str,
        ended: Callable[[], object],
    ) -> None:
        self._incoming = incoming
        self._reader = FrameReader(incoming)
        self._writer = FrameWriter(outgoing)
        self._name = name
        self._on_end = ended
        self._subscriptions: dict[str, FlowSubscription] = {}
        # Guards who reads: `_taking`, `_taken` and `_reading`, from the thread that reads against
        # the one that watches it, one that writes in a `take`, and `close`. So exactly one thread
        # reads.
        self._lock = threading.Lock()
        self._taking: FlowSubscription | None = None  # what the thread that reads takes just now
        self._taken = 0  # how often it has begun to take something
        self._is_watched = threading.Event()
        self._closing = threading.Event()
        self._reading = self._watching = threading.Thread(
            target=self._watch, name=f"uoarm-watch-{name}", daemon=True
        )
        with on_failure(self.close):
            self._watching.start()
            with self._lock:  # the new thread waits for it, so `_reading` is set before it reads
                self._reading = self._start_reading()

    def write(self, key: str, header: bytes, payload: Frame, seconds: float) -> None:
        """Write a frame, after what is left of the one before.

        Raises:
            BridgeTimeoutError: the link was full for so long, and none of it was written.
            BridgeError: REFUSED: it is too long.
            OSError: the link is closed.
        """
        if threading.get_ident() == self._reading.ident:
            # While it waits no thread reads; if the other end does the same, neither wait ends.
            if len(payload) <= _SHORT_OCTETS:
                with suppress(BridgeTimeoutError):
                    self._writer.write(
                        _FRAME, key, 0, header, payload, min(_STUCK_SECONDS, seconds)
                    )
                    return
            self._read_elsewhere()
        self._writer.write(_FRAME, key, 0, header, payload, seconds)

    def write_on(self) -> None:
        """Write of a frame that was begun what the kernel takes now. Does not wait."""
        self._writer.write_on()

    def subscribe(self, key: str, length: int, take: Take, name: str) -> Callable[[], None]:
        """Have the frames at a key taken; returns what ends it."""
        kept = self._subscriptions[key] = FlowSubscription(take, length, name)

        def end() -> None:
            # A later subscription of the key may have its place, and goes on.
            if self._subscriptions.get(key) is kept:
                del self._subscriptions[key]
            kept.end()

        return end

    def shut(self) -> None:
        """Have both ends know that no more is said."""
        self._writer.shut()
        with suppress(OSError):  # it is closed, or the other end is
            self._incoming.shutdown(socket.SHUT_RDWR)

    def close(self) -> None:
        """End every subscription and close the sockets; a `take` that hangs finishes alone."""
        self.shut()
        with self._lock:
            self._closing.set()
            self._is_watched.set()  # or the thread that watches would sleep on
            # One that is in a `take` is not waited for: that may hang.
            reading = None if self._taking is not None else self._reading
        for thread in (reading, self._watching):
            # One without a number never began: the system gave no more threads.
            if thread is not None and thread.ident not in {None, threading.get_ident()}:
                thread.join(_JOIN_SECONDS)
        for subscription in list(self._subscriptions.values()):
            subscription.end()
        # After the thread that reads: a descriptor that is closed under it may be given out anew.
        self._writer.close()
        self._incoming.close()

    def _start_reading(self) -> threading.Thread:
        """Start a thread that reads once this one lets go of the lock, which it has."""
        thread = threading.Thread(target=self._read, name=f"uoarm-flows-{self._name}", daemon=True)
        thread.start()
        return thread

    def _read(self) -> None:
        """Read, and take what is read, until the end, or until another thread reads on."""
        with self._lock:  # until it is written down that this is the thread that reads
            pass
        try:
            while (frame := self._reader.read()) is not None:
                instead = self._take(frame)
                del frame  # or it would be kept until the next one comes
                if instead is not None:
                    instead.run_here()
                    return
        except Exception as error:  # noqa: BLE001 - such as no memory for a long frame
            if not self._closing.is_set():
                _log.warning("a link ended: %s: %s", type(error).__name__, error)
        # Once: a thread that goes on as that of a flow has returned above, and the last that reads
        # is here.
        self._on_end()

    def _take(self, frame: Received) -> FlowSubscription | None:
        """Have a frame taken; return whose thread this one is now, None where it is to read on."""
        # Without a lock: the table changes in single steps. A frame of a key that just ended is
        # dropped.
        subscription = self._subscriptions.get(frame.key)
        if subscription is None or not subscription.begin(frame.payload, frame.header):
            return None
        with self._lock:
            self._taking = subscription
            self._taken += 1
        # After `_taken` is counted: `_watch` clears first and looks at the count then, so one of
        # the two sees the other.
        if not self._is_watched.is_set():
            self._is_watched.set()
        subscription.take(frame.payload, frame.header)
        with self._lock:
            # Another thread reads on already: this one is that of the flow from now on.
            if self._taking is not subscription:
                return subscription
            self._taking = None
        return None

    def _read_elsewhere(self, taken: int | None = None) -> None:
        """Have another thread read on, while the one that reads is in a `take`.

        Args:
            taken: nothing is done unless it is the `take` of this number.
        """
        with self._lock:
            if self._taking is None or self._closing.is_set() or taken not in (None, self._taken):
                return
            try:
                self._reading = self._start_reading()
            except RuntimeError:  # there are too many threads
                return
            # Before the new thread can read, which waits for this lock: what it reads of this flow
            # then queues behind the frame that is being taken.
            self._taking.hand_over()
            self._taking = None

    def _watch(self) -> None:
        """Look whether the thread that reads is in the same `take` as at the last look."""
        while self._is_watched.wait() and not self._closing.is_set():
            idle, before = 0, self._taken
            while idle < _IDLE_LOOKS and not self._closing.wait(_LOOK_SECONDS):
                now = self._taken
                if now == before:
                    idle += 1
                    self._read_elsewhere(now)
                else:
                    idle, before = 0, now
            self._is_watched.clear()
            if self._taken != before or self._closing.is_set():  # it began before it was cleared
                self._is_watched.set()
