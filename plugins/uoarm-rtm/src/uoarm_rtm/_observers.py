"""Observers: components that report changes of their states are checked at once.

A component whose process has OpenRTM's `ComponentObserver` takes an observer through its SDO
configuration, and calls it without waiting. Where one does not, the check of every second finds the
same, later; so an event is never believed, but brings the next check forward.

Observed are the states of the component and of its execution contexts. Changes of ports are not:
for them a component would run a listener with each message. Nor are heartbeats: OpenRTM-aist in
Python 1.2 continues them when the observer has been removed; the check asks, which says more.
"""

from __future__ import annotations

import contextlib
import threading
import time
import uuid
from collections.abc import Callable
from typing import Any

from _uoarm_rtm_stubs import OpenRTM, OpenRTM__POA, SDOPackage
from omniORB import CORBA

from uoarm.bridge import Log, WorkerExecutor
from uoarm.errors import BridgeError
from uoarm_rtm._health import WatchedComponent
from uoarm_rtm._journal import NAME, PROCESS, JournalEntry, end_observer, journal
from uoarm_rtm._orb import Orb, calls, corba_errors, limit
from uoarm_rtm._peer import pairs
from uoarm_rtm._watch import Check

_AT_ONCE = 8

_log = Log("uoarm.rtm")


class _Observer(OpenRTM__POA.ComponentObserver):  # type: ignore[misc]  # generated
    """What one component calls."""

    def __init__(self, notify: Callable[[], None]) -> None:
        self._notify = notify

    def update_status(self, status_kind: Any, hint: str) -> None:
        """Take an event (CORBA operation, without an answer); a check finds out what it means."""
        del status_kind, hint
        self._notify()


class _Observed:
    """One component, and our observer there once it was asked for."""

    def __init__(self, owner: Observers, component: WatchedComponent) -> None:
        self._owner = owner
        self._component = component
        # Held while the component is called: `remove` waits for a registration under way, which
        # would be left behind otherwise.
        self._changing = threading.Lock()
        self._is_asked = self._is_over = False
        self._id = ""
        self._reference: Any = None
        self._configuration: Any = None

    @property
    def is_settled(self) -> bool:
        """Whether there is nothing to do until the last channel is closed."""
        return self._is_asked and self._component.is_used

    def check(self) -> None:
        """Ask a component that is new to take an observer; remove that of one without channels."""
        with self._changing:
            if self._is_over:
                return
            if self._owner.forget_unused(self._component):
                self._remove()
            elif not self._is_asked:
                self._is_asked = True
                self._register()

    def remove(self) -> None:
        """Remove the observer, for good."""
        with self._changing:
            self._remove()

    def _register(self) -> None:
        peer, owner, notify = self._component.peer, self._owner, self._component.check_soon
        try:
            with corba_errors(f"component {peer.path!r}: its configuration"):
                found = peer.reference.get_configuration()
                if found is None:
                    return
                self._configuration = limit(found, owner.seconds)
            self._reference = owner.orb.serve(_Observer(notify))
            self._id = f"uoarm-{uuid.uuid4()}"
            ior = owner.orb.text(self._configuration)
            entry = JournalEntry(self._id, (ior,), f"observer in {peer.path}", is_observer=True)
            journal().write(entry)
            profile = SDOPackage.ServiceProfile(
                self._id,
                OpenRTM.ComponentObserver._NP_RepositoryId,  # noqa: SLF001 - of generated code
                pairs(owner.properties),
                self._reference,
            )
            with corba_errors(f"component {peer.path!r}: registering an observer"):
                is_taken = self._configuration.add_service_profile(profile)
        except BridgeError as error:
            _log.debug("%s", error)
            is_taken = False
        if is_taken:
            notify()  # it may have changed before it knew us
        else:
            _log.debug("component %s takes no observer: it is only checked", peer.path)
            self._withdraw()

    def _remove(self) -> None:
        self._is_over = True
        self._withdraw()

    def _withdraw(self) -> None:
        if self._reference is not None:
            self._owner.orb.withdraw(self._reference)
        if self._id:
            # One that does not answer may still have it: then it stays in the journal.
            with contextlib.suppress(CORBA.Exception), calls:
                end_observer(self._id, self._configuration)
                journal().erase(self._id)
        self._id, self._reference = "", None


class Observers:
    """The observers of one bridge: one in each component that an open channel leads to.

    Args:
        name: of the bridge, which they carry.
        seconds: limit of each call.
        soon: has a check made before its turn, in another thread.
    """

    def __init__(self, orb: Orb, name: str, seconds: float, soon: Callable[[Check], None]) -> None:
        self.orb = orb
        self.properties = {
            NAME: name,
            PROCESS: journal().process,
            "observed_status": "RTC_STATUS,EC_STATUS",
            "heartbeat.enable": "NO",
        }
        self.seconds = seconds
        self._soon = soon
        # Guards the table, never held while a component is called.
        self._guard = threading.Lock()
        self._observed: dict[WatchedComponent, _Observed] = {}

    def enter(self, component: WatchedComponent) -> None:
        """Have a component's events bring its check forward, while it has open channels.

        Does not block: the component is asked in a thread of the checks.
        """
        with self._guard:
            observed = self._observed.setdefault(component, _Observed(self, component))
        self._soon(observed.check)

    def forget_unused(self, component: WatchedComponent) -> bool:
        """Leave out a component without channels from the next round on; say whether it is one."""
        # Looked at with the guard: one of which a channel opens now enters before it, and is kept,
        # or is observed anew after it.
        with self._guard:
            is_unused = not component.is_used
            if is_unused:
                self._observed.pop(component, None)
        return is_unused

    def checks(self) -> list[Check]:
        """Return what there is to do, of each component on its own."""
        return [observed.check for observed in self._all() if not observed.is_settled]

    def close(self, seconds: float | None = None) -> None:
        """Remove all; idempotent.

        Args:
            seconds: one after the other for so long, in a process in which no thread can begin
                any more; what is left then is the next process's. None: several at once.
        """
        left = self._all()
        with self._guard:
            self._observed.clear()
        if seconds is not None:
            deadline = time.monotonic() + seconds
            for observed in left:
                if time.monotonic() < deadline:
                    observed.remove()
        elif left:
            with WorkerExecutor("uoarm-rtm-observers", _AT_ONCE) as pool:
                list(pool.map(_Observed.remove, left))

    def _all(self) -> list[_Observed]:
        with self._guard:
            return list(self._observed.values())
