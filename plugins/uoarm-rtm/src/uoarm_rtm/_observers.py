"""Observers that we register in components, which then report their states as they change.

A component whose process has OpenRTM's `ComponentObserver` takes an observer through its SDO
configuration, and calls it without waiting. Where one does not, the check of every second finds
the same, later; so an event is never believed, but brings the next check forward.

Asked for are the states of the component and of its execution contexts. Changes of ports are not:
for them a component would run a listener with each message. Nor are heartbeats: OpenRTM-aist in
Python 1.2 goes on with them when the observer has been removed; the check asks, which says more.

What we registered is ours to remove: it stands in the journal for as long as it may exist.
"""

from __future__ import annotations

import contextlib
import logging
import threading
import time
import uuid
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from typing import Any

from _uoarm_rtm_stubs import OpenRTM, OpenRTM__POA, SDOPackage
from attrs import Factory, define
from omniORB import CORBA

from uoarm.bridge import Channel
from uoarm.errors import BridgeError
from uoarm_rtm._calls import calls
from uoarm_rtm._faults import corba_errors
from uoarm_rtm._journal import JournalEntry, journal
from uoarm_rtm._leftovers import NAME, PROCESS, end_observer
from uoarm_rtm._orb import Orb, limit
from uoarm_rtm._peer import PeerComponent, pairs

__all__ = ["Observers"]

_AT_ONCE = 8

_log = logging.getLogger("uoarm.rtm")

Tick = Callable[[], None]


class _Observer(OpenRTM__POA.ComponentObserver):  # type: ignore[misc]  # generated
    """What one component calls."""

    def __init__(self, notify: Tick) -> None:
        self._notify = notify

    def update_status(self, status_kind: Any, hint: str) -> None:
        """Take an event (CORBA operation, without an answer); a check finds out what it means."""
        del status_kind, hint
        self._notify()


@define
class _Observed:
    """One component: the checks of its channels, and our observer there once it was asked for."""

    peer: PeerComponent
    ticks: dict[Channel, Tick] = Factory(dict)
    is_asked: bool = False
    id: str = ""
    reference: Any = None
    configuration: Any = None


class Observers:
    """The observers of one bridge: one in each component that an open channel leads to.

    Args:
        orb: where they are served.
        name: of the bridge, which they carry.
        seconds: limit of each call.
        soon: has a check made before its turn, in another thread.
    """

    def __init__(self, orb: Orb, name: str, seconds: float, soon: Callable[[Tick], None]) -> None:
        self._orb = orb
        self._properties = {
            NAME: name,
            PROCESS: journal().process,
            "observed_status": "RTC_STATUS,EC_STATUS",
            "heartbeat.enable": "NO",
        }
        self._seconds = seconds
        self._soon = soon
        # Guards the table, never held while a component is called.
        self._guard = threading.Lock()
        # Held while components are called: `close` waits for a registration under way, which
        # would be left behind otherwise.
        self._changing = threading.Lock()
        self._closed = False
        self._observed: dict[str, _Observed] = {}

    def enter(self, channel: Channel, tick: Tick, peer: PeerComponent) -> None:
        """Have a component's events bring a channel's check forward, while the channel is open.

        Does not block: the component is asked in the thread of the checks.
        """
        key = self._orb.text(peer.reference)  # one that came back is another
        with self._guard:
            self._observed.setdefault(key, _Observed(peer)).ticks[channel] = tick
        self._soon(self.tick)

    def tick(self) -> None:
        """Ask components that are new to take an observer, and remove those of closed channels."""
        with self._changing:
            for key, observed in self._all():
                if self._closed:
                    return
                with self._guard:
                    for channel in [channel for channel in observed.ticks if channel.closed]:
                        del observed.ticks[channel]
                    is_over = not observed.ticks
                    if is_over:
                        del self._observed[key]
                if is_over:
                    self._remove(observed)
                elif not observed.is_asked:
                    self._register(observed)

    def close(self, seconds: float | None = None) -> None:
        """Remove all; idempotent.

        Args:
            seconds: one after the other for so long, in a process in which no thread can begin
                any more; what is left then is the next process's. None: several at once.
        """
        self._closed = True
        with self._changing:
            left = [observed for _, observed in self._all()]
            with self._guard:
                self._observed.clear()
            if seconds is not None:
                deadline = time.monotonic() + seconds
                for observed in left:
                    if time.monotonic() < deadline:
                        self._remove(observed)
            elif left:
                with ThreadPoolExecutor(_AT_ONCE, "uoarm-rtm-observers") as pool:
                    list(pool.map(self._remove, left))

    def _all(self) -> list[tuple[str, _Observed]]:
        with self._guard:
            return list(self._observed.items())

    def _register(self, observed: _Observed) -> None:
        observed.is_asked = True
        path = observed.peer.path

        def notify() -> None:
            with self._guard:
                ticks = list(observed.ticks.values())
            for tick in ticks:
                self._soon(tick)

        try:
            with corba_errors(f"component {path!r}: its configuration"):
                found = observed.peer.reference.get_configuration()
                if found is None:
                    return
                observed.configuration = limit(found, self._seconds)
            observed.reference = self._orb.serve(_Observer(notify))
            observed.id = f"uoarm-{uuid.uuid4()}"
            ior = self._orb.text(observed.configuration)
            journal().write(
                JournalEntry(observed.id, (ior,), f"observer in {path}", is_observer=True)
            )
            profile = SDOPackage.ServiceProfile(
                observed.id,
                OpenRTM.ComponentObserver._NP_RepositoryId,  # noqa: SLF001 - of generated code
                pairs(self._properties),
                observed.reference,
            )
            with corba_errors(f"component {path!r}: registering an observer"):
                is_taken = observed.configuration.add_service_profile(profile)
        except BridgeError as error:
            _log.debug("%s", error)
            is_taken = False
        if is_taken:
            notify()  # it may have changed before it knew us
        else:
            _log.debug("component %s takes no observer: it is only checked", path)
            self._remove(observed)

    def _remove(self, observed: _Observed) -> None:
        if observed.reference is not None:
            self._orb.withdraw(observed.reference)
        if observed.id:
            # One that does not answer may still have it: then it stays in the journal.
            with contextlib.suppress(CORBA.Exception), calls:
                end_observer(observed.id, observed.configuration)
                journal().erase(observed.id)
        observed.id, observed.reference = "", None
