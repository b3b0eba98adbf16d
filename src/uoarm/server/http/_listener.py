"""Listening sockets that wait, where the process may open no more files, instead of spinning."""

from __future__ import annotations

import asyncio
import errno
import os
import socket
import sys
import time
from collections.abc import Callable
from typing import Any

from uoarm._forks import close_in_children
from uoarm._raised import Log, on_failure

_log = Log("uoarm.server")
_EXHAUSTED = frozenset({errno.EMFILE, errno.ENFILE, errno.ENOBUFS, errno.ENOMEM})
_ABSENT = frozenset({errno.EADDRNOTAVAIL, errno.EAFNOSUPPORT})
# asyncio takes a socket out of its loop for a second after an error of these, but not before it has
# tried a hundred times, each of which puts the socket back after its own second.
_PAUSE_SECONDS = 0.5
_SILENT_SECONDS = 60.0
BACKLOG = 1024
_AT_ONCE = 2


class NoRoomError(OSError):
    """A connection could not be accepted, for want of descriptors or memory; it was logged."""


class ListeningSocket(socket.socket):
    """A listening socket whose `accept` fails once in a while, not as often as it is called.

    After a few connections it takes no more until the loop asks again: asyncio would take all that
    wait in one turn of its loop, in which no other client is served.

    Args:
        clock: monotonic seconds.
        arguments: of `socket.socket`.
    """

    def __init__(self, *arguments: Any, clock: Callable[[], float] = time.monotonic) -> None:
        super().__init__(*arguments)
        self._clock = clock
        self._paused_till = self._silent_till = clock()
        self._unlogged = 0
        self._failed = False
        self._accepted = 0  # since the loop asked

    def fileno(self) -> int:
        """Return the descriptor.

        Raises:
            NoRoomError: it was closed in a pause, after which asyncio would listen again.
        """
        number = super().fileno()
        if number < 0 and self._failed:
            raise NoRoomError(errno.EBADF, "closed in a pause")
        return number

    def accept(self) -> tuple[socket.socket, Any]:
        """Accept a connection.

        Raises:
            NoRoomError: there is no room for one; asyncio tries again after a second.
            BlockingIOError: no client connects, it is others' turn, or there was no room.
        """
        if self._clock() < self._paused_till:
            raise BlockingIOError(errno.EAGAIN, "there was no room a moment ago")
        if self._accepted == _AT_ONCE:
            self._accepted = 0
            raise BlockingIOError(errno.EAGAIN, "others have their turn first")
        self._accepted += 1
        try:
            connection, place = super().accept()
        except OSError as error:
            self._accepted = 0
            if error.errno not in _EXHAUSTED:
                raise
            self._paused_till = self._clock() + _PAUSE_SECONDS
            self._failed = True
            self._log(error)
            raise NoRoomError(error.errno, error.strerror) from error
        close_in_children(connection)
        return connection, place

    def _log(self, error: OSError) -> None:
        if self._clock() < self._silent_till:
            self._unlogged += 1
            return
        self._silent_till = self._clock() + _SILENT_SECONDS
        _log.error(
            "no connection can be taken: %s; it is tried once a second (%d failures before were "
            "not logged)",
            error.strerror,
            self._unlogged,
        )
        self._unlogged = 0


async def listen(host: str, port: int) -> list[ListeningSocket]:
    """Return sockets that listen at all addresses of a name, on one port.

    Raises:
        OSError: the port is taken, or the name has no address here.
    """
    loop = asyncio.get_running_loop()
    found = await loop.getaddrinfo(
        host or None, port, type=socket.SOCK_STREAM, flags=socket.AI_PASSIVE
    )
    bound: list[ListeningSocket] = []
    absent: OSError | None = None
    try:
        for family, kind, protocol, _, address in dict.fromkeys(found):
            chosen = (address[0], port, *address[2:])
            try:
                bound.append(_bound(ListeningSocket(family, kind, protocol), chosen))
            except OSError as error:
                if error.errno not in _ABSENT:
                    raise
                absent = error  # such as ::1 where IPv6 is switched off
            else:
                port = bound[-1].getsockname()[1]
    except BaseException:
        for listener in bound:
            listener.close()
        raise
    if not bound:
        raise absent or OSError(errno.EADDRNOTAVAIL, f"{host!r} has no address here")
    return bound


def _bound(listener: ListeningSocket, address: tuple[Any, ...]) -> ListeningSocket:
    with on_failure(listener.close):
        if os.name == "posix":
            listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        if listener.family == socket.AF_INET6:
            listener.setsockopt(socket.IPPROTO_IPV6, socket.IPV6_V6ONLY, 1)
        listener.bind(address)
        listener.setblocking(False)
        listener.listen(BACKLOG)
        close_in_children(listener)
    return listener


def connections_possible(wanted: int) -> int:
    """Return how many connections there may be: at most half of the files of this process.

    The other half is the robot's: a flood of connections must not keep it from opening a device.
    """
    if sys.platform == "win32":
        return wanted
    import resource  # noqa: PLC0415 - not everywhere

    files = resource.getrlimit(resource.RLIMIT_NOFILE)[0]
    return wanted if files == resource.RLIM_INFINITY else min(wanted, max(files // 2, 1))
