"""The connection to the framework, which is made again when it breaks.

A stand-in: lines of JSON over TCP, to the bus in `tests/bus.py`. Put your middleware here, and
import it nowhere else. What the other modules use must stay: `ask`, `post`, `join`, `leave`.
"""

from __future__ import annotations

import itertools
import json
import selectors
import socket
import threading
import time
from collections import deque
from collections.abc import Callable
from typing import Any, Protocol

from uoarm.bridge import Backoff, reason_of
from uoarm.errors import BridgeError, BridgeTimeoutError, FailureReason

_BACKOFF = Backoff(first=0.05, most=2.0)
_TICK_SECONDS = 0.5
_MOST_LINES = 10_000
_MOST_OCTETS = 64 * 2**20  # of one line
_Reply = dict[str, Any]


class ExampleMember(Protocol):
    """What an open channel has to do with the connection."""

    request: _Reply
    """With what the bus is asked when the channel opens and after each break; empty: nothing."""
    lost: int
    """Messages that waited to be sent when the connection broke."""

    def take(self, event: _Reply) -> None:
        """Take what came; must return at once."""

    def connected(self) -> None:
        """The connection is there again, and the bus has agreed to the request."""

    def disconnected(self, cause: str) -> None:
        """The connection broke."""

    def refused(self, cause: str) -> None:
        """The bus has not agreed to the request again."""

    def tick(self) -> None:
        """Time has passed."""


class ExampleConnection:
    """One connection for all channels of a bridge; its one thread reads, writes and reconnects.

    Args:
        host: of the bus.
        port: of the bus.
        timeout: seconds that the bus has to reply.
    """

    def __init__(self, host: str, port: int, timeout: float) -> None:
        self._address, self._timeout = (host, port), timeout
        self._numbers = itertools.count(1)
        # Guards everything below between the thread of the connection and those that use it. No
        # member and no reply is called under it, as they may report or open something.
        self._lock = threading.Lock()
        self._members: dict[int, ExampleMember] = {}
        self._replies: dict[int, Callable[[_Reply], None]] = {}
        self._lines: deque[tuple[bytes, ExampleMember | None]] = deque()
        self._why_down: str | None = "not connected yet"
        self._tried = threading.Event()  # what is asked before the first attempt waits for it
        self._closing = threading.Event()
        self._wake, self._woken = socket.socketpair()
        self._wake.setblocking(False)
        self._woken.setblocking(False)
        self._thread = threading.Thread(target=self._run, name="example connection", daemon=True)
        self._thread.start()

    def ask(self, do: str, timeout: float | None = None, **fields: Any) -> Any:
        """Ask the bus and return its result.

        Raises:
            BridgeTimeoutError: it does not reply in time.
            BridgeError: it is not there, or refuses.
        """
        limit = self._timeout if timeout is None else timeout
        came, kept = threading.Event(), list[_Reply]()

        def keep(reply: _Reply) -> None:
            kept.append(reply)
            came.set()

        self._tried.wait(limit)
        number = self._post({"do": do, **fields}, keep)
        if not came.wait(limit):
            with self._lock:
                self._replies.pop(number, None)
            raise BridgeTimeoutError(f"the bus did not reply to {do} within {limit:g} s")
        (reply,) = kept
        if "error" in reply:
            raise BridgeError(reply["error"], FailureReason(reply.get("reason", "refused")))
        return reply.get("result")

    def post(self, do: str, member: ExampleMember | None = None, **fields: Any) -> None:
        """Send a request that has no reply; returns at once.

        Raises:
            BridgeError: it cannot be sent now.
        """
        self._post({"do": do, **fields}, None, member)

    def join(self, member: ExampleMember) -> int:
        """Have a channel notified of what concerns it; returns its number on the bus.

        Raises:
            BridgeError: the bus is not there, or does not agree to what the channel requests.
        """
        number = next(self._numbers)
        with self._lock:
            self._members[number] = member
        try:
            if member.request:
                self.ask(**member.request, id=number)
            else:
                self.ask("ping")
        except BaseException:
            with self._lock:
                self._members.pop(number, None)
            raise
        return number

    def leave(self, number: int) -> None:
        """Forget a channel, and withdraw what it requested."""
        with self._lock:
            member = self._members.pop(number, None)
            if member is None or not member.request or self._why_down is not None:
                return  # the bus forgets by itself what asked over a connection that broke
        self.ask("withdraw", id=number)

    def close(self) -> None:
        """Let go of the bus; does not wait for the thread, which then ends."""
        self._closing.set()
        self._rouse()

    def _post(
        self,
        request: _Reply,
        on_reply: Callable[[_Reply], None] | None,
        member: ExampleMember | None = None,
    ) -> int:
        number = next(self._numbers)
        line = json.dumps({**request, "number": number}).encode() + b"\n"
        with self._lock:
            if self._why_down is not None:
                text = f"the bus at {self._address} is not there: {self._why_down}"
                raise BridgeError(text, FailureReason.UNAVAILABLE)
            # What has a reply, such as the end of a channel, still passes where data waits.
            if len(self._lines) >= (_MOST_LINES if on_reply is None else 2 * _MOST_LINES):
                text = f"{len(self._lines)} messages wait for the bus: it takes none"
                raise BridgeError(text, FailureReason.UNAVAILABLE)
            if on_reply is not None:
                self._replies[number] = on_reply
            self._lines.append((line, member))
        self._rouse()
        return number

    def _rouse(self) -> None:
        try:
            self._wake.send(b"\0")
        except OSError:  # it is awake, or has ended
            return

    def _run(self) -> None:
        failed = 0
        while not self._closing.is_set():
            try:
                with socket.create_connection(self._address, self._timeout) as line:
                    if line.recv(1) != b"\n":  # the bus greets whom it serves
                        raise ConnectionError("it does not greet")
                    failed = 0
                    self._up()
                    self._exchange(line)
            except (OSError, ValueError, RecursionError) as error:
                failed += 1
                self._down(reason_of(error))
            self._rest(_BACKOFF.pause(failed))
        self._down("the bridge is closed")
        self._wake.close()
        self._woken.close()

    def _rest(self, seconds: float) -> None:
        """Wait before the next attempt, in which channels that are lost by then are reported."""
        end = time.monotonic() + seconds
        while (left := end - time.monotonic()) > 0 and not self._closing.is_set():
            self._closing.wait(min(left, _TICK_SECONDS))
            self._each(lambda member: member.tick())

    def _exchange(self, line: socket.socket) -> None:
        """Write what waits and read what comes, until the connection ends."""
        line.setblocking(False)
        unsent, unread = b"", bytearray()
        with selectors.DefaultSelector() as selector:
            selector.register(self._woken, selectors.EVENT_READ)
            selector.register(line, selectors.EVENT_READ)
            while not self._closing.is_set():
                with self._lock:
                    if not unsent and self._lines:
                        unsent = self._lines[0][0]
                wanted = selectors.EVENT_READ | (selectors.EVENT_WRITE if unsent else 0)
                selector.modify(line, wanted)
                for key, ready in selector.select(_TICK_SECONDS):
                    if key.fileobj is self._woken:
                        self._woken.recv(4096)
                        continue
                    if ready & selectors.EVENT_WRITE:
                        unsent = self._send(line, unsent)
                    if ready & selectors.EVENT_READ:
                        self._read(line, unread)
                self._each(lambda member: member.tick())

    def _send(self, line: socket.socket, unsent: bytes) -> bytes:
        """Send what the bus takes now and return the rest; a message is kept until all is sent."""
        rest = unsent[line.send(unsent) :]
        if not rest:
            with self._lock:
                self._lines.popleft()
        return rest

    def _read(self, line: socket.socket, unread: bytearray) -> None:
        octets = line.recv(2**18)
        if not octets:
            raise ConnectionError("the bus has ended the connection")
        begin = len(unread)
        unread += octets
        while (end := unread.find(b"\n", begin)) >= 0:
            came = json.loads(unread[:end])
            if not isinstance(came, dict):
                raise ConnectionError(f"the bus sent {type(came).__name__}, which is no object")
            self._take(came)
            del unread[: end + 1]
            begin = 0
        if len(unread) > _MOST_OCTETS:
            raise ConnectionError(f"the bus sent a line of more than {_MOST_OCTETS} octets")

    def _take(self, came: _Reply) -> None:
        with self._lock:
            on_reply = self._replies.pop(came.get("number", 0), None)
            member = self._members.get(came.get("id", 0))
        if on_reply is not None:
            on_reply(came)
        elif member is not None:
            member.take(came)

    def _up(self) -> None:
        with self._lock:
            self._why_down = None
            members = dict(self._members)
        for number, member in members.items():
            request = {**member.request, "id": number} if member.request else {"do": "ping"}
            self._post(request, _agreed(member))
        self._tried.set()

    def _down(self, cause: str) -> None:
        with self._lock:
            self._why_down = cause
            lines, self._lines = self._lines, deque()
            replies, self._replies = self._replies, {}
        for _, member in lines:
            if member is not None:
                member.lost += 1
        gone = {"error": f"the bus is not there: {cause}", "reason": "unavailable"}
        for on_reply in replies.values():
            on_reply(gone)
        self._each(lambda member: member.disconnected(cause))
        self._tried.set()

    def _each(self, call: Callable[[ExampleMember], None]) -> None:
        with self._lock:
            members = tuple(self._members.values())
        for member in members:
            call(member)


def _agreed(member: ExampleMember) -> Callable[[_Reply], None]:
    def agreed(reply: _Reply) -> None:
        if "error" not in reply:
            member.connected()
        elif reply.get("reason") != "unavailable":  # else it broke again
            member.refused(reply["error"])

    return agreed
