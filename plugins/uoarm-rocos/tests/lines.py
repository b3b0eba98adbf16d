"""Real lines for tests: a pseudo-terminal pair, and a listening socket on loopback."""

from __future__ import annotations

import itertools
import os
import select
import socket
import tempfile
import tty
from collections.abc import Iterator
from contextlib import closing, contextmanager
from pathlib import Path

from typing_extensions import Self

from uoarm.testing import patience

LIMIT = patience()
_LINKS = tempfile.TemporaryDirectory(prefix="uoarm-rocos-")
_COUNT = itertools.count()


def fresh_link() -> str:
    """A path for a port that no other test ever has, as numbers of pseudo-terminals come again."""
    return str(Path(_LINKS.name) / f"port{next(_COUNT)}")


class PseudoTerminal:
    """The device's end of a tty; the host opens `path`. `cut` is the cable pulled out."""

    def __init__(self) -> None:
        device, line = os.openpty()
        tty.setraw(line)
        self.path = fresh_link()
        Path(self.path).symlink_to(os.ttyname(line))
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
        Path(self.path).unlink(missing_ok=True)
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
