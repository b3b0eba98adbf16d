"""Outlets: where the messages of one open output fan out to its routes."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from contextlib import contextmanager

from uoarm._dataplane._route import Route
from uoarm.model import Message

__all__ = ["Outlet"]


class _Turn:
    """One route of an output that retains: it gets no message twice, and none after a newer one.

    The lock orders the thread that brings messages with one that joins: without it, the retained
    message could overtake, or be overtaken by, the one that replaces it.
    """

    __slots__ = ("lock", "number", "route")

    def __init__(self, route: Route) -> None:
        self.route = route
        self.number = 0
        self.lock = threading.RLock()

    def deliver(self, number: int, message: Message) -> None:
        with self.lock:
            if number > self.number:
                self.number = number
                self.route.deliver(message)

    def deliver_again(self, number: int, message: Message) -> None:
        """Deliver what counts for another route already, or as unheard."""
        with self.lock:
            if number > self.number:
                self.route.copies += 1
                self.deliver(number, message)


class Outlet:
    """The routes that one output feeds.

    `deliver` reads a tuple that `attach` and `detach` replace, so that it needs no lock. Only
    an output that retains, or of which that is not known yet, takes one for each message.

    Attributes:
        unheard: messages that came while no route was there.
    """

    __slots__ = ("_last", "_lock", "_retains", "_routes", "_turns", "unheard")

    def __init__(self) -> None:
        self._routes: tuple[Route, ...] = ()
        self._lock = threading.Lock()
        self._retains: bool | None = None
        self._turns: dict[Route, _Turn] = {}
        self._last: tuple[int, Message] = 0, None
        self.unheard = 0

    @property
    def routes(self) -> tuple[Route, ...]:
        """The routes attached now."""
        return self._routes

    def retain(self, retains: bool) -> None:  # noqa: FBT001 - the source's answer
        """Say, once the source is open, whether the last message is for those who join later.

        Until then the last one is kept, since a framework may hand it over while it opens.
        """
        with self._lock:
            self._retains = retains
            turns, last = tuple(self._turns.values()), self._last
            if not retains:
                self._turns, self._last = {}, (0, None)
        if retains:
            for turn in turns:
                turn.deliver_again(*last)

    def deliver(self, message: Message) -> None:
        """Hand one message to every route. Never raises."""
        if self._retains is not False and self._deliver_kept(message):
            return
        routes = self._routes
        for route in routes:
            route.deliver(message)
        for other in routes[1:]:
            other.copies += 1
        if not routes:
            self.unheard += 1

    def _deliver_kept(self, message: Message) -> bool:
        """Hand a message over and keep it; False where it turns out that none is retained."""
        with self._lock:
            if self._retains is False:  # said while this waited for the lock: no route has a turn
                return False
            number = self._last[0] + 1
            self._last = number, message
            turns = tuple(self._turns.values())
        for turn in turns[:1]:
            turn.deliver(number, message)
        for turn in turns[1:]:
            turn.deliver_again(number, message)
        if not turns:
            self.unheard += 1
        return True

    def attach(self, route: Route) -> None:
        """Feed a route from the next message on, and no more those that were closed meanwhile.

        An output that retains gives it the last message first, in this thread.

        A closed route counts what is lost as long as nobody has taken its place; from the message
        on that another one gets, it would be counted twice.
        """
        turn = _Turn(route)
        with self._lock:
            kept = [other for other in self._routes if not other.closed]
            self._routes = (*kept, route)
            if self._retains is not False:
                self._turns = {**{other: self._turns[other] for other in kept}, route: turn}
            last = self._last
        if self._retains:
            turn.deliver_again(*last)

    @contextmanager
    def letting_through(self, route: Route) -> Iterator[None]:
        """Give a route, which dropped what came so far, the retained message after the block.

        The block ends the dropping. Messages wait meanwhile, so that none comes twice.
        """
        turn = self._turns.get(route)
        if turn is None:
            yield
            return
        with turn.lock:
            yield
            if self._retains:
                turn.number = 0
                turn.deliver_again(*self._last)

    def detach(self, route: Route) -> None:
        """Feed a route no more; a message under way may still reach it."""
        with self._lock:
            self._routes = tuple(other for other in self._routes if other is not route)
            self._turns.pop(route, None)
