"""The transport between a manager and a host that it started: connected sockets.

Nothing listens and nothing lies in a folder: the host inherits its end. Requests, answers and signs
of life have a socket and a thread of their own, so that they wait for no message and for no
consumer of one. A thread that sends writes by itself.

Of the flows, one thread reads and, as a rule, takes what it read by itself. Where a `take` lasts,
another thread reads on, and the one that is in it goes on as the thread of that flow: so no flow
waits long for another one, and no message for the wake-up of a second thread.
"""

from __future__ import annotations

import itertools
import logging
import socket
import threading
import time
from collections.abc import Callable
from contextlib import suppress
from queue import Empty, Queue, SimpleQueue
from typing import Any, final

from uoarm._host.transport.codec import Frame, pack
from uoarm._host.transport.frames import FrameReader, FrameWriter, LinkSockets, Received
from uoarm._host.transport.transport import (
    ANSWER_SECONDS,
    LinkLostError,
    Reply,
    Transport,
    answer_of,
    answer_to,
    read_answer,
)
from uoarm._raised import LimitedLog, Log, foreign, on_failure
from uoarm.errors import BridgeError, BridgeTimeoutError, FailureReason, UoarmError

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


_ASK, _ANSWER, _NOTIFY, _TOKEN = range(4)
_FULL_SECONDS = 0.2
_MUST_ARRIVE_SECONDS = 5.0


@final
class SocketTransport(Transport):
    """One end of connected sockets.

    Args:
        sockets: this end, which belongs to the transport from now on.
        name: for its threads.
    """

    def __init__(self, sockets: LinkSockets, name: str = "manager") -> None:
        self._records = LimitedLog(_log)
        super().__init__()
        self._reader = FrameReader(sockets.requests)
        self._writer = FrameWriter(sockets.requests)
        self._numbers = itertools.count(1)
        # Guards `_tokens` and `_watching` together, from the thread that reads against callers: a
        # token that comes as its watcher does is reported by one of them, and one that goes once.
        self._lock = threading.Lock()
        # The tables of waits are changed in single steps (set, pop), which need no lock: an answer
        # and the end of its wait may both take an entry, and only one gets it.
        self._asked: dict[int, Callable[[Frame | None], object]] = {}
        self._late: dict[int, float] = {}
        # Read without a lock by the thread that reads; entries come and go under it, or of two that
        # end at once, or an end and the next declaration of a key, one would undo the other.
        self._answering: dict[str, Callable[[Any, Reply], None]] = {}
        self._listening: dict[str, Callable[[bytes], None]] = {}
        self._tokens: set[str] = set()
        self._watching: dict[str, Callable[[bool], None]] = {}
        self._thread = threading.Thread(target=self._run, name=f"uoarm-link-{name}", daemon=True)
        with on_failure(self._writer.close):  # where the system gives no more threads
            self._flows = FrameFlows(sockets.incoming, sockets.outgoing, name, self._shut)
            with on_failure(self._flows.close):
                self._thread.start()

    def ask(self, key: str, request: Any, *, timeout: float = ANSWER_SECONDS) -> Any:
        """Send a request and return the answer."""
        answered: Queue[Frame | None] = Queue()
        deadline = time.monotonic() + timeout
        number = self._expect(answered.put)  # before it is sent: the answer may be faster
        try:
            self._write(_ASK, key, number, b"", pack(request), _MUST_ARRIVE_SECONDS)
            answer = answered.get(timeout=max(0.0, deadline - time.monotonic()))
        except Empty:
            raise BridgeTimeoutError(f"no answer at {key} within {timeout:g} s") from None
        finally:
            # What answers later finds no entry, and is dropped.
            self._asked.pop(number, None)
        if answer is None:
            raise _closed(f"asking {key}")
        return read_answer(answer, key)

    def ask_later(self, key: str, take: Callable[[Any], None], *, timeout: float) -> None:
        """Send a bare request, and have the answer handed to `take` in the transport's thread."""

        def hand(answer: Frame | None) -> None:
            self._late.pop(number, None)
            if answer is None:
                return
            try:
                value = read_answer(answer, key)
            except UoarmError as error:
                _log.debug("%s", error)
            else:
                take(value)

        now = time.monotonic()
        for old in [name for name, until in self._late.copy().items() if until < now]:
            self._late.pop(old, None)
            self._asked.pop(old, None)
        # Both before it is sent. Where that fails, the next such request forgets it in time.
        number = self._expect(hand)
        self._late[number] = now + timeout
        self._write(_ASK, key, number, b"", pack(None), _MUST_ARRIVE_SECONDS)

    def answer(self, key: str, take: Callable[[Any, Reply], None]) -> Callable[[], None]:
        """Have requests at a key handed to `take`, in the transport's thread."""
        with self._lock:
            self._answering[key] = take
        return lambda: self._end(self._answering, key, take)

    def publish(
        self, key: str, payload: bytes, header: bytes, *, must_arrive: bool = False
    ) -> None:
        """Send one frame."""
        try:
            limit = _MUST_ARRIVE_SECONDS if must_arrive else _FULL_SECONDS
            self._flows.write(key, header, payload, limit)
        # One that may be lost and found no room is counted at the other end, by the gap in the
        # numbers of its flow: to raise would count it twice.
        except BridgeTimeoutError:  # which is an OSError, too
            if must_arrive:
                raise
        except OSError as error:
            self._shut()
            raise _closed(f"sending to {key}") from error

    def subscribe(
        self, key: str, length: int, take: Callable[[Frame, bytes], object], name: str
    ) -> Callable[[], None]:
        """Have frames at a key handed to `take`, in the thread that read them where it is quick."""
        return self._flows.subscribe(key, length, take, name)

    def notify(self, key: str, header: bytes) -> None:
        """Send a header to who listens at a key."""
        self._write(_NOTIFY, key, 0, header, b"", _MUST_ARRIVE_SECONDS)

    def listen(self, key: str, take: Callable[[bytes], None]) -> Callable[[], None]:
        """Have headers that are sent to a key handed to `take`, in the transport's thread."""
        with self._lock:
            self._listening[key] = take
        return lambda: self._end(self._listening, key, take)

    def show_alive(self, key: str) -> None:
        """Declare a token that goes when this end dies."""
        self._write(_TOKEN, key, 0, b"", b"", _MUST_ARRIVE_SECONDS)

    def watch_alive(self, key: str, seen: Callable[[bool], None]) -> None:
        """Have the coming and going of a token reported; one that is there is reported at once."""
        with self._lock:
            self._watching[key] = seen
            is_there = key in self._tokens
        if is_there:  # outside of the lock, as below: what it calls is not known here
            seen(True)

    def close(self) -> None:
        """End everything of this end; at the other one its tokens are seen to go."""
        with self._lock:
            self._watching.clear()  # first: who closes the link wants no report of a death
        self._shut()
        if threading.current_thread() is not self._thread:
            self._thread.join(_JOIN_SECONDS)
        self._lose()  # also where the thread hangs in a `take` and was not waited for
        self._flows.close()
        self._writer.close()

    def _shut(self) -> None:
        """Have both ends know that no more is said."""
        self._writer.shut()
        self._flows.shut()

    def _end(self, table: dict[str, Any], key: str, kept: object) -> None:
        with self._lock:
            if table.get(key) is kept:  # else another one has its place
                del table[key]

    def _expect(self, take: Callable[[Frame | None], object]) -> int:
        number = next(self._numbers) & 0xFFFF_FFFF
        self._asked[number] = take
        return number

    def _write(
        self, kind: int, key: str, number: int, header: bytes, payload: bytes, seconds: float
    ) -> None:
        """Write a frame to the socket of requests, after what is left of the one before.

        Raises:
            BridgeTimeoutError: the link was full for so long, and none of it was written.
            LinkLostError: the link is closed.
        """
        if threading.current_thread() is self._thread:
            seconds = _FULL_SECONDS  # it must go on reading, or both ends might wait for each other
        self._flows.write_on()  # no other thread may come to write there for long
        try:
            self._writer.write(kind, key, number, header, payload, seconds)
        except BridgeTimeoutError:  # which is an OSError, too
            raise
        except OSError as error:
            self._shut()
            raise _closed(f"sending to {key}") from error

    def _run(self) -> None:
        try:
            while (frame := self._reader.read()) is not None:
                try:
                    self._take(frame)
                except Exception as error:  # noqa: BLE001 - the thread must go on
                    text = "what came over the link could not be taken"
                    self._records.write(logging.ERROR, text, error)
        except Exception as error:  # noqa: BLE001 - such as no memory for a long frame
            _log.warning("a link ended: %s: %s", type(error).__name__, error)
        finally:
            # In this order: who begins to wait from here on fails as it writes, and `_lose` ends
            # the others.
            self._shut()
            self._lose()

    def _take(self, frame: Received) -> None:
        key = frame.key
        if frame.kind == _NOTIFY:
            listener = self._listening.get(key)
            if listener is not None:
                listener(frame.header)
        elif frame.kind == _ANSWER:
            take = self._asked.pop(frame.number, None)
            if take is not None:
                take(frame.payload)
        elif frame.kind == _ASK:
            self._answer(key, frame.number, frame.payload)
        elif frame.kind == _TOKEN:
            with self._lock:
                self._tokens.add(key)
                seen = self._watching.get(key)
            # Outside of the lock: what is called may ask, or close this, in the thread that reads.
            if seen is not None:
                seen(True)

    def _answer(self, key: str, number: int, request: Frame) -> None:
        # Maybe called later, by another thread: the number says to which request it belongs, in
        # whatever order answers come.
        def reply(value: Any) -> None:
            try:
                self._write(_ANSWER, "", number, b"", answer_of(value), _MUST_ARRIVE_SECONDS)
            except BridgeError as error:
                _log.debug("the answer at %s could not be sent: %s", key, error)

        take = self._answering.get(key)
        if take is None:
            reply(BridgeError(f"there is no answer at {key}", FailureReason.UNAVAILABLE))
        else:
            answer_to(take, request, reply)

    def _lose(self) -> None:
        """End every wait for the other end, which is gone. Idempotent."""
        with self._lock:
            # Looked at and cleared at once: the thread that reads and a `close` may both come here,
            # and each token goes once.
            gone = [seen for key, seen in self._watching.items() if key in self._tokens]
            self._tokens.clear()
        # Again and again: a caller may begin to wait as this goes on, before its write fails.
        while self._asked:
            with suppress(KeyError):  # it was answered, or given up, between the two looks
                self._asked.popitem()[1](None)
        for seen in gone:
            seen(False)


def _closed(step: str) -> LinkLostError:
    return LinkLostError(f"{step} failed: the link is closed")
