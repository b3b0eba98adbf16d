"""The course of a connection: the plan that runs behind its handle, from opening to end."""

from __future__ import annotations

import itertools
import threading
from collections.abc import Callable

from uoarm._control._heirs import names
from uoarm._control._history import History
from uoarm._control._life import Life
from uoarm._control._live import LiveComponent
from uoarm._control._opening import OpenPlan
from uoarm._control._reception import MakeRoute, Reception
from uoarm._dataplane import Route
from uoarm.errors import ConnectionClosedError
from uoarm.model import ConnectionState, Plan, QueuePolicy, RouteStatus

__all__ = ["Course"]


class Course:
    """What the manager does with a connection. All methods may be called from any thread.

    Args:
        identity: of the connection.
        opened: the first plan, not open yet.
        queue: of the application's inbox.
        output: the output that the application receives, None where it receives none.
        receive: makes the route of a plan's messages; None where the application receives none.
    """

    def __init__(
        self,
        identity: str,
        opened: OpenPlan,
        queue: QueuePolicy,
        *,
        output: str | None = None,
        receive: MakeRoute | None = None,
    ) -> None:
        self.id = identity
        self.opened = opened
        self.output = output
        self.reception = Reception(queue, receive)
        self.life = Life()
        self.history = History()
        self.succeeding = threading.Lock()
        self._numbers = itertools.count(2)  # of its plans, also of those opened in vain
        self._tell: Callable[[], None] | None = None

    @property
    def plan(self) -> Plan:
        """The plan that runs."""
        return self.opened.plan

    def open(self) -> None:
        """Open the first plan; called once.

        Raises:
            UoarmError: something could not be opened. Everything is closed again.
        """
        self._changed()
        try:
            self.open_plan(self.opened, None, is_heard=True)
        except BaseException:
            self.opened.close()
            raise
        if not self.life.start():
            self.opened.close()
            text = f"connection {self.id} ended while it was being opened"
            raise ConnectionClosedError(f"{text}: {self.life.cause or 'kill'}")
        self._changed()

    def open_plan(self, opened: OpenPlan, before: OpenPlan | None, *, is_heard: bool) -> None:
        """Open a plan as the application wished the first one.

        Args:
            opened: the plan.
            before: the plan so far, whose ends stay where the provider does.
            is_heard: whether the application hears a new provider from its first message on.

        Raises:
            UoarmError: something could not be opened; the caller closes the plan.
        """

        def receive() -> Route | None:
            route = self.reception.route(opened.plan)
            if is_heard:
                self.reception.hear(route)
            return route

        opened.open(self.output, receive, None if before is None else before.ends)

    def successor(self, plan: Plan, *, beside: bool) -> OpenPlan:
        """Return a plan to be opened as the application wished the first one.

        It stands `beside` the plan so far where that is not dead.
        """
        first = self.opened
        user = f"{self.id}#{next(self._numbers)}"
        return OpenPlan(plan, user, first.pool, first.validate, first.clock, beside)

    def wait(self, cause: str) -> None:
        """Wait for what can take over, and tell of it; nothing new where it waits already."""
        if self.life.wait(cause):
            self._changed()

    def change(self, swap: Callable[[], None]) -> None:
        """Do a quick `swap` of plans that no end can come between.

        Raises:
            ConnectionClosedError: the connection has ended.
        """
        waited = self.life.state is ConnectionState.WAITING
        if not self.life.change(swap):
            raise ConnectionClosedError(f"connection {self.id} has ended: {self.life.cause}")
        if waited:
            self._changed()

    def components(self) -> tuple[str, ...]:
        """Return the components of the plan; while it waits, those that are left of it."""
        waits = self.life.state is ConnectionState.WAITING
        lost = self.opened.lost() if waits else frozenset[str]()
        return tuple(name for name in names(self.plan) if name not in lost)

    def end(self, state: ConnectionState, cause: str, dead: tuple[LiveComponent, ...] = ()) -> None:
        """End with a state and a cause, and close what only this connection used.

        What was under way in components that are `dead` is counted as lost.
        """
        if not self.life.begin_end(cause):
            return
        try:
            self.opened.close()
            lost = self.history.lost_with(dead)
            self.history.settle(lost, self.history.ended_edges(self.opened))
        finally:
            self.life.finish(state)
            self._changed()  # before the reader hears of the end, so that its status agrees
            self.reception.inbox.close(discard=state is ConnectionState.CLOSED and not cause)

    def on_change(self, tell: Callable[[], None]) -> None:
        """Have every change of state told."""
        self._tell = tell

    def uses(self, live: LiveComponent) -> bool:
        """Say whether the running plan depends on an open component."""
        return self.opened.uses(live)

    def drain(self, timeout: float) -> None:
        """Wait until what is under way has reached the application.

        Waits `timeout` seconds at most for the opening, and as long for each queue.
        """
        self.life.wait_opened(timeout)
        self.opened.drain(timeout)

    def routes(self) -> tuple[RouteStatus, ...]:
        """Return the counters of the routes that belong to this connection alone."""
        return tuple(route.status() for route in self.opened.routes())

    def _changed(self) -> None:
        if self._tell is not None:
            self._tell()
