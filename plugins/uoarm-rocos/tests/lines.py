"""Real lines for tests: a pseudo-terminal pair, and a listening socket on loopback."""

from __future__ import annotations

import os
import select
import socket
import tty
from collections.abc import Iterator
from contextlib import closing, contextmanager

from typing_extensions import Self

__all__ = ["LIMIT", "PseudoTerminal", "listening"]

LIMIT = 5.0


class PseudoTerminal:
    """The device's end of a tty; the host opens `path`. `cut` is the cable pulled out."""

    def __init__(self) -> None:
        device, line = os.openpty()
        tty.setraw(line)
        self.path = os.ttyname(line)
        self._device = os.fdopen(device, "r+b", buffering=0)
        self._line = os.fdopen(line, "r+b", buffering=0)

    def fileno(self) -> int:
        return self._device.fileno()

    def write(self, data: bytes) -> None:
        while data:
            data = data[self._device.write(data) :]

    def read(self, count: int) -> bytes:
        """Read so many octets, or what came within the limit."""
        found = b""
        while len(found) < count and select.select([self._device], [], [], LIMIT)[0]:
            found += self._device.read(count - len(found)) or b""
        return found

    def read_some(self) -> bytes:
        """Read what is there."""
        return self._device.read(10_000) or b""

    def cut(self) -> None:
        self._device.close()
        self._line.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *error: object) -> None:
        self.cut()


@contextmanager
def listening() -> Iterator[tuple[socket.socket, int]]:
    """A server on loopback and its port."""
    with closing(socket.create_server(("127.0.0.1", 0))) as server:
        server.settimeout(LIMIT)
        yield server, server.getsockname()[1]
