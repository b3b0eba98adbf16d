"""Whether a line has something to read, told to one thread only while no other reads it."""

from __future__ import annotations

import select

__all__ = ["Readiness"]


class Readiness:
    """Watches a descriptor for the line's own thread; on Linux.

    While another thread reads what comes, `ignore` keeps the watching one asleep: epoll takes that
    in while it waits, so that nobody has to be woken for it.
    """

    def __init__(self, descriptor: int) -> None:
        self._descriptor = descriptor
        self._epoll = select.epoll()
        self._epoll.register(descriptor, select.EPOLLIN)

    def wait(self, timeout: float) -> bool:
        """Wait at most so many seconds; return whether there is something to read, or an end."""
        return bool(self._epoll.poll(timeout))

    def ignore(self) -> None:
        """Have `wait` not return for what comes, but for an end."""
        self._epoll.modify(self._descriptor, 0)

    def heed(self) -> None:
        """Have `wait` return for what comes, or is there, again."""
        self._epoll.modify(self._descriptor, select.EPOLLIN)

    def close(self) -> None:
        """End; nobody waits any more."""
        self._epoll.close()
