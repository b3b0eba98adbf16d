"""One line that is kept: opened, read, and opened again with a growing pause when it was lost."""

from __future__ import annotations

import logging
import select
import threading
import time
from collections.abc import Callable
from typing import Protocol

from uoarm.bridge import Backoff, LimitedLog, TurnCounter, foreign, text_of
from uoarm.errors import BridgeError, BridgeTimeoutError
from uoarm_rocos._framing import LineError
from uoarm_rocos._transport import TICK_SECONDS, LineTransport


class Readiness:
    """Watches a descriptor for the line's own thread; on Linux.

    While another thread reads what comes, `ignore` keeps the watching one asleep: epoll takes that
    in while it waits, so that no thread has to be woken for it.
    """

    def __init__(self, descriptor: int) -> None:
        self._descriptor = descriptor
        self._epoll = select.epoll()
        self._epoll.register(descriptor, select.EPOLLIN)

    def wait(self, timeout: float) -> bool:
        """Wait at most so many seconds; return whether there is something to read, or an end."""
        return bool(self._epoll.poll(timeout))

    def ignore(self) -> None:
        """Have `wait` not return for what comes, but for an end."""
        self._epoll.modify(self._descriptor, 0)

    def heed(self) -> None:
        """Have `wait` return for what comes, or is there, again."""
        self._epoll.modify(self._descriptor, select.EPOLLIN)

    def close(self) -> None:
        """End; no thread waits any more."""
        self._epoll.close()


_OPEN_SECONDS = 3.0
_log = logging.getLogger("uoarm")


class DeviceLineUser(Protocol):
    """What uses a line. Every method is called in the line's own thread, one at a time.

    `received` may be called in the thread of a caller that has a turn instead.

    Any of them may raise BridgeError to have the line dropped and opened again.
    """

    def connected(self) -> None:
        """The line is open; `send` works from now on."""

    def received(self, data: bytes) -> None:
        """Take octets that arrived."""

    def tick(self, now: float) -> None:
        """Look at the clock (monotonic), 20 times a second or more."""

    def lost(self, cause: str) -> None:
        """The line is gone, or could not be opened. It is tried again after a pause."""


class DeviceLine:
    """Keeps one line open in a thread of its own, from `start` to `close`.

    Args:
        name: for the thread's name and for errors.
        make: makes a transport that has not been opened.
        user: takes what arrives.
        backoff: how long to wait between attempts.
        is_shared: whether `begin_turn` is used.
    """

    def __init__(
        self,
        name: str,
        make: Callable[[], LineTransport],
        user: DeviceLineUser,
        backoff: Backoff,
        *,
        is_shared: bool = False,
    ) -> None:
        self.name = name
        self._records = LimitedLog(_log)
        self._make = make
        self._user = user
        self._backoff = backoff
        self._is_shared = is_shared
        self._stop = threading.Event()
        # Guards transport and `_broken` between senders and the line's thread: whole messages stay
        # whole. Where `send_within` has left a rest, the thread that sends it releases it.
        self._sending = threading.Lock()
        # Held by the thread that reads and calls the user. The line's thread waits for it; others
        # only try, and not while that waits, so that `tick` is called however many there are.
        self._reading = threading.Lock()
        self._is_wanted = False
        self._turns = 0
        self._readiness: Readiness | None = None
        self._transport: LineTransport | None = None
        self._broken = ""
        self._cause = "not open yet"
        self._counter = TurnCounter()
        self._thread = threading.Thread(target=self._run, name=f"uoarm-{name}", daemon=True)

    @property
    def empty_turns(self) -> int:
        """How often the line's thread looked for octets before its time, and found none."""
        return self._counter.turns.empty

    def start(self) -> None:
        """Begin; returns at once."""
        self._thread.start()

    def send(self, data: bytes) -> None:
        """Send octets; any thread, whole messages stay whole. Bounded by the transport.

        Raises:
            LineError: the line is not open, or takes nothing.
        """
        with self._sending:
            if self._transport is None:
                raise LineError(f"{self.name} is not connected: {self._cause}")
            try:
                self._transport.write(data)
            except LineError as error:
                self._broken = str(error)
                raise

    def send_within(self, data: bytes, timeout: float) -> None:
        """Send octets as `send` does, over a prompt transport, and wait at most so many seconds.

        What the line does not take at once is sent after this has returned; where that fails, the
        line is lost.

        Raises:
            LineError: the line is not open.
            BridgeTimeoutError: it was busy all the time with what was sent before.
        """
        if not self._sending.acquire(timeout=timeout):
            raise BridgeTimeoutError(f"{self.name} took nothing within {timeout:g} s")
        is_handed_over = False
        try:
            transport = self._transport
            if transport is None or self._broken:
                cause = self._broken or self._cause
                raise LineError(f"{self.name} is not connected: {cause}")
            try:
                taken = transport.write_now(data)
                if taken < len(data):
                    rest = threading.Thread(
                        target=self._send_rest,
                        args=(transport, data[taken:]),
                        name=f"uoarm-{self.name}-rest",
                        daemon=True,
                    )
                    is_handed_over = True
                    rest.start()
            except BaseException as error:  # whatever it is, half a message may be on the line
                self._broken = str(error) or f"sending ended with {type(error).__name__}"
                if isinstance(error, RuntimeError):  # the system gives no more threads
                    is_handed_over = False
                    raise LineError(f"{self.name}: {error}") from error
                raise
        finally:
            if not is_handed_over:
                self._sending.release()

    def _send_rest(self, transport: LineTransport, rest: bytes) -> None:
        """Send what is left of a message, in a thread that holds what every sender needs."""
        try:
            transport.write(rest)
        except LineError as error:
            self._broken = str(error)
        finally:
            self._sending.release()

    def begin_turn(self) -> bool:
        """Have the caller's thread read instead of the line's, over a prompt transport.

        A caller that sends and waits for the answer within a turn need not be woken by the line's
        thread. A turn is to be short, and not begun in a user's method. Returns whether it is one:
        not where another thread reads, or the line is not open.
        """
        if self._is_wanted or not self._reading.acquire(blocking=False):
            return False
        if self._readiness is None or self._broken:
            self._reading.release()
            return False
        self._turns += 1
        self._readiness.ignore()
        return True

    def end_turn(self) -> None:
        """Leave the reading to the line's thread again; only after `begin_turn` was True."""
        if self._readiness is not None:
            self._readiness.heed()
        self._reading.release()

    def read_for(self, is_over: Callable[[], bool], until: float) -> None:
        """Read within a turn until a caller has what it waits for, but no longer than 50 ms.

        Args:
            is_over: says whether there is no more to wait for.
            until: monotonic time at which to return at the latest, but for 50 ms.
        """
        transport = self._transport
        assert transport is not None, "closed only by the thread that has the turn"
        until = min(until, time.monotonic() + TICK_SECONDS)
        try:
            while not self._is_wanted and not self._stop.is_set():
                data = transport.read()
                if data:
                    self._user.received(data)
                if is_over() or time.monotonic() >= until:
                    return
        except BridgeError as error:
            self._broken = str(error)  # the line's thread does the rest
        except BaseException as error:  # what was read is lost, whatever it is
            self._broken = text_of(error)
            raise

    def stop(self) -> None:
        """Begin to end; returns at once."""
        self._stop.set()

    def close(self, timeout: float = 2.0) -> None:
        """End; waits at most `timeout` seconds for the thread, and not in it."""
        self.stop()
        if self._thread.is_alive() and threading.current_thread() is not self._thread:
            self._thread.join(timeout)

    def _watched(self, transport: LineTransport) -> Readiness | None:
        """Return what lets other threads read as well; None: the line's own alone does."""
        descriptor = transport.descriptor() if self._is_shared else None
        if descriptor is None or not hasattr(select, "epoll"):
            return None
        return Readiness(descriptor)

    def _run(self) -> None:
        failed = 0
        while not self._stop.is_set():
            began = time.monotonic()
            self._cause = self._use_once()
            if self._stop.is_set():
                return
            self._user.lost(self._cause)
            # A line that held for a while is opened again as soon as one that broke first.
            failed = 1 if time.monotonic() - began > self._backoff.most else failed + 1
            self._stop.wait(self._backoff.pause(failed))

    def _use_once(self) -> str:
        """Use the line until it is lost; return why it was lost."""
        try:
            return foreign(self._use)
        except BridgeError as error:
            return str(error)
        except Exception as error:  # noqa: BLE001 - a replaced transport may raise anything
            self._records.write(logging.WARNING, f"line {self.name}", error)
            return text_of(error)

    def _use(self) -> str:
        """Open, read until the line is lost or its end, close; return why it was lost."""
        transport: LineTransport | None = None
        try:
            transport = self._make()
            transport.open(_OPEN_SECONDS)
            with self._sending:
                self._transport, self._broken = transport, ""
            self._user.connected()
            readiness = self._readiness = self._watched(transport)
            while not self._stop.is_set():
                if self._broken:
                    return self._broken
                turns, data = self._turns, b""
                until = time.monotonic() + TICK_SECONDS
                is_ready = readiness is None or readiness.wait(TICK_SECONDS)
                self._is_wanted = True
                with self._reading:
                    self._is_wanted = False
                    # A caller that had a turn meanwhile may have read it.
                    if readiness is not None and turns != self._turns:
                        is_ready = readiness.wait(0)
                    if is_ready:
                        data = transport.read()
                        if data:
                            self._user.received(data)
                    self._user.tick(now := time.monotonic())
                # Not what `read` waited for itself, nor what a caller in its turn has read.
                rest = self._counter.add(empty=is_ready and not data and now < until)
                if rest:
                    self._stop.wait(rest)
        finally:
            with self._reading, self._sending:
                self._transport = None
                readiness, self._readiness = self._readiness, None
            if readiness is not None:
                readiness.close()
            if transport is not None:
                transport.close()
        return "closed"
