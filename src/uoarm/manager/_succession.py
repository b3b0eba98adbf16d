"""Successions: one plan goes on behind a handle where another one stood."""

from __future__ import annotations

from types import TracebackType

from attrs import evolve
from typing_extensions import Self

from uoarm.errors import BridgeTimeoutError, ConnectionClosedError
from uoarm.flow import Clock
from uoarm.manager._course import Course
from uoarm.manager._heirs import names
from uoarm.manager._history import Counting, dropped_by_reason
from uoarm.manager._live import LiveComponent
from uoarm.manager._opening import OpenPlan
from uoarm.model import Gap, Plan

__all__ = ["Succession"]

_TURN_SECONDS = 60.0
_RUN_OUT_SECONDS = 2.0


class Succession:
    """Changes the plan of one connection: opened on entry, heard from `take` on, then finished.

    On leaving, a plan that was not taken is closed again, and the one so far still stands.

    Args:
        course: of the connection.
        plan: what is to go on.
        clock: seconds that only grow.
        is_dead: whether the plan so far is dead: the application then hears a new provider
            from its first message on, and else from when it is taken.
    """

    def __init__(self, course: Course, plan: Plan, clock: Clock, *, is_dead: bool) -> None:
        self.course = course
        self._clock = clock
        self._is_dead = is_dead
        self._plan = plan
        self._before: OpenPlan  # as it is on entry
        self._opened: OpenPlan
        self._taken: Gap | None = None

    def __enter__(self) -> Self:
        """Open the plan.

        Raises:
            UoarmError: something could not be opened; everything is closed again.
        """
        if not self.course.succeeding.acquire(timeout=_TURN_SECONDS):
            raise BridgeTimeoutError(f"connection {self.course.id} is still changing its plan")
        self._before = self.course.opened
        self._opened = self.course.successor(self._plan, beside=not self._is_dead)
        try:
            self.course.open_plan(self._opened, self._before, is_heard=self._is_dead)
        except BaseException:
            self._abandon()
            self.course.reception.hear(self._before.ends.route)
            self.course.succeeding.release()
            raise
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        if self._taken is None:
            self._abandon()
        self.course.succeeding.release()

    @property
    def opened(self) -> OpenPlan:
        """The plan that is to go on."""
        return self._opened

    def take(self, since: float, cause: str) -> None:
        """Let the plan go on from here.

        Args:
            since: when messages ceased, on the clock.
            cause: why.

        Raises:
            ConnectionClosedError: the connection has ended meanwhile.
        """
        now = self._clock()

        def swap() -> None:
            stays = self._opened.ends is self._before.ends
            self._opened.inherit(self._before)
            self.course.opened = self._opened
            reception = self.course.reception
            reception.hear(self._opened.ends.route)
            self._taken = Gap(
                time=now,
                position=reception.arrived if stays else reception.began,
                seconds=now - since,
                lost=0,
                before=names(self._before.plan),
                after=names(self._opened.plan),
                cause=cause,
            )

        if not self.course.life.change(swap):
            cause = self.course.life.cause
            raise ConnectionClosedError(f"connection {self.course.id} has ended: {cause}")

    def finish(self, dead: tuple[LiveComponent, ...] = ()) -> None:
        """Let the plan so far run out, close it, and count what went with it all the same.

        Called after `take`, outside the context.

        Args:
            dead: the components that died; what was under way in them is counted as lost.
        """
        assert self._taken is not None, "only what was taken is finished"
        self._before.run_out(_RUN_OUT_SECONDS)
        self._before.close()
        lost = self.course.history.lost_with((*dead, *_closed(self._before)))
        ended = self._ended_with(self._before)
        dropped = dropped_by_reason(route.status() for route in ended)
        gap = evolve(self._taken, lost=lost, dropped=dropped)
        self.course.history.add(gap, ended)

    def _abandon(self) -> None:
        """Close a plan that was opened in vain, and count what went with it."""
        self._opened.close()
        history = self.course.history
        lost = history.lost_with(_closed(self._opened))
        history.settle(lost, self._ended_with(self._opened))

    def _ended_with(self, plan: OpenPlan) -> tuple[Counting, ...]:
        """Return the routes that ended with one of the two plans."""
        ends = () if self._opened.shares_ends(self._before) else plan.routes()
        return (*ends, *self.course.history.ended_edges(plan))


def _closed(plan: OpenPlan) -> list[LiveComponent]:
    return [live for live in plan.components if live.is_closed]
