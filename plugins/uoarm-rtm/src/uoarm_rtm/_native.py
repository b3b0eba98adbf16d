"""Two ports of other components, connected directly: they move the data, we watch."""

from __future__ import annotations

from collections.abc import Callable, Mapping

from uoarm.bridge import Channel
from uoarm.errors import BridgeError, BridgeTimeoutError
from uoarm.model import Endpoint, Health
from uoarm_rtm._connector import Connections, asked
from uoarm_rtm._peer import Peer, Port
from uoarm_rtm._settings import Settings

__all__ = ["Native"]


class Native(Channel):
    """A connector from one component's OutPort to another's InPort.

    Args:
        endpoint: of the OutPort.
        ends: both components with their ports, the OutPort first.
        settings: options of the OutPort's endpoint.
        connections: makes the connector.
        report: takes (channel, health, sentence).
        ended: called when the connection has ended.

    Raises:
        BridgeError: a port refuses; nothing stays connected.
    """

    def __init__(
        self,
        endpoint: Endpoint,
        ends: tuple[tuple[Peer, Port], tuple[Peer, Port]],
        settings: Settings,
        connections: Connections,
        report: Callable[[Channel, Health, str], None],
        ended: Callable[[], None],
    ) -> None:
        super().__init__(endpoint)
        (source, out), (sink, into) = ends
        self._where = f"port {out.name!r} of {source.path!r} to port {into.name!r} of {sink.path!r}"
        self._report = report
        self._ended = ended
        self._lost = False
        properties = asked(settings, out.data_type)
        self._connector = connections.connect(self._where, properties, out, into)

    def facts(self) -> Mapping[str, object]:
        """Return which ports are connected."""
        return {"native": self._where}

    def tick(self) -> None:
        """Look after the connection; called about once a second by the bridge's watch."""
        if self._lost or self.closed:
            return
        cause = ""
        try:
            if not self._connector.alive():
                cause = f"{self._where}: the components have ended the connection"
        except BridgeTimeoutError:
            cause = f"{self._where}: the source does not answer: it hangs"
        except BridgeError as error:
            cause = str(error)
        if cause:
            self._lost = True
            self._report(self, Health.LOST, cause)

    def _close(self) -> None:
        try:
            self._connector.disconnect()
        finally:
            self._ended()
