# ruff: noqa: SLF001 - CORBA begins the names of its own operations with an underscore
"""What our own component consists of: its lifecycle, execution context and configuration.

    INACTIVE --activate--> ACTIVE --deactivate--> INACTIVE
    ACTIVE --a callback fails--> ERROR --reset--> INACTIVE

The lifecycle is that of one component in one execution context, as the RTC specification has it.
A component that takes part in no context is CREATED.
"""

from __future__ import annotations

import logging
import threading
from collections.abc import Callable, Mapping
from functools import partial
from typing import Any

from _uoarm_rtm_stubs import RTC, RTC__POA, SDOPackage, SDOPackage__POA
from attrs import frozen

from uoarm.bridge import LimitedLog, foreign
from uoarm_rtm._orb import Orb
from uoarm_rtm._peer import pairs, properties_of

_LEAST_HZ, _MOST_HZ = 1e-6, 1e6  # of a context: no wait is for ever, and each is one

_log = logging.getLogger("uoarm.rtm")


def _nothing() -> None:
    """Do nothing."""


@frozen
class Callbacks:
    """What a component does at each change; raising sends it to ERROR.

    `executed` is called at the context's rate while ACTIVE; None for a component that works only
    when data arrives.
    """

    activated: Callable[[], None] = _nothing
    deactivated: Callable[[], None] = _nothing
    aborting: Callable[[], None] = _nothing
    reset: Callable[[], None] = _nothing
    executed: Callable[[], None] | None = None


class ComponentLifecycle:
    """The state, and the calls that change it. Callbacks run in the caller's thread.

    Attributes:
        lock: held while the state changes and callbacks run. Transitions come in threads of the
            ORB, steps in the context's, and never overlap. Re-entrant, since a callback may call
            `fail`.
        entered: called under it after each change.
    """

    def __init__(self, callbacks: Callbacks) -> None:
        self._records = LimitedLog(_log, burst=2)  # the second is of the first one's aborting
        self._callbacks = callbacks
        self.lock = threading.RLock()
        self.state: Any = RTC.INACTIVE_STATE
        self.entered: Callable[[], None] = _nothing

    def activate(self) -> Any:
        """INACTIVE to ACTIVE."""
        return self._move(RTC.INACTIVE_STATE, RTC.ACTIVE_STATE, self._callbacks.activated)

    def deactivate(self) -> Any:
        """ACTIVE to INACTIVE."""
        return self._move(RTC.ACTIVE_STATE, RTC.INACTIVE_STATE, self._callbacks.deactivated)

    def reset(self) -> Any:
        """ERROR to INACTIVE; the component stays in ERROR when its callback fails."""
        return self._move(RTC.ERROR_STATE, RTC.INACTIVE_STATE, self._callbacks.reset)

    def execute(self) -> None:
        """Run one step, when ACTIVE."""
        with self.lock:
            if self.state == RTC.ACTIVE_STATE and self._callbacks.executed is not None:
                self._guarded(self._callbacks.executed)

    def fail(self) -> None:
        """ACTIVE to ERROR, as when a callback fails."""
        with self.lock:
            if self.state == RTC.ACTIVE_STATE:
                self._abort()

    def _move(self, before: Any, after: Any, callback: Callable[[], None]) -> Any:
        with self.lock:
            if self.state != before:
                return RTC.PRECONDITION_NOT_MET
            if not self._guarded(callback):
                return RTC.RTC_ERROR
            self._enter(after)
            return RTC.RTC_OK

    def _guarded(self, callback: Callable[[], None]) -> bool:
        try:
            foreign(callback)
        except Exception as error:  # noqa: BLE001 - whatever it raises is a failed transition
            self._records.write(logging.ERROR, "a component's callback failed", error)
            self._abort()
            return False
        return True

    def _abort(self) -> None:
        self._enter(RTC.ERROR_STATE)
        try:
            foreign(self._callbacks.aborting)
        except Exception as error:  # noqa: BLE001 - as above, and it is in ERROR already
            text = "a component's callback failed while it was aborting"
            self._records.write(logging.ERROR, text, error)

    def _enter(self, state: Any) -> None:
        self.state = state
        self.entered()


class ContextServant(RTC__POA.ExecutionContextService):  # type: ignore[misc]  # generated
    """A context with one component, running from the start.

    Args:
        rate: steps a second; 0 for an event-driven context without a thread.
    """

    def __init__(self, orb: Orb, lifecycle: ComponentLifecycle, rate: float) -> None:
        self._orb = orb
        self._lifecycle = lifecycle
        self._rate = rate
        # Guards the rate and both fields below, which operations in threads of the ORB change under
        # our thread.
        self._changed = threading.Condition()
        self._running = True
        self._closed = False
        self.component: Any = None
        self.reference = orb.serve(self)
        if rate:
            threading.Thread(target=self._run, name="uoarm-rtm-context", daemon=True).start()

    def close(self) -> None:
        """End the thread and stop serving."""
        with self._changed:
            self._closed = True
            self._changed.notify_all()
        self._orb.withdraw(self.reference)

    def is_running(self) -> bool:
        """Whether it runs (CORBA operation)."""
        return self._running

    def start(self) -> Any:
        """Run (CORBA operation)."""
        return self._switch(on=True)

    def stop(self) -> Any:
        """Rest (CORBA operation)."""
        return self._switch(on=False)

    def get_rate(self) -> float:
        """Return the steps a second (CORBA operation)."""
        return self._rate

    def set_rate(self, rate: float) -> Any:
        """Set the steps a second (CORBA operation)."""
        if not _LEAST_HZ <= rate <= _MOST_HZ:
            return RTC.BAD_PARAMETER
        if not self._rate:
            return RTC.UNSUPPORTED
        with self._changed:
            self._rate = rate
            self._changed.notify_all()
        return RTC.RTC_OK

    def add_component(self, component: Any) -> Any:
        """Refuse: this context has its component (CORBA operation)."""
        return RTC.PRECONDITION_NOT_MET if self._is_mine(component) else RTC.UNSUPPORTED

    def remove_component(self, component: Any) -> Any:
        """Refuse: this context keeps its component (CORBA operation)."""
        return RTC.UNSUPPORTED if self._is_mine(component) else RTC.BAD_PARAMETER

    def activate_component(self, component: Any) -> Any:
        """Activate the component (CORBA operation)."""
        return self._move(component, self._lifecycle.activate)

    def deactivate_component(self, component: Any) -> Any:
        """Deactivate the component (CORBA operation)."""
        return self._move(component, self._lifecycle.deactivate)

    def reset_component(self, component: Any) -> Any:
        """Bring the component out of ERROR (CORBA operation)."""
        return self._move(component, self._lifecycle.reset)

    def get_component_state(self, component: Any) -> Any:
        """Return the component's state, CREATED for any other (CORBA operation)."""
        return self._lifecycle.state if self._is_mine(component) else RTC.CREATED_STATE

    def get_kind(self) -> Any:
        """Return whether it is periodic (CORBA operation)."""
        return RTC.PERIODIC if self._rate else RTC.EVENT_DRIVEN

    def get_profile(self) -> Any:
        """Return the context's profile (CORBA operation)."""
        kind = self.get_kind()
        return RTC.ExecutionContextProfile(kind, self._rate, self.component, [], [])

    def _is_mine(self, component: Any) -> bool:
        return component is not None and bool(self.component._is_equivalent(component))

    def _move(self, component: Any, move: Callable[[], Any]) -> Any:
        if not self._is_mine(component):
            return RTC.BAD_PARAMETER
        return move() if self._running else RTC.RTC_ERROR

    def _switch(self, *, on: bool) -> Any:
        with self._changed:
            if self._running is on:
                return RTC.PRECONDITION_NOT_MET
            self._running = on
            self._changed.notify_all()
        return RTC.RTC_OK

    def _run(self) -> None:
        while not self._closed:
            if self._running:
                self._lifecycle.execute()
            with self._changed:
                before = self._rate
                self._changed.wait_for(partial(self._is_over, before), 1.0 / before)

    def _is_over(self, rate: float) -> bool:
        return self._closed or self._rate != rate


_MOST_SETS = 100
_MOST_VALUES = 1000  # of a set


class ConfigurationServant(SDOPackage__POA.Configuration):  # type: ignore[misc]  # generated
    """Device profiles, service profiles and organisations are refused: we have none.

    Args:
        sets: values by name of the set.
        changed: called with the values in force whenever they change, in a thread of the ORB, once
            at a time.
    """

    def __init__(
        self,
        orb: Orb,
        sets: Mapping[str, Mapping[str, str]],
        changed: Callable[[Mapping[str, str]], None],
    ) -> None:
        self._orb = orb
        self._changed = changed
        # Guards the sets and which is active: operations come in threads of the ORB.
        self._lock = threading.Lock()
        # Held while a change is notified: the last is of what is in force. Re-entrant, since that
        # may change more.
        self._notifying = threading.RLock()
        self._sets = {name: dict(values) for name, values in sets.items()}
        self._sets.setdefault("default", {})
        self._active = "default"
        self.reference = orb.serve(self)

    def close(self) -> None:
        """Stop serving."""
        self._orb.withdraw(self.reference)

    def get_configuration_sets(self) -> list[Any]:
        """Return every set (CORBA operation)."""
        with self._lock:
            return [self._set(name) for name in self._sets]

    def get_configuration_set(self, config_id: str) -> Any:
        """Return one set (CORBA operation)."""
        with self._lock:
            if config_id not in self._sets:
                raise SDOPackage.InternalError(f"there is no configuration set {config_id!r}")
            return self._set(config_id)

    def get_active_configuration_set(self) -> Any:
        """Return the set in force (CORBA operation)."""
        with self._lock:
            return self._set(self._active)

    def activate_configuration_set(self, config_id: str) -> bool:
        """Put a set in force (CORBA operation)."""
        with self._lock:
            if config_id not in self._sets:
                raise SDOPackage.InvalidParameter(f"there is no configuration set {config_id!r}")
            self._active = config_id
        self._notify()
        return True

    def set_configuration_set_values(self, configuration_set: Any) -> bool:
        """Replace values of a set (CORBA operation)."""
        with self._lock:
            if configuration_set.id not in self._sets:
                text = f"there is no configuration set {configuration_set.id!r}"
                raise SDOPackage.InvalidParameter(text)
            values = properties_of(configuration_set.configuration_data)
            self._sets[configuration_set.id] = _bounded(self._sets[configuration_set.id], values)
            in_force = configuration_set.id == self._active
        if in_force:
            self._notify()
        return True

    def add_configuration_set(self, configuration_set: Any) -> bool:
        """Add a set (CORBA operation)."""
        with self._lock:
            if configuration_set.id in self._sets or len(self._sets) >= _MOST_SETS:
                raise SDOPackage.InvalidParameter("it is there already, or there are too many")
            values = properties_of(configuration_set.configuration_data)
            self._sets[configuration_set.id] = _bounded({}, values)
        return True

    def remove_configuration_set(self, config_id: str) -> bool:
        """Remove a set that is not in force (CORBA operation)."""
        with self._lock:
            if config_id == self._active or self._sets.pop(config_id, None) is None:
                raise SDOPackage.InvalidParameter("it is in force, or not there")
        return True

    def get_configuration_parameters(self) -> list[Any]:
        """Return nothing: types of parameters are not declared (CORBA operation)."""
        return []

    def get_configuration_parameter_values(self) -> list[Any]:
        """Return the values in force (CORBA operation)."""
        with self._lock:
            return pairs(self._sets[self._active])

    def _set(self, name: str) -> Any:
        return SDOPackage.ConfigurationSet(name, "", pairs(self._sets[name]))

    def _notify(self) -> None:
        with self._notifying:
            with self._lock:
                values = dict(self._sets[self._active])
            self._changed(values)


def _bounded(before: Mapping[str, str], values: Mapping[str, str]) -> dict[str, str]:
    """Return values with those before, or raise InvalidParameter where they are too many."""
    after = {**before, **values}
    if len(after) > _MOST_VALUES:
        raise SDOPackage.InvalidParameter(f"a set has {_MOST_VALUES} values at most")
    return after
