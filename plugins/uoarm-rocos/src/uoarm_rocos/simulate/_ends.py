"""The device's end of a line: a pseudo-terminal, or a TCP port on loopback for one host."""

from __future__ import annotations

import os
import select
import socket
import sys
from abc import ABC, abstractmethod
from contextlib import suppress
from pathlib import Path

__all__ = ["End", "PtyEnd", "TcpEnd"]

_MOST = 65_536
_WRITE_SECONDS = 1.0


class End(ABC):
    """The device's end of one line; used by one thread.

    Attributes:
        where: the URL that a host uses.
        framed: whether the profile's length prefix belongs on this line (TCP).
    """

    where: str
    framed: bool

    @abstractmethod
    def meet(self, timeout: float) -> bool:
        """Return whether a new host came within `timeout` seconds, or one is there."""

    @abstractmethod
    def read(self, timeout: float) -> bytes | None:
        """Return what came within `timeout` seconds, perhaps nothing; None: the host is gone."""

    @abstractmethod
    def write(self, data: bytes) -> None:
        """Send octets; what the host does not take within a second is lost, as on a real line."""

    @abstractmethod
    def cut(self) -> None:
        """Pull the cable out; it can be met again."""

    @abstractmethod
    def close(self) -> None:
        """Let go of everything."""


class PtyEnd(End):
    """A new pseudo-terminal; `link`, where given, always points to the present one."""

    framed = False

    def __init__(self, link: str = "") -> None:
        self._link = link
        self._open()

    def _open(self) -> None:
        if sys.platform == "win32":
            raise OSError("pseudo-terminals need Linux or macOS; use TCP here")
        import tty  # noqa: PLC0415 - not on Windows

        self._device, line = os.openpty()
        tty.setraw(line)
        self._line = line  # kept open, so that the host may come and go
        path = os.ttyname(line)
        if self._link:
            fresh = Path(f"{self._link}.new")
            fresh.unlink(missing_ok=True)
            fresh.symlink_to(path)
            fresh.replace(self._link)
        self.where = self._link or path

    def meet(self, timeout: float) -> bool:
        """Return at once: nobody can see whether a host has opened the port."""
        del timeout
        if self._device < 0:
            self._open()
        return True

    def read(self, timeout: float) -> bytes | None:
        """Return what came."""
        if not select.select([self._device], [], [], timeout)[0]:
            return b""
        try:
            return os.read(self._device, _MOST)
        except OSError:
            return None

    def write(self, data: bytes) -> None:
        """Send octets; a port that nobody reads overflows."""
        while data and select.select([], [self._device], [], _WRITE_SECONDS)[1]:
            os.set_blocking(self._device, False)
            with suppress(BlockingIOError):
                data = data[os.write(self._device, data) :]
                continue
            return

    def cut(self) -> None:
        """Remove the port; the next one has another number and the same link."""
        if self._device >= 0:
            os.close(self._device)
            os.close(self._line)
            self._device = -1
        if self._link:
            Path(self._link).unlink(missing_ok=True)

    def close(self) -> None:
        """Remove the port."""
        self.cut()


class TcpEnd(End):
    """A listening socket on loopback; port 0 takes a free one."""

    framed = True

    def __init__(self, port: int = 0) -> None:
        self._server = socket.create_server(("127.0.0.1", port))
        self._host: socket.socket | None = None
        self._writer: socket.socket | None = None  # the same connection, with a limit of its own
        self.where = f"tcp://127.0.0.1:{self._server.getsockname()[1]}"

    def meet(self, timeout: float) -> bool:
        """Return whether a host is there."""
        if self._host is not None:
            return True
        if not select.select([self._server], [], [], timeout)[0]:
            return False
        self._host = self._server.accept()[0]
        self._host.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        self._writer = self._host.dup()
        self._writer.setblocking(False)
        return True

    def read(self, timeout: float) -> bytes | None:
        """Return what came."""
        if self._host is None:
            return None
        if self._host.gettimeout() != timeout:
            self._host.settimeout(timeout)
        data = b""
        try:
            data = self._host.recv(_MOST)
        except TimeoutError:
            return b""
        except OSError:
            pass  # the host is gone
        if not data:
            self.cut()
            return None
        return data

    def write(self, data: bytes) -> None:
        """Send octets; a host that does not take them is cut off."""
        if self._writer is not None:
            try:
                self._send(self._writer, data)
            except OSError:
                self.cut()

    @staticmethod
    def _send(writer: socket.socket, data: bytes) -> None:
        """Send at once what the host takes at once, as most of it is."""
        sent = 0
        with suppress(BlockingIOError):
            sent = writer.send(data)
        if sent < len(data):
            writer.settimeout(_WRITE_SECONDS)
            writer.sendall(data[sent:])
            writer.setblocking(False)

    def cut(self) -> None:
        """Close the host's connection."""
        for item in (self._host, self._writer):
            if item is not None:
                item.close()
        self._host = self._writer = None

    def close(self) -> None:
        """Close everything."""
        self.cut()
        self._server.close()
