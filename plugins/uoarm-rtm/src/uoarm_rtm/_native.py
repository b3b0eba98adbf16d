"""Two ports of other components, connected directly: they move the data, we watch."""

from __future__ import annotations

from collections.abc import Callable, Mapping

from uoarm.bridge import Channel
from uoarm.model import Health
from uoarm_rtm._connector import connector_properties
from uoarm_rtm._options import RtmEndpointOptions
from uoarm_rtm._place import PortFault, RemotePort

__all__ = ["NativeConnector"]


class NativeConnector(Channel):
    """A connector from one component's OutPort to another's InPort.

    Args:
        source: the OutPort.
        sink: the InPort.
        options: what the options of both ends ask together.
        report: that of the bridge.

    Raises:
        BridgeError: a port refuses; nothing stays connected.
    """

    def __init__(
        self,
        source: RemotePort,
        sink: RemotePort,
        options: RtmEndpointOptions,
        report: Callable[..., None],
    ) -> None:
        super().__init__(source.endpoint)
        self._ends = source, sink
        self._where = f"{source.where} to {sink.where}"
        self._report = report
        self._lost = False
        self._idle = dict.fromkeys(range(2), "")
        self._states = ["", ""]
        properties = connector_properties(options, source.port.data_type)
        self._connector = source.connections.connect(
            self._where, properties, source.port, sink.port
        )

    def facts(self) -> Mapping[str, object]:
        """Return which ports are connected, and the states of both components."""
        return {"native": self._where, "states": tuple(self._states)}

    def tick(self) -> None:
        """Check both ends, about once a second; the one with the surest sign is blamed.

        When an end dies the other drops the connection: what is gone is the cause of what ended.
        """
        if self._lost or self.closed:
            return
        statuses = [remote.check(self._connector, end) for end, remote in enumerate(self._ends)]
        self._states = [status.state for status in statuses]
        worst = max(range(2), key=lambda end: statuses[end].fault)
        if statuses[worst].fault > PortFault.INACTIVE:
            self._lost = True
            text = f"{statuses[worst].cause}; it was connected from {self._where}"
            if all(status.fault is PortFault.ENDED for status in statuses):
                text = f"{self._where}: the components have ended the connection"
            self._report_of(worst, Health.LOST, text)
            return
        for end, cause in enumerate(status.cause for status in statuses):
            if cause != self._idle[end]:
                self._idle[end] = cause
                text = f"{self._ends[end].where} works again"
                self._report_of(end, Health.DEGRADED if cause else Health.OK, cause or text)

    def _report_of(self, end: int, health: Health, cause: str) -> None:
        """Report of one component: of the source as this channel, which has its endpoint."""
        if self.closed:
            return
        if end == 0:
            self._report(health, cause, channel=self)
        else:
            self._report(health, cause, component=self._ends[end].endpoint.component)

    def _close(self) -> None:
        try:
            self._connector.disconnect()
        finally:
            for remote in self._ends:
                remote.ended()
