"""The ledger: the connections that are open, by id."""

from __future__ import annotations

import itertools
import threading

from uoarm._control._board import Board
from uoarm._control._connection import Connection
from uoarm._control._live import LiveComponent
from uoarm.errors import ConnectionClosedError

__all__ = ["Ledger"]


class Ledger:
    """Numbers connections, lists those that are open, and posts what becomes of them."""

    def __init__(self, board: Board) -> None:
        self._board = board
        self._numbers = itertools.count(1)
        self._connections: dict[str, Connection] = {}
        self._lock = threading.Lock()
        self._closed = False

    def new_id(self) -> str:
        """Return an id that no connection of this manager had before."""
        return f"c{next(self._numbers)}"

    def add(self, connection: Connection) -> None:
        """List a connection until it ends.

        Raises:
            ConnectionClosedError: the manager is closed.
        """
        with self._lock:
            self.require_open()
            self._connections[connection.id] = connection
        connection.course.on_change(lambda: self._changed(connection))

    def require_open(self) -> None:
        """Raise ConnectionClosedError when the manager is closed."""
        if self._closed:
            raise ConnectionClosedError("the robot manager is closed")

    def all(self) -> tuple[Connection, ...]:
        """Return the connections that have not ended, oldest first."""
        with self._lock:
            return tuple(self._connections.values())

    def users_of(self, live: LiveComponent) -> list[Connection]:
        """Return the connections that depend on an open component."""
        return [connection for connection in self.all() if connection.course.uses(live)]

    def close(self) -> tuple[Connection, ...]:
        """Admit no more connections; return those that are open."""
        with self._lock:
            self._closed = True
            return tuple(self._connections.values())

    def _changed(self, connection: Connection) -> None:
        status = connection.status()
        if connection.ended:
            with self._lock:
                self._connections.pop(connection.id, None)
        self._board.post(f"connection {status.id}", status.state.value, status.cause)
