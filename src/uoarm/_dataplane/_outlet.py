"""Outlets: where the messages of one open output fan out to its routes."""

from __future__ import annotations

import threading

from uoarm._dataplane._route import Route
from uoarm.model import Message

__all__ = ["Outlet"]


class Outlet:
    """The routes that one output feeds.

    `deliver` reads a tuple that `attach` and `detach` replace, so that it needs no lock.

    Attributes:
        unheard: messages that came while no route was there.
    """

    __slots__ = ("_lock", "_routes", "unheard")

    def __init__(self) -> None:
        self._routes: tuple[Route, ...] = ()
        self._lock = threading.Lock()
        self.unheard = 0

    @property
    def routes(self) -> tuple[Route, ...]:
        """The routes attached now."""
        return self._routes

    def deliver(self, message: Message) -> None:
        """Hand one message to every route. Never raises."""
        routes = self._routes
        for route in routes:
            route.deliver(message)
        if not routes:
            self.unheard += 1

    def attach(self, route: Route) -> None:
        """Feed a route from the next message on, and no more those that were closed meanwhile.

        A closed route counts what is lost as long as nobody has taken its place; from the message
        on that another one gets, it would be counted twice.
        """
        with self._lock:
            self._routes = (*(other for other in self._routes if not other.closed), route)

    def detach(self, route: Route) -> None:
        """Feed a route no more; a message under way may still reach it."""
        with self._lock:
            self._routes = tuple(other for other in self._routes if other is not route)
