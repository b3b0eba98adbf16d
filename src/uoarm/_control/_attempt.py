"""One attempt to open a connection, which its caller may give up at any moment."""

from __future__ import annotations

import threading

from uoarm._control._connection import Connection
from uoarm.errors import ConnectionClosedError
from uoarm.model import ConnectionState

__all__ = ["Attempt"]


class Attempt:
    """Keeps the worker that opens and the caller that waits from missing each other."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._connection: Connection | None = None
        self._is_given_up = False

    def adopt(self, connection: Connection) -> None:
        """Take the connection that is about to be opened.

        Raises:
            ConnectionClosedError: the caller has gone; nothing may be opened.
        """
        with self._lock:
            if self._is_given_up:
                raise ConnectionClosedError("the request was given up")
            self._connection = connection

    def give_up(self, cause: str) -> Connection | None:
        """End the connection, open or not, or keep one from being opened; return it."""
        with self._lock:
            self._is_given_up = True
            connection = self._connection
        if connection is not None:
            connection.course.end(ConnectionState.FAILED, cause)
        return connection
