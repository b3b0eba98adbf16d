"""What a server says to the service manager that started it, such as systemd.

Source of the protocol: sd_notify(3). It is a datagram of lines to the socket that `NOTIFY_SOCKET`
names; the packages that send it are older than the Pythons that uoarm runs on.
"""

from __future__ import annotations

import logging
import os
import socket
from collections.abc import MutableMapping

from uoarm.errors import UsageError

__all__ = ["ServiceManager"]

_SOCKET, _MICROSECONDS, _PROCESS = "NOTIFY_SOCKET", "WATCHDOG_USEC", "WATCHDOG_PID"
_log = logging.getLogger("uoarm.server")


class ServiceManager:
    """The service manager of this process, or none: then nothing is said. For one thread.

    What it needs is taken out of the environment, so that no process that is started here speaks
    in this one's name.

    Args:
        environment: of the process.

    Raises:
        UsageError: it states an address or a time that is none.

    Attributes:
        watchdog_seconds: within which a sign of life is expected again and again; None: never.
    """

    def __init__(self, environment: MutableMapping[str, str] = os.environ) -> None:
        self._address = _address(environment.pop(_SOCKET, ""))
        stated, process = environment.pop(_MICROSECONDS, ""), environment.pop(_PROCESS, "")
        self.watchdog_seconds: float | None = None
        if stated and process in {"", str(os.getpid())}:
            self.watchdog_seconds = _seconds(stated)

    def ready(self, text: str) -> None:
        """Say that the server listens, and what `systemctl status` shows of it."""
        self._send("READY=1", f"STATUS={text}")

    def alive(self) -> None:
        """Give a sign of life."""
        self._send("WATCHDOG=1")

    def stopping(self) -> None:
        """Say that the server was asked to stop, and does."""
        self._send("STOPPING=1", "STATUS=closing")

    def _send(self, *lines: str) -> None:
        if self._address is None:
            return
        try:
            with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM | socket.SOCK_CLOEXEC) as line:
                line.setblocking(False)
                line.sendto("\n".join(lines).encode(), self._address)
        except OSError as error:
            _log.warning("the service manager could not be reached: %s", error)


def _address(given: str) -> str | None:
    if not given:
        return None
    if given[0] not in "/@":
        raise UsageError(f"{_SOCKET}: expected a path, or @ and a name, got {given[:80]!r}")
    # Of the abstract namespace, which the kernel marks with a zero.
    return f"\0{given[1:]}" if given[0] == "@" else given


def _seconds(given: str) -> float:
    if not given.isdecimal() or not int(given):
        raise UsageError(f"{_MICROSECONDS}: expected microseconds, got {given[:40]!r}")
    return int(given) / 1e6
