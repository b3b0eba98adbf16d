"""Runs a simulated device on its end of a line, with faults where they are asked for."""

from __future__ import annotations

import errno
import os
import random
import select
import socket
import sys
import threading
import time
from abc import ABC, abstractmethod
from contextlib import suppress
from pathlib import Path
from typing import Protocol

from attrs import frozen

from uoarm.bridge import on_failure
from uoarm.errors import BridgeError, ListenError

_MOST = 65_536
_WRITE_SECONDS = 1.0


class LineEnd(ABC):
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


class PtyEnd(LineEnd):
    """A new pseudo-terminal; `link`, where given, always points to the present one.

    Raises:
        OSError: the link cannot be made, or something else stands there, which stays.
    """

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
            with on_failure(self._shut):
                self._point(path)
        self.where = self._link or path

    def _point(self, path: str) -> None:
        link = Path(self._link)
        if link.exists() and not link.is_symlink():
            raise FileExistsError(errno.EEXIST, os.strerror(errno.EEXIST), self._link)
        fresh = Path(f"{self._link}.new")
        fresh.unlink(missing_ok=True)
        fresh.symlink_to(path)
        fresh.replace(link)

    def meet(self, timeout: float) -> bool:
        """Return at once: a host that opens the port cannot be noticed."""
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
        """Send octets; a port that is not read overflows."""
        while data and select.select([], [self._device], [], _WRITE_SECONDS)[1]:
            os.set_blocking(self._device, False)
            with suppress(BlockingIOError):
                data = data[os.write(self._device, data) :]
                continue
            return

    def cut(self) -> None:
        """Remove the port; the next one has another number and the same link."""
        self._shut()
        if self._link:
            Path(self._link).unlink(missing_ok=True)

    def _shut(self) -> None:
        if self._device >= 0:
            os.close(self._device)
            os.close(self._line)
            self._device = -1

    def close(self) -> None:
        """Remove the port."""
        self.cut()


class TcpEnd(LineEnd):
    """A listening socket on loopback; port 0 takes a free one.

    Raises:
        ListenError: the port cannot be had.
    """

    framed = True

    def __init__(self, port: int = 0) -> None:
        try:
            self._server = socket.create_server(("127.0.0.1", port))
        except OSError as error:
            raise ListenError(f"127.0.0.1:{port}", port, error) from error
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


_STEP_SECONDS = 0.005
_MEET_SECONDS = 0.2


@frozen
class LineFaults:
    """What goes wrong on the way to the host.

    Attributes:
        drop: chance for each frame to be lost.
        garble: chance for each frame to have one octet changed.
        delay: seconds by which every frame is late.
        disconnect: seconds after which the cable is pulled out, and put in again; None: never.
        seed: of the dice; the same seed gives the same faults.
    """

    drop: float = 0.0
    garble: float = 0.0
    delay: float = 0.0
    disconnect: float | None = None
    seed: int = 0


class Simulated(Protocol):
    """A device without any I/O: octets and a time in, frames out."""

    def begin(self, now: float) -> None:
        """A new host is there, or the line was opened."""

    def receive(self, data: bytes, now: float) -> list[bytes]:
        """Take octets of the host; return frames to send.

        Raises:
            BridgeError: the host breaks the protocol; it is cut off.
        """

    def step(self, now: float) -> list[bytes]:
        """Return the frames that are due."""


def run(
    device: Simulated, end: LineEnd, stop: threading.Event, faults: LineFaults | None = None
) -> None:
    """Run a device until `stop` is set; then everything is closed."""
    way = _FaultyTransport(end, faults or LineFaults())
    try:
        while not stop.is_set():
            if end.meet(_MEET_SECONDS):
                _serve(device, end, way, stop)
    finally:
        end.close()


def _serve(device: Simulated, end: LineEnd, way: _FaultyTransport, stop: threading.Event) -> None:
    began = time.monotonic()
    device.begin(began)
    way.begin()
    while not stop.is_set():
        data = end.read(_STEP_SECONDS)
        now = time.monotonic()
        if data is None:
            return
        try:
            frames = device.receive(data, now) if data else []
        except BridgeError:
            end.cut()
            return
        way.send([*frames, *device.step(now)], now)
        if way.cut_due(now - began):
            end.cut()
            return


class _FaultyTransport:
    """The way to the host, where things go wrong."""

    def __init__(self, end: LineEnd, faults: LineFaults) -> None:
        self._end = end
        self._faults = faults
        self._is_faultless = not (faults.drop or faults.garble or faults.delay)
        self._dice = random.Random(faults.seed)  # noqa: S311 - faults to be repeated, no secrets
        self._late: list[tuple[float, bytes]] = []

    def begin(self) -> None:
        """Forget what was on its way to the host before."""
        self._late.clear()

    def send(self, frames: list[bytes], now: float) -> None:
        """Send frames, and those whose delay is over."""
        if self._is_faultless:
            for frame in frames:
                self._end.write(frame)
            return
        for frame in frames:
            if self._dice.random() >= self._faults.drop:
                self._late.append((now + self._faults.delay, self._garbled(frame)))
        while self._late and self._late[0][0] <= now:
            self._end.write(self._late.pop(0)[1])

    def cut_due(self, elapsed: float) -> bool:
        """Say whether it is time to pull the cable out."""
        return self._faults.disconnect is not None and elapsed >= self._faults.disconnect

    def _garbled(self, frame: bytes) -> bytes:
        if self._dice.random() >= self._faults.garble:
            return frame
        place = self._dice.randrange(len(frame))
        return (
            frame[:place] + bytes([frame[place] ^ self._dice.randint(1, 255)]) + frame[place + 1 :]
        )
