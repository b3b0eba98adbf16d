"""The bridge instances of one manager, each made when it is first needed, some in a host.

A bridge that died is started again at once, then later and later, and at last never (`Restarts`).
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Mapping
from functools import partial
from typing import TYPE_CHECKING

from attrs import define, evolve, field

from uoarm._backoff import Backoff
from uoarm._bridges._machines import Joining, Machines
from uoarm._dataplane import Clock
from uoarm._interrupts import Uninterrupted
from uoarm._origin import install_command
from uoarm._raised import Log, foreign, text_of
from uoarm._support import deadlines
from uoarm.bridge import Bridge, Channel, HealthEvent, Registry
from uoarm.errors import BridgeError, ConnectionClosedError, FailureReason, PluginError
from uoarm.model import BridgeSpec, BridgeStatus, Health, Listening, Options, StatusMap

if TYPE_CHECKING:
    from uoarm._host.machines import MachineRegistry

# Between two restarts of a bridge that died more than once; the first restart is free.
_RESTARTS = Backoff(first=0.25, most=30.0)
_HEALTHY_SECONDS = 60.0


@define
class _Record:
    """What is known of one bridge: its deaths in a row, and when it began and ended last."""

    deaths: int = 0
    began: float = 0.0
    ended: float = 0.0
    cause: str = ""


class Restarts:
    """Keeps a bridge that dies again and again from being started again and again.

    The first restart is free. Each later one waits twice as long as the one before, from 0.25 s
    to 30 s. A bridge that has lived for a minute starts with a clean record.
    """

    def __init__(self, clock: Clock) -> None:
        self._clock = clock
        # Guards the records: a bridge dies in one thread while another asks whether it may be
        # started.
        self._lock = threading.Lock()
        self._records: dict[str, _Record] = {}

    def began(self, name: str) -> None:
        """Note that a bridge is being started."""
        with self._lock:
            self._records.setdefault(name, _Record()).began = self._clock()

    def died(self, name: str, cause: str) -> None:
        """Note that a bridge died, or did not come to life."""
        with self._lock:
            record = self._records.setdefault(name, _Record())
            now = self._clock()
            lived = now - record.began
            record.deaths = 1 if lived >= _HEALTHY_SECONDS else record.deaths + 1
            record.ended, record.cause = now, cause

    def check(self, name: str, limit: int) -> None:
        """Let a bridge be started now, or say why not.

        Args:
            name: of the bridge.
            limit: deaths in a row after which it is given up.

        Raises:
            BridgeError: it must wait, or is given up; the text has the last cause of death.
        """
        with self._lock:
            record = self._records.get(name)
            if record is None or record.deaths == 0:
                return
            deaths, cause = record.deaths, record.cause
            due = record.ended + (_RESTARTS.pause(deaths - 1) if deaths > 1 else 0.0)
        if deaths >= limit:
            text = f"bridge {name!r} is given up: it died {deaths} times in a row, at last: {cause}"
            raise BridgeError(text, FailureReason.UNAVAILABLE)
        wait = due - self._clock()
        if wait > 0:
            text = (
                f"bridge {name!r} died {deaths} times in a row and is started again in "
                f"{wait:.2g} s at the earliest; it died because {cause}"
            )
            raise BridgeError(text, FailureReason.UNAVAILABLE)


def start_hosted(
    spec: BridgeSpec,
    host: Options,
    restarts: Restarts,
    registry: Callable[[], MachineRegistry],
    origin: str,
) -> Bridge:
    """Start the host of a bridge, or find it on its machine, and return when it is ready.

    Args:
        spec: the bridge.
        host: the settings of its host, see `HostSettings`.
        restarts: what is known of earlier deaths.
        registry: says where other machines join; what runs there is never started from here.
        origin: the configuration file, which the host's command line shows.

    Raises:
        PluginError: the extra `uoarm[hosts]`, or the plugin in the host, is missing.
        BridgeError: the host could not be started, or died too often.
    """
    try:
        from uoarm._host import HostSettings, RemoteBridge  # noqa: PLC0415 - needs an extra
    except ImportError as error:
        command = install_command("uoarm", "hosts")
        text = f"bridge {spec.name!r} has a host, which needs: {command} ({error})"
        raise PluginError(text) from error
    if "machine" in host:
        return RemoteBridge(spec, registry())
    restarts.check(spec.name, HostSettings.read(host).restarts)
    restarts.began(spec.name)
    try:
        return RemoteBridge(spec, origin=origin)
    except BridgeError as error:
        if error.reason in {FailureReason.UNAVAILABLE, FailureReason.TIMEOUT}:
            restarts.died(spec.name, str(error))
        raise


_log = Log("uoarm")
_START_SECONDS = 30.0
_RETIRE_SECONDS = 10.0
_FINE = Health.OK, ""


class BridgeSet:
    """Makes, keeps and closes bridges by name.

    Args:
        listener: takes what bridges report behind all that it took before, and waits for nothing;
            what it returns handles it.
        ready: instances to use instead of making them; closed with the others.
        origin: the configuration file, for those who look at the processes of hosts.
        manager: identity of the manager that uses them.
    """

    def __init__(
        self,
        specs: Mapping[str, BridgeSpec],
        registry: Registry,
        listener: Callable[[HealthEvent], Callable[[], object]],
        ready: Mapping[str, Bridge],
        clock: Clock,
        listening: Listening | None = None,
        origin: str = "",
        manager: str = "",
    ) -> None:
        self._origin, self._manager = origin, manager
        self._status: Callable[[], StatusMap] | None = None
        self._specs = specs
        self._registry = registry
        self._listener = listener
        self._bridges: dict[str, Bridge] = {}
        self._restarts = Restarts(clock)
        self._turns: dict[str, threading.Lock] = {}
        # What was lost waits here for `RetireBridge`, which comes after the edges were stopped.
        self._dead: dict[str, list[Bridge]] = {}
        # What the configuration has otherwise goes on for the components that it has open.
        self._replaced: list[Bridge] = []
        self._retiring: set[threading.Thread] = set()
        self._health: dict[str, tuple[Health, str]] = {}
        # Guards what is listed, and never a start or a close: these may hang, and starts have a
        # lock for each name. The listener takes reports under it, so that those of a bridge come
        # before those of the next one of its name.
        self._lock = threading.Lock()
        self._closed = False
        self.machines = Machines(specs, listening, self._note_health, self._state)
        self._bridges.update(ready)

    def begin(self) -> None:
        """Take what bridges report, and listen for other machines."""
        for name, bridge in self._bridges.copy().items():
            self._watch(name, bridge)
        self.machines.begin()

    def show(self, status: Callable[[], StatusMap]) -> None:
        """Have bridges of this process read the manager's status; before any of them is used."""
        self._status = status
        for bridge in self._bridges.values():
            bridge.status = status

    def get(self, name: str) -> Bridge:
        """Return the bridge of this name, starting it when it is the first time.

        Raises:
            PluginError: its plugin is missing, broken or lacks its middleware.
            BridgeError: it failed to start, or there is no such bridge.
            ConnectionClosedError: the manager is closed.
        """
        # Without the lock, as each part of each opening asks: an entry is set and taken out in one
        # step.
        bridge = self._bridges.get(name)
        if bridge is not None:
            return bridge
        with self._lock:
            self._require_open()
            turn = self._turns.setdefault(name, threading.Lock())
        # One that is slow to start holds up no other; the second who asks for it finds it made.
        with turn:
            bridge = self._bridges.get(name)
            if bridge is not None:
                return bridge
            spec = self._specs.get(name)
            bridge = self.start(name, spec)
            with self._lock:
                # What another configuration has no more is closed where it would go unnoticed.
                keep = not self._closed and self._specs.get(name) == spec
                handle: Callable[[], object] | None = None
                if keep:
                    self._bridges[name] = bridge
                    if self._health.pop(name, _FINE)[0] is Health.LOST:
                        event = HealthEvent(name, Health.OK, "it was started again")
                        handle = self._listener(event)
        if not keep:
            bridge.close()
            self._require_open()
            text = f"the configuration of bridge {name!r} was changed while it was started"
            raise BridgeError(text, FailureReason.UNAVAILABLE)
        if handle is not None:
            handle()
        self._watch(name, bridge)
        return bridge

    def running(self, name: str) -> Bridge | None:
        """Return the bridge of this name; None where it would have to be started."""
        return self._bridges.get(name)

    def stopping(self) -> tuple[Bridge, ...]:
        """Return the bridges that run, those replaced too, and stop what moves behind them."""
        with self._lock:
            running = (*self._bridges.values(), *self._replaced)
        return tuple(bridge for bridge in running if bridge.capabilities.stop)

    def is_in_use(self, bridge: Bridge) -> bool:
        """Say whether a bridge is the one that bears its name now."""
        return self._bridges.get(bridge.name) is bridge

    def retire(self, name: str) -> None:
        """Close a bridge that was lost, in a thread of its own: it may hang as it dies.

        Failures while closing are logged.
        """

        def close() -> None:
            for bridge in dead:
                close_logged(bridge.close)
            with self._lock:
                self._retiring.discard(thread)

        thread = threading.Thread(target=close, name=f"uoarm-retire-{name}", daemon=True)
        with self._lock:  # with the start: `close` joins all that are listed
            dead = self._dead.get(name, [])
            if dead:
                thread.start()  # where it cannot, they stay listed for the end
                self._retiring.add(thread)
                del self._dead[name]

    def stage(self, specs: Mapping[str, BridgeSpec], listening: Listening | None) -> StagedBridges:
        """Return the bridges of another configuration: these, where they stay as they are.

        Raises:
            BridgeError: other machines cannot join at its address.
            PluginError: the extra `uoarm[machines]` is missing.
        """
        return StagedBridges(self, self._specs, specs, self.machines.stage(specs, listening))

    def adopt(self, staged: StagedBridges) -> None:
        """Have these bridges in place of those so far, which go on for who uses them. Quick."""
        with self._lock:
            before, self._specs = self._specs, staged.specs
            names = {*before, *staged.specs}
            changed = {text for text in names if before.get(text) != staged.specs.get(text)}
            unwell = []
            for name in changed:
                if self._health.pop(name, _FINE)[0] is not Health.OK:  # no other bridge would say
                    event = HealthEvent(name, Health.OK, "the configuration has another")
                    unwell.append(self._listener(event))
                replaced = self._bridges.pop(name, None)
                if replaced is not None:
                    replaced.watch(None)
                    self._replaced.append(replaced)
                new = staged.made.pop(name, None)
                if new is not None:
                    self._bridges[name] = new
        for handle in unwell:
            handle()
        for name in changed & self._bridges.keys():
            self._watch(name, self._bridges[name])
        self.machines.adopt(staged.joining, frozenset(changed))

    def retire_replaced(self, in_use: Callable[[Bridge], bool]) -> None:
        """Close those that were replaced and that have no user any more; returns at once."""
        if not self._replaced:
            return
        with self._lock:
            unused = [bridge for bridge in self._replaced if not in_use(bridge)]
            self._replaced = [bridge for bridge in self._replaced if bridge not in unused]
            for bridge in unused:
                self._dead.setdefault(bridge.name, []).append(bridge)
        for name in {bridge.name for bridge in unused}:
            self.retire(name)

    def statuses(self) -> tuple[BridgeStatus, ...]:
        """Return what the status map shows: bridges that were started, those that died included."""
        with self._lock:
            known = {**dict.fromkeys(self._health), **self._bridges}
            health = dict(self._health)
        return tuple(
            BridgeStatus(
                name=name,
                plugin=self._specs[name].plugin if name in self._specs else name,
                health=health.get(name, _FINE)[0],
                open_channels=0 if bridge is None else bridge.open_channels,
                cause=health.get(name, _FINE)[1],
                assigned=tuple(self._specs[name].assigned.items()) if name in self._specs else (),
                process=None if bridge is None else bridge.process_id,
                facts=() if bridge is None else facts_of(bridge),
            )
            for name, bridge in known.items()
        )

    def close(self) -> list[BridgeError]:
        """Close every bridge, and the link to other machines; return what failed.

        Waits ten seconds at most for bridges that were lost.
        """
        with self._lock:
            # Under the lock of `get`: a bridge that starts just now finds this, and closes itself.
            self._closed = True
            bridges = [*self._bridges.values(), *self._replaced]
            self._bridges.clear()
            self._replaced.clear()
            dead = tuple(self._dead)
        for name in dead:
            try:
                self.retire(name)
            except RuntimeError:  # the system gives no more threads
                for bridge in self._dead.pop(name):
                    close_logged(bridge.close)
        failures: list[BridgeError] = []
        for close in (*(bridge.close for bridge in bridges), self.machines.close):
            try:
                close()
            except BridgeError as error:
                failures.append(error)
        deadline = time.monotonic() + _RETIRE_SECONDS
        for thread in tuple(self._retiring):
            thread.join(max(0.0, deadline - time.monotonic()))
        return failures

    def _state(self, name: str) -> Health | None:
        """Return how a bridge is that runs or was lost, None of any other."""
        with self._lock:
            health = self._health.get(name, _FINE)[0]
            return health if name in self._bridges or health is Health.LOST else None

    def _require_open(self) -> None:
        if self._closed:
            raise ConnectionClosedError("the robot manager is closed")

    def _watch(self, name: str, bridge: Bridge) -> None:
        """Take what a bridge reports, which is listed, as long as it bears the name.

        Without the lock: what it has said already is reported at once.
        """
        bridge.watch(partial(self._note_health, name=name, bridge=bridge))

    def _note_health(
        self, event: HealthEvent, name: str = "", bridge: Bridge | None = None
    ) -> None:
        """Note what happens to a whole bridge, and have the listener take what is reported.

        One that is lost is given out no more from this moment on: `get` makes a new one, which
        bears the same name, so that nothing more is reported of the lost one.

        Args:
            event: what is reported.
            name: of the bridge that reports.
            bridge: that reports; None: whichever bears the name, as of another machine.
        """
        is_whole = event.channel is None and event.component is None
        with Uninterrupted():  # what the listener took is handled
            with self._lock:
                # Here, as another thread may have reported the loss meanwhile: then the next one
                # may bear the name.
                if bridge is not None and self._bridges.get(name) is not bridge:
                    return
                if is_whole:
                    self._health[event.bridge] = event.health, event.cause
                if is_whole and event.health is Health.LOST:
                    # Listed as dead before the listener knows: what it has sought next asks `get`,
                    # which must not give out this one.
                    lost = self._bridges.pop(event.bridge, None)
                    if lost is not None:
                        lost.watch(None)
                        self._dead.setdefault(event.bridge, []).append(lost)
                    self._restarts.died(event.bridge, event.cause)
                handle = self._listener(event)
            handle()

    def start(self, name: str, spec: BridgeSpec | None, joining: Joining | None = None) -> Bridge:
        """Make a bridge, which is kept by who asked for it.

        Args:
            name: of the bridge.
            spec: how it is configured; None: not at all.
            joining: where machines join; None: in the configuration in force.

        Raises:
            UoarmError: as `get`.
        """
        if spec is None:
            raise BridgeError(f"there is no bridge {name!r}", FailureReason.NOT_FOUND)
        spec = evolve(spec, manager=self._manager)
        if spec.host is not None:
            registry = partial(self.machines.registry, joining)
            return start_hosted(spec, spec.host, self._restarts, registry, self._origin)
        bridge = deadlines.run(
            f"starting bridge {name!r}",
            _START_SECONDS,
            partial(self._registry.create, spec),
            on_late=lambda late: late.close(),
        )
        bridge.status = self._status
        return bridge


@define(eq=False)
class StagedBridges:
    """The bridges of a configuration that is not in force yet; new ones start when needed."""

    _running: BridgeSet
    _before: Mapping[str, BridgeSpec]
    specs: Mapping[str, BridgeSpec]
    joining: Joining
    # Held while a bridge starts: two threads that ask for structures must not start it twice.
    _lock: threading.Lock = field(factory=threading.Lock, init=False)
    made: dict[str, Bridge] = field(factory=dict, init=False)

    def get(self, name: str) -> Bridge:
        """Return the bridge of this name, starting it when it is the first time.

        Raises:
            UoarmError: as `BridgeSet.get`.
        """
        spec = self.specs.get(name)
        if spec is not None and spec == self._before.get(name):
            return self._running.get(name)
        with self._lock:
            if name not in self.made:
                self.made[name] = self._running.start(name, spec, self.joining)
            return self.made[name]

    def close(self) -> None:
        """Close what was started for a configuration that is not taken. Failures are logged."""
        while self.made:
            _, bridge = self.made.popitem()
            close_logged(bridge.close)
        self._running.machines.discard(self.joining)


def close_logged(close: Callable[[], object]) -> None:
    """Call the close of a bridge or a channel; what fails is logged."""
    try:
        close()
    except BridgeError as error:
        _log.warning("%s", error)


def facts_of(source: Bridge | Channel) -> tuple[tuple[str, object], ...]:
    """Return the facts of a bridge or channel; what it raises instead stands in their place."""
    try:
        return tuple(foreign(source.facts).items())
    except Exception as error:  # noqa: BLE001 - a bridge's code may raise anything
        return (("failed", text_of(error)),)
