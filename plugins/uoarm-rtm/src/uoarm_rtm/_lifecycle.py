"""The lifecycle of one component in one execution context, as the RTC specification has it.

    INACTIVE --activate--> ACTIVE --deactivate--> INACTIVE
    ACTIVE --a callback fails--> ERROR --reset--> INACTIVE

A component that takes part in no context is CREATED.
"""

from __future__ import annotations

import logging
import threading
from collections.abc import Callable
from typing import Any

from _uoarm_rtm_stubs import RTC
from attrs import frozen

from uoarm.bridge import foreign

__all__ = ["Callbacks", "ComponentLifecycle"]

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
    """The state, and the calls that change it. Callbacks run in the caller's thread."""

    def __init__(self, callbacks: Callbacks) -> None:
        self._callbacks = callbacks
        self._lock = threading.RLock()
        self.state: Any = RTC.INACTIVE_STATE
        self.changed = threading.Condition()

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
        with self._lock:
            if self.state == RTC.ACTIVE_STATE and self._callbacks.executed is not None:
                self._guarded(self._callbacks.executed)

    def fail(self) -> None:
        """ACTIVE to ERROR, as when a callback fails."""
        with self._lock:
            if self.state == RTC.ACTIVE_STATE:
                self._abort()

    def _move(self, before: Any, after: Any, callback: Callable[[], None]) -> Any:
        with self._lock:
            if self.state != before:
                return RTC.PRECONDITION_NOT_MET
            if not self._guarded(callback):
                return RTC.RTC_ERROR
            self._enter(after)
            return RTC.RTC_OK

    def _guarded(self, callback: Callable[[], None]) -> bool:
        try:
            foreign(callback)
        except Exception:  # noqa: BLE001 - whatever it raises is a failed transition
            _log.exception("a component's callback failed")
            self._abort()
            return False
        return True

    def _abort(self) -> None:
        self._enter(RTC.ERROR_STATE)
        try:
            foreign(self._callbacks.aborting)
        except Exception:  # noqa: BLE001 - as above, and it is in ERROR already
            _log.exception("a component's callback failed while it was aborting")

    def _enter(self, state: Any) -> None:
        with self.changed:
            self.state = state
            self.changed.notify_all()
