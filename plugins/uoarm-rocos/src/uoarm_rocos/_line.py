"""One line that is kept: opened, read, and opened again with a growing pause when it was lost."""

from __future__ import annotations

import logging
import threading
import time
from collections.abc import Callable
from typing import Protocol

from attrs import frozen

from uoarm.errors import BridgeError
from uoarm_rocos._errors import LineError
from uoarm_rocos._transport import Transport

__all__ = ["Backoff", "Line", "LineUser"]

_OPEN_SECONDS = 3.0
_log = logging.getLogger("uoarm")


@frozen
class Backoff:
    """Seconds before the first new attempt, doubled each time up to the last."""

    first: float = 0.1
    last: float = 2.0


class LineUser(Protocol):
    """Who uses a line. Every method is called in the line's own thread, one at a time.

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


class Line:
    """Keeps one line open in a thread of its own, from `start` to `close`.

    Args:
        name: for the thread's name and for errors.
        make: makes a transport that has not been opened.
        user: takes what arrives.
        backoff: how long to wait between attempts.
    """

    def __init__(
        self, name: str, make: Callable[[], Transport], user: LineUser, backoff: Backoff
    ) -> None:
        self.name = name
        self._make = make
        self._user = user
        self._backoff = backoff
        self._stop = threading.Event()
        self._sending = threading.Lock()
        self._transport: Transport | None = None
        self._broken = ""
        self._cause = "not open yet"
        self._thread = threading.Thread(target=self._run, name=f"uoarm-{name}", daemon=True)

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

    def stop(self) -> None:
        """Begin to end; returns at once."""
        self._stop.set()

    def close(self, timeout: float = 2.0) -> None:
        """End; waits at most `timeout` seconds for the thread, and not in it."""
        self.stop()
        if self._thread.is_alive() and threading.current_thread() is not self._thread:
            self._thread.join(timeout)

    def _run(self) -> None:
        pause = self._backoff.first
        while not self._stop.is_set():
            began = time.monotonic()
            self._cause = self._use_once()
            if self._stop.is_set():
                return
            self._user.lost(self._cause)
            if time.monotonic() - began > self._backoff.last:
                pause = self._backoff.first
            self._stop.wait(pause)
            pause = min(2 * pause, self._backoff.last)

    def _use_once(self) -> str:
        """Open, read until the line is lost, close; return why it was lost."""
        transport: Transport | None = None
        try:
            transport = self._make()
            transport.open(_OPEN_SECONDS)
            with self._sending:
                self._transport, self._broken = transport, ""
            self._user.connected()
            while not self._stop.is_set():
                if self._broken:
                    return self._broken
                data = transport.read()
                if data:
                    self._user.received(data)
                self._user.tick(time.monotonic())
        except BridgeError as error:
            return str(error)
        except Exception as error:  # noqa: BLE001 - a replaced transport may raise anything
            _log.warning("line %s", self.name, exc_info=True)
            return f"{type(error).__name__}: {error}"
        finally:
            with self._sending:
                self._transport = None
            if transport is not None:
                transport.close()
        return "closed"
