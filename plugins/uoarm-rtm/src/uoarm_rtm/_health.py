"""The health of channels to components: what a check finds, and what is reported of it.

A check of a component finds the worst that is wrong with it. A component that is gone, hangs, has
failed (state ERROR) or has ended the connection is lost, and is the one to blame; an inactive one
is degraded: it takes data, and does nothing with it.

A component is asked for its state once for all channels. Where it answers, its ports are asked for
their connections, each in a check of its own: a port may ask the one at the other end, and hang as
long as that one does (`uoarm_rtm._watch` has when checks are made).
"""

from __future__ import annotations

import contextlib
import threading
import time
from collections.abc import Callable, Mapping, Sequence
from enum import IntEnum

from attrs import define, evolve, field, frozen

from uoarm.bridge import Channel, ChannelHealth, ChannelMonitor
from uoarm.errors import BridgeError, BridgeTimeoutError
from uoarm.model import Endpoint, Health
from uoarm_rtm._control import change
from uoarm_rtm._options import RtmEndpointOptions
from uoarm_rtm._orb import Orb
from uoarm_rtm._peer import Connections, Connector, PeerComponent, PeerPort, state_of
from uoarm_rtm._shape import CdrCodec
from uoarm_rtm._watch import Ticker

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


_OF_THE_COMPONENT = {PortFault.FAILED, PortFault.HANGS, PortFault.GONE}


@frozen
class PortStatus:
    """What a check found at one end of a connection. Times are in seconds of one clock.

    Attributes:
        cause: what to say of the port.
        asked_at: when its component was asked.
        wrong_at: what is wrong was so then, or began later.
    """

    fault: PortFault
    cause: str
    state: str
    asked_at: float = 0.0
    wrong_at: float = 0.0


def component_status(peer: PeerComponent, seconds: float) -> PortStatus:
    """Ask a component for its state, and return what is wrong with it, for all its ports."""
    asked_at = time.monotonic()
    try:
        state = state_of(peer, seconds)
    except BridgeTimeoutError:
        return PortStatus(PortFault.HANGS, "does not answer: it hangs", "", asked_at)
    except BridgeError as error:
        return PortStatus(PortFault.GONE, str(error), "", asked_at)
    if state == "error":
        text = "its component has failed: it is in state ERROR"
        return PortStatus(PortFault.FAILED, text, state, asked_at)
    return PortStatus(PortFault.NONE, "", state, asked_at)


def blamed(statuses: Sequence[PortStatus | None]) -> int | None:
    """Return which end of a connection of two ports is to blame; None: none, or it is not clear.

    When an end dies or hangs the other drops the connection, or hangs as it asks that end. So what
    a port says of the connection counts when the other end was asked after it, and answered.

    Args:
        statuses: what was found last at each end; None: nothing yet.
    """
    faults = [PortFault.NONE if status is None else status.fault for status in statuses]
    worst = max(range(2), key=lambda end: faults[end])
    status, other = statuses[worst], statuses[1 - worst]
    if status is None or status.fault <= PortFault.INACTIVE:
        return None
    if status.fault in _OF_THE_COMPONENT:
        return worst
    return worst if other is not None and other.asked_at > status.wrong_at else None


@frozen
class RemotePort:
    """One data port of a component, described and checked.

    `ended` is called with a channel to the port that has let go of it.
    """

    orb: Orb
    connections: Connections
    endpoint: Endpoint
    peer: PeerComponent
    port: PeerPort
    codec: CdrCodec
    options: RtmEndpointOptions = field(hash=False)
    seconds: float
    report: Callable[[Channel, Health, str, str], None]
    ended: Callable[[Channel], None]

    @property
    def where(self) -> str:
        """The port's name, for errors."""
        return f"port {self.port.name!r} of component {self.peer.path!r}"

    def check(self, connector: Connector, end: int, component: PortStatus) -> PortStatus:
        """Check the end of a connection; activate the component where that is asked.

        Args:
            connector: the connection.
            end: which of its ports this one is.
            component: what was found of the component, which answers.
        """
        begin = time.monotonic()
        try:
            is_connected = connector.alive(end)
        except BridgeTimeoutError:
            # A port may be asking the other one, which hangs; so that is the surer sign.
            text = "does not answer: it hangs"
            return evolve(component, fault=PortFault.STUCK, cause=text, wrong_at=begin)
        except BridgeError:
            # It may have died since it was asked for its state; but ports of OpenRTM in Python
            # answer also with what came of asking the other one (observed).
            again = component_status(self.peer, self.seconds)
            if again.fault is PortFault.GONE:
                return again
            is_connected = False
        if not is_connected:
            text = "has ended the connection"
            return evolve(component, fault=PortFault.ENDED, cause=text, wrong_at=time.monotonic())
        state = component.state
        if state == "active":
            return component
        if self.options.activate == "keep":
            with contextlib.suppress(BridgeError):  # it stays inactive, which is reported
                change(self.peer, "activate", self.seconds, there_is_fine=True)
        text = f"its component is {_IDLE.get(state, state)}: it does nothing now"
        return evolve(component, fault=PortFault.INACTIVE, cause=text)


class ConnectorHealth:
    """Counts what passes one end of a connection, and reports how it is, each change once.

    `lost` is why it is lost, empty before that.

    Args:
        stale_after: seconds without a message that count as a loss; None for any number.
    """

    def __init__(
        self,
        channel: Channel,
        remote: RemotePort,
        stale_after: float | None = None,
    ) -> None:
        self._channel = channel
        self._remote = remote
        health = ChannelHealth(remote.where, time.monotonic(), stale_after=stale_after)
        # Messages come in threads of the ORB, checks in those of the watch.
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

    def tick(self) -> None:
        """Report a silence that is too long, without a call."""
        self._monitor.tick()

    @property
    def is_lost(self) -> bool:
        """Whether that was reported."""
        return bool(self.lost)

    def judge(self, end: int, status: PortStatus) -> bool:
        """Report what a check found; no other end may be to blame."""
        del end
        self.take(status)
        return False

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
            end = self._remote.endpoint.component
            self._remote.report(self._channel, health, cause, end)


class LinkHealth:
    """Reports how both ends of a native link are; of a loss, the one to blame, once.

    `is_lost` is whether that was reported.

    Args:
        where: which ports are connected, for the cause.
        ends: both, the one first that is asked first for the connection.
    """

    def __init__(self, where: str, *ends: ConnectorHealth) -> None:
        self._where = where
        self._ends = ends
        # Guards both fields below: the ends are checked in different threads.
        self._lock = threading.Lock()
        self._statuses: list[PortStatus | None] = [None] * len(ends)
        self.is_lost = False

    @property
    def states(self) -> tuple[str, ...]:
        """The states of both components at their last checks."""
        return tuple(end.state for end in self._ends)

    def judge(self, end: int, status: PortStatus) -> bool:
        """Take what a check found at one end.

        Returns:
            whether the other end is to be asked, to know which is to blame.
        """
        with self._lock:
            self._statuses[end] = status
            if self.is_lost:
                return False
            worst = blamed(self._statuses)
            self.is_lost = worst is not None
            statuses = tuple(self._statuses)
        if worst is not None:
            self._lose(worst, statuses)
            return False
        if status.fault > PortFault.INACTIVE:
            self._ends[end].state = status.state
            return True
        self._ends[end].take(status)
        return False

    def _lose(self, end: int, statuses: Sequence[PortStatus | None]) -> None:
        for health, known in zip(self._ends, statuses, strict=True):
            health.state = "" if known is None else known.state
        found = statuses[end]
        assert found is not None
        text = f"{found.cause}; it was connected from {self._where}"
        if all(known is not None and known.fault is PortFault.ENDED for known in statuses):
            text = f"the components have ended the connection from {self._where}"
        self._ends[end].take(evolve(found, cause=text))


@define(eq=False)
class WatchedPort:
    """One end of a channel's connection.

    Attributes:
        end: which of its ports this one is.
        other: the component at the other end, which may be to blame.
    """

    channel: Channel
    health: ConnectorHealth | LinkHealth
    remote: RemotePort
    connector: Connector
    end: int = 0
    other: WatchedComponent | None = None
    _component: PortStatus | None = None

    @property
    def is_over(self) -> bool:
        """Whether there is nothing to ask any more."""
        return self.channel.closed or self.health.is_lost

    def component_answers(self, status: PortStatus) -> None:
        """Keep what was found of the component, for the next check."""
        self._component = status

    def check(self) -> None:
        """Ask the port for its connection, after its component has answered."""
        component = self._component
        if component is not None and not self.is_over:
            self.take(self.remote.check(self.connector, self.end, component))

    def take(self, status: PortStatus) -> None:
        """Report what was found, once it is clear whose fault it is."""
        if not self.is_over and self.health.judge(self.end, status) and self.other is not None:
            self.other.check_soon()


class WatchedComponent:
    """A component in which channels are open: asked once for all of them.

    Args:
        seconds: limit of each call.
    """

    def __init__(self, peer: PeerComponent, seconds: float, ticker: Ticker) -> None:
        self.peer = peer
        self._seconds = seconds
        self._ticker = ticker
        # Guards the ports, from channels that open in any thread.
        self._guard = threading.Lock()
        self._ports: list[WatchedPort] = []

    def enter(self, port: WatchedPort) -> None:
        """Check a port from now on, as long as its channel is open."""
        with self._guard:
            self._ports.append(port)

    @property
    def is_used(self) -> bool:
        """Whether a channel is open there."""
        with self._guard:
            self._ports = [port for port in self._ports if not port.channel.closed]
            return bool(self._ports)

    def check_soon(self) -> None:
        """Have the next check before its turn."""
        self._ticker.soon(self.check)

    def check(self) -> None:
        """Ask for the component's state; where it answers, each port is asked next."""
        with self._guard:
            ports = [port for port in self._ports if not port.is_over]
        if not ports:
            return
        status = component_status(self.peer, self._seconds)
        for port in ports:
            if status.fault is PortFault.NONE:
                port.component_answers(status)
                self._ticker.follow(port.check)
            else:
                port.take(status)
