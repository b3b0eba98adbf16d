"""Successions: one plan goes on behind a handle where another one stood."""

from __future__ import annotations

import threading
from types import TracebackType

from typing_extensions import Self

from uoarm._control._course import Course
from uoarm._control._heirs import names
from uoarm._control._history import Counting
from uoarm._control._live import LiveComponent
from uoarm._control._opening import OpenPlan
from uoarm._dataplane import Clock
from uoarm.errors import BridgeTimeoutError
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
        dead: the components of the plan so far that died, if any: the application then hears a
            new provider from its first message on, and else from when it is taken.
    """

    def __init__(
        self, course: Course, plan: Plan, clock: Clock, dead: tuple[LiveComponent, ...] = ()
    ) -> None:
        self.course = course
        self._clock = clock
        self._dead = dead
        self._before: OpenPlan  # as it is on entry
        self._opened = course.successor(plan, beside=not dead)
        self._taken: Gap | None = None
        self._deciding = threading.Lock()
        self._is_withdrawn = False
        self._has_turn = False

    def __enter__(self) -> Self:
        """Open the plan.

        Raises:
            UoarmError: something could not be opened; everything is closed again.
            BridgeTimeoutError: the connection has gone on without what is dead already.
        """
        self._wait_for_turn()
        self._before = self.course.opened
        try:
            self.course.open_plan(self._opened, self._before, is_heard=bool(self._dead))
        except BaseException:
            self._abandon()
            with self._deciding:
                if self._has_turn:
                    self.course.reception.hear(self._before.ends.route)
            self._end_turn()
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
        self._end_turn()

    @property
    def opened(self) -> OpenPlan:
        """The plan that is to go on."""
        return self._opened

    def newcomers(self, dead: frozenset[str] = frozenset()) -> str:
        """Name the components that go on where others, or `dead` ones of the same name, stood."""
        before = set(names(self._before.plan)) - dead
        after = names(self._opened.plan)
        return ", ".join([name for name in after if name not in before] or after[-1:])

    def take(self, since: float, cause: str) -> None:
        """Let the plan go on from here.

        Args:
            since: when messages ceased, on the clock.
            cause: why.

        Raises:
            ConnectionClosedError: the connection has ended meanwhile.
            BridgeTimeoutError: it was withdrawn, since it took too long.
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
                counted=False,
            )
            self.course.history.add(self._taken)

        with self._deciding:
            self._require_turn()
            if self._opened.shares_ends(self._before) or self._dead:
                self.course.change(swap)  # it hears them already
            else:
                with self._opened.ends.letting_through():
                    self.course.change(swap)

    def withdraw(self) -> bool:
        """Keep a plan that takes too long to open from being taken; False when it was already.

        Another one may be taken from now on. What is open of this one is closed, and what opens
        still as soon as it has opened.
        """
        with self._deciding:
            self._is_withdrawn = self._taken is None
        if self._is_withdrawn:
            self._opened.close()
            self._end_turn()
        return self._is_withdrawn

    def finish(self) -> None:
        """Let the plan so far run out, close it, and count what went with it all the same.

        Called after `take`, outside the context. What was under way in what died is lost.
        """
        assert self._taken is not None, "only what was taken is finished"
        self._before.run_out(_RUN_OUT_SECONDS)
        self._before.close()
        lost = self.course.history.lost_with((*self._dead, *_closed(self._before)))
        self.course.history.count(self._taken, lost, self._ended_with(self._before))

    def _wait_for_turn(self) -> None:
        if not self.course.succeeding.acquire(timeout=_TURN_SECONDS):
            raise BridgeTimeoutError(f"connection {self.course.id} is still changing its plan")
        with self._deciding:
            self._has_turn = not self._is_withdrawn and self._is_needed()
            if not self._has_turn:
                self.course.succeeding.release()
            self._require_turn()

    def _is_needed(self) -> bool:
        return not self._dead or any(map(self.course.uses, self._dead))

    def _require_turn(self) -> None:
        if not self._has_turn:
            raise BridgeTimeoutError(f"connection {self.course.id} has gone on without it")

    def _end_turn(self) -> None:
        with self._deciding:
            if self._has_turn:
                self._has_turn = False
                self.course.succeeding.release()

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
