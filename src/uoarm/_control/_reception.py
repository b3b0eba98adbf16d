"""Reception: the application's end of the messages, whichever plan they come from."""

from __future__ import annotations

from collections.abc import Callable

from uoarm._dataplane import Inbox, Route
from uoarm.model import Deliver, Message, Plan, QueuePolicy

__all__ = ["MakeRoute", "Reception"]

MakeRoute = Callable[[Plan, Deliver], Route]
"""Makes the route of the messages that a plan's provider emits."""


class Reception:
    """An inbox into which the route of one plan at a time delivers.

    Args:
        queue: what to do when the application is slower than the messages.
        make: makes the route of a plan; None where the application receives nothing.
    """

    def __init__(self, queue: QueuePolicy, make: MakeRoute | None) -> None:
        self.inbox = Inbox(queue, self._count_drop)
        self.arrived = 0
        self.began = 0
        self._make = make
        self._heard: Route | None = None

    @property
    def is_wanted(self) -> bool:
        """Whether the application receives anything."""
        return self._make is not None

    def route(self, plan: Plan) -> Route | None:
        """Make the route of a plan; while it is not heard its messages are dropped, counted."""
        if self._make is None:
            return None

        def arrive(message: Message) -> None:
            if route is self._heard:
                self.arrived += 1
                self.inbox.put(message)
            else:
                route.take_back("replaced")

        route = self._make(plan, arrive)
        return route

    def hear(self, route: Route | None) -> None:
        """Let the messages of this route through from now on, and of no other.

        `began` is how many messages had arrived before them.
        """
        if route is not self._heard:
            self._heard = route
            self.began = self.arrived

    def _count_drop(self, reason: str) -> None:
        if self._heard is not None:
            self._heard.take_back(reason)
