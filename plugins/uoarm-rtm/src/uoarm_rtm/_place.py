"""What every channel to a data port stands on, and the pulse that its status shows."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping

from attrs import field, frozen

from uoarm.bridge import Channel
from uoarm.errors import BridgeError, BridgeTimeoutError
from uoarm.model import Endpoint, Health
from uoarm_rtm._codec import Codec
from uoarm_rtm._connector import Connections, Connector
from uoarm_rtm._orb import Orb
from uoarm_rtm._peer import Peer, Port, state_of
from uoarm_rtm._settings import Settings

__all__ = ["Place", "Pulse"]


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
        self._health: Health = Health.OK
        self.count = 0
        self.refused = 0
        self.state = ""
        self.last = time.monotonic()

    def beat(self) -> None:
        """Count a message."""
        self.count += 1
        self.last = time.monotonic()
        if self._health is Health.DEGRADED:
            self.tell(Health.OK, f"{self._place.where} works again")

    def tell(self, health: Health, cause: str) -> None:
        """Report a change; nothing comes after LOST or from a closed channel."""
        if self._health is Health.LOST or self._channel.closed:
            return
        if health is not self._health:
            self._health = health
            self._place.report(self._channel, health, cause)

    def look(self, connector: Connector) -> None:
        """Look after a connection: the component's state, its end, a silence that is too long."""
        place, limit = self._place, self._stale_after
        silence = time.monotonic() - self.last
        if limit is not None and silence > limit:
            self.tell(Health.LOST, f"no message from {place.where} for {silence:.1f} s")
        try:
            self.state = state_of(place.peer, place.seconds)
            if not connector.alive():
                self.tell(Health.LOST, f"{place.where} has ended the connection")
        except BridgeTimeoutError:
            self.tell(Health.LOST, f"{place.where} does not answer: it hangs")
        except BridgeError as error:
            self.tell(Health.LOST, str(error))

    def facts(self) -> Mapping[str, object]:
        """Return counters, the port, and the component's state when it was last looked at."""
        return {
            "count": self.count,
            "refused": self.refused,
            "component": self._place.peer.path,
            "state": self.state,
            "port": self._place.port.name,
            "data_type": self._place.port.data_type,
        }
