"""A link that can be stalled and cut: a TCP proxy on loopback."""

from __future__ import annotations

import contextlib
import socket
import struct
import threading

__all__ = ["Proxy"]

_OCTETS = 65_536
_RESET = struct.pack("ii", 1, 0)


class Proxy:
    """Passes octets between whoever connects to `port` and a port behind it.

    Args:
        behind: the port on loopback to which it connects.

    Attributes:
        port: where it listens.
    """

    def __init__(self, behind: int) -> None:
        self._behind = behind
        self._listening = socket.create_server(("127.0.0.1", 0))
        self.port: int = self._listening.getsockname()[1]
        self._lock = threading.Lock()
        self._open: set[socket.socket] = set()
        self._is_cut = False
        self._passing = threading.Event()
        self._passing.set()
        threading.Thread(target=self._accept, daemon=True).start()

    def stall(self) -> None:
        """Pass nothing, in either direction; nobody is told."""
        self._passing.clear()

    def cut(self) -> None:
        """Reset every connection, and each one that is tried."""
        with self._lock:
            self._is_cut = True
            for one in self._open:
                _reset(one)
            self._open.clear()

    def mend(self) -> None:
        """Pass again what was stalled, and let connections in."""
        with self._lock:
            self._is_cut = False
        self._passing.set()

    def close(self) -> None:
        """Cut it for good."""
        self._listening.close()
        self.cut()
        self._passing.set()

    def _accept(self) -> None:
        with contextlib.suppress(OSError):
            while True:
                self._enter(self._listening.accept()[0])

    def _enter(self, near: socket.socket) -> None:
        with self._lock:
            if self._is_cut:
                _reset(near)
                return
        try:
            far = socket.create_connection(("127.0.0.1", self._behind))
        except OSError:
            _reset(near)
            return
        for one in (near, far):
            one.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        with self._lock:
            self._open |= {near, far}
        for ends in ((near, far), (far, near)):
            threading.Thread(target=self._pass_on, args=ends, daemon=True).start()

    def _pass_on(self, source: socket.socket, target: socket.socket) -> None:
        with contextlib.suppress(OSError):
            while data := source.recv(_OCTETS):
                self._passing.wait()
                target.sendall(data)
        for one in (source, target):
            with self._lock:
                self._open.discard(one)
            with contextlib.suppress(OSError):
                one.shutdown(socket.SHUT_RDWR)
            one.close()


def _reset(one: socket.socket) -> None:
    with contextlib.suppress(OSError):
        one.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, _RESET)
        one.shutdown(socket.SHUT_RDWR)
    one.close()
