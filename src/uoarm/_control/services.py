"""Calls of services; those that raise are counted by name, as nothing of them stays open."""

from __future__ import annotations

import threading
from collections.abc import Callable
from functools import partial
from typing import Any

from uoarm._control.live.emergency_stop import EmergencyStop
from uoarm._control.live.failure_watch import FailureWatch
from uoarm._dataplane import Clock, make_check
from uoarm._hints.applications import MessageType, as_message
from uoarm._raised import is_raised
from uoarm.bridge import Bridge, ServiceStructures
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
    FailureLimits,
    Health,
    Message,
    MessageStructure,
    Step,
    ValidationMode,
)

__all__ = ["Services"]

_WATCHES = 1000


class Services:
    """Calls services and watches those that have raised. Thread safe.

    Args:
        bridge: gives the bridge of this name.
        limits: gives when one is lost.
        clock: seconds.
        tell: told when the verdict on one changes.
        is_avoided: says whether one that was lost is still avoided; after that it has another
            chance.
        emergency_stop: refuses and cancels calls of what moves something.
    """

    def __init__(
        self,
        bridge: Callable[[str], Bridge],
        limits: Callable[[], FailureLimits],
        clock: Clock,
        tell: Callable[[Component, Health, str], None],
        is_avoided: Callable[[str], bool],
        emergency_stop: EmergencyStop,
    ) -> None:
        self._bridge = bridge
        self._limits = limits
        self._clock = clock
        self._tell = tell
        self._is_avoided = is_avoided
        self._emergency_stop = emergency_stop
        self._lock = threading.Lock()
        self._watches: dict[str, tuple[Component, FailureWatch]] = {}

    def call(
        self,
        name: str,
        step: Step,
        message: Message,
        wanted: MessageType[Any] | None,
        timeout: float,
    ) -> Any:
        """Call the service of a function, both messages checked.

        Args:
            name: of the function.
            step: of the service, or of what is none.
            message: the request, objects of classes included.
            wanted: the type in which the reply is wanted; None: plain values.
            timeout: seconds.

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
        _check(message, step.structures["request"], place)
        bridge = self._bridge(component.bridge)
        endpoint = component.service.endpoint
        if endpoint.command is not None and endpoint.command.lifetime is not None:
            timeout = min(timeout, endpoint.command.lifetime)
        try:
            with self._emergency_stop.calling(bridge, endpoint, name) as number:
                reply = _answer(bridge, step, endpoint, message, timeout, number)
        except CommandRefusedError:
            raise  # nobody is to blame
        except Exception as error:
            self._failed(component, error)
            raise
        self._answered(component)
        return reply if wanted is None else wanted.read(reply)

    def statuses(self) -> tuple[ComponentStatus, ...]:
        """Return what the status map shows of services that have raised."""
        return tuple(
            ComponentStatus(
                name=component.name,
                function=component.function,
                bridge=component.bridge,
                health=watch.health,
                users=(),
                cause=watch.cause,
                failed=watch.failed,
                last_error=watch.last_error,
            )
            for component, watch in tuple(self._watches.values())
        )

    def _answered(self, component: Component) -> None:
        """Take in that a service replied."""
        found = self._watches.get(component.name)
        if found is None:
            return
        if found[1].health is Health.LOST:
            self._begin(component)
            self._tell(component, Health.OK, "it answers again")
        elif found[1].is_alert:
            found[1].took()

    def _failed(self, component: Component, error: BaseException) -> None:
        """Take in that a call failed."""
        if not is_raised(error):
            return
        _, watch = self._watches.get(component.name, (component, None))
        if watch is None or (watch.health is Health.LOST and not self._is_avoided(component.name)):
            watch = self._begin(component)
        # Where the service ran in this process, what it raised itself is the cause.
        watch.raised("the service", error.__cause__ or error)

    def _begin(self, component: Component) -> FailureWatch:
        """Judge a service afresh; what was counted stays."""
        watch = FailureWatch(
            component.name, self._limits(), self._clock, partial(self._tell, component)
        )
        with self._lock:
            before = self._watches.get(component.name)
            if before is not None:
                watch.failed, watch.last_error = before[1].failed, before[1].last_error
            self._watches[component.name] = component, watch
            while len(self._watches) > _WATCHES:  # names come and go for ever
                del self._watches[next(iter(self._watches))]
        return watch


def _answer(
    bridge: Bridge, step: Step, endpoint: Endpoint, message: Message, timeout: float, number: int
) -> Message:
    """Call a service; what raises here is the service, or its bridge."""
    structures = ServiceStructures(step.structures["request"], step.structures["reply"])
    reply = bridge.call(endpoint, message, structures, timeout=timeout, number=number)
    try:
        _check(reply, structures.reply, f"the reply of the service {step.component.name}")
    except MessageError as error:
        raise BridgeError(str(error), FailureReason.BAD_MESSAGE) from error
    return reply


def _check(message: Message, structure: MessageStructure, place: str) -> None:
    check = make_check(structure, ValidationMode.ALWAYS, place)
    if check is not None:
        check(message)
