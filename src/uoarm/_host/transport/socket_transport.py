"""The transport between a manager and a host that it started: connected sockets.

Nothing listens and nothing lies in a folder: the host inherits its end. Requests, answers and signs
of life have a socket and a thread of their own, so that they wait for no message and for no
consumer of one. A thread that sends writes by itself.
"""

from __future__ import annotations

import itertools
import logging
import threading
import time
from collections.abc import Callable
from contextlib import suppress
from queue import Empty, Queue
from typing import Any, final

from uoarm._host.transport.codec import Frame, pack
from uoarm._host.transport.frame_flows import FrameFlows
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
from uoarm._raised import LimitedLog, Log, on_failure
from uoarm.errors import BridgeError, BridgeTimeoutError, FailureReason, UoarmError

_ASK, _ANSWER, _NOTIFY, _TOKEN = range(4)
_FULL_SECONDS = 0.2
_MUST_ARRIVE_SECONDS = 5.0
_JOIN_SECONDS = 2.0
_log = Log("uoarm")


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
