"""Data ports of other components, and the health of the channels to them.

A check of a component finds the worst that is wrong with it. What is gone, hangs, has failed
(state ERROR) or has ended the connection is lost, and is the one to blame; what is inactive is
degraded: it takes data, and does nothing with it.
"""

from __future__ import annotations

import contextlib
import threading
import time
from collections.abc import Callable, Mapping
from enum import IntEnum

from attrs import field, frozen

from uoarm.bridge import Channel
from uoarm.errors import BridgeError, BridgeTimeoutError
from uoarm.model import Endpoint, Health
from uoarm_rtm._codec import CdrCodec
from uoarm_rtm._connector import Connections, Connector
from uoarm_rtm._control import change
from uoarm_rtm._options import RtmEndpointOptions
from uoarm_rtm._orb import Orb
from uoarm_rtm._peer import PeerComponent, PeerPort, state_of

__all__ = ["ConnectorHealth", "PortFault", "PortStatus", "RemotePort"]


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
    """What a check found at one end: the fault, a sentence about it, and the component's state."""

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
            return PortStatus(PortFault.HANGS, f"{self.where} does not answer: it hangs", "")
        except BridgeError as error:
            return PortStatus(PortFault.GONE, str(error), "")
        if state == "error":
            text = f"component {self.peer.path!r} has failed: it is in state ERROR"
            return PortStatus(PortFault.FAILED, text, state)
        try:
            is_connected = connector.alive(end)
        except BridgeTimeoutError:
            # A port may be asking the other one, which hangs; so that is the surer sign.
            return PortStatus(PortFault.STUCK, f"{self.where} does not answer: it hangs", state)
        except BridgeError:
            # Ports of OpenRTM in Python answer with what came of asking the other one (observed).
            is_connected = False
        if not is_connected:
            return PortStatus(PortFault.ENDED, f"{self.where} has ended the connection", state)
        if state == "active":
            return PortStatus(PortFault.NONE, "", state)
        if self.options.activate == "keep":
            with contextlib.suppress(BridgeError):  # it stays inactive, which is reported
                change(self.peer, "activate", self.seconds, there_is_fine=True)
        text = f"component {self.peer.path!r} is {_IDLE.get(state, state)}: it does nothing now"
        return PortStatus(PortFault.INACTIVE, text, state)


class ConnectorHealth:
    """Counts what passes, and reports a loss once.

    Args:
        channel: the channel that it belongs to.
        remote: the port that the channel leads to.
        stale_after: seconds without a message that count as a loss; None for any number.
    """

    def __init__(
        self, channel: Channel, remote: RemotePort, stale_after: float | None = None
    ) -> None:
        self._channel = channel
        self._remote = remote
        self._stale_after = stale_after
        # Guards health and cause: messages come in threads of the ORB, checks in the ticker's.
        self._lock = threading.Lock()
        self._health: Health = Health.OK
        self._cause = ""
        self._refusal = ""
        self._idle = ""
        self.count = 0
        self.state = ""
        self.last = time.monotonic()

    def note_message(self) -> None:
        """Count a message."""
        self.count += 1
        self.last = time.monotonic()
        if self._refusal:
            self._refusal = ""
            self._report_state()

    def degrade(self, cause: str) -> None:
        """Report a message that did not pass; the next one that does ends that."""
        self._refusal = cause
        self._report_state()

    def lose(self, cause: str) -> None:
        """Report that the connection is over; nothing comes after that."""
        self._report(Health.LOST, cause)

    def check(self, connector: Connector) -> None:
        """Check a connection: the component's state, its end, a silence that is too long."""
        remote, limit = self._remote, self._stale_after
        silence = time.monotonic() - self.last
        if limit is not None and silence > limit:
            self.lose(f"no message from {remote.where} for {silence:.1f} s")
            return
        status = remote.check(connector)
        self.state = status.state
        if status.fault > PortFault.INACTIVE:
            self.lose(status.cause)
            return
        self._idle = status.cause
        self._report_state()

    def _report_state(self) -> None:
        """Report the health that follows from the last message and the last check."""
        cause = self._refusal or self._idle
        if cause:
            self._report(Health.DEGRADED, cause)
        elif self._health is Health.DEGRADED:
            self._report(Health.OK, f"{self._remote.where} works again")

    def _report(self, health: Health, cause: str) -> None:
        """Report a change; nothing comes after LOST or from a closed channel."""
        with self._lock:
            if self._health is Health.LOST or self._channel.closed:
                return
            if (health, cause) == (self._health, self._cause):
                return
            self._health, self._cause = health, cause
        self._remote.report(health, cause, channel=self._channel)

    def facts(self) -> Mapping[str, object]:
        """Return counters, the port, and the component's state at the last check."""
        return {
            "count": self.count,
            "component": self._remote.peer.path,
            "state": self.state,
            "port": self._remote.port.name,
            "data_type": self._remote.port.data_type,
        }
