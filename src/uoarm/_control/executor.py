"""The executor: owns the state, gives `step` its events, and has the performer do what follows.

One thread at a time owns the state: the one that posts an event while it has no owner. It works
until no event is left, calls nothing foreign meanwhile and waits for nothing, so that a post is
quick and no event needs a thread of its own. Ctrl-C and SIGTERM, which may be raised after any
call in the main thread, wait until what that thread has begun is whole.
"""

from __future__ import annotations

import itertools
import logging
import os
import threading
import time
from collections import deque
from collections.abc import Iterable

from uoarm import _bounded
from uoarm._control.bridges import BridgeSet
from uoarm._control.engine import events as ev
from uoarm._control.engine.draft import by_age, connection_of
from uoarm._control.engine.events import write_event
from uoarm._control.engine.state import ComponentRecord, State, oldest_first
from uoarm._control.engine.step import step
from uoarm._control.live.component import LiveComponent
from uoarm._control.live.connection_runtime import ConnectionRuntime
from uoarm._control.live.edge import LiveEdge
from uoarm._control.live.parts import LiveParts
from uoarm._control.live.safety import EmergencyStop
from uoarm._control.performer import Performer
from uoarm._control.revisions import Revisions, StagedRevision
from uoarm._control.threads import EventDispatcher, Job, Lanes, Timer
from uoarm._dataplane import Clock
from uoarm._interrupts import Uninterrupted
from uoarm._resolve import keep_candidates
from uoarm._spans import current, span
from uoarm._workers import WorkerPool
from uoarm.bridge import HealthEvent
from uoarm.config import compare
from uoarm.errors import BridgeTimeoutError
from uoarm.model import Component, ComponentStatus, Health, Robot

__all__ = ["Executor"]

_LISTED_CHANGES = 20
_LANES = 8
_PATIENCE_SECONDS = 0.05
_log = logging.getLogger("uoarm")
_log_of_events = logging.getLogger("uoarm.control")


class Executor:
    """Runs the control plane of one manager. All methods may be called from any thread.

    Args:
        state: to begin with.
        bridges: of the manager.
        events: where changes are announced.
        revisions: of the configuration, in which plans are found.
        clock: seconds.
        emergency_stop: holds all inputs that move something.
    """

    def __init__(
        self,
        state: State,
        *,
        bridges: BridgeSet,
        events: EventDispatcher,
        revisions: Revisions,
        clock: Clock,
        emergency_stop: EmergencyStop,
    ) -> None:
        self._process = os.getpid()
        self.state = state
        self.live = LiveParts(
            bridges, lambda: self.state, clock, self._judged, emergency_stop, events.post
        )
        self._bridges = bridges
        self._revisions = revisions
        self._clock = clock
        self._events: deque[ev.Event] = deque()
        self._owning = threading.Lock()
        self._numbers = itertools.count()  # of those who wait
        # Thousands of lanes begin with the death of a bridge. A thread for each would fight for the
        # interpreter; but those that a bridge holds up must hold up no others.
        self._workers = WorkerPool("uoarm-lane", _LANES, patience=_PATIENCE_SECONDS)
        self._lanes = Lanes(self._start)
        self._timer = Timer(clock, lambda: self.post(ev.TimeReached()))
        self._performer = Performer(
            lambda: self.state,
            self.post,
            live=self.live,
            lanes=self._lanes,
            timer=self._timer,
            bridges=bridges,
            announcements=events,
            revisions=revisions,
        )

    def post(self, event: ev.Event) -> None:
        """Take an event. Quick: what follows from it may be done later, in other threads."""
        with Uninterrupted():
            self._events.append(event)
            self._work()

    def _work(self) -> None:
        # A thread that finds the state owned leaves its event to the owner, which looks once more
        # after it let go: an event that came between is not left lying.
        while self._events and self._owning.acquire(blocking=False):
            try:
                self._handle_all()
            finally:
                self._owning.release()

    def _handle_all(self) -> None:
        while self._events:
            self._handle(self._events.popleft())

    def request(
        self, runtime: ConnectionRuntime, event: ev.Requested, step_name: str, timeout: float
    ) -> None:
        """Post a request and wait until it is running.

        Raises:
            BridgeTimeoutError: it is not, in time; it is given up.
            UoarmError: it failed.
        """
        with span("request", function=str(event.wanted), connection=runtime.id):
            runtime.context = current()
            self._request(runtime, event, step_name, timeout)

    def _request(
        self, runtime: ConnectionRuntime, event: ev.Requested, step_name: str, timeout: float
    ) -> None:
        try:
            with Uninterrupted():
                self.live.runtimes[runtime.id] = runtime
                self._lanes.reserve(event.waiter)
                self.post(event)
                is_quick = self._lanes.is_quick(event.waiter)
                if is_quick:  # sharing what is open costs no hop
                    self._lanes.drive(event.waiter)
            if not is_quick:
                _bounded.run(step_name, timeout, lambda: self._lanes.drive(event.waiter))
        except BaseException as error:
            with Uninterrupted():
                self._lanes.abandon(event.waiter)
                self.kill(runtime.id, str(error) or type(error).__name__, is_failure=True)
                self.live.runtimes.pop(runtime.id, None)
            raise

    @property
    def is_foreign(self) -> bool:
        """Whether this is a forked child: what is open is its parent's, and locks may be held."""
        return os.getpid() != self._process

    def kill(self, identity: str, cause: str = "", *, is_failure: bool = False) -> None:
        """End a connection, and close in this thread what only it used. Idempotent."""
        if self.is_foreign:
            return
        waiter = f"kill {next(self._numbers)}"
        self._ask(ev.Killed(identity, waiter, cause, is_failure))

    def configure(self, staged: StagedRevision, timeout: float) -> None:
        """Put a configuration into force; wait until every connection has moved that can.

        What is sent and emitted from then on goes the new ways.

        Raises:
            BridgeTimeoutError: they have not in time; they go on with it.
        """
        robot = staged.revision.robot
        event = ev.Configured(
            staged.revision.number,
            f"configuration {staged.revision.number}",
            robot.failover,
            {component.name: component.bridge for component in robot.components()},
            staged.difference.superseded,
            staged.difference.functions,
        )
        step_name = f"changing to revision {event.revision} of the configuration"
        deadline = time.monotonic() + timeout
        try:
            with Uninterrupted():
                self._revisions.expect(staged)
                self._lanes.reserve(event.waiter)
                self.post(event)
            _bounded.run(step_name, timeout, lambda: self._lanes.drive(event.waiter))
        except BaseException:
            self._lanes.abandon(event.waiter)
            raise
        if not self._performer.wait_delivered(max(0.0, deadline - time.monotonic())):
            text = f"{step_name}: an application that is called now holds it up"
            raise BridgeTimeoutError(text)

    def change_candidates(self, robot: Robot) -> None:
        """Have other discovered candidates from now on; those in use stay as they run.

        Args:
            robot: the configuration in force, with these candidates.
        """
        # They were found in seconds, in which some may have been requested: what is in use is
        # known, and stays so until they are in force, only to who owns the state.
        with self._owning:
            self._handle_all()
            self._change_candidates(robot)
        self._work()  # what was left to the owner meanwhile

    def _change_candidates(self, robot: Robot) -> None:
        revision = self._revisions.current
        before, number = revision.robot, revision.candidates
        robot = keep_candidates(robot, self._candidates_in_use(before))
        if before.functions == robot.functions:
            return
        difference = compare(before, robot)
        if difference.changes:
            both = (*before.components(), *robot.components())
            every = {component.name: component.bridge for component in both}
            number += 1
            text, superseded = (
                "; ".join(difference.changes[:_LISTED_CHANGES]),
                difference.superseded,
            )
            # A plan with a new candidate can be found only after the state knows its bridge.
            self._handle(ev.CandidatesChanged(every, text, number, superseded))
        self._revisions.use_candidates(robot, difference.superseded, number)

    def _candidates_in_use(self, robot: Robot) -> Iterable[Component]:
        """Return the discovered components that are in use, as they run where they are shared."""
        state = self.state
        there = {component.name for component in state.components.values()}
        known = {
            component.name: component
            for component in robot.components()
            if component.match and component.name in there
        }
        shared = (state.components[number].step.component for number in state.serving.values())
        return (
            known | {component.name: component for component in shared if component.match}
        ).values()

    def _ask(self, event: ev.Killed | ev.Stopped) -> None:
        """Post an event and do what follows from it in this thread, until it is done."""
        with Uninterrupted():
            self._lanes.reserve(event.waiter)
            self.post(event)
            self._lanes.drive(event.waiter)

    def report(self, event: HealthEvent, *, is_avoided: bool = False) -> None:
        """Take a change of health; one of a channel that was closed is no news."""
        channel = event.channel
        part: object = "bridge" if event.component is None else "component"
        component = event.component
        if channel is not None:
            if channel.closed:
                return
            # Found by its endpoint: it may report before its opening has returned.
            component = channel.endpoint.component
            part = channel.endpoint.role, channel.endpoint.port
        spared = frozenset[int]()
        if event.health is Health.LOST and component is None:
            live = self.live.components.copy()
            spared = frozenset(
                n for n, value in live.items() if self._bridges.is_in_use(value.bridge)
            )
        self.post(
            ev.HealthReported(
                event.bridge, event.health, event.cause, component, part, spared, is_avoided
            )
        )

    def judge_service(self, component: Component, health: Health, cause: str) -> None:
        """Take a new verdict on what a service raises."""
        is_lost = health is Health.LOST
        self.post(
            ev.HealthReported(
                component.bridge,
                health,
                cause,
                component.name,
                "messages",
                is_avoided=is_lost,
                function=component.function,
            )
        )

    def connections(self) -> tuple[ConnectionRuntime, ...]:
        """Return the connections that have a plan and have not ended, oldest first."""
        runtimes = self.live.runtimes.copy()
        records = oldest_first(self.state.connections.values())
        found = (runtimes.get(record.id) for record in records)
        return tuple(
            runtime for runtime in found if runtime is not None and runtime.record is not None
        )

    def components(self) -> tuple[LiveComponent, ...]:
        """Return the components that are in use and well enough to be shared."""
        objects = self.live.components.copy()
        return tuple(objects[record.id] for record in self.state.shared() if record.id in objects)

    def edges(self) -> tuple[LiveEdge, ...]:
        """Return the edges that feed something."""
        objects = self.live.edges.copy()
        numbers = sorted(self.state.feeding.values())
        return tuple(objects[number] for number in numbers if number in objects)

    def component_statuses(self) -> tuple[ComponentStatus, ...]:
        """Return what the status map shows of components."""
        state, objects = self.state, self.live.components.copy()
        return tuple(_status(record, objects.get(record.id)) for record in state.shared())

    def deaths(self) -> tuple[tuple[str, int], ...]:
        """Return how often each component was lost."""
        return tuple(sorted(self._performer.deaths.copy().items()))

    def takeovers(self) -> tuple[tuple[str, int], ...]:
        """Return how often a plan took over, by function."""
        return tuple(sorted(self._performer.takeovers.copy().items()))

    def close(self) -> None:
        """End every connection, and take no more requests or times that are reached."""
        self._ask(ev.Stopped(f"close {next(self._numbers)}"))
        self._timer.close()
        self._workers.close()

    def _judged(self, number: int, health: Health, cause: str) -> None:
        """Take a new verdict on what an instance of a component raises, and no other of it."""
        state = self.state
        record = state.components.get(number)
        if record is None or state.serving.get(record.name) != number:
            return
        self.post(
            ev.HealthReported(
                record.step.component.bridge,
                health,
                cause,
                record.name,
                "messages",
                is_avoided=health is Health.LOST,
                instance=number,
            )
        )

    def _handle(self, event: ev.Event) -> None:
        now = self._clock()
        if _log_of_events.isEnabledFor(logging.DEBUG):
            _log_of_events.debug("%s", write_event(event, now))
        try:
            self.state, actions = step(self.state, event, now)
        except Exception:  # noqa: BLE001 - its caller must not pay for a fault of ours
            _log.exception("the control plane failed at %r", event)
            return
        if isinstance(event, ev.Opened):
            self._performer.opened(event)
        for action in actions:
            try:
                self._performer.perform(action)
            except Exception:  # noqa: BLE001 - nor do the actions that come after it
                _log.exception("the control plane failed to do %r", action)

    def _start(self, job: Job) -> None:
        """Have a lane served by a worker; what comes late is closed after the manager, too."""
        if not self._workers.submit(job):
            threading.Thread(target=job, name="uoarm-late", daemon=True).start()


def _status(record: ComponentRecord, live: LiveComponent | None) -> ComponentStatus:
    """Return what the status map shows of a component; its object is None while it opens."""
    channels = () if live is None else live.channel_statuses()
    return ComponentStatus(
        name=record.name,
        function=record.step.component.function,
        bridge=record.step.component.bridge,
        health=record.health.health,
        users=tuple(by_age(map(connection_of, record.users))),
        cause=record.health.cause,
        channels=channels,
        failed=0 if live is None else live.failures.failed,
        last_error="" if live is None else live.failures.last_error,
        lost=sum(channel.lost for channel in channels),
    )
