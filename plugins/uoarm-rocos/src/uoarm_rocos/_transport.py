"""Transports: how octets reach a device and come back. A part that others may replace."""

from __future__ import annotations

import os
import socket
from abc import ABC, abstractmethod
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path

import serial

from uoarm.bridge import close_in_children, reason_of
from uoarm_rocos._framing import LineError
from uoarm_rocos._options import LineOptions, tcp_address

TICK_SECONDS = 0.05
_WRITE_SECONDS = 2.0
_MOST = 65_536
_TERMINAL: tuple[type[Exception], ...] = ()
with suppress(ImportError):  # it is not on Windows
    import termios

    _TERMINAL = (termios.error,)
# What sockets and ports raise; pyserial TypeError when a port is closed under a read.
_FAILURES: tuple[type[Exception], ...] = (
    OSError,
    ValueError,
    TypeError,
    NotImplementedError,
    *_TERMINAL,
)
_PSEUDO_TERMINALS = range(136, 144)  # the numbers of their devices on Linux


class LineTransport(ABC):
    """One line to one device; opened, used and closed once.

    `read` and `close` are called by one thread, `write` by another, one call at a time.
    """

    @abstractmethod
    def open(self, timeout: float) -> None:
        """Reach the device within `timeout` seconds.

        Raises:
            LineError: it cannot be reached.
        """

    @abstractmethod
    def read(self) -> bytes:
        """Return what has arrived; nothing when nothing came within 50 ms.

        Raises:
            LineError: the line is gone.
        """

    @abstractmethod
    def write(self, data: bytes) -> None:
        """Send octets; blocks 2 seconds at most.

        Raises:
            LineError: the line is gone, or the device takes nothing. It must then be closed.
        """

    def descriptor(self) -> int | None:
        """Return what epoll can watch for octets to read; None: `read` alone can wait for them."""
        return None

    def write_now(self, data: bytes) -> int:
        """Send as many octets as the line takes at once, waiting for nothing; return how many.

        For a transport of a `LineParts` that is `prompt`; called where `write` might be.

        Raises:
            LineError: the line is gone.
        """
        raise NotImplementedError

    @abstractmethod
    def close(self) -> None:
        """Let go of the line; never raises, also after a failed `open`."""


class TcpTransport(LineTransport):
    """A TCP connection to a listening device."""

    def __init__(self, host: str, port: int) -> None:
        self._address = (host, port)
        self._reader: socket.socket | None = None
        self._writer: socket.socket | None = None

    def open(self, timeout: float) -> None:
        """Connect within `timeout` seconds."""
        try:
            self._reader = socket.create_connection(self._address, timeout)
            self._reader.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            self._writer = self._reader.dup()
            close_in_children(self._reader, self._writer)
            self._reader.settimeout(TICK_SECONDS)
            self._writer.settimeout(_WRITE_SECONDS)
        except _FAILURES as error:
            where = f"tcp://{self._address[0]}:{self._address[1]}"
            raise _line_error(where, error) from error

    def read(self) -> bytes:
        """Return what has arrived."""
        assert self._reader is not None
        try:
            data = self._reader.recv(_MOST)
        except TimeoutError:
            return b""
        except _FAILURES as error:
            raise _line_error("reading from TCP", error) from error
        if not data:
            raise LineError("the device closed the connection")
        return data

    def write(self, data: bytes) -> None:
        """Send octets."""
        assert self._writer is not None
        try:
            self._writer.sendall(data)
        except _FAILURES as error:
            raise _line_error("writing to TCP", error) from error

    def descriptor(self) -> int | None:
        """Return the socket's."""
        assert self._reader is not None
        return self._reader.fileno()

    def write_now(self, data: bytes) -> int:
        """Send as many octets as the connection takes at once."""
        assert self._writer is not None
        return _write_now(self._writer.fileno(), data, "writing to TCP")

    def close(self) -> None:
        """Close the connection; a `write` under way ends."""
        for item in (self._reader, self._writer):
            if item is not None:
                with suppress(OSError):  # the other side was quicker
                    item.shutdown(socket.SHUT_RDWR)
                item.close()


class SerialTransport(LineTransport):
    """A serial line by any form of `serial.serial_for_url`: a port, `socket://`, `rfc2217://`.

    With `rfc2217://` pyserial takes no limit for writing; that of its socket, 5 seconds, holds.
    """

    def __init__(self, url: str, options: LineOptions) -> None:
        self._url = url
        self._options = options
        self._port: serial.Serial | None = None

    def open(self, timeout: float) -> None:
        """Open the port; `timeout` is the concern of pyserial, which has limits of its own."""
        del timeout
        parity = self._options.parity
        if parity != serial.PARITY_NONE and _is_pseudo_terminal(self._url):
            # It has no parity, and takes the wish for one only beside another change: not from
            # who opens it again.
            with suppress(LineError):
                self._port = self._opened(parity)
                return
            parity = serial.PARITY_NONE
        self._port = self._opened(parity)

    def _opened(self, parity: str) -> serial.Serial:
        options = self._options
        try:
            port = serial.serial_for_url(
                self._url,
                baudrate=options.baud,
                bytesize=options.bits,
                parity=parity,
                stopbits=options.stop,
                xonxoff=options.xonxoff,
                timeout=TICK_SECONDS,
                write_timeout=None if self._url.startswith("rfc2217:") else _WRITE_SECONDS,
                exclusive=True,
            )
        except _FAILURES as error:
            raise _line_error(self._url, error) from error
        # Of a port elsewhere the socket: to close such a port would end it for the parent, too.
        close_in_children(getattr(port, "_socket", None) or port)
        return port

    def read(self) -> bytes:
        """Return what has arrived."""
        assert self._port is not None
        try:
            first = bytes(self._port.read(1))
            waiting = min(self._port.in_waiting, _MOST) if first else 0
            return first + bytes(self._port.read(waiting)) if waiting else first
        except _FAILURES as error:
            raise _line_error(f"reading from {self._url}", error) from error

    def write(self, data: bytes) -> None:
        """Send octets."""
        assert self._port is not None
        try:
            self._port.write(data)
        except _FAILURES as error:
            raise _line_error(f"writing to {self._url}", error) from error

    def descriptor(self) -> int | None:
        """Return the port's; None where it has none."""
        try:
            return int(self._port.fileno()) if self._port is not None else None
        except (AttributeError, OSError):
            return None

    def write_now(self, data: bytes) -> int:
        """Send as many octets as the port takes at once; on POSIX, to a port of this machine."""
        assert self._port is not None
        return _write_now(self._port.fileno(), data, f"writing to {self._url}")

    def close(self) -> None:
        """Close the port."""
        if self._port is not None:
            with suppress(OSError, TypeError):  # it went away before
                self._port.close()


def transport_for(url: str, options: LineOptions) -> Callable[[], LineTransport]:
    """Return what makes a transport for a URL: `tcp://host:port`, or a form of pyserial.

    Raises:
        ValueError: `tcp://` without host and port.
    """
    address = tcp_address(url)
    if address is None:
        return lambda: SerialTransport(url, options)
    return lambda: TcpTransport(*address)


def _write_now(descriptor: int, data: bytes, what: str) -> int:
    """Write to what was made non-blocking: sockets with a limit are, and the ports of pyserial."""
    try:
        return os.write(descriptor, data)
    except BlockingIOError:
        return 0
    except _FAILURES as error:
        raise _line_error(what, error) from error


def _line_error(what: str, error: Exception) -> LineError:
    return LineError(f"{what}: {reason_of(error)}")


def _is_pseudo_terminal(path: str) -> bool:
    try:
        return os.major(Path(path).stat().st_rdev) in _PSEUDO_TERMINALS
    except OSError:
        return False
