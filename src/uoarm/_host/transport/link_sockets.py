"""The sockets of one end of a link: one for requests, and one for messages each way."""

from __future__ import annotations

import socket
from collections.abc import Sequence
from contextlib import ExitStack

from attrs import frozen

from uoarm._forks import close_in_children

__all__ = ["LinkSockets"]


@frozen
class LinkSockets:
    """One end of three connected pairs.

    Messages have a pair for each way: where an end reads and writes the same socket, its reading
    thread, which sleeps at it, is woken by the kernel whenever the other end takes what it wrote.

    Attributes:
        requests: read and written by both ends.
        incoming: only read here.
        outgoing: only written here.
    """

    requests: socket.socket
    incoming: socket.socket
    outgoing: socket.socket

    @classmethod
    def make(cls) -> tuple[LinkSockets, LinkSockets]:
        """Return both ends of a link.

        Raises:
            OSError: there are no descriptors left.
        """
        with ExitStack() as made:
            (asks, answers), (here, there), (from_here, to_there) = (_pair(made) for _ in range(3))
            made.pop_all()
        close_in_children(asks, here, from_here)
        return cls(asks, here, from_here), cls(answers, to_there, there)

    @classmethod
    def inherited(cls, descriptors: Sequence[int]) -> LinkSockets:
        """Return the end whose `descriptors` a process has inherited."""
        requests, incoming, outgoing = (
            socket.socket(fileno=descriptor) for descriptor in descriptors
        )
        close_in_children(requests, incoming, outgoing)
        return cls(requests, incoming, outgoing)

    @property
    def descriptors(self) -> tuple[int, int, int]:
        """What another process inherits of this end."""
        return self.requests.fileno(), self.incoming.fileno(), self.outgoing.fileno()

    def close(self) -> None:
        """Close all three. Idempotent."""
        for item in (self.requests, self.incoming, self.outgoing):
            item.close()


def _pair(made: ExitStack) -> tuple[socket.socket, socket.socket]:
    one, other = socket.socketpair()
    made.callback(one.close)
    made.callback(other.close)
    return one, other
