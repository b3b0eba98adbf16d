"""The health of channels to components: what a check finds, and when it is made.

A check of a component finds the worst that is wrong with it. A component that is gone, hangs, has
failed (state ERROR) or has ended the connection is lost, and is the one to blame; an inactive one
is degraded: it takes data, and does nothing with it.

`Ticker` makes the checks at intervals, and one of them at once on request. Requests come from
`Observers`: a component whose process has OpenRTM's `ComponentObserver` takes an observer through
its SDO configuration, and calls it without waiting. Where one does not, the check of every second
finds the same, later; so an event is never believed, but brings the next check forward.

Observed are the states of the component and of its execution contexts. Changes of ports are not:
for them a component would run a listener with each message. Nor are heartbeats: OpenRTM-aist in
Python 1.2 continues them when the observer has been removed; the check asks, which says more.
"""

from __future__ import annotations

import contextlib
import logging
import threading
import time
import uuid
from collections.abc import Callable, Mapping
from concurrent.futures import ThreadPoolExecutor
from enum import IntEnum
from typing import Any

from _uoarm_rtm_stubs import OpenRTM, OpenRTM__POA, SDOPackage
from attrs import Factory, define, field, frozen
from omniORB import CORBA

from uoarm.bridge import Channel, ChannelHealth, ChannelMonitor
from uoarm.errors import BridgeError, BridgeTimeoutError
from uoarm.model import Endpoint, Health
from uoarm_rtm._control import change
from uoarm_rtm._journal import NAME, PROCESS, JournalEntry, end_observer, journal
from uoarm_rtm._options import RtmEndpointOptions
from uoarm_rtm._orb import Orb, calls, corba_errors, limit
from uoarm_rtm._peer import Connections, Connector, PeerComponent, PeerPort, pairs, state_of
from uoarm_rtm._shape import CdrCodec

_IDLE = {"none": "inactive, without an execution context", "created": "not initialised"}


class PortFault(IntEnum):
    """What is wrong with one end of a connection, the surest sign last."""

    NONE = 0
    INACTIVE = 1
    ENDED = 2
    FAILED = 3
    STUCK = 4
    HANGS = 5
    GONE = 6


@frozen
class PortStatus:
    """What a check found at one end: the fault, what to say of the port, the component's state."""

    fault: PortFault
    cause: str
    state: str


@frozen
class RemotePort:
    """One data port of a component, described and checked.

    `ended` is called when a channel to the port has let go of it.
    """

    orb: Orb
    connections: Connections
    endpoint: Endpoint
    peer: PeerComponent
    port: PeerPort
    codec: CdrCodec
    options: RtmEndpointOptions = field(hash=False)
    seconds: float
    report: Callable[..., None]
    ended: Callable[[], None]

    @property
    def where(self) -> str:
        """The port's name, for errors."""
        return f"port {self.port.name!r} of component {self.peer.path!r}"

    def check(self, connector: Connector, end: int = 0) -> PortStatus:
        """Check the component and its end of a connection; activate it where that is asked.

        Args:
            connector: the connection.
            end: which of its ports this one is.
        """
        try:
            state = state_of(self.peer, self.seconds)
        except BridgeTimeoutError:
            return PortStatus(PortFault.HANGS, "does not answer: it hangs", "")
        except BridgeError as error:
            return PortStatus(PortFault.GONE, str(error), "")
        if state == "error":
            text = "its component has failed: it is in state ERROR"
            return PortStatus(PortFault.FAILED, text, state)
        try:
            is_connected = connector.alive(end)
        except BridgeTimeoutError:
            # A port may be asking the other one, which hangs; so that is the surer sign.
            return PortStatus(PortFault.STUCK, "does not answer: it hangs", state)
        except BridgeError:
            # Ports of OpenRTM in Python answer with what came of asking the other one (observed).
            is_connected = False
        if not is_connected:
            return PortStatus(PortFault.ENDED, "has ended the connection", state)
        if state == "active":
            return PortStatus(PortFault.NONE, "", state)
        if self.options.activate == "keep":
            with contextlib.suppress(BridgeError):  # it stays inactive, which is reported
                change(self.peer, "activate", self.seconds, there_is_fine=True)
        text = f"its component is {_IDLE.get(state, state)}: it does nothing now"
        return PortStatus(PortFault.INACTIVE, text, state)


class ConnectorHealth:
    """Counts what passes one end of a connection, and reports how it is, each change once.

    `lost` is why it is lost, empty before that.

    Args:
        channel: the channel that it belongs to.
        remote: the port at this end.
        stale_after: seconds without a message that count as a loss; None for any number.
        component: to report of in place of the channel, for its far end; empty for none.
    """

    def __init__(
        self,
        channel: Channel,
        remote: RemotePort,
        stale_after: float | None = None,
        component: str = "",
    ) -> None:
        self._channel = channel
        self._remote = remote
        self._about = {"component": component} if component else {"channel": channel}
        health = ChannelHealth(remote.where, time.monotonic(), stale_after=stale_after)
        # Messages come in threads of the ORB, checks in the ticker's.
        self._monitor = ChannelMonitor(health, self._report)
        self._monitor.connected()
        self.lost = ""
        self.count = 0
        self.state = ""

    def note_message(self) -> None:
        """Count a message."""
        self.count += 1
        self._monitor.passed()

    def degrade(self, cause: str) -> None:
        """Report a message that did not pass; the next one that does ends that."""
        self._monitor.refused(cause)

    def lose(self, cause: str) -> None:
        """Report that the connection is over; nothing comes after that."""
        self._monitor.connected(0, cause)

    def check(self, connector: Connector) -> None:
        """Check a connection: the component's state, its end, a silence that is too long."""
        self._monitor.tick()
        if not self.lost:
            self.take(self._remote.check(connector))

    def take(self, status: PortStatus) -> None:
        """Report what a check found."""
        self.state = status.state
        if status.fault is PortFault.FAILED:
            self._monitor.peer_reported(Health.LOST, status.cause)
        elif status.fault > PortFault.INACTIVE:
            self.lose(status.cause)
        elif status.cause:
            self._monitor.peer_reported(Health.DEGRADED, status.cause)
        else:
            self._monitor.peer_reported(Health.OK, "works again")

    def facts(self) -> Mapping[str, object]:
        """Return counters, the port, and the component's state at the last check."""
        return {
            "count": self.count,
            "component": self._remote.peer.path,
            "state": self.state,
            "port": self._remote.port.name,
            "data_type": self._remote.port.data_type,
            **self._monitor.facts(),
        }

    def _report(self, health: Health, cause: str) -> None:
        if health is Health.LOST:
            self.lost = cause
        if not self._channel.closed:
            self._remote.report(health, cause, **self._about)


_AGAIN_SECONDS = 0.02

_log = logging.getLogger("uoarm.rtm")

Tick = Callable[[], None]


class Ticker:
    """A thread that calls some ticks again and again, each on its own, and others on request.

    Args:
        ticks: returns what to call now.
        seconds: pause between rounds; 0 for no thread at all.
    """

    def __init__(self, ticks: Callable[[], list[Tick]], seconds: float) -> None:
        self._ticks = ticks
        self._seconds = seconds
        # Guards the two fields below: components request checks in threads of the ORB.
        self._changed = threading.Condition(threading.Lock())
        self._ended = False
        self._urgent: dict[Tick, None] = {}
        self._thread = threading.Thread(target=self._run, name="uoarm-rtm-watch", daemon=True)

    def start(self) -> None:
        """Begin, where there are rounds at all."""
        if self._seconds:
            self._thread.start()

    def soon(self, tick: Tick) -> None:
        """Have a tick called next, after the one under way, and once more 20 ms later.

        A component reports a state before it is in it (observed). Several that wait are one.
        """
        with self._changed:
            self._urgent[tick] = None
            self._changed.notify_all()

    def close(self, seconds: float) -> None:
        """End the thread after the tick under way, and wait for that up to `seconds`.

        A thread that lets go of references while the interpreter ends aborts the process.
        """
        with self._changed:
            self._ended = True
            self._changed.notify_all()
        if self._thread.is_alive() and self._thread is not threading.current_thread():
            self._thread.join(seconds)

    def _run(self) -> None:
        while self._look() and self._rest(self._seconds):
            pass

    def _look(self) -> bool:
        """Call each once; returns whether to go on."""
        # Not in the frame of `_run`, which would keep the last one while it rests.
        for tick in self._ticks():
            if not self._rest(0):
                return False
            _call(tick)
        return True

    def _rest(self, seconds: float) -> bool:
        """Let time pass, and call what is urgent meanwhile; returns whether to go on.

        What comes faster than it is called does not keep the others from their turn.
        """
        until = time.monotonic() + seconds
        while True:
            with self._changed:
                left = until - time.monotonic()
                self._changed.wait_for(lambda: self._ended or self._urgent, left)
                if self._ended:
                    return False
                urgent, self._urgent = self._urgent, {}
            if not urgent:
                return True
            for _ in range(2):
                for tick in urgent:
                    _call(tick)
                with self._changed:  # also because a component may report without end
                    if self._changed.wait_for(lambda: self._ended, _AGAIN_SECONDS):
                        return False
            if time.monotonic() >= until:
                return True


def _call(tick: Tick) -> None:
    try:
        tick()
    except Exception:  # noqa: BLE001 - one that fails hurts no other
        _log.exception("a check of OpenRTM failed")


_AT_ONCE = 8


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
