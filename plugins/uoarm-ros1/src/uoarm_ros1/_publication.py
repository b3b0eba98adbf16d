"""A topic that the node publishes: subscribers, and what waits for each of them."""

from __future__ import annotations

import fcntl
import socket
import struct
import termios
import threading
import time
from collections import deque
from collections.abc import Callable, Mapping
from contextlib import suppress

from attrs import define, field

from uoarm_ros1._definitions import RosRecord
from uoarm_ros1._server import Handler, SocketLoop
from uoarm_ros1._tcpros import (
    encode_header,
    frames_of,
    publisher_header,
    subscriber_problem,
)

_CHUNK = 4096
_LOOK_SECONDS = 0.002


def keep_alive(connection: socket.socket) -> None:
    """Have the system notice within seconds that the machine at the other end is gone."""
    with suppress(OSError, AttributeError):
        connection.setsockopt(socket.SOL_SOCKET, socket.SO_KEEPALIVE, 1)
        connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_KEEPIDLE, 5)
        connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_KEEPINTVL, 2)
        connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_KEEPCNT, 3)
        connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_USER_TIMEOUT, 15_000)


class _Subscriber(Handler):
    """One connection to a subscriber.

    What the socket takes is written in the thread that sends; the loop writes the rest.
    """

    def __init__(
        self,
        connection: socket.socket,
        caller: str,
        loop: SocketLoop,
        limits: tuple[int, int],
        gone: Callable[[_Subscriber, str], None],
    ) -> None:
        super().__init__(connection)
        self.caller = caller
        self.lost = 0
        self._loop, self._gone = loop, gone
        self._most, self._most_octets = limits
        # Guards the queue, and that octets of two messages do not mix: between the threads that
        # send and the loop. What is done under it never blocks.
        self._lock = threading.Lock()
        self._waiting: deque[memoryview] = deque()
        self._octets = 0
        self._is_begun = False  # whether a part of the first that waits was written
        self._is_closed = False

    @property
    def waiting(self) -> int:
        """How many messages wait here."""
        return len(self._waiting)

    def is_drained(self) -> bool:
        """Whether the other machine has all that was sent."""
        if self._waiting:
            return False
        try:
            left = fcntl.ioctl(self.socket.fileno(), termios.TIOCOUTQ, struct.pack("i", 0))
        except (OSError, ValueError):
            return True  # closed, or no such question here
        return left == bytes(len(left))

    def send(self, run: bytes | bytearray) -> None:
        """Hand frames over; the oldest that wait are dropped where too many do."""
        with self._lock:
            if self._is_closed:
                return
            view, sent = memoryview(run), 0
            if not self._waiting:
                try:
                    sent = self.socket.send(view)
                except BlockingIOError:
                    sent = 0
                except OSError:
                    return  # the loop notices
                if sent == len(view):
                    return
                self._loop.write(self)
            for frame in frames_of(view):
                if sent < len(frame):
                    self._is_begun = self._is_begun or sent > 0
                    self._wait_for_room(frame[sent:])
                sent = max(0, sent - len(frame))

    def _wait_for_room(self, view: memoryview) -> None:
        self._waiting.append(view)
        self._octets += len(view)
        while len(self._waiting) > 1 and (
            len(self._waiting) > self._most or self._octets > self._most_octets
        ):
            if self._is_begun and len(self._waiting) <= 2:  # noqa: PLR2004 - that one, and this
                break
            # The first may be half written: then the second is the oldest.
            at = 1 if self._is_begun else 0
            self._octets -= len(self._waiting[at])
            del self._waiting[at]
            self.lost += 1

    def writable(self) -> bool:
        with self._lock, suppress(BlockingIOError):
            while self._waiting:
                view = self._waiting[0]
                sent = self.socket.send(view)
                self._octets -= sent
                if sent < len(view):
                    self._waiting[0] = view[sent:]
                    self._is_begun = True
                else:
                    self._waiting.popleft()
                    self._is_begun = False
        return bool(self._waiting)

    def readable(self) -> None:
        if not self.socket.recv(_CHUNK):
            raise ConnectionError(f"subscriber {self.caller} closed the connection")

    def failed(self, cause: str) -> None:
        self.end()
        self._gone(self, cause)

    def end(self) -> None:
        """Take nothing more."""
        with self._lock:
            self._is_closed = True
            self.lost += len(self._waiting)
            self._waiting.clear()


@define(eq=False)
class TopicPublication:
    """One topic, with one type.

    Args:
        caller: the node's own name.
        latch: how many of the last messages are given to each subscriber that comes.
        limits: messages, and octets, that may wait for one subscriber.

    Attributes:
        registered: how many subscribers the master knew as it was registered; None: not asked.
        watchers: called, in the loop's thread, with what has happened, and the node that was
            refused; empty: one has come or gone.
    """

    _loop: SocketLoop
    _caller: str
    topic: str
    record: RosRecord
    latch: int = field(default=0, kw_only=True)
    _limits: tuple[int, int] = field(default=(100, 1 << 26), kw_only=True)
    # Guards who is subscribed and what is latched: one who comes gets what was latched before,
    # or what is sent from then on, never neither.
    _changed: threading.Condition = field(factory=threading.Condition, init=False)
    _subscribers: tuple[_Subscriber, ...] = field(default=(), init=False)
    _latched: deque[bytes | bytearray] = field(factory=deque, init=False)
    _lost: int = field(default=0, init=False)
    sent: int = field(default=0, init=False)
    registered: int | None = field(default=None, init=False)
    watchers: tuple[Callable[[str, str], None], ...] = field(default=(), init=False)

    @property
    def callers(self) -> list[str]:
        """The names of the nodes that are connected, once for each connection."""
        return [subscriber.caller for subscriber in self._subscribers]

    @property
    def lost(self) -> int:
        """How many messages were dropped for subscribers that did not take them."""
        return self._lost + sum(subscriber.lost for subscriber in self._subscribers)

    @property
    def waiting(self) -> int:
        """How many messages wait, for all subscribers together."""
        return sum(subscriber.waiting for subscriber in self._subscribers)

    def connections(self) -> list[tuple[str, str]]:
        """Return the nodes that are connected and the texts of their connections."""
        found = []
        for subscriber in self._subscribers:
            with suppress(OSError, ValueError):
                own, peer = subscriber.socket.getsockname(), subscriber.socket.getpeername()
                text = f"TCPROS connection on port {own[1]} to [{peer[0]}:{peer[1]} on socket "
                found.append((subscriber.caller, f"{text}{subscriber.socket.fileno()}]"))
        return found

    def send(self, frame: bytes | bytearray) -> None:
        """Send a frame to all who are subscribed; returns at once."""
        if self.latch:
            with self._changed:
                self._latched.append(frame)
                while len(self._latched) > self.latch or (
                    len(self._latched) > 1 and sum(map(len, self._latched)) > self._limits[1]
                ):
                    self._latched.popleft()
                subscribers = self._subscribers
        else:
            subscribers = self._subscribers
        self.sent += 1
        for subscriber in subscribers:
            subscriber.send(frame)

    def send_run(self, run: bytes | bytearray) -> int:
        """Send frames that came together; returns how many they are."""
        frames = list(frames_of(memoryview(run)))
        if self.latch:
            for frame in frames:
                self.send(bytes(frame))
            return len(frames)
        self.sent += len(frames)
        for subscriber in self._subscribers:
            subscriber.send(run)
        return len(frames)

    def arrived(self, connection: socket.socket, header: Mapping[str, str]) -> None:
        """Take a connection in, or refuse it; in the loop's thread."""
        caller = header.get("callerid", "a node without a name")[:200]
        problem = subscriber_problem(header, self.topic, self.record.name, self.record.md5)
        if problem:
            with suppress(OSError):
                connection.send(encode_header({"error": problem, "callerid": self._caller}))
            connection.close()
            self._say(problem, refused=caller)
            return
        keep_alive(connection)
        if header.get("tcp_nodelay") == "0":
            with suppress(OSError):
                connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 0)
        subscriber = _Subscriber(connection, caller, self._loop, self._limits, self._gone)
        record = self.record
        answer = publisher_header(
            self._caller,
            self.topic,
            record.name,
            record.md5,
            record.definition,
            latching=bool(self.latch),
        )
        connection.setblocking(False)
        self._loop.add(subscriber)
        with self._changed:
            subscriber.send(encode_header(answer))
            for frame in self._latched:
                subscriber.send(frame)
            self._subscribers = (*self._subscribers, subscriber)
            self._changed.notify_all()
        self._say(f"{caller} is connected")

    def wait(self, is_there: Callable[[list[str]], bool], seconds: float) -> bool:
        """Wait until the nodes that are connected are those that are waited for."""
        with self._changed:
            return self._changed.wait_for(lambda: is_there(self.callers), seconds)

    def drain(self, seconds: float) -> bool:
        """Wait until every subscriber's machine has what was sent."""
        deadline = time.monotonic() + seconds
        pause = threading.Event()
        while not all(subscriber.is_drained() for subscriber in self._subscribers):
            if time.monotonic() >= deadline:
                return False
            pause.wait(_LOOK_SECONDS)
        return True

    def close(self) -> None:
        """Close every connection; the system still delivers what it took."""
        with self._changed:
            subscribers, self._subscribers = self._subscribers, ()
        for subscriber in subscribers:
            self._loop.discard(subscriber)
            subscriber.end()
            self._lost += subscriber.lost

    def _gone(self, subscriber: _Subscriber, cause: str) -> None:
        with self._changed:
            if subscriber not in self._subscribers:
                return
            self._subscribers = tuple(
                other for other in self._subscribers if other is not subscriber
            )
            self._lost += subscriber.lost
            self._changed.notify_all()
        self._say(cause or f"{subscriber.caller} is gone")

    def refuse_transport(self, caller: str) -> None:
        """Say that a subscriber asks for what is not spoken here; in the loop's thread."""
        self._say(f"{caller} wants {self.topic} over UDPROS alone, and not TCPROS", refused=caller)

    def _say(self, what: str, *, refused: str = "") -> None:
        for watcher in self.watchers:
            watcher(what, refused)
