"""Other machines, as the manager sees them: which bridges are theirs, and who of them is there."""

from __future__ import annotations

import threading
from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING

from attrs import define, field, frozen

from uoarm._origin import install_command
from uoarm._raised import Log
from uoarm.bridge import HealthEvent
from uoarm.errors import BridgeError, FailureReason, PluginError
from uoarm.model import BridgeSpec, Health, Listening, MachineStatus

if TYPE_CHECKING:
    from uoarm._host.machines import MachineRegistry

_log = Log("uoarm")
_LET_GO_SECONDS = 10.0


@frozen
class Joining:
    """Which machines join where, as one configuration has it: the one in force, or one to come.

    Attributes:
        is_cut: whether machines that have joined must join anew when it comes into force, since
            the address is the same; until then none can.
    """

    bridges: Mapping[str, tuple[str, ...]]
    listener: _Listener
    is_cut: bool = False

    @property
    def cut_bridges(self) -> frozenset[str]:
        """The bridges that machines must take up anew."""
        names = (name for names in self.bridges.values() for name in names)
        return frozenset(names) if self.is_cut else frozenset()


class Machines:
    """Listens for the machines that a configuration names, from its making until it is closed.

    An address that cannot be had is tried again whenever a bridge of another machine is needed.

    Args:
        notify: called for every bridge of another machine whether a host for it is there, unless
            the bridge reports more of itself: it runs, or was lost.
        state: says how a bridge is: None when it neither runs nor was lost.
    """

    def __init__(
        self,
        specs: Mapping[str, BridgeSpec],
        listening: Listening | None,
        notify: Callable[[HealthEvent], None],
        state: Callable[[str], Health | None],
    ) -> None:
        self._notify = notify
        self._state = state
        bridges = _by_machine(specs)
        self._joining = Joining(bridges, _Listener(listening, frozenset(bridges)))
        # Held from the look at a machine to its report: or one that left and came would be
        # reported in the other order.
        self._reporting = threading.Lock()
        self._reported: dict[str, bool] = {}
        # Those of configurations before, until the last bridge that joined there is closed.
        self._retired: list[_Listener] = []
        self._beginning: set[threading.Thread] = set()
        self._closed = False

    def begin(self) -> None:
        """Listen, where there is a machine to wait for; what is in the way is logged."""
        if not self._joining.bridges or self._closed:
            return
        try:
            self.registry()
        except (BridgeError, PluginError) as error:
            _log.warning("no other machine can join: %s", error)
            for machine in tuple(self._joining.bridges):
                self._changed(machine, None)

    def registry(self, joining: Joining | None = None) -> MachineRegistry:
        """Return where machines join; None: in the configuration in force.

        Raises:
            BridgeError: the address cannot be had, or not before the configuration is in force; or
                the certificate is missing, or it is closed.
            PluginError: the extra `uoarm[machines]` is missing.
        """
        joining = joining or self._joining
        if joining.is_cut:
            text = "it can join once the configuration is in force"
            raise BridgeError(text, FailureReason.UNAVAILABLE)
        found, is_new = joining.listener.registry(self._changed)
        if is_new and joining is self._joining:
            for machine in tuple(joining.bridges):  # those that came before there was a listener
                self._changed(machine, None)
        return found

    def stage(self, specs: Mapping[str, BridgeSpec], listening: Listening | None) -> Joining:
        """Return the machines of another configuration, which can join it from now on.

        Where the address is another one, both are listened at. Where it is the same, and must be
        listened at otherwise, that begins when the configuration is adopted.

        Raises:
            BridgeError: the address cannot be had, or the certificate not be used.
            PluginError: the extra `uoarm[machines]` is missing.
        """
        bridges, running = _by_machine(specs), self._joining
        before, names = running.listener, frozenset(bridges)
        if before.listening == listening and (
            bridges == running.bridges or before.can_watch(names)
        ):
            before.watch(names | set(running.bridges))
            return Joining(bridges, before)
        is_elsewhere = not before.is_open or _place(before.listening) != _place(listening)
        listener = _Listener(listening, names, None if is_elsewhere else before)
        if is_elsewhere and bridges:
            listener.registry(self._changed)
        return Joining(bridges, listener, is_cut=not is_elsewhere and bool(names))

    def adopt(self, staged: Joining, changed: frozenset[str]) -> None:
        """Have these machines in place of those so far; returns at once.

        Args:
            staged: what is in force from now on.
            changed: names of the bridges that are others, or gone.
        """
        before, after = self._joining.listener, staged.listener
        if after is before and staged.bridges == self._joining.bridges and not changed:
            return
        self._joining = Joining(staged.bridges, after)
        for name in changed:
            self._reported.pop(name, None)
        lost = staged.cut_bridges - changed
        if after is not before:
            self._retired = [listener for listener in self._retired if listener.is_open]
            self._retired.append(before)

        # In a thread, as it waits for hosts: who adopts owns the state of the control plane.
        def begin() -> None:
            for name in sorted(lost):
                if self._state(name) not in {None, Health.LOST}:
                    cause = "the manager listens anew for other machines"
                    self._notify(HealthEvent(name, Health.LOST, cause))
            before.retire() if after is not before else before.watch(frozenset(staged.bridges))
            self.begin()

        thread = threading.Thread(target=begin, name="uoarm-machines", daemon=True)
        try:
            thread.start()
        except RuntimeError:  # the system gives no more threads
            begin()
        else:
            self._beginning = {*filter(threading.Thread.is_alive, self._beginning), thread}

    def statuses(self) -> tuple[MachineStatus, ...]:
        """Return what the status map shows of every machine of the configuration."""
        return tuple(
            self._status(machine, names) for machine, names in self._joining.bridges.items()
        )

    def close(self) -> None:
        """Let every machine go. Once is enough."""
        self._closed = True
        for listener in (self._joining.listener, *self._retired):
            listener.close()
        for thread in tuple(self._beginning):
            thread.join(_LET_GO_SECONDS)

    def discard(self, staged: Joining) -> None:
        """Listen no more for what only a configuration needed that is not taken."""
        if staged.listener is self._joining.listener:
            staged.listener.watch(frozenset(self._joining.bridges))
        else:
            staged.listener.close()

    def _status(self, machine: str, bridges: tuple[str, ...]) -> MachineStatus:
        missing = [bridge for bridge in bridges if not self._here(machine, bridge)]
        registry = self._joining.listener.opened
        offset = None if registry is None else registry.offset(machine)
        known = offset is not None and offset.known
        return MachineStatus(
            machine,
            present=not missing,
            bridges=bridges,
            clock_offset=offset.nanoseconds / 1e9 if offset is not None and known else None,
            clock_error=offset.round_trip / 2e9 if offset is not None and known else None,
            cause=self._waiting(f"its {_listed(missing)}") if missing else "",
        )

    def _here(self, machine: str, bridge: str) -> bool:
        opened = [listener.opened for listener in (self._joining.listener, *self._retired)]
        return any(registry is not None and registry.here(machine, bridge) for registry in opened)

    def _changed(self, machine: str, bridge: str | None) -> None:
        """Report what is new of each bridge of a machine."""
        mine = self._joining.bridges.get(machine, ())
        with self._reporting:
            for name in mine if bridge is None else {bridge}.intersection(mine):
                present = self._here(machine, name)
                if self._reported.get(name) != present:
                    self._reported[name] = present
                    self._report(machine, name, present=present)

    def _report(self, machine: str, bridge: str, *, present: bool) -> None:
        state = self._state(bridge)
        if present and state in {None, Health.LOST}:
            self._notify(HealthEvent(bridge, Health.OK, f"machine {machine!r} has joined"))
        elif not present and state is None:
            cause = self._waiting(f"machine {machine!r}")
            self._notify(HealthEvent(bridge, Health.DEGRADED, cause))

    def _waiting(self, what: str) -> str:
        """Return the cause of a row; the names that the row itself has are not said again."""
        return f"waiting for {what}{self._joining.listener.problem}"


def _listed(bridges: list[str]) -> str:
    return f"bridge{'s' * (len(bridges) > 1)} {', '.join(bridges)}"


@define(eq=False)
class _Listener:
    """Listens at one address, from the first need on; tries again where that failed.

    Args:
        before: who listens there until this one does.
    """

    listening: Listening | None
    _names: frozenset[str]
    _before: _Listener | None = None
    # Held while it begins to listen: who needs it meanwhile waits for the one address, and
    # none opens it after the end.
    _lock: threading.Lock = field(factory=threading.Lock, init=False)
    _closed: bool = field(default=False, init=False)
    opened: MachineRegistry | None = field(default=None, init=False)
    problem: str = field(default="", init=False)

    @property
    def is_open(self) -> bool:
        return self.opened is not None and not self.opened.closed.is_set()

    def can_watch(self, names: frozenset[str]) -> bool:
        """Say whether it listens, and would let these machines join."""
        with self._lock:
            return self.opened is not None and self.opened.can_watch(names)

    def watch(self, names: frozenset[str]) -> None:
        """Let these machines join, all of which it serves, and no others."""
        with self._lock:
            self._names = names
            if self.opened is not None and not self._closed:
                self.opened.watch(names)

    def registry(self, changed: Callable[[str, str | None], None]) -> tuple[MachineRegistry, bool]:
        """Return where machines join, and whether that was opened for this.

        Raises:
            BridgeError: as `Machines.registry`.
            PluginError: likewise.
        """
        try:
            from uoarm._host.machines import (  # noqa: PLC0415 - needs an extra
                MachineRegistry,
            )
        except ImportError as error:
            command = install_command("uoarm", "machines")
            raise PluginError(f"bridges on other machines need: {command} ({error})") from error
        with self._lock:
            if self._closed or self.listening is None:
                text = "the manager does not listen for other machines"
                raise BridgeError(text, FailureReason.UNAVAILABLE)
            if self.opened is not None:
                return self.opened, False
            try:
                if self._before is not None:
                    self._before.require_gone()
                    self._before = None
                self.opened = MachineRegistry(self.listening, self._names, changed)
            except BridgeError as error:
                self.problem = f", which cannot join: {error}"
                raise
            self.problem = ""
            return self.opened, True

    def require_gone(self) -> None:
        """Wait until it listens no more.

        Raises:
            BridgeError: it still does, since a bridge there does not close.
        """
        if self.opened is not None and not self.opened.closed.wait(_LET_GO_SECONDS):
            text = f"machines that joined at {_place(self.listening)} before are still let go"
            raise BridgeError(text, FailureReason.UNAVAILABLE)

    def retire(self) -> None:
        """Take no more hosts; end with the last bridge that uses it."""
        with self._lock:
            self._closed = True
        if self.opened is not None:
            self.opened.retire()

    def close(self) -> None:
        """Let every machine go. Idempotent."""
        with self._lock:
            self._closed = True
        if self.opened is not None:
            self.opened.close()


def _by_machine(specs: Mapping[str, BridgeSpec]) -> Mapping[str, tuple[str, ...]]:
    found: dict[str, list[str]] = {}
    for name, spec in specs.items():
        machine = (spec.host or {}).get("machine")
        if machine is not None:
            found.setdefault(str(machine), []).append(name)
    return {machine: tuple(names) for machine, names in found.items()}


def _place(listening: Listening | None) -> str:
    return "" if listening is None else listening.place
