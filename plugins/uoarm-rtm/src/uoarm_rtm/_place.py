"""What every channel to a data port stands on, and the pulse that its status shows.

A look at a component tells the worst that is wrong with it. What is gone, hangs, has failed
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
from uoarm_rtm._codec import Codec
from uoarm_rtm._connector import Connections, Connector
from uoarm_rtm._control import change
from uoarm_rtm._orb import Orb
from uoarm_rtm._peer import Peer, Port, state_of
from uoarm_rtm._settings import Settings

__all__ = ["Look", "Place", "Pulse", "Trouble"]


_IDLE = {"none": "inactive, without an execution context", "created": "not initialised"}


class Trouble(IntEnum):
    """What is wrong with one end of a connection, the surest sign last."""

    NONE = 0
    INACTIVE = 1
    ENDED = 2
    FAILED = 3
    STUCK = 4
    HANGS = 5
    GONE = 6


@frozen
class Look:
    """What was seen of one end: the trouble, a sentence about it, and the component's state."""

    trouble: Trouble
    cause: str
    state: str


@frozen
class Place:
    """One data port of a component, described and checked.

    `ended` is called when a channel to the port has let go of it.
    """

    orb: Orb
    connections: Connections
    endpoint: Endpoint
    peer: Peer
    port: Port
    codec: Codec
    settings: Settings = field(hash=False)
    seconds: float
    report: Callable[[Channel, Health, str], None]
    ended: Callable[[], None]

    @property
    def where(self) -> str:
        """The port's name, for errors."""
        return f"port {self.port.name!r} of component {self.peer.path!r}"

    def look(self, connector: Connector, end: int = 0) -> Look:
        """Look at the component and at its end of a connection; activate it where that is asked.

        Args:
            connector: the connection.
            end: which of its ports this one is.
        """
        try:
            state = state_of(self.peer, self.seconds)
        except BridgeTimeoutError:
            return Look(Trouble.HANGS, f"{self.where} does not answer: it hangs", "")
        except BridgeError as error:
            return Look(Trouble.GONE, str(error), "")
        if state == "error":
            text = f"component {self.peer.path!r} has failed: it is in state ERROR"
            return Look(Trouble.FAILED, text, state)
        try:
            is_connected = connector.alive(end)
        except BridgeTimeoutError:
            # A port may be asking the other one, which hangs; so that is the surer sign.
            return Look(Trouble.STUCK, f"{self.where} does not answer: it hangs", state)
        except BridgeError:
            # Ports of OpenRTM in Python answer with what came of asking the other one (observed).
            is_connected = False
        if not is_connected:
            return Look(Trouble.ENDED, f"{self.where} has ended the connection", state)
        if state == "active":
            return Look(Trouble.NONE, "", state)
        if self.settings.activate == "keep":
            with contextlib.suppress(BridgeError):  # it stays inactive, which is told
                change(self.peer, "activate", self.seconds, there_is_fine=True)
        text = f"component {self.peer.path!r} is {_IDLE.get(state, state)}: it does nothing now"
        return Look(Trouble.INACTIVE, text, state)


class Pulse:
    """Counts what passes, and tells of a loss once.

    Args:
        channel: the channel that it belongs to.
        place: the port that the channel leads to.
        stale_after: seconds without a message that count as a loss; None for any number.
    """

    def __init__(self, channel: Channel, place: Place, stale_after: float | None = None) -> None:
        self._channel = channel
        self._place = place
        self._stale_after = stale_after
        self._telling = threading.Lock()
        self._health: Health = Health.OK
        self._cause = ""
        self._refusal = ""
        self._idle = ""
        self.count = 0
        self.state = ""
        self.last = time.monotonic()

    def beat(self) -> None:
        """Count a message."""
        self.count += 1
        self.last = time.monotonic()
        if self._refusal:
            self._refusal = ""
            self._weigh()

    def degrade(self, cause: str) -> None:
        """Tell of a message that did not pass; the next one that does ends that."""
        self._refusal = cause
        self._weigh()

    def lose(self, cause: str) -> None:
        """Tell that the connection is over; nothing comes after that."""
        self._tell(Health.LOST, cause)

    def look(self, connector: Connector) -> None:
        """Look after a connection: the component's state, its end, a silence that is too long."""
        place, limit = self._place, self._stale_after
        silence = time.monotonic() - self.last
        if limit is not None and silence > limit:
            self.lose(f"no message from {place.where} for {silence:.1f} s")
            return
        seen = place.look(connector)
        self.state = seen.state
        if seen.trouble > Trouble.INACTIVE:
            self.lose(seen.cause)
            return
        self._idle = seen.cause
        self._weigh()

    def _weigh(self) -> None:
        """Tell the health that follows from the last message and the last look."""
        cause = self._refusal or self._idle
        if cause:
            self._tell(Health.DEGRADED, cause)
        elif self._health is Health.DEGRADED:
            self._tell(Health.OK, f"{self._place.where} works again")

    def _tell(self, health: Health, cause: str) -> None:
        """Report a change; nothing comes after LOST or from a closed channel."""
        with self._telling:
            if self._health is Health.LOST or self._channel.closed:
                return
            if (health, cause) == (self._health, self._cause):
                return
            self._health, self._cause = health, cause
        self._place.report(self._channel, health, cause)

    def facts(self) -> Mapping[str, object]:
        """Return counters, the port, and the component's state when it was last looked at."""
        return {
            "count": self.count,
            "component": self._place.peer.path,
            "state": self.state,
            "port": self._place.port.name,
            "data_type": self._place.port.data_type,
        }
