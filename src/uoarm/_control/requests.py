"""Requests: from the name of a function to its plan, and to a connection that runs."""

from __future__ import annotations

import itertools
import threading
from collections.abc import Callable, Iterator
from functools import partial
from typing import Any

from attrs import define, field

from uoarm._bridges import BridgeSet
from uoarm._control.candidates import CandidateWatch
from uoarm._control.connection import Connection
from uoarm._control.engine.events import Requested
from uoarm._control.engine.move import recently
from uoarm._control.engine.placement import MESSAGES, ComponentHealth
from uoarm._control.engine.step import output_of
from uoarm._control.live.connection_runtime import ConnectionRuntime
from uoarm._control.live.driver import Driver
from uoarm._control.live.listeners import EventDispatcher
from uoarm._control.live.revisions import Revision, Revisions
from uoarm._dataplane import Clock, FailureWatch
from uoarm._hints.applications import MessageType, as_message
from uoarm._raised import is_raised
from uoarm._spans import span
from uoarm._support import deadlines
from uoarm._support.ordered import keep_newest
from uoarm.bridge import Bridge, ServiceStructures, message_check
from uoarm.errors import (
    BridgeError,
    CommandRefusedError,
    FailureReason,
    MessageError,
    UsageError,
)
from uoarm.model import (
    Component,
    ComponentStatus,
    Endpoint,
    Health,
    Message,
    MessageStructure,
    Plan,
    PortRef,
    QueuePolicy,
    Step,
    ValidationMode,
)


@define(eq=False)
class Requests:
    """Finds plans and opens connections, for any thread.

    Args:
        candidates: of functions with needs, for which the first round of discovery is waited for.
        events: where what a callback raises is reported.
    """

    _revisions: Revisions
    _driver: Driver
    _candidates: CandidateWatch
    _events: EventDispatcher
    _clock: Clock
    _numbers: Iterator[int] = field(factory=lambda: itertools.count(1), init=False)

    def resolve(self, name: str, timeout: float) -> Plan:
        """Return the plan that `open` would open; errors are those of `RobotManager.resolve`."""
        wanted = _reference(name)
        function = wanted.function
        left = self._candidates.wait(timeout, function)
        revision = self._revisions.current
        plan = self._known(function, revision)
        if plan is None:
            avoided = recently(self._driver.state.avoided, self._clock())
            with span("resolve", function=function):
                plan = deadlines.run(
                    f"resolving {function!r}",
                    left,
                    lambda: revision.resolve(function, avoided=avoided),
                )
        if wanted.port is not None:
            output_of(plan, wanted)
        return plan

    def open(
        self,
        name: str,
        as_type: Any,
        mode: ValidationMode,
        queue: QueuePolicy,
        on_message: Callable[[Any], None] | None,
        timeout: float,
    ) -> Connection[Any]:
        """Open a function's whole plan; errors are those of `RobotManager.request`."""
        wanted = _reference(name)
        left = self._candidates.wait(timeout, wanted.function)
        wanted_type = self._typed(as_type, name, left)
        revision = self._revisions.current
        identity = f"c{next(self._numbers)}"
        report = partial(self._events.post, f"connection {identity}", Health.DEGRADED.value)
        runtime = ConnectionRuntime(identity, queue, report)
        if on_message is not None:
            take = on_message if wanted_type is None else wanted_type.callback(on_message)
            runtime.receiver.inbox.subscribe(take)
        connection = Connection(runtime, self._driver, wanted_type)
        event = Requested(
            runtime.id,
            wanted,
            mode,
            waiter=f"request {runtime.id}",
            plan=self._known(wanted.function, revision),
            has_callback=on_message is not None,
            revision=revision.number,
            candidates=revision.candidates,
        )
        self._driver.request(runtime, event, f"request for {name!r}", left)
        if wanted_type is not None:
            try:  # of the plan that was opened, which may be another one than was found above
                wanted_type.require(_given(connection.plan, connection.output, name).schema)
            except UsageError:
                connection.kill()
                raise
        return connection

    def _typed(self, hint: Any, name: str, timeout: float) -> MessageType[Any] | None:
        """Return the type that an application wants, proven to be what the function gives."""
        if hint is None:
            return None
        wanted: MessageType[Any] = MessageType(hint, f"function {name!r}")
        reference = _reference(name)
        plan = self.resolve(reference.function, timeout=timeout)
        wanted.require(_given(plan, reference.port, name).schema)
        return wanted

    def _known(self, function: str, revision: Revision) -> Plan | None:
        """Return the plan that was found before, unless it may use what is avoided now."""
        avoided = self._driver.state.avoided
        if avoided and recently(avoided, self._clock()):
            return None
        return revision.resolver.known(function)


def _given(plan: Plan, output: str | None, name: str) -> MessageStructure:
    """Return the structure of the messages that an application receives of a plan."""
    component = plan.provider.component
    given = component.output(output)
    if given is None:
        names = ", ".join(item.name for item in component.outputs)
        has = (
            f"has the outputs {names}" if names else "has no output, so that `as_type` says nothing"
        )
        raise UsageError(f"function {name!r} {has}")
    return plan.provider.structures[f"output.{given.name}"]


def _reference(name: str) -> PortRef:
    """Read `function` or `function.output`."""
    function, dot, port = name.partition(".")
    if dot and not (function and port):
        raise UsageError(f"expected a function, or function.output, got {name!r}")
    return PortRef(function, port if dot else None)


@define(eq=False)
class Services:
    """Calls services and watches those that have raised. Thread safe.

    Args:
        revisions: for the services that the configuration has.
        bridges: that run, and those that are yet to be started.
        driver: takes the verdict on one where it changes.
    """

    _revisions: Revisions
    _bridges: BridgeSet
    _driver: Driver
    _clock: Clock
    # Guards the order of watches: the newest are kept, and two threads may begin one each.
    _lock: threading.Lock = field(factory=threading.Lock, init=False)
    _watches: dict[str, tuple[Component, FailureWatch]] = field(factory=dict, init=False)

    def call(
        self,
        name: str,
        step: Step,
        message: Message,
        wanted: MessageType[Any] | None,
        timeout: float,
        began: Callable[[Callable[[], bool]], object] | None = None,
    ) -> Any:
        """Call the service of a function, both messages checked.

        Args:
            name: of the function.
            step: of the service, or of what is none.
            message: the request, objects of classes included.
            wanted: the type in which the reply is wanted; None: plain values.
            timeout: seconds.
            began: called with what cancels the call, once it is about to be made.

        Raises:
            MessageError: the request does not match the structure.
            CommandRefusedError: it moves something, and the emergency stop refused or cancelled it.
            BridgeError: the service failed or is gone, or its reply does not match the structure.
            BridgeTimeoutError: no reply in time, or within the lifetime of a call.
            UsageError: the function is a stream, or a reply may be no `wanted`.
        """
        component = step.component
        if component.service is None:
            raise UsageError(f"function {name!r} is a stream: use request, not call")
        place = f"request to {component.name}"
        if wanted is not None:
            wanted.require(step.structures["reply"].schema)
        message = as_message(message, place)
        message_check(step.structures["request"], place)(message)
        bridge = self._bridges.running(component.bridge)
        if bridge is None:  # it was lost since; starting it may take as long as it likes
            start = partial(self._bridges.get, component.bridge)
            bridge = deadlines.run(f"starting bridge {component.bridge!r}", timeout, start)
        endpoint = component.service.endpoint
        if endpoint.command is not None and endpoint.command.lifetime is not None:
            timeout = min(timeout, endpoint.command.lifetime)
        before = self._driver.state.services.get(component.name)
        try:
            with self._driver.live.emergency_stop.calling(bridge, endpoint, name) as number:
                if began is not None:
                    began(partial(bridge.cancel_call, number))
                reply = _answer(bridge, step, endpoint, message, timeout, number)
        except CommandRefusedError:
            raise  # no component is to blame
        except Exception as error:
            self._failed(component, error)
            raise
        self._answered(component, before)
        return reply if wanted is None else wanted.read(reply)

    def statuses(self) -> tuple[ComponentStatus, ...]:
        """Return what the status map shows of services that are not well, or have raised."""
        revision, services = self._revisions.current, self._driver.state.services
        names = dict.fromkeys((*self._watches.copy(), *sorted(services)))
        there = [found for found in map(revision.service, names) if found is not None]
        rows = [(found, services.get(found.name), self._watch_of(found)) for found in there]
        return tuple(_status(*row) for row in rows if row[1:] != (None, None))

    def _watch_of(self, component: Component) -> FailureWatch | None:
        """Return what has raised; None: nothing, or another service that had the name before."""
        found = self._watches.get(component.name)
        return found[1] if found is not None and found[0].service == component.service else None

    def _answered(self, component: Component, before: ComponentHealth | None) -> None:
        # Not what was reported since the call began: what answered may have gone since.
        if before is not None and before is self._driver.state.services.get(component.name):
            for part, (health, _) in before.reported.items():
                if health is not Health.DEGRADED:
                    self._driver.judge(component, Health.OK, "it answers again", part)
        watch = self._watch_of(component)
        if watch is None:
            return
        if watch.health is Health.LOST:
            self._begin(component)
        elif watch.is_alert:
            watch.took()

    def _failed(self, component: Component, error: BaseException) -> None:
        if isinstance(error, BridgeError) and error.reason is FailureReason.NOT_FOUND:
            # Nothing of a service is open, so that a bridge may not notice that it went.
            known = self._driver.state.services.get(component.name)
            is_lost = known is not None and known.health is Health.LOST
            if not is_lost or not self._is_avoided(component):
                # One that was lost before has died once: then this has it avoided, and is no news.
                cause = known.cause if known is not None and is_lost else str(error)
                self._driver.judge(component, Health.LOST, cause, "component")
            return
        if not is_raised(error):
            return
        watch = self._watch_of(component)
        if watch is None or (watch.health is Health.LOST and not self._is_avoided(component)):
            watch = self._begin(component)
        # Where the service ran in this process, what it raised itself is the cause.
        watch.raised("the service", error.__cause__ or error)

    def _is_avoided(self, component: Component) -> bool:
        """Say whether one that was lost is avoided still; after that it has another chance."""
        return component.name in recently(self._driver.state.avoided, self._clock())

    def _begin(self, component: Component) -> FailureWatch:
        """Judge a service afresh; what was counted stays."""
        watch = FailureWatch(
            component.name,
            self._driver.state.policy.failing,
            self._clock,
            partial(self._driver.judge, component, part=MESSAGES),
        )
        with self._lock:
            before = self._watch_of(component)
            if before is not None:
                watch.failed, watch.last_error = before.failed, before.last_error
            keep_newest(self._watches, component.name, (component, watch))
        return watch


def _status(
    component: Component, reported: ComponentHealth | None, watch: FailureWatch | None
) -> ComponentStatus:
    health = reported or ComponentHealth()
    if watch is not None:
        health = health.noted(MESSAGES, watch.health, watch.cause)
    return ComponentStatus(
        name=component.name,
        function=component.function,
        bridge=component.bridge,
        health=health.health,
        users=(),
        cause=health.cause,
        failed=0 if watch is None else watch.failed,
        last_error="" if watch is None else watch.last_error,
    )


def _answer(
    bridge: Bridge, step: Step, endpoint: Endpoint, message: Message, timeout: float, number: int
) -> Message:
    """Call a service; what raises here is the service, or its bridge."""
    structures = ServiceStructures(step.structures["request"], step.structures["reply"])
    reply = bridge.call(endpoint, message, structures, timeout=timeout, number=number)
    try:
        message_check(structures.reply, f"the reply of the service {step.component.name}")(reply)
    except MessageError as error:
        raise BridgeError(str(error), FailureReason.BAD_MESSAGE) from error
    return reply
