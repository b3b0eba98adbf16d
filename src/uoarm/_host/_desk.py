"""The manager's end of every link to other machines: who is there, and what time it is there."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterable
from contextlib import suppress

from uoarm._host import _keys
from uoarm._host._link import Link
from uoarm._host._offset import ClockOffset
from uoarm._host._security import MANAGER, Identity, access_list
from uoarm.errors import UoarmError
from uoarm.model import Listening

__all__ = ["MachineDesk"]

_CLOCK_SECONDS = 1.0
_ANSWER_SECONDS = 0.5
_JOIN_SECONDS = 2.0
_MOST_HOSTS = 64
_MOST_BRIDGES = 1024
_END_OF_TIME = 2**63  # in nanoseconds, in the year 2262


class MachineDesk:
    """Waits for hosts on other machines at one address, from its making until it is closed.

    Args:
        listening: the address, and the folder of the manager's certificate.
        machines: the names that may join; everybody else is denied everything.
        changed: told in the link's thread that a host of a machine has come or gone: the name of
            the machine, and the bridge that it serves, None for every one. Must not block.

    Raises:
        BridgeError: the address cannot be had, or the certificate not be used.
    """

    def __init__(
        self,
        listening: Listening,
        machines: Iterable[str],
        changed: Callable[[str, str | None], None],
    ) -> None:
        names = tuple(machines)
        more = dict(access_list(names, named=listening.certificates is not None))
        if listening.certificates is not None:
            identity = Identity.find(listening.certificates, MANAGER)
            more.update(identity.settings(listen=True))
        self._changed = changed
        self._news = threading.Condition()
        self._hosts: dict[str, list[tuple[str, str]]] = {name: [] for name in names}
        self._came: dict[str, set[str]] = {name: set() for name in names}
        self._offsets = {name: ClockOffset() for name in names}
        self._since = time.monotonic()
        self._stopped = threading.Event()
        self._whole = Link(listening.place, listen=True, lease=listening.silence, more=more)
        self._link = self._whole.part(_keys.MACHINES)
        self._link.watch_tokens(_keys.here("*", "*", "*"), self._seen)
        self._asking = threading.Thread(
            target=self._ask_for_times, name="uoarm-clocks", daemon=True
        )
        self._asking.start()

    def find(self, machine: str, bridge: str, patience: float) -> str | None:
        """Return the name of the host that serves a bridge, None when none comes in time.

        Waits for the first one until the desk has been open for `patience` seconds. Who has
        not joined by then, or has left again, is not waited for.
        """
        deadline = self._since + patience
        with self._news:
            self._news.wait_for(
                lambda: (
                    self._stopped.is_set()
                    or not self._came[machine].isdisjoint({bridge, _keys.ANY_BRIDGE})
                ),
                max(0.0, deadline - time.monotonic()),
            )
            return self._serving(machine, bridge)

    def here(self, machine: str, bridge: str) -> bool:
        """Say whether a host that serves this bridge is there now."""
        with self._news:
            return self._serving(machine, bridge) is not None

    def part(self, prefix: str) -> Link:
        """Return a link to what lies behind a prefix of the keys of machines."""
        return self._link.part(prefix)

    def meet(self, machine: str, host: str, timeout: float) -> None:
        """Ask a host for its time, which one that hangs does not tell.

        Raises:
            BridgeError: UNAVAILABLE when the host has gone.
            BridgeTimeoutError: no answer in time.
        """
        asked, began = time.time_ns(), time.monotonic_ns()
        theirs = self._link.ask(_keys.clock(machine, host), None, timeout=timeout)
        if type(theirs) is int and 0 <= theirs < _END_OF_TIME:
            self._offsets[machine].add(asked, theirs, time.time_ns(), time.monotonic_ns() - began)

    def attach(self, machine: str, host: str, orders: object, timeout: float) -> None:
        """Have a host make a bridge.

        Raises:
            UoarmError: what making it raised.
            BridgeError: UNAVAILABLE when the host has gone.
        """
        self._link.ask(_keys.attach(machine, host), orders, timeout=timeout)

    def offset(self, machine: str) -> ClockOffset:
        """Return what is known of a machine's clock; it goes on learning."""
        return self._offsets[machine]

    def close(self) -> None:
        """Let every machine go. Once is enough."""
        self._stopped.set()
        with self._news:
            self._news.notify_all()
        if threading.current_thread() is not self._asking:
            self._asking.join(_JOIN_SECONDS)
        self._whole.close()

    def _serving(self, machine: str, bridge: str) -> str | None:
        """Return the newest host that serves just this bridge, else the newest that serves all."""
        newest = self._hosts[machine][::-1]
        just = (host for served, host in newest if served == bridge)
        every = (host for served, host in newest if served == _keys.ANY_BRIDGE)
        return next(just, next(every, None))

    def _seen(self, key: str, present: bool) -> None:  # noqa: FBT001 - told, not asked
        machine, _, bridge, host = key.split("/")
        if machine not in self._hosts:
            return
        with self._news:
            hosts = self._hosts[machine]
            if (bridge, host) in hosts:
                hosts.remove((bridge, host))
            if present and len(hosts) < _MOST_HOSTS:
                hosts.append((bridge, host))
                if len(self._came[machine]) < _MOST_BRIDGES:
                    self._came[machine].add(bridge)
            if not hosts:
                self._offsets[machine].clear()
            self._news.notify_all()
        self._changed(machine, None if bridge == _keys.ANY_BRIDGE else bridge)

    def _ask_for_times(self) -> None:
        while not self._stopped.wait(_CLOCK_SECONDS):
            with self._news:
                present = {name: one[-1][1] for name, one in self._hosts.items() if one}
            for machine, host in present.items():
                with suppress(UoarmError):  # whoever uses the machine notices that it is silent
                    self.meet(machine, host, _ANSWER_SECONDS)
