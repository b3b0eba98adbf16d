"""The transport between a manager and a host that it started: two connected sockets.

Nothing listens and nothing lies in a folder: the host inherits its end. One thread at either end
reads, and hands on what it read; whoever sends writes by itself.

A frame is a head of fixed layout, a key, a header and a payload. One that has begun to be written
is always written to its end, if need be by whoever writes next.
"""

from __future__ import annotations

import itertools
import logging
import socket
import struct
import threading
import time
from collections.abc import Callable
from contextlib import suppress
from queue import Empty, SimpleQueue
from typing import Any, final

from uoarm._host.transport.codec import Frame, pack
from uoarm._host.transport.transport import (
    ANSWER_SECONDS,
    Reply,
    Transport,
    answer_of,
    answer_to,
    read_answer,
)
from uoarm.errors import BridgeError, BridgeTimeoutError, FailureReason, UoarmError

__all__ = ["SocketTransport"]

_HEAD = struct.Struct("<BBHIII")
"""What it is, nothing, the length of its key, its number, the lengths of header and payload."""
_ASK, _ANSWER, _PUBLISH, _TOKEN = range(4)
_READ_OCTETS = 2**16
_KERNEL_OCTETS = 2**20  # what the kernel may hold; on most machines it gives less
_JOINED_OCTETS = 2**14  # a short frame is written as one piece
_MOST_OCTETS = 2**30
_FULL_SECONDS = 0.2
_MUST_ARRIVE_SECONDS = 5.0
_STEP_MICROSECONDS = 20_000
_JOIN_SECONDS = 2.0
_NO_SIGNAL = getattr(socket, "MSG_NOSIGNAL", 0)
_log = logging.getLogger("uoarm")


@final
class SocketTransport(Transport):
    """One end of a pair of connected sockets.

    Args:
        connected: this end, which belongs to the transport from now on.
        name: for its thread.
    """

    def __init__(self, connected: socket.socket, name: str = "manager") -> None:
        super().__init__()
        self._socket = connected
        for option in (socket.SO_SNDBUF, socket.SO_RCVBUF):
            with suppress(OSError):
                connected.setsockopt(socket.SOL_SOCKET, option, _KERNEL_OCTETS)
        _limit_writing(connected)
        self._writing = threading.Lock()
        self._rest = memoryview(b"")
        self._is_torn = False
        self._numbers = itertools.count(1)
        self._lock = threading.Lock()
        self._is_lost = False
        self._asked: dict[int, Callable[[Frame | None], object]] = {}
        self._late: dict[int, float] = {}
        self._answering: dict[str, Callable[[Any, Reply], None]] = {}
        self._frames: dict[str, _Ring] = {}
        self._listening: dict[str, Callable[[bytes], None]] = {}
        self._tokens: set[str] = set()
        self._watching: dict[str, Callable[[bool], None]] = {}
        self._reader = threading.Thread(target=self._run, name=f"uoarm-link-{name}", daemon=True)
        self._reader.start()

    def ask(self, key: str, request: Any, *, timeout: float = ANSWER_SECONDS) -> Any:
        """Send a request and return the answer."""
        answered: SimpleQueue[Frame | None] = SimpleQueue()
        deadline = time.monotonic() + timeout
        number = self._expect(answered.put)
        try:
            self._write(_ASK, key, number, b"", pack(request), _MUST_ARRIVE_SECONDS)
            answer = answered.get(timeout=max(0.0, deadline - time.monotonic()))
        except Empty:
            raise BridgeTimeoutError(f"no answer at {key} within {timeout:g} s") from None
        finally:
            self._asked.pop(number, None)
        if answer is None:
            raise _closed(f"asking {key}")
        return read_answer(answer, key)

    def ask_later(
        self, key: str, request: Any, take: Callable[[Any], None], *, timeout: float
    ) -> None:
        """Send a request, and have the answer handed to `take` in the transport's thread."""

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
        for old in [one for one, until in self._late.copy().items() if until < now]:
            self._late.pop(old, None)
            self._asked.pop(old, None)
        number = self._expect(hand)
        self._late[number] = now + timeout
        self._write(_ASK, key, number, b"", pack(request), _MUST_ARRIVE_SECONDS)

    def answer(self, key: str, take: Callable[[Any, Reply], None]) -> Callable[[], None]:
        """Have requests at a key handed to `take`, in the transport's thread."""
        self._answering[key] = take
        return lambda: self._end(self._answering, key, take)

    def publish(
        self, key: str, payload: bytes, header: bytes, *, must_arrive: bool = False
    ) -> None:
        """Send one frame."""
        try:
            limit = _MUST_ARRIVE_SECONDS if must_arrive else _FULL_SECONDS
            self._write(_PUBLISH, key, 0, header, payload, limit)
        except BridgeTimeoutError:
            if must_arrive:
                raise

    def subscribe(
        self, key: str, length: int
    ) -> tuple[Callable[[], tuple[Frame, bytes] | None], Callable[[], None]]:
        """Return a function that waits for the next frame, and one that ends the subscription."""
        ring = self._frames[key] = _Ring(length)

        def end() -> None:
            self._end(self._frames, key, ring)
            ring.end()

        return ring.get, end

    def listen(self, key: str, take: Callable[[bytes], None]) -> Callable[[], None]:
        """Have the headers of frames at a key handed to `take`, in the transport's thread."""
        self._listening[key] = take
        return lambda: self._end(self._listening, key, take)

    def show_alive(self, key: str) -> None:
        """Declare a token that goes when this end dies."""
        self._write(_TOKEN, key, 0, b"", b"", _MUST_ARRIVE_SECONDS)

    def watch_alive(self, key: str, seen: Callable[[bool], None]) -> None:
        """Have the coming and going of a token told; one that is there is told at once."""
        with self._lock:
            self._watching[key] = seen
            is_there = key in self._tokens
        if is_there:
            seen(True)

    def close(self) -> None:
        """End everything of this end; the other one is told that its tokens have gone."""
        with self._lock:
            self._watching.clear()
        self._shut()
        if threading.current_thread() is not self._reader:
            self._reader.join(_JOIN_SECONDS)
        self._lose()
        for ring in list(self._frames.values()):
            ring.end()
        # A write that a starved thread begins now must not reach who gets this descriptor next.
        with self._writing:
            self._socket.close()

    def _shut(self) -> None:
        """Have both ends know that no more is said."""
        with suppress(OSError):  # it is closed, or the other end is
            self._socket.shutdown(socket.SHUT_RDWR)

    @staticmethod
    def _end(table: dict[str, Any], key: str, kept: object) -> None:
        if table.get(key) is kept:
            del table[key]

    def _expect(self, take: Callable[[Frame | None], object]) -> int:
        number = next(self._numbers) & 0xFFFF_FFFF
        self._asked[number] = take
        return number

    def _write(
        self, kind: int, key: str, number: int, header: bytes, payload: bytes, seconds: float
    ) -> None:
        """Write a frame, after what is left of the one before.

        Raises:
            BridgeTimeoutError: the link was full for so long, and none of it was written.
            BridgeError: the link is closed.
        """
        name = key.encode()
        head = _HEAD.pack(kind, 0, len(name), number, len(header), len(payload))
        if len(payload) > _MOST_OCTETS:
            text = f"{key}: a message of {len(payload):,} octets is longer than {_MOST_OCTETS:,}"
            raise BridgeError(text, FailureReason.REFUSED)
        start = b"".join((head, name, header))
        if threading.current_thread() is self._reader:
            seconds = _FULL_SECONDS  # it must go on reading, or both ends might wait for each other
        deadline = time.monotonic() + seconds
        full = BridgeTimeoutError(f"sending to {key}: the link has been full for {seconds:g} s")
        if not self._writing.acquire(timeout=seconds):
            raise full
        try:
            if self._is_lost or self._is_torn:
                raise OSError  # noqa: TRY301 - as where the kernel says so
            self._is_torn = True  # until it is known what is left: a signal's handler may raise
            has_begun = self._write_rest(deadline) and self._begin(start, payload, deadline)
            if has_begun:
                self._write_rest(deadline)
            self._is_torn = False
        except OSError as error:
            self._shut()
            raise _closed(f"sending to {key}") from error
        finally:
            self._writing.release()
        if not has_begun:
            raise full

    def _begin(self, start: bytes, payload: bytes, deadline: float) -> bool:
        """Write what the kernel takes of a frame, and keep the rest; False: it takes none."""
        is_short = len(payload) < _JOINED_OCTETS
        pieces = (start + payload,) if is_short else (start, payload)
        while True:
            try:
                written = self._socket.sendmsg(pieces, (), _NO_SIGNAL)
                break
            except BlockingIOError:
                if time.monotonic() >= deadline:
                    return False
        if written < len(start) + len(payload):
            whole = start + payload if written < len(start) else payload
            gone = written if written < len(start) else written - len(start)
            self._rest = memoryview(whole)[gone:]
        return True

    def _write_rest(self, deadline: float) -> bool:
        """Write on at what was begun; False when time ran out before its end."""
        while self._rest:
            try:
                self._rest = self._rest[self._socket.send(self._rest, _NO_SIGNAL) :]
            except BlockingIOError:
                if time.monotonic() >= deadline:
                    return False
        self._rest = memoryview(b"")
        return True

    def _run(self) -> None:
        reader = _FrameReader(self._socket)
        try:
            while (frame := reader.read()) is not None:
                try:
                    self._take(*frame)
                except Exception:  # noqa: BLE001 - the thread must go on
                    _log.exception("what came over the link could not be taken")
        except Exception as error:  # noqa: BLE001 - such as no memory for a long one
            _log.warning("a link ended: %s: %s", type(error).__name__, error)
        finally:
            self._shut()
            self._lose()

    def _take(self, kind: int, key: str, number: int, header: bytes, payload: Frame) -> None:
        if kind == _PUBLISH:
            ring = self._frames.get(key)
            if ring is not None:
                ring.put((payload, header))
                return
            listener = self._listening.get(key)
            if listener is not None:
                listener(header)
        elif kind == _ANSWER:
            take = self._asked.pop(number, None)
            if take is not None:
                take(payload)
        elif kind == _ASK:
            self._answer(key, number, payload)
        elif kind == _TOKEN:
            with self._lock:
                self._tokens.add(key)
                seen = self._watching.get(key)
            if seen is not None:
                seen(True)

    def _answer(self, key: str, number: int, request: Frame) -> None:
        def reply(value: Any) -> None:
            try:
                self._write(_ANSWER, "", number, b"", answer_of(value), _MUST_ARRIVE_SECONDS)
            except BridgeError as error:
                _log.debug("the answer at %s reached nobody: %s", key, error)

        take = self._answering.get(key)
        if take is None:
            reply(BridgeError(f"nobody answers at {key}", FailureReason.UNAVAILABLE))
        else:
            answer_to(take, request, reply)

    def _lose(self) -> None:
        """Have whoever waits for the other end know that it is gone. Idempotent."""
        with self._lock:
            self._is_lost = True
            gone = [seen for key, seen in self._watching.items() if key in self._tokens]
            self._tokens.clear()
        while self._asked:
            with suppress(KeyError):
                self._asked.popitem()[1](None)
        for seen in gone:
            seen(False)


class _Ring:
    """The newest frames of a subscription, from the thread that reads to the one that takes."""

    def __init__(self, length: int) -> None:
        self._length = length
        self._frames: SimpleQueue[tuple[Frame, bytes] | None] = SimpleQueue()
        self.get = self._frames.get

    def put(self, frame: tuple[Frame, bytes]) -> None:
        if self._frames.qsize() >= self._length:
            with suppress(Empty):
                self._frames.get_nowait()
        self._frames.put(frame)

    def end(self) -> None:
        self._frames.put(None)


class _FrameReader:
    """Cuts what a socket gives into frames: few calls for many short ones, no copy of long ones."""

    def __init__(self, connected: socket.socket) -> None:
        self._socket = connected
        self._buffer = bytearray(_READ_OCTETS)
        self._view = memoryview(self._buffer)
        self._start = self._end = 0

    def read(self) -> tuple[int, str, int, bytes, Frame] | None:
        """Return kind, key, number, header and payload of the next frame; None at the end.

        Raises:
            OSError: the link broke.
            ValueError: what came is no frame.
        """
        if not self._have(_HEAD.size):
            return None
        kind, _, key_length, number, header_length, length = _HEAD.unpack_from(
            self._buffer, self._start
        )
        if length > _MOST_OCTETS:
            raise ValueError(f"a frame says that it is {length:,} octets long")
        self._start += _HEAD.size
        names = self._take(key_length + header_length)
        payload = self._take(length)
        if names is None or payload is None:
            return None
        return kind, str(names[:key_length], "utf-8"), number, bytes(names[key_length:]), payload

    def _take(self, length: int) -> Frame | None:
        """Return so many octets; long ones as a bytearray, which nobody else holds."""
        if length <= _READ_OCTETS:
            if not self._have(length):
                return None
            begin = self._start
            self._start += length
            return bytes(self._view[begin : self._start])
        taken = bytearray(length)
        got = self._end - self._start
        taken[:got] = self._view[self._start : self._end]
        self._start = self._end
        rest = memoryview(taken)[got:]
        while rest:
            count = self._socket.recv_into(rest, len(rest), socket.MSG_WAITALL)
            if not count:
                return None
            rest = rest[count:]
        return taken

    def _have(self, length: int) -> bool:
        """Read until so many octets, 64 KiB at most, are there; False at the end."""
        if self._end - self._start >= length:
            return True
        if self._start == self._end:
            self._start = self._end = 0
        elif self._start + length > _READ_OCTETS:
            left = bytes(self._view[self._start : self._end])
            self._start, self._end = 0, len(left)
            self._view[: self._end] = left
        while self._end - self._start < length:
            count = self._socket.recv_into(self._view[self._end :])
            if not count:
                return False
            self._end += count
        return True


def _limit_writing(connected: socket.socket) -> None:
    """Have the kernel wait for room a short while, then ask again; reading has no limit."""
    limit = struct.pack("ll", 0, _STEP_MICROSECONDS)  # a `struct timeval`
    connected.setsockopt(socket.SOL_SOCKET, socket.SO_SNDTIMEO, limit)


def _closed(step: str) -> BridgeError:
    return BridgeError(f"{step} failed: the link is closed", FailureReason.UNAVAILABLE)
