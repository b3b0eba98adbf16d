# ruff: noqa: SLF001 - CORBA begins the names of its own operations with an underscore
"""The execution context of our own component: it owns one component and drives it."""

from __future__ import annotations

import threading
from typing import Any

from _uoarm_rtm_stubs import RTC, RTC__POA

from uoarm_rtm._lifecycle import ComponentLifecycle
from uoarm_rtm._orb import Orb

__all__ = ["ContextServant"]


class ContextServant(RTC__POA.ExecutionContextService):  # type: ignore[misc]  # generated
    """A context with one component, running from the start.

    Args:
        orb: where it is served.
        lifecycle: the component's.
        rate: steps a second; 0 for an event-driven context without a thread.
    """

    def __init__(self, orb: Orb, lifecycle: ComponentLifecycle, rate: float) -> None:
        self._orb = orb
        self._lifecycle = lifecycle
        self._rate = rate
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
        if not rate > 0:
            return RTC.BAD_PARAMETER
        if not self._rate:
            return RTC.UNSUPPORTED
        self._rate = rate
        return RTC.RTC_OK

    def add_component(self, component: Any) -> Any:
        """Refuse: this context has its component (CORBA operation)."""
        return RTC.PRECONDITION_NOT_MET if self._is_mine(component) else RTC.UNSUPPORTED

    def remove_component(self, component: Any) -> Any:
        """Refuse: this context keeps its component (CORBA operation)."""
        return RTC.UNSUPPORTED if self._is_mine(component) else RTC.BAD_PARAMETER

    def activate_component(self, component: Any) -> Any:
        """Activate the component (CORBA operation)."""
        if not self._is_mine(component):
            return RTC.BAD_PARAMETER
        return self._lifecycle.activate() if self._running else RTC.RTC_ERROR

    def deactivate_component(self, component: Any) -> Any:
        """Deactivate the component (CORBA operation)."""
        if not self._is_mine(component):
            return RTC.BAD_PARAMETER
        return self._lifecycle.deactivate() if self._running else RTC.RTC_ERROR

    def reset_component(self, component: Any) -> Any:
        """Bring the component out of ERROR (CORBA operation)."""
        if not self._is_mine(component):
            return RTC.BAD_PARAMETER
        return self._lifecycle.reset() if self._running else RTC.RTC_ERROR

    def get_component_state(self, component: Any) -> Any:
        """Return the component's state, CREATED for a stranger (CORBA operation)."""
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
                self._changed.wait_for(lambda: self._closed, 1.0 / self._rate)
