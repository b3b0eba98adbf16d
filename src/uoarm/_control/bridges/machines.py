"""Other machines, as the manager sees them: which bridges are theirs, and who of them is there."""

from __future__ import annotations

import logging
import threading
from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING

from uoarm._origin import install_command
from uoarm.bridge import HealthEvent
from uoarm.errors import BridgeError, FailureReason, PluginError
from uoarm.model import BridgeSpec, Health, Listening, MachineStatus

if TYPE_CHECKING:
    from uoarm._host import MachineRegistry

__all__ = ["Machines"]

_log = logging.getLogger("uoarm")


class Machines:
    """Listens for the machines that a configuration names, from its making until it is closed.

    An address that cannot be had is tried again whenever a bridge of another machine is needed.

    Args:
        specs: the bridges of the configuration.
        listening: where machines join.
        heard: told of every bridge of another machine whether a host for it is there, unless
            the bridge tells more of itself: it runs, or was lost.
        state: says how a bridge is: None when it neither runs nor was lost.
    """

    def __init__(
        self,
        specs: Mapping[str, BridgeSpec],
        listening: Listening | None,
        heard: Callable[[HealthEvent], None],
        state: Callable[[str], Health | None],
    ) -> None:
        self._listening = listening
        self._heard = heard
        self._state = state
        self._bridges: dict[str, list[str]] = {}
        for name, spec in specs.items():
            machine = (spec.host or {}).get("machine")
            if machine is not None:
                self._bridges.setdefault(str(machine), []).append(name)
        self._lock = threading.Lock()
        self._telling = threading.Lock()
        self._registry: MachineRegistry | None = None
        self._closed = False
        self._told: dict[str, bool] = {}
        self._problem = ""

    def begin(self) -> None:
        """Listen, where there is a machine to wait for; what is in the way is logged."""
        if not self._bridges:
            return
        try:
            self.registry()
        except (BridgeError, PluginError) as error:
            _log.warning("no other machine can join: %s", error)
            for machine in self._bridges:
                self._changed(machine, None)

    def registry(self) -> MachineRegistry:
        """Return where machines join.

        Raises:
            BridgeError: the address cannot be had, the certificate is missing, or it is closed.
            PluginError: the extra `uoarm[hosts]` is missing.
        """
        try:
            from uoarm._host import MachineRegistry  # noqa: PLC0415 - needs an extra
        except ImportError as error:
            command = install_command("uoarm", "hosts")
            raise PluginError(f"bridges on other machines need: {command} ({error})") from error
        with self._lock:
            if self._closed or self._listening is None:
                text = "the manager does not listen for other machines"
                raise BridgeError(text, FailureReason.UNAVAILABLE)
            if self._registry is not None:
                return self._registry
            try:
                registry = self._registry = MachineRegistry(
                    self._listening, self._bridges, self._changed
                )
            except BridgeError as error:
                self._problem = f", which cannot join: {error}"
                raise
            self._problem = ""
        for machine in self._bridges:  # who came before anybody listened
            self._changed(machine, None)
        return registry

    def statuses(self) -> tuple[MachineStatus, ...]:
        """Return what the status map shows of every machine of the configuration."""
        return tuple(self._status(machine) for machine in self._bridges)

    def close(self) -> None:
        """Let every machine go. Once is enough."""
        with self._lock:
            self._closed = True
            registry, self._registry = self._registry, None
        if registry is not None:
            registry.close()

    def _status(self, machine: str) -> MachineStatus:
        registry = self._registry
        bridges = tuple(self._bridges[machine])
        missing = [one for one in bridges if registry is None or not registry.here(machine, one)]
        offset = None if registry is None else registry.offset(machine)
        known = offset is not None and offset.known
        return MachineStatus(
            machine,
            present=not missing,
            bridges=bridges,
            clock_offset=offset.nanoseconds / 1e9 if offset is not None and known else None,
            clock_error=offset.round_trip / 2e9 if offset is not None and known else None,
            cause=self._waiting(machine, missing) if missing else "",
        )

    def _changed(self, machine: str, bridge: str | None) -> None:
        """Tell what is new of each bridge of a machine."""
        mine = self._bridges[machine]
        with self._telling:
            for name in mine if bridge is None else {bridge}.intersection(mine):
                registry = self._registry
                present = registry is not None and registry.here(machine, name)
                if self._told.get(name) != present:
                    self._told[name] = present
                    self._tell(machine, name, present=present)

    def _tell(self, machine: str, bridge: str, *, present: bool) -> None:
        state = self._state(bridge)
        if present and state in {None, Health.LOST}:
            self._heard(HealthEvent(bridge, Health.OK, f"machine {machine!r} has joined"))
        elif not present and state is None:
            self._heard(HealthEvent(bridge, Health.DEGRADED, self._waiting(machine, [bridge])))

    def _waiting(self, machine: str, bridges: list[str]) -> str:
        return f"waiting for machine {machine!r}: {', '.join(bridges)}{self._problem}"
