"""Frames over a connected socket: a head of fixed layout, a key, a header and a payload.

A frame that has begun to be written is always written to its end, if need be by the next
thread that writes.
"""

from __future__ import annotations

import socket
import struct
import threading
import time
from collections.abc import Sequence
from contextlib import ExitStack, suppress
from typing import NamedTuple

from attrs import frozen

from uoarm._forks import close_in_children
from uoarm._host.transport.codec import Frame
from uoarm.errors import BridgeError, BridgeTimeoutError, FailureReason

_HEAD = struct.Struct("<BBHIII")
"""What it is, nothing, the length of its key, its number, the lengths of header and payload."""
_READ_OCTETS = 2**16
_KERNEL_OCTETS = 2**20  # what the kernel may hold; on most machines it gives less
_JOINED_OCTETS = 2**14  # a short frame is written as one piece
_MOST_OCTETS = 2**30
_MOST_HEADER = 2**16
_CLAIMED_OCTETS = 2**24  # memory taken for what a frame says that it has; more when it has come
_STEP_MICROSECONDS = 20_000
_NO_SIGNAL = getattr(socket, "MSG_NOSIGNAL", 0)
_AT_ONCE = _NO_SIGNAL | getattr(socket, "MSG_DONTWAIT", 0)


class Received(NamedTuple):
    """One frame. `payload` is a bytearray where it is long; no one else holds it."""

    kind: int
    key: str
    number: int
    header: bytes
    payload: Frame


class FrameWriter:
    """Writes frames to a socket, from any thread.

    Args:
        connected: the socket, which another thread may read.
    """

    def __init__(self, connected: socket.socket) -> None:
        self._socket = connected
        for option in (socket.SO_SNDBUF, socket.SO_RCVBUF):
            with suppress(OSError):
                connected.setsockopt(socket.SOL_SOCKET, option, _KERNEL_OCTETS)
        # The kernel waits for room a short while, then we look at the time; reading has no limit.
        limit = struct.pack("ll", 0, _STEP_MICROSECONDS)  # a `struct timeval`
        connected.setsockopt(socket.SOL_SOCKET, socket.SO_SNDTIMEO, limit)
        # Guards the socket's outgoing side, `_rest` and `_is_torn`, from all threads that send: a
        # frame is never mixed with another. It is waited for within the time of the write only.
        self._writing = threading.Lock()
        # What the kernel has not taken of the frame before. Its sender has returned already, as the
        # frame will arrive; the next write begins with it, in any thread.
        self._rest = memoryview(b"")
        # Whether it is not known how much of a frame was written: nothing may follow it.
        self._is_torn = False

    def write(
        self,
        kind: int,
        key: str,
        number: int,
        header: bytes,
        payload: Frame,
        seconds: float,
    ) -> None:
        """Write a frame, after what is left of the one before.

        Args:
            kind: what it is, below 256.
            key: below 64 KiB.
            number: below 2**32.
            header: short.
            payload: 1 GiB at most.
            seconds: for which to wait for room.

        Raises:
            BridgeTimeoutError: there was no room, and none of it was written.
            BridgeError: REFUSED: it is too long.
            OSError: the socket is closed, at either end.
        """
        if len(payload) > _MOST_OCTETS:
            text = f"{key}: a message of {len(payload):,} octets is longer than {_MOST_OCTETS:,}"
            raise BridgeError(text, FailureReason.REFUSED)
        name = key.encode()
        start = _HEAD.pack(kind, 0, len(name), number, len(header), len(payload)) + name + header
        deadline = time.monotonic() + seconds
        if not self._writing.acquire(timeout=seconds):
            raise _full(key, seconds)
        try:
            # An exception of a signal's handler ended a write midway: the other end could not see
            # where the next frame begins, so the link ends.
            if self._is_torn:
                self.shut()
                raise OSError("a write was interrupted")
            self._is_torn = True  # until it is known what is left: a signal's handler may raise
            # Time may run out only before a frame is begun: then none of it was written, and its
            # sender may count it as not sent. One that was begun is sent, whenever its end follows.
            has_begun = self._write_rest(deadline) and self._begin(start, payload, deadline)
            if has_begun:
                self._write_rest(deadline)
            self._is_torn = False
        finally:
            self._writing.release()
        if not has_begun:
            raise _full(key, seconds)

    def write_on(self) -> None:
        """Write of a frame that was begun what the kernel takes now. Does not wait."""
        # Looked at without the lock: what is written now is another thread's to finish.
        if not self._rest or not self._writing.acquire(blocking=False):
            return
        try:
            if self._rest and not self._is_torn:
                self._is_torn = True
                with suppress(
                    OSError
                ):  # there is no room, or the reader of the link reports its end
                    self._rest = self._rest[self._socket.send(self._rest, _AT_ONCE) :]
                self._is_torn = False
        finally:
            self._writing.release()

    def shut(self) -> None:
        """Have both ends know that no more is said."""
        with suppress(OSError):  # it is closed, or the other end is
            self._socket.shutdown(socket.SHUT_RDWR)

    def close(self) -> None:
        """Close the socket, which was shut: no thread waits in it."""
        # A write that a starved thread begins now must not reach who gets this descriptor next.
        with self._writing:
            self._is_torn = True
            self._socket.close()

    def _begin(self, start: bytes, payload: Frame, deadline: float) -> bool:
        """Write what the kernel takes of a frame, and keep the rest; False: it takes none."""
        is_short = len(payload) < _JOINED_OCTETS
        while True:
            try:
                if is_short:
                    written = self._socket.send(start + payload, _NO_SIGNAL)
                else:
                    written = self._socket.sendmsg((start, payload), (), _NO_SIGNAL)
                break
            except BlockingIOError:
                if time.monotonic() >= deadline:
                    return False
        if written < len(start) + len(payload):
            # The rest keeps the payload, which its sender does not change any more, without a copy.
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
        return True


def _full(key: str, seconds: float) -> BridgeTimeoutError:
    return BridgeTimeoutError(f"sending to {key}: the link has been full for {seconds:g} s")


class FrameReader:
    """Cuts what a socket gives into frames: few calls for many short ones, no copy of long ones.

    Args:
        connected: the socket, which one thread reads.
    """

    def __init__(self, connected: socket.socket) -> None:
        self._socket = connected
        # One thread reads, so nothing here is locked. Which one that is may change between two
        # frames (`frame_flows`), and all that is left over stands in the buffer.
        self._buffer = bytearray(_READ_OCTETS)
        self._view = memoryview(self._buffer)
        self._start = self._end = 0

    def read(self) -> Received | None:
        """Return the next frame; None at the end. Waits for it without a limit.

        Raises:
            OSError: the link broke.
            ValueError: what came is no frame.
        """
        if not self._have(_HEAD.size):
            return None
        kind, _, key_length, number, header_length, length = _HEAD.unpack_from(
            self._buffer, self._start
        )
        # Before any memory is taken for what the frame claims.
        if length > _MOST_OCTETS or header_length > _MOST_HEADER:
            text = f"a frame says that it is {length:,} octets long, its header {header_length:,}"
            raise ValueError(text)
        self._start += _HEAD.size
        names = self._take(key_length + header_length)
        payload = self._take(length)
        if names is None or payload is None:
            return None
        key, header = str(names[:key_length], "utf-8"), bytes(names[key_length:])
        return Received(kind, key, number, header, payload)

    def _take(self, length: int) -> Frame | None:
        """Return so many octets; long ones as a bytearray, which no one else holds."""
        if length <= _READ_OCTETS:
            if not self._have(length):
                return None
            begin = self._start
            self._start += length
            return bytes(self._view[begin : self._start])
        taken = bytearray(min(length, _CLAIMED_OCTETS))
        got = self._end - self._start
        taken[:got] = self._view[self._start : self._end]
        self._start = self._end
        while got < length:
            # Grown by what has come, twofold at most: a claim alone takes no memory.
            if got == len(taken):
                taken.extend(bytes(min(got, length - got)))
            with memoryview(taken) as whole, whole[got:] as rest:
                count = self._socket.recv_into(rest, len(rest), socket.MSG_WAITALL)
            if not count:
                return None
            got += count
        return taken

    def _have(self, length: int) -> bool:
        """Read until so many octets, 64 KiB at most, are there; False at the end."""
        if self._end - self._start >= length:
            return True
        if self._start == self._end:
            self._start = self._end = 0
        # What is left is moved only where the buffer would end before the octets do.
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


@frozen
class LinkSockets:
    """One end of three connected pairs.

    Messages have a pair for each way: where an end reads and writes the same socket, its reading
    thread, which sleeps at it, is woken by the kernel whenever the other end takes what it wrote.

    Attributes:
        requests: read and written by both ends.
        incoming: only read here.
        outgoing: only written here.
    """

    requests: socket.socket
    incoming: socket.socket
    outgoing: socket.socket

    def __attrs_post_init__(self) -> None:
        """Take away the time limit that an application may have set for all new sockets."""
        for item in (self.requests, self.incoming, self.outgoing):
            item.settimeout(None)

    @classmethod
    def make(cls) -> tuple[LinkSockets, LinkSockets]:
        """Return both ends of a link.

        Raises:
            OSError: there are no descriptors left.
        """
        with ExitStack() as made:
            (asks, answers), (here, there), (from_here, to_there) = (_pair(made) for _ in range(3))
            made.pop_all()  # all three pairs are there: from now on their owners close them
        # Else a child that is forked here would hold this end open, and the host not see its
        # manager die.
        close_in_children(asks, here, from_here)
        return cls(asks, here, from_here), cls(answers, to_there, there)

    @classmethod
    def inherited(cls, descriptors: Sequence[int]) -> LinkSockets:
        """Return the end whose `descriptors` a process has inherited."""
        requests, incoming, outgoing = (
            socket.socket(fileno=descriptor) for descriptor in descriptors
        )
        close_in_children(requests, incoming, outgoing)
        return cls(requests, incoming, outgoing)

    @property
    def descriptors(self) -> tuple[int, int, int]:
        """What another process inherits of this end."""
        return self.requests.fileno(), self.incoming.fileno(), self.outgoing.fileno()

    def close(self) -> None:
        """Close all three. Idempotent."""
        for item in (self.requests, self.incoming, self.outgoing):
            item.close()


def _pair(made: ExitStack) -> tuple[socket.socket, socket.socket]:
    one, other = socket.socketpair()
    made.callback(one.close)
    made.callback(other.close)
    return one, other
