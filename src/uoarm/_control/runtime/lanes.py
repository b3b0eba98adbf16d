"""Lanes: work that is done in order, by whoever waits for it or by a worker thread."""

from __future__ import annotations

import threading
from collections.abc import Callable
from queue import Empty, SimpleQueue
from typing import TypeAlias

from attrs import define, field, frozen

__all__ = ["Job", "Lanes"]

Job: TypeAlias = Callable[[], None]


@frozen
class _Done:
    """The reply that the driver of a lane waits for."""

    error: BaseException | None


@define(eq=False)
class _Lane:
    """Jobs, and whether somebody is doing them or waits for them.

    Attributes:
        are_quick: says of each job whether it is quick.
        is_waited_for: whether nothing is to be done in it yet.
    """

    jobs: SimpleQueue[Job | _Done] = field(factory=SimpleQueue)
    is_driven: bool = False
    has_begun: bool = False
    are_quick: tuple[Callable[[], bool], ...] = ()
    is_waited_for: bool = True


class Lanes:
    """Does the jobs of each lane one after another, those of several lanes at the same time.

    Args:
        start: begins a call in a worker thread; it does not wait for it.
    """

    def __init__(self, start: Callable[[Job], None]) -> None:
        self._start = start
        self._lock = threading.Lock()
        self._lanes: dict[str, _Lane] = {}

    def reserve(self, name: str) -> None:
        """Leave what comes into a new lane to a call of `drive`."""
        with self._lock:
            self._lanes[name] = _Lane(is_driven=True)

    def put(self, name: str, job: Job, *, is_quick: Callable[[], bool] | None = None) -> None:
        """Have a job done after the others of its lane. Waits for nothing.

        Args:
            name: of the lane.
            job: to be done; it raises nothing.
            is_quick: says whether it calls nothing that may hang; None: it may.
        """
        with self._lock:
            lane = self._lanes.get(name)
            if lane is None:
                lane = self._lanes[name] = _Lane()
            lane.jobs.put(job)
            lane.are_quick = (*lane.are_quick, is_quick or _never)
            lane.is_waited_for = False
            if lane.is_driven:
                return
            lane.is_driven = True
        self._start(lambda: self._serve(name, lane))

    def reply(self, name: str, error: BaseException | None) -> None:
        """End the `drive` of a lane after the jobs that are in it; nothing where there is none."""
        with self._lock:
            lane = self._lanes.get(name)
            if lane is not None:
                lane.jobs.put(_Done(error))
                lane.is_waited_for = False

    def is_quick(self, name: str) -> bool:
        """Say whether `drive` needs no time limit: there is something to do, all of it quick."""
        with self._lock:
            lane = self._lanes.get(name)
            are_quick = () if lane is None or lane.is_waited_for else lane.are_quick
        return bool(are_quick) and all(is_quick() for is_quick in are_quick)

    def drive(self, name: str) -> None:
        """Do the jobs of a lane that was reserved, in this thread, until the reply.

        Where that is interrupted, a worker thread goes on.

        Raises:
            BaseException: the error of the reply.
        """
        with self._lock:
            lane = self._lanes[name]
            lane.has_begun = True
        try:
            while not isinstance(job := lane.jobs.get(), _Done):
                job()
        except BaseException:
            self._start(lambda: self._serve(name, lane))
            raise
        with self._lock:
            del self._lanes[name]
        if job.error is not None:
            raise job.error

    def abandon(self, name: str) -> None:
        """Have a worker thread do the jobs of a lane that was reserved, unless `drive` began."""
        with self._lock:
            lane = self._lanes.get(name)
            if lane is None or lane.has_begun:
                return
            lane.has_begun = True
        self._start(lambda: self._serve(name, lane))

    def _serve(self, name: str, lane: _Lane) -> None:
        while True:
            try:
                job = lane.jobs.get_nowait()
            except Empty:
                with self._lock:
                    if lane.jobs.empty():
                        self._lanes.pop(name, None)
                        return
                continue
            if not isinstance(job, _Done):
                job()


def _never() -> bool:
    return False
