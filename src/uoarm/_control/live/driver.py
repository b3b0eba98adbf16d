"""The driver: owns the state, gives `step` its events, and does what follows from them.

One thread at a time owns the state: the one that posts an event while it has no owner. It works
until no event is left, calls nothing foreign meanwhile and waits for nothing, so that a post is
quick and needs no thread. Ctrl-C and SIGTERM wait until what the main thread has begun is whole.

Quick steps of our own are done at once, by the owner. Calls into bridges are made in lanes, by
their caller or by worker threads, under time limits; what became of them comes back as events.
"""

from __future__ import annotations

import itertools
import logging
import math
import threading
import time
from collections import deque
from collections.abc import Callable, Hashable, Iterable
from contextlib import AbstractContextManager, nullcontext, suppress
from functools import partial

from uoarm._bridges import BridgeSet
from uoarm._control.engine import actions as act
from uoarm._control.engine import events as ev
from uoarm._control.engine.placement import MESSAGES
from uoarm._control.engine.state import ConnectionRecord, State
from uoarm._control.engine.step import step
from uoarm._control.live.connection_runtime import ConnectionRuntime, StartDelivery, record_takeover
from uoarm._control.live.listeners import EventDispatcher, EventLog
from uoarm._control.live.offers import Offers
from uoarm._control.live.parts import LiveParts, OpenedParts, subject_of
from uoarm._control.live.revisions import Revisions, StagedRevision
from uoarm._dataplane import Clock
from uoarm._encodable import shown
from uoarm._forks import forks
from uoarm._interrupts import Uninterrupted
from uoarm._parts import Functions
from uoarm._raised import LimitedLog, foreign, on_failure, sentence_of
from uoarm._resolve import keep_candidates
from uoarm._safety import EmergencyStop
from uoarm._spans import current, span
from uoarm._support import deadlines
from uoarm._support.ordered import keep_newest
from uoarm._support.workers import Job, Lanes, Timer, WorkerPool
from uoarm.bridge import HealthEvent
from uoarm.config import compare
from uoarm.errors import BridgeTimeoutError, ConnectionClosedError, UoarmError
from uoarm.model import Component, Health, Plan, Robot

_LISTED_CHANGES = 20
_LANES = 8
_PATIENCE_SECONDS = 0.05
_OPEN_SECONDS = 60.0
_FIRST_SHARE = 0.5
_AGAIN_SECONDS = 0.5
_log = logging.getLogger("uoarm")


class Driver:
    """Runs the control plane of one manager. All methods may be called from any thread.

    Args:
        functions: where the functions of offers are requested.

    Attributes:
        state: of this moment. A reader takes it once: each is whole, and never changed.
        live: what is open, as objects.
        offers: what is open in frameworks.
        deaths: how often each component was lost, of the thousand that were last.
        takeovers: how often a plan took over, by function, of as many.
        timer: of the one time that is waited for.
        when_changed: called after events were handled; must return at once.
    """

    def __init__(
        self,
        *,
        bridges: BridgeSet,
        events: EventDispatcher,
        revisions: Revisions,
        clock: Clock,
        emergency_stop: EmergencyStop,
        functions: Functions,
    ) -> None:
        self._log_failure = partial(LimitedLog(_log).write, logging.ERROR)
        self._process = forks.generation
        robot = revisions.current.robot
        self.state = State(robot.failover, _bridges_of(robot.components()))
        self.offers = Offers(self, revisions, functions, bridges, events, clock)
        self.live = LiveParts(self, bridges, clock, self._judged, emergency_stop, events.post)
        self.deaths: dict[str, int] = {}
        self.takeovers: dict[str, int] = {}
        self._bridges = bridges
        self._revisions = revisions
        self._announcements = events
        self._clock = clock
        self._events: deque[ev.Event] = deque()
        # Guards the state and the order of events: two owners would give `step` the same state.
        self._owning = threading.Lock()
        # One for each wait: two threads that kill a connection at once both get a reply.
        self._numbers = itertools.count()
        # Thousands of lanes begin with the death of a bridge. A thread for each would fight for the
        # interpreter; but those that a bridge holds up must hold up no others.
        self._workers = WorkerPool("uoarm-lane", _LANES, patience=_PATIENCE_SECONDS)
        self._lanes = Lanes(self._start)
        self._event_log = EventLog(self._lanes)
        # Lanes for which there was no thread; appended by any, taken by the timer and who closes.
        self._unstarted: deque[Job] = deque()
        self.timer = Timer(clock, self._reach_time)
        self.when_changed: Callable[[], None] = lambda: None
        # Read by the threads that open, which take a look before each part: one look too early
        # opens one part more, which comes back with the others and is closed.
        self._cancelled: set[int] = set()
        # Replaced as a whole by the owner, read by a thread that waits for a new configuration.
        self._undelivered: tuple[StartDelivery, ...] = ()

    def post(self, event: ev.Event) -> None:
        """Take an event. Quick: what follows from it may be done later, in other threads."""
        # An event that is appended is handled, whatever is raised in this thread afterwards.
        with Uninterrupted():
            self.queue(event)
            self.work()

    def queue(self, event: ev.Event) -> None:
        """Have an event handled behind those so far, by `work`: for who holds a lock."""
        self._events.append(event)

    def work(self) -> None:
        """Handle what is queued, unless another thread does. For who is not interrupted."""
        # Who finds the state owned leaves its event to the owner, who looks again after it let go.
        while self._events and self._owning.acquire(blocking=False):
            try:
                self._handle_all()
            finally:
                self._owning.release()

    def _handle_all(self) -> None:
        while self._events:
            self._handle(self._events.popleft())
        self.when_changed()

    def request(
        self, runtime: ConnectionRuntime, event: ev.Requested, step_name: str, timeout: float
    ) -> None:
        """Post a request and wait until it is running.

        Raises:
            BridgeTimeoutError: it is not, in time; it is given up.
            UoarmError: it failed.
        """
        with span("request", function=str(event.wanted), connection=runtime.id) as traced:
            if traced is not None:
                runtime.context = current()
            self._request(runtime, event, step_name, timeout)

    def _request(
        self, runtime: ConnectionRuntime, event: ev.Requested, step_name: str, timeout: float
    ) -> None:
        try:
            with Uninterrupted():
                # Before the event: the first action already shows the connection at its handle.
                self.live.runtimes[runtime.id] = runtime
                # Before it, too: a lane that is not reserved is served by a worker thread.
                self._lanes.reserve(event.waiter)
                self.post(event)
                is_over = self._lanes.drive_quick(event.waiter)  # sharing costs no hop
            if not is_over:
                deadlines.run(step_name, timeout, partial(self._lanes.drive, event.waiter))
        except BaseException as error:
            # Given up, by the limit or by Ctrl-C. A thread may be opening parts for it still; what
            # it has opened comes back as an event, and is closed since no plan uses it any more.
            with Uninterrupted():
                self._lanes.abandon(event.waiter)
                self.kill(runtime.id, sentence_of(error), is_failure=True)
                self.live.runtimes.pop(runtime.id, None)
            raise

    @property
    def is_foreign(self) -> bool:
        """Whether this is a forked child: what is open is its parent's, and locks may be held."""
        return forks.generation != self._process

    def require_own(self, what: str) -> None:
        """Refuse in a forked child, with ConnectionClosedError, what only its parent can do."""
        if self.is_foreign:
            text = f"{what} belongs to the process that made it, of which this is a child"
            raise ConnectionClosedError(f"{text}: make another one here")

    def kill(self, identity: str, cause: str = "", *, is_failure: bool = False) -> None:
        """End a connection, and close in this thread what only it used. Idempotent."""
        if self.is_foreign:  # the parent's connection goes on, and its locks are of no use here
            return
        waiter = f"kill {next(self._numbers)}"
        self._ask(ev.Killed(identity, waiter, cause, is_failure))

    def configure(self, staged: StagedRevision, timeout: float) -> None:
        """Put a configuration into force; wait until every connection has moved that can.

        What is sent and emitted from then on goes the new ways.

        Raises:
            BridgeTimeoutError: they have not in time; they go on with it.
            ConnectionClosedError: the manager was closed; it is not in force.
        """
        robot = staged.revision.robot
        event = ev.Configured(
            staged.revision.number,
            f"configuration {staged.revision.number}",
            robot.failover,
            _bridges_of(robot.components()),
            staged.difference.superseded,
            staged.difference.functions,
        )
        step_name = f"changing to revision {event.revision} of the configuration"
        deadline = time.monotonic() + timeout
        # The change stands: where this thread leaves, a worker does what it would have done for it.
        with on_failure(self._lanes.abandon, event.waiter):
            with Uninterrupted():
                # `Adopt` finds it by its number, in the thread that owns the state.
                self._revisions.expect(staged)
                self._lanes.reserve(event.waiter)
                self.post(event)
            deadlines.run(step_name, timeout, partial(self._lanes.drive, event.waiter))
        if not self._wait_delivered(max(0.0, deadline - time.monotonic())):
            raise BridgeTimeoutError(f"{step_name}: an application that is called now holds it up")

    def change_candidates(self, robot: Robot) -> None:
        """Have the candidates that were discovered for the configuration; those in use stay."""
        # They were found in seconds, in which some may have been requested: what is in use is
        # known, and stays so until they are in force, only to who owns the state.
        try:
            with self._owning:
                self._handle_all()
                self._change_candidates(robot)
        finally:
            self.work()  # what was left to the owner meanwhile

    def _change_candidates(self, robot: Robot) -> None:
        revision = self._revisions.current
        before, number = revision.robot, revision.candidates
        robot = keep_candidates(robot, self._candidates_in_use(before))
        if before.functions == robot.functions:
            return
        difference = compare(before, robot)
        if difference.changes:
            every = _bridges_of((*before.components(), *robot.components()))
            number += 1
            text = "; ".join(difference.changes[:_LISTED_CHANGES])
            # A plan with a new candidate can be found only after the state knows its bridge.
            self._handle(ev.CandidatesChanged(every, text, number, difference.superseded))
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
            # Reserved before the event, or a worker would serve the lane and this thread wait for a
            # reply that went there.
            self._lanes.reserve(event.waiter)
            self.post(event)
            with suppress(IndexError):  # another thread may do some, too
                while self._unstarted:  # for which no thread was to be had
                    self._unstarted.popleft()()
            self._lanes.drive(event.waiter)

    def report(self, event: HealthEvent, *, is_avoided: bool = False) -> None:
        """Queue a change of health; one of a channel that was closed is no news."""
        if event.channel is not None and event.channel.closed:
            return
        component, part = subject_of(event)
        service = None if component is None else self._revisions.current.service(component)
        function = "" if service is None else service.function
        # By now another bridge may have the name: what it has opened is not what died.
        spared = frozenset[int]()
        if event.health is Health.LOST and component is None:
            live = self.live.components.copy()
            spared = frozenset(
                n for n, value in live.items() if self._bridges.is_in_use(value.bridge)
            )
        what = event.bridge, event.health, event.cause, component, part
        self.queue(ev.HealthReported(*what, spared, is_avoided, function))

    def judge(
        self, component: Component, health: Health, cause: str, part: Hashable, instance: int = 0
    ) -> None:
        """Take a new verdict on a part of a service, or of an instance of a component."""
        self.post(
            ev.HealthReported(
                component.bridge,
                health,
                cause,
                component.name,
                part,
                is_avoided=health is Health.LOST,
                function="" if instance else component.function,
                instance=instance,
            )
        )

    def close(self) -> None:
        """End every connection, and take no more requests or times that are reached."""
        self._ask(ev.Stopped(f"close {next(self._numbers)}"))
        self._event_log.close()
        self.timer.close()
        # What lanes still have to close is closed; later ones get threads of their own (`_start`).
        self._workers.close(drop=False)

    def _judged(self, number: int, health: Health, cause: str) -> None:
        """Take a new verdict on what an instance of a component raises, and no other of it."""
        # The thread that raised knows the number of its instance only; another one of the name may
        # serve by now, and is not to blame.
        state = self.state
        record = state.components.get(number)
        if record is None or state.serving.get(record.name) != number:
            return
        self.judge(record.step.component, health, cause, MESSAGES, number)

    def _handle(self, event: ev.Event) -> None:
        # Before the step: an event at which it fails is the one that a test must play again
        # (`tests/control/test_trace.py`).
        now = self._clock()
        self._event_log.write(event, now)
        try:
            state, actions = step(self.state, event, now)
        except Exception as error:  # noqa: BLE001 - its caller must not pay for a fault of ours
            self._log_failure(f"the control plane failed at {shown(event)}", error)
            return
        # Before the actions: a thread that an action wakes finds the state from which it follows.
        before, self.state = self.state, state
        if state.offers is not before.offers:
            self.offers.wake()
        # A thread that hangs in a batch still asks whether it was cancelled.
        if isinstance(event, ev.Opened) and not isinstance(event.error, BridgeTimeoutError):
            self._cancelled.discard(event.batch)
        # In the order in which the step gave them, by this thread alone: a reply wakes its caller
        # after all that was published before it.
        for action in actions:
            try:
                self._perform(action)
            except Exception as error:  # noqa: BLE001 - nor do the actions that come after it
                self._log_failure(f"the control plane failed to do {shown(action)}", error)

    def _perform(self, action: act.Action) -> None:  # noqa: C901, PLR0912, PLR0915 - a case for each
        """Do an action, or have it done in its lane. Waits for nothing, and calls nothing foreign.

        Here alone a decision becomes a call.
        """
        match action:
            case act.Publish():
                self._publish(action)
            case act.Announce():
                self._announce(action)
            case act.Reply():
                self._lanes.reply(action.waiter, action.error)
            # With the state of this moment: by the time of the call another event may have taken
            # the records out, and the parts come back as `Opened` all the same.
            case act.Open():
                call = partial(self._open, action, self.state)
                self._call(action, call, is_quick=partial(self.live.is_quick, action))
            case act.Close():
                # What is closed is taken out now: by the time of the call it would be found again.
                parts, lost = action.parts, action.lost
                ending = self.live.take(action.connection, parts, action.placement, lost)
                ended = ev.Ended(action.connection) if action.ends else None
                close = partial(self.live.close, ending, ends=action.ends)
                self._call(action, close, after=ended)
            case act.Finish():
                finish = partial(self.live.finish, self.live.take_draining(action))
                self._call(action, finish, after=ev.RanOut(action.placement.user))
            case act.HandOver():
                self._hand_over(action)
            case act.Resolve():
                self._call(action, partial(self._resolve, action))
            case act.FindReplacement():
                self._call(action, partial(self._revisions.current.seek_replacement, action))
            case act.CheckPreferred():
                self._call(action, partial(self._revisions.current.check_preferred, action))
            case act.SwitchInputs():
                self._call(action, partial(self._switch_inputs, action))
            case act.Drain():
                # Found now: a move of the same connection may close them before the lane is
                # reached.
                drain = partial(self.live.drain, self.live.edges_of(action.placement))
                self._call(action, drain, after=ev.Drained(action.connection))
            case act.Release():
                self._call(action, partial(self.live.release, action.components))
            case act.OpenOffer():
                self._call(action, partial(self.offers.open, action))
            case act.CloseOffer():
                self._call(action, partial(self.offers.close_offer, action))
            case act.Listen():
                self.live.listen(action.connection, action.ports)
            case act.Stop():
                self.live.stop(action.edges)
            case act.SetCheck():
                self.live.renew_check(action.edge)
            case act.CancelBatch():
                self._cancelled.add(action.batch)
            case act.Forget():
                self._revisions.current.forget_within(action.function, action.components)
            case act.RetireBridge():
                self._bridges.retire(action.bridge)
            case act.Adopt():
                # In this order: bridges are retired that the adopted configuration has replaced.
                # Both before the next event, which may be a request that finds its plan in it.
                self._revisions.adopt(action.revision)
                self._bridges.retire_replaced(self.live.uses)
            case act.WakeAt():
                self.timer.wake_at(action.time)
            case act.Warn():
                runtime = self.live.runtimes.get(action.connection)
                if runtime is not None:  # else its request was given up
                    lane = f"warn {action.connection}"
                    self._lanes.put(lane, partial(runtime.warn, action.text))

    def _call(
        self,
        action: act.CallAction,
        call: Callable[[], ev.Event | None],
        *,
        after: ev.Event | None = None,
        is_quick: Callable[[], bool] | None = None,
    ) -> None:
        """Have a call made in the action's lane, and its result posted.

        Args:
            action: what is done.
            call: does it, and returns an event, if any.
            after: the event that follows whatever goes wrong: an end ends.
            is_quick: says whether it calls nothing that may hang.
        """
        self._lanes.put(action.lane, partial(self._made, action, call, after), is_quick=is_quick)

    def _made(
        self,
        action: act.CallAction,
        call: Callable[[], ev.Event | None],
        after: ev.Event | None,
    ) -> None:
        event = after
        try:
            event = foreign(call) or after
        except Exception as error:  # noqa: BLE001 - the lane must go on
            self._log_failure(f"the control plane failed to do {shown(action)}", error)
        finally:
            # Also where a second Ctrl-C ends the call: no close would find its end. In the lane's
            # thread, which owns the state then if no other does: no event needs one of its own.
            if event is not None:
                self.post(event)

    # Quick steps, done by the thread that owns the state.

    def _publish(self, action: act.Publish) -> None:
        record = action.record
        runtime = self.live.runtimes.get(record.id)
        if runtime is None:
            return
        # Ports first: who reads the new record at the handle sends into the plan that it shows.
        if record.current is not None and not record.state.is_over:
            runtime.ports = self.live.ports.get(record.current.ports, runtime.ports)
        runtime.publish(record)
        if record.state.is_over:
            # After it was published: a handle keeps its runtime and reads the end there. What comes
            # for it later, as a gap, finds none.
            del self.live.runtimes[record.id]

    def _announce(self, action: act.Announce) -> None:
        kind, _, name = action.subject.partition(" ")
        if kind == "component" and action.change == Health.LOST.value:
            keep_newest(self.deaths, name, self.deaths.get(name, 0) + 1)
        self._announcements.post(action.subject, action.change, action.cause, action.function)

    def _hand_over(self, action: act.HandOver) -> None:
        function = action.after.plan.function
        keep_newest(self.takeovers, function, self.takeovers.get(function, 0) + 1)
        ports = self.live.ports[action.after.ports]
        runtime = self.live.runtimes[action.connection]
        # At once where the application receives from the plan already; else it may be called with a
        # retained message, which is foreign code and needs a lane.
        if action.is_receiving:
            runtime.hand_over(action, ports)
        else:
            letting = StartDelivery(action, runtime, ports)
            self._undelivered = (
                *(let_through for let_through in self._undelivered if not let_through.is_over),
                letting,
            )
            self._lanes.put(action.lane, letting)
        if runtime.context is not None:
            # In a lane, as everything foreign: what takes a finished span may export it at once.
            self._lanes.put(action.lane, partial(record_takeover, action, runtime))

    def _wait_delivered(self, timeout: float) -> bool:
        """Wait until applications receive from plans that have taken over; False when time ran out.

        Any thread; one in which an application is given a retained message now does not wait for
        itself.
        """
        deadline = time.monotonic() + timeout
        return all(
            let_through.wait(max(0.0, deadline - time.monotonic()))
            for let_through in self._undelivered
        )

    # Calls into bridges, made in lanes.

    def _open(self, action: act.Open, state: State) -> ev.Event:
        """Open a batch; a first plan has the time limit of its request."""
        done = OpenedParts(action.parts)
        open_parts = partial(self.live.open, action, state, done, self._cancelled)
        record, left = state.connections.get(action.connection), deadlines.left(math.inf)
        try:
            with self._span("open", action.connection, plan=action.placement.plan):
                if record is None or not record.waiter:  # no request waits for it
                    step_name = f"takeover of connection {action.connection}"
                    deadlines.run(step_name, _OPEN_SECONDS, open_parts)
                # What opens at once is opened by the application's own thread, without a limit.
                elif left < math.inf and self._is_dispensable(action.placement.plan, record):
                    step_name = f"opening a plan of connection {action.connection}"
                    limit = round(_FIRST_SHARE * left, 2)  # the rest is for another plan
                    deadlines.run(step_name, limit, open_parts, isolated=True)
                else:
                    open_parts()
        except BaseException as error:  # noqa: BLE001 - the state learns of it whatever it is
            self._cancelled.add(action.batch)  # a thread that hangs in it opens nothing more
            return ev.Opened(action.batch, done.end(), error)
        return ev.Opened(action.batch, done.end())

    def _is_dispensable(self, plan: Plan, record: ConnectionRecord) -> bool:
        """Whether another plan may do for a request."""
        move, revision = record.move, self._revisions.current
        return self.state.policy.enabled and bool(move and revision.has_others(plan, move.excluded))

    def _span(
        self, name: str, connection: str, *, plan: Plan | None = None, **attributes: str
    ) -> AbstractContextManager[object]:
        runtime = self.live.runtimes.get(connection)
        context = None if runtime is None else runtime.context
        if context is None:  # no spans are recorded
            return nullcontext()
        if plan is not None:
            attributes["components"] = " -> ".join(plan.names)
        return span(name, context, connection=connection, **attributes)

    def _resolve(self, action: act.Resolve) -> ev.Event:
        revision = self._revisions.current
        try:
            with self._span("resolve", action.connection, function=action.function):
                plan = revision.resolve(action.function, avoided=action.avoided)
        except BaseException as error:  # noqa: BLE001 - handed to who asked
            return ev.Resolved(action.connection, None, error, revision.number)
        return ev.Resolved(action.connection, plan, None, revision.number, revision.candidates)

    def _switch_inputs(self, action: act.SwitchInputs) -> ev.Event:
        switch = partial(self.live.switch_inputs, action.edges)
        try:
            deadlines.run("switchover to better components", _OPEN_SECONDS, switch)
        except Exception as error:  # noqa: BLE001 - the state learns of it whatever it is
            if not isinstance(error, UoarmError):
                self._log_failure("changing over failed", error)
            return ev.InputsSwitched(action.switchover, str(error))
        return ev.InputsSwitched(action.switchover)

    def _start(self, job: Job) -> None:
        """Have a lane served by a worker; what comes late is closed after the manager, too."""
        try:
            if not self._workers.submit(job):
                threading.Thread(target=job, name="uoarm-late", daemon=True).start()
        except RuntimeError as error:
            # The system gives no more threads. The lane counts as driven, so that no later job of
            # it would have it served: it is tried again with the time.
            LimitedLog(_log).write(logging.WARNING, f"a lane waits for a thread: {error}")
            self._unstarted.append(job)
        if self._unstarted:
            with suppress(RuntimeError):  # nor one for the timer: the next start asks again
                self.timer.wake_at(self._clock() + _AGAIN_SECONDS)

    def _reach_time(self) -> None:
        with suppress(IndexError):  # who closes may take some meanwhile
            for _ in range(len(self._unstarted)):
                self._start(self._unstarted.popleft())
        self.post(ev.TimeReached())


def _bridges_of(components: Iterable[Component]) -> dict[str, str]:
    return {component.name: component.bridge for component in components}
