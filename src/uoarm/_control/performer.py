"""The performer: does what `step` asks for.

Quick steps of our own are done at once, by the thread that owns the state. Calls into bridges are
made in lanes, by their caller or by worker threads, under time limits; what became of them comes
back as events.
"""

from __future__ import annotations

import logging
import threading
import time
from collections.abc import Callable
from contextlib import AbstractContextManager
from functools import partial
from typing import Any

from uoarm import _bounded
from uoarm._control.bridges import BridgeSet
from uoarm._control.engine import actions as act
from uoarm._control.engine import events as ev
from uoarm._control.engine.state import Part, State, keep_newest, names
from uoarm._control.live.application_ports import ApplicationPorts
from uoarm._control.live.connection_runtime import ConnectionRuntime
from uoarm._control.live.parts import LiveParts
from uoarm._control.revisions import Revisions, check_preferred, seek_replacement
from uoarm._control.threads import EventDispatcher, Lanes, Timer
from uoarm._raised import foreign
from uoarm._spans import past_span, span
from uoarm.errors import BridgeTimeoutError, UoarmError
from uoarm.model import Health

__all__ = ["Performer"]

_OPEN_SECONDS = 60.0
_log = logging.getLogger("uoarm")


class Performer:
    """Does actions, one after another; the owner of the state calls it.

    Args:
        state: gives the state of this moment.
        post: takes the events that come back.
        live: what is open, as objects.
        lanes: where calls into bridges are made.
        timer: wakes when a time is reached.
        bridges: of the manager.
        announcements: where changes are announced.
        revisions: of the configuration, in which plans are found.

    Attributes:
        deaths: how often each component was lost, of the thousand that were last.
        takeovers: how often a plan took over, by function, of as many.
    """

    def __init__(
        self,
        state: Callable[[], State],
        post: Callable[[ev.Event], None],
        *,
        live: LiveParts,
        lanes: Lanes,
        timer: Timer,
        bridges: BridgeSet,
        announcements: EventDispatcher,
        revisions: Revisions,
    ) -> None:
        self.deaths: dict[str, int] = {}
        self.takeovers: dict[str, int] = {}
        self._state = state
        self._post = post
        self._live = live
        self._lanes = lanes
        self._bridges = bridges
        self._announcements = announcements
        self._revisions = revisions
        self._cancelled: set[int] = set()
        self._undelivered: tuple[_LetThrough, ...] = ()
        self._doers: dict[type[Any], Callable[[Any], None]] = {
            act.Publish: self._publish,
            act.Announce: self._announce,
            act.Reply: lambda item: lanes.reply(item.waiter, item.error),
            act.HandOver: self._hand_over,
            act.Listen: self._listen,
            act.Stop: self._stop,
            act.SetCheck: self._set_check,
            act.CancelBatch: lambda item: self._cancelled.add(item.batch),
            act.Forget: self._forget_all,
            act.RetireBridge: lambda item: bridges.retire(item.bridge),
            act.Adopt: lambda item: self._adopt(item.revision),
            act.WakeAt: lambda item: timer.wake_at(item.time),
            act.Warn: lambda item: _log.warning("connection %s: %s", item.connection, item.text),
            act.Resolve: lambda item: self._call(item, lambda: self._seek_plan(item)),
            act.Open: self._open,
            act.Close: self._close,
            act.Finish: self._finish,
            act.Drain: self._drain,
            act.FindReplacement: self._find_replacement,
            act.CheckPreferred: self._check_preferred,
            act.SwitchInputs: lambda item: self._call(item, lambda: self._switch_inputs(item)),
            act.Release: lambda item: self._call(item, lambda: self._live.release(item.components)),
        }

    def perform(self, action: act.Action) -> None:
        """Do an action, or have it done in its lane. Waits for nothing."""
        self._doers[type(action)](action)

    def opened(self, event: ev.Opened) -> None:
        """Forget a batch whose end was handled; a thread that hangs in it still asks for it."""
        if not isinstance(event.error, BridgeTimeoutError):
            self._cancelled.discard(event.batch)

    def _call(
        self,
        action: act.CallAction,
        call: Callable[[], ev.Event | None],
        *,
        is_quick: Callable[[], bool] | None = None,
    ) -> None:
        """Have a call made in the action's lane, and its result posted."""

        def job() -> None:
            try:
                event = foreign(call)
            except Exception:  # noqa: BLE001 - the lane must go on
                _log.exception("the control plane failed to do %r", action)
                return
            if event is not None:
                self._post(event)

        self._lanes.put(action.lane, job, is_quick=is_quick)

    # Quick steps, done by the thread that owns the state.

    def _publish(self, action: act.Publish) -> None:
        record = action.record
        runtime = self._live.runtimes.get(record.id)
        if runtime is None:
            return
        is_over = record.is_over
        if record.current is not None and not is_over:
            runtime.ports = self._live.ports.get(record.current.ports, runtime.ports)
        runtime.publish(record, is_over=is_over)
        if is_over:
            del self._live.runtimes[record.id]

    def _announce(self, action: act.Announce) -> None:
        kind, _, name = action.subject.partition(" ")
        if kind == "component" and action.change == Health.LOST.value:
            keep_newest(self.deaths, name, self.deaths.get(name, 0) + 1)
        self._announcements.post(action.subject, action.change, action.cause, action.function)

    def _hand_over(self, action: act.HandOver) -> None:
        function = action.after.plan.function
        keep_newest(self.takeovers, function, self.takeovers.get(function, 0) + 1)
        ports = self._live.ports[action.after.ports]
        runtime = self._live.runtimes[action.connection]
        if action.is_receiving:
            runtime.hand_over(action, ports)
        else:
            letting = _LetThrough(action, runtime, ports)
            self._undelivered = (
                *(let_through for let_through in self._undelivered if not let_through.is_over),
                letting,
            )
            self._lanes.put(action.lane, letting)
        if runtime.context is not None:
            # In a lane, as everything foreign: what takes a finished span may export it at once.
            self._lanes.put(action.lane, lambda: _record_takeover(action, runtime))

    def wait_delivered(self, timeout: float) -> bool:
        """Wait until applications receive from plans that have taken over; False when time ran out.

        Any thread; one in which an application is given a retained message now does not wait for
        itself.
        """
        deadline = time.monotonic() + timeout
        return all(
            let_through.wait(max(0.0, deadline - time.monotonic()))
            for let_through in self._undelivered
        )

    def _listen(self, action: act.Listen) -> None:
        ports = self._live.ports.get(action.ports)
        runtime = self._live.runtimes.get(action.connection)
        if ports is not None and runtime is not None:
            runtime.receiver.deliver_from(ports.route, ports.outlet)

    def _stop(self, action: act.Stop) -> None:
        for number in action.edges:
            joined = self._live.edges.get(number)
            if joined is not None and joined.route is not None:
                joined.route.stop()

    def _set_check(self, action: act.SetCheck) -> None:
        joined = self._live.edges.get(action.edge)
        if joined is not None:
            joined.renew_check()

    def _forget_all(self, action: act.Forget) -> None:
        revision = self._revisions.current
        may = revision.within(action.function, action.components)
        revision.forget(action.components if not action.function else may)

    def _adopt(self, number: int) -> None:
        self._revisions.adopt(number)
        self._bridges.retire_replaced(self._live.uses)

    # Calls into bridges. What they are about is taken now: the state may forget it meanwhile.

    def _close(self, action: act.Close) -> None:
        ending = self._live.take(action.connection, action.parts, action.placement, action.lost)
        ended = ev.Ended(action.connection) if action.ends else None
        self._end(action, lambda: self._live.close(ending, ends=action.ends), ended)

    def _finish(self, action: act.Finish) -> None:
        ending = self._live.take_draining(action)
        self._end(action, lambda: self._live.finish(ending), ev.RanOut(action.placement.user))

    def _end(
        self, action: act.Close | act.Finish, call: Callable[[], None], event: ev.Event | None
    ) -> None:
        """Have a call made after which an event is posted whatever goes wrong: an end ends."""

        def end() -> ev.Event | None:
            try:
                foreign(call)
            except Exception:  # noqa: BLE001 - see above
                _log.exception("closing what %s had open failed", action.connection)
            return event

        self._call(action, end)

    def _drain(self, action: act.Drain) -> None:
        edges = self._live.edges_of(action.placement)

        def drain() -> ev.Event:
            self._live.drain(edges)
            return ev.Drained(action.connection)

        self._call(action, drain)

    def _open(self, action: act.Open) -> None:
        state = self._state()
        self._call(
            action,
            lambda: self._open_batch(action, state),
            is_quick=lambda: self._live.is_quick(action),
        )

    def _open_batch(self, action: act.Open, state: State) -> ev.Event:
        """Open a batch; the time limit of a first plan is that of its request."""
        done: list[Part] = []
        open_parts = partial(self._live.open, action, state, done, self._cancelled)
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
        runtime = self._live.runtimes.get(connection)
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
        number, candidates = revision.number, revision.candidates
        return ev.Resolved(action.connection, plan, revision=number, candidates=candidates)

    def _switch_inputs(self, action: act.SwitchInputs) -> ev.Event:
        try:
            step_name = "switchover to better components"
            _bounded.run(step_name, _OPEN_SECONDS, lambda: self._live.switch_inputs(action.edges))
        except Exception as error:  # noqa: BLE001 - the state learns of it whatever it is
            if not isinstance(error, UoarmError):
                _log.exception("changing over failed")
            return ev.InputsSwitched(action.switchover, str(error))
        return ev.InputsSwitched(action.switchover)


class _LetThrough:
    """A job: have an application receive from a plan that is open, its retained message first."""

    def __init__(
        self, action: act.HandOver, runtime: ConnectionRuntime, ports: ApplicationPorts
    ) -> None:
        self._action = action
        self._runtime = runtime
        self._ports = ports
        self._thread = 0
        self._over = threading.Event()

    @property
    def is_over(self) -> bool:
        return self._over.is_set()

    def wait(self, timeout: float) -> bool:
        return self._thread == threading.get_ident() or self._over.wait(timeout)

    def __call__(self) -> None:
        self._thread = threading.get_ident()
        try:
            with self._ports.letting_through():
                self._runtime.hand_over(self._action, self._ports)
        finally:
            self._over.set()


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
