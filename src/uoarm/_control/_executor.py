"""The executor: owns the state, gives `step` its events, and does what it asks for.

One thread at a time owns the state: whoever posts an event while nobody does. It works until no
event is left, calls nothing foreign meanwhile and waits for nothing, so that a post is quick and no
event needs a thread of its own. Calls into bridges are made in lanes, by whoever waits for them or
by worker threads, under time limits, and come back as events.
"""

from __future__ import annotations

import itertools
import logging
import threading
from collections import Counter, deque
from collections.abc import Callable
from contextlib import AbstractContextManager
from functools import partial
from typing import Any

from uoarm import _bounded
from uoarm._control import _actions as act
from uoarm._control import _events as ev
from uoarm._control._application_ports import ApplicationPorts
from uoarm._control._bridges import BridgeSet
from uoarm._control._connection_runtime import ConnectionRuntime
from uoarm._control._draft import connection_of
from uoarm._control._event_dispatcher import EventDispatcher
from uoarm._control._lanes import Job, Lanes
from uoarm._control._live_component import LiveComponent
from uoarm._control._live_edge import LiveEdge
from uoarm._control._live_parts import LiveParts
from uoarm._control._revisions import Revisions, StagedRevision
from uoarm._control._searches import check_preferred, seek_replacement
from uoarm._control._state import PORTS, ComponentRecord, Part, State, names
from uoarm._control._step import step
from uoarm._control._timer import Timer
from uoarm._control._trace import write
from uoarm._dataplane import Clock
from uoarm._spans import current, past_span, span
from uoarm._workers import WorkerPool
from uoarm.bridge import HealthEvent
from uoarm.errors import BridgeTimeoutError, UoarmError
from uoarm.model import Component, ComponentStatus, Health

__all__ = ["Executor"]

_OPEN_SECONDS = 60.0
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
    """

    def __init__(
        self,
        state: State,
        *,
        bridges: BridgeSet,
        events: EventDispatcher,
        revisions: Revisions,
        clock: Clock,
    ) -> None:
        self.state = state
        self.live = LiveParts(bridges, lambda: self.state, clock, self._judged)
        self._bridges = bridges
        self._announcements = events
        self._deaths: Counter[str] = Counter()
        self._takeovers: Counter[str] = Counter()
        self._revisions = revisions
        self._clock = clock
        self._events: deque[ev.Event] = deque()
        self._owning = threading.Lock()
        self._numbers = itertools.count()  # of those who wait
        self._cancelled: set[int] = set()
        self._workers = WorkerPool("uoarm-lane")
        self._lanes = Lanes(self._start)
        self._timer = Timer(clock, lambda: self.post(ev.TimeReached()))
        self._doers: dict[type[Any], Callable[[Any], None]] = {
            act.Publish: self._publish,
            act.Announce: self._announce,
            act.Reply: lambda one: self._lanes.reply(one.waiter, one.error),
            act.HandOver: self._hand_over,
            act.Listen: self._listen,
            act.Stop: self._stop,
            act.SetCheck: self._set_check,
            act.CancelBatch: lambda one: self._cancelled.add(one.batch),
            act.Forget: self._forget_all,
            act.RetireBridge: lambda one: bridges.retire(one.bridge),
            act.Adopt: lambda one: self._adopt(one.revision),
            act.WakeAt: lambda one: self._timer.wake_at(one.time),
            act.Warn: lambda one: _log.warning("connection %s: %s", one.connection, one.text),
            act.Resolve: lambda one: self._call(one, lambda: self._seek_plan(one)),
            act.Open: self._open,
            act.Close: self._close,
            act.Finish: self._finish,
            act.Drain: self._drain,
            act.FindReplacement: self._find_replacement,
            act.CheckPreferred: self._check_preferred,
            act.ChangeOver: lambda one: self._call(one, lambda: self._change_over(one)),
            act.Release: lambda one: self._call(one, lambda: self.live.release(one.components)),
        }

    def post(self, event: ev.Event) -> None:
        """Take an event. Quick: what follows from it may be done later, in other threads."""
        self._events.append(event)
        # Whoever finds the state owned leaves its event to the owner, which looks once more after
        # it let go: an event that came between is not left lying.
        while self._events and self._owning.acquire(blocking=False):
            try:
                while self._events:
                    self._handle(self._events.popleft())
            finally:
                self._owning.release()

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
        self.live.runtimes[runtime.id] = runtime
        self._lanes.reserve(event.waiter)
        self.post(event)
        try:
            if self._lanes.is_quick(event.waiter):  # sharing what is open costs no hop
                self._lanes.drive(event.waiter)
            else:
                _bounded.run(step_name, timeout, lambda: self._lanes.drive(event.waiter))
        except BaseException as error:
            self._lanes.abandon(event.waiter)
            self.kill(runtime.id, str(error), is_failure=True)
            self.live.runtimes.pop(runtime.id, None)
            raise

    def kill(self, identity: str, cause: str = "", *, is_failure: bool = False) -> None:
        """End a connection, and close in this thread what only it used. Idempotent."""
        waiter = f"kill {next(self._numbers)}"
        self._ask(ev.Killed(identity, waiter, cause, is_failure))

    def configure(self, staged: StagedRevision, timeout: float) -> None:
        """Put a configuration into force; wait until every connection has moved that can.

        Raises:
            BridgeTimeoutError: they have not in time; they go on with it.
        """
        robot = staged.revision.robot
        event = ev.Configured(
            staged.revision.number,
            f"configuration {staged.revision.number}",
            robot.failover,
            {one.name: one.bridge for one in robot.components()},
            staged.difference.superseded,
            staged.difference.functions,
        )
        self._revisions.expect(staged)
        self._lanes.reserve(event.waiter)
        self.post(event)
        step_name = f"changing to revision {event.revision} of the configuration"
        try:
            _bounded.run(step_name, timeout, lambda: self._lanes.drive(event.waiter))
        except BaseException:
            self._lanes.abandon(event.waiter)
            raise

    def _ask(self, event: ev.Killed | ev.Stopped) -> None:
        """Post an event and do what follows from it in this thread, until it is done."""
        self._lanes.reserve(event.waiter)
        self.post(event)
        self._lanes.drive(event.waiter)

    def report(self, event: HealthEvent, *, is_stale: bool = False) -> None:
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
            spared = frozenset(n for n, one in live.items() if self._bridges.is_in_use(one.bridge))
        self.post(
            ev.HealthReported(
                event.bridge, event.health, event.cause, component, part, spared, is_stale
            )
        )

    def judge_service(self, component: Component, health: Health, cause: str) -> None:
        """Take a new verdict on what a service raises."""
        is_lost = health is Health.LOST
        self.post(
            ev.HealthReported(
                component.bridge, health, cause, component.name, "messages", is_stale=is_lost
            )
        )

    def connections(self) -> tuple[ConnectionRuntime, ...]:
        """Return the connections that have a plan and have not ended, oldest first."""
        runtimes = self.live.runtimes.copy()
        found = (runtimes.get(one) for one in self.state.connections)
        return tuple(one for one in found if one is not None and one.record is not None)

    def components(self) -> tuple[LiveComponent, ...]:
        """Return the components that are open and well enough to be shared."""
        objects = self.live.components.copy()
        return tuple(objects[one] for one in self.state.serving.values() if one in objects)

    def edges(self) -> tuple[LiveEdge, ...]:
        """Return the edges that feed something."""
        objects = self.live.edges.copy()
        return tuple(objects[one] for one in self.state.feeding.values() if one in objects)

    def component_statuses(self) -> tuple[ComponentStatus, ...]:
        """Return what the status map shows of components."""
        state, objects = self.state, self.live.components.copy()
        return tuple(
            _status(state.components[one], objects.get(one)) for one in state.serving.values()
        )

    def deaths(self) -> tuple[tuple[str, int], ...]:
        """Return how often each component was lost."""
        return tuple(sorted(self._deaths.copy().items()))

    def takeovers(self) -> tuple[tuple[str, int], ...]:
        """Return how often a plan took over, by function."""
        return tuple(sorted(self._takeovers.copy().items()))

    def close(self) -> None:
        """End every connection, take no more requests, and tell no more when times are reached."""
        self._ask(ev.Stopped(f"close {next(self._numbers)}"))
        self._timer.close()
        self._workers.close()

    def _judged(self, number: int, health: Health, cause: str) -> None:
        """Take a new verdict on what an instance of a component raises, and no other of it."""
        state = self.state
        record = state.components.get(number)
        if record is None or state.serving.get(record.name) != number:
            return
        others = frozenset(self.live.components.copy()) - {number}
        bridge, is_lost = record.step.component.bridge, health is Health.LOST
        self.post(
            ev.HealthReported(bridge, health, cause, record.name, "messages", others, is_lost)
        )

    def _handle(self, event: ev.Event) -> None:
        now = self._clock()
        if _log_of_events.isEnabledFor(logging.DEBUG):
            _log_of_events.debug("%s", write(event, now))
        try:
            self.state, actions = step(self.state, event, now)
        except Exception:  # noqa: BLE001 - whoever posted it must not pay for a fault of ours
            _log.exception("the control plane failed at %r", event)
            return
        if isinstance(event, ev.Opened) and not isinstance(event.error, BridgeTimeoutError):
            self._cancelled.discard(event.batch)
        for action in actions:
            try:
                self._doers[type(action)](action)
            except Exception:  # noqa: BLE001 - nor do the actions that come after it
                _log.exception("the control plane failed to do %r", action)

    def _call(
        self,
        action: act.CallAction,
        call: Callable[[], ev.Event | None],
        *,
        is_quick: bool = False,
    ) -> None:
        """Have a call made in the action's lane, and its result posted."""

        def job() -> None:
            try:
                event = call()
            except Exception:  # noqa: BLE001 - the lane must go on
                _log.exception("the control plane failed to do %r", action)
                return
            if event is not None:
                self.post(event)

        self._lanes.put(action.lane, job, is_quick=is_quick)

    def _start(self, job: Job) -> None:
        """Have a lane served by a worker; what comes late is closed after the manager, too."""
        if not self._workers.submit(job):
            threading.Thread(target=job, name="uoarm-late", daemon=True).start()

    # Quick steps, done by the thread that owns the state.

    def _publish(self, action: act.Publish) -> None:
        record = action.record
        runtime = self.live.runtimes.get(record.id)
        if runtime is None:
            return
        is_over = record.is_over
        if record.current is not None and not is_over:
            runtime.ports = self.live.ports.get(record.current.ports, runtime.ports)
        runtime.publish(record, is_over=is_over)
        if is_over:
            del self.live.runtimes[record.id]

    def _announce(self, action: act.Announce) -> None:
        kind, _, name = action.subject.partition(" ")
        if kind == "component" and action.change == Health.LOST.value:
            self._deaths[name] += 1
        self._announcements.post(action.subject, action.change, action.cause)

    def _hand_over(self, action: act.HandOver) -> None:
        self._takeovers[action.after.plan.function] += 1
        ports = self.live.ports[action.after.ports]
        runtime = self.live.runtimes[action.connection]
        if action.is_heard:
            runtime.hand_over(action, ports)
        else:
            self._lanes.put(action.lane, lambda: _let_through(action, runtime, ports))
        if runtime.context is not None:
            # In a lane, as everything foreign: what takes a finished span may export it at once.
            self._lanes.put(action.lane, lambda: _record_takeover(action, runtime))

    def _listen(self, action: act.Listen) -> None:
        ports = self.live.ports.get(action.ports)
        runtime = self.live.runtimes.get(action.connection)
        if ports is not None and runtime is not None:
            runtime.receiver.hear(ports.route)

    def _stop(self, action: act.Stop) -> None:
        for number in action.edges:
            joined = self.live.edges.get(number)
            if joined is not None and joined.route is not None:
                joined.route.stop()

    def _set_check(self, action: act.SetCheck) -> None:
        joined = self.live.edges.get(action.edge)
        if joined is not None:
            joined.renew_check()

    def _forget_all(self, action: act.Forget) -> None:
        revision = self._revisions.current
        for name in action.components:
            revision.forget(name)

    def _adopt(self, number: int) -> None:
        self._revisions.adopt(number)
        self._bridges.retire_replaced(self.live.uses)

    # Calls into bridges. What they are about is taken now: the state may forget it meanwhile.

    def _close(self, action: act.Close) -> None:
        ending = self.live.take(action.connection, action.parts, action.placement, action.lost)

        def close() -> ev.Event | None:
            try:
                self.live.close(ending, ends=action.ends)
            except Exception:  # noqa: BLE001 - an end ends, whatever goes wrong
                _log.exception("closing what %s had open failed", action.connection)
            return ev.Ended(action.connection) if action.ends else None

        self._call(action, close)

    def _finish(self, action: act.Finish) -> None:
        ending = self.live.take(action.connection, action.parts, action.placement, action.lost)
        self._call(action, lambda: self.live.finish(ending, action.placement))

    def _drain(self, action: act.Drain) -> None:
        edges = self.live.edges_of(action.placement)

        def drain() -> ev.Event:
            self.live.drain(edges)
            return ev.Drained(action.connection)

        self._call(action, drain)

    def _open(self, action: act.Open) -> None:
        fed = action.placement.plan.provider.component.inputs
        is_quick = all(part.kind in PORTS for part in action.parts) and all(
            port.source is not None for port in fed
        )
        state = self.state
        self._call(action, lambda: self._open_batch(action, state), is_quick=is_quick)

    def _open_batch(self, action: act.Open, state: State) -> ev.Event:
        """Open a batch; the time limit of a first plan is that of its request."""
        done: list[Part] = []
        open_parts = partial(self.live.open, action, state, done, self._cancelled)
        try:
            components = " -> ".join(names(action.placement.plan))
            with self._span("open", action.connection, components=components):
                if action.placement.user == action.connection:
                    open_parts()
                else:
                    step_name = f"takeover of connection {action.connection}"
                    _bounded.run(step_name, _OPEN_SECONDS, open_parts)
        except BaseException as error:  # noqa: BLE001 - the state learns of it whatever it is
            self._cancelled.add(action.batch)  # a thread that hangs in it opens nothing more
            return ev.Opened(action.batch, tuple(done), error)
        return ev.Opened(action.batch, tuple(done))

    def _span(
        self, name: str, connection: str, **attributes: str
    ) -> AbstractContextManager[object]:
        runtime = self.live.runtimes.get(connection)
        context = None if runtime is None else runtime.context
        return span(name, context, connection=connection, **attributes)

    def _find_replacement(self, action: act.FindReplacement) -> None:
        self._call(action, lambda: seek_replacement(action, self._revisions.current))

    def _check_preferred(self, action: act.CheckPreferred) -> None:
        self._call(action, lambda: check_preferred(action, self._revisions.current))

    def _seek_plan(self, action: act.Resolve) -> ev.Event:
        revision = self._revisions.current
        try:
            with self._span("resolve", action.connection, function=action.function):
                plan = revision.resolve(action.function, avoided=action.avoided)
        except BaseException as error:  # noqa: BLE001 - handed to who asked
            return ev.Resolved(action.connection, None, error, revision.number)
        return ev.Resolved(action.connection, plan, revision=revision.number)

    def _change_over(self, action: act.ChangeOver) -> ev.Event:
        try:
            step_name = "return to preferred components"
            _bounded.run(step_name, _OPEN_SECONDS, lambda: self.live.change_over(action.edges))
        except Exception as error:  # noqa: BLE001 - the state learns of it whatever it is
            if not isinstance(error, UoarmError):
                _log.exception("changing over failed")
            return ev.ChangedOver(action.returning, str(error))
        return ev.ChangedOver(action.returning)


def _let_through(action: act.HandOver, runtime: ConnectionRuntime, ports: ApplicationPorts) -> None:
    """Have the application hear a plan that was open already, its retained message first."""
    with ports.letting_through():
        runtime.hand_over(action, ports)


def _record_takeover(action: act.HandOver, runtime: ConnectionRuntime) -> None:
    """Record a takeover, from when it was needed to when it was done."""
    past_span(
        "takeover",
        action.time - action.since,
        runtime.context,
        connection=action.connection,
        function=action.after.plan.function,
        cause=action.cause,
        before=" -> ".join(names(action.before.plan)),
        after=" -> ".join(names(action.after.plan)),
    )


def _status(record: ComponentRecord, live: LiveComponent | None) -> ComponentStatus:
    """Return what the status map shows of a component; its object is None while it opens."""
    channels = () if live is None else live.channel_statuses()
    return ComponentStatus(
        name=record.name,
        function=record.step.component.function,
        bridge=record.step.component.bridge,
        health=record.health.health,
        users=tuple(dict.fromkeys(map(connection_of, record.users))),
        cause=record.health.cause,
        channels=channels,
        failed=0 if live is None else live.failures.failed,
        last_error="" if live is None else live.failures.last_error,
        lost=sum(channel.lost for channel in channels),
    )
