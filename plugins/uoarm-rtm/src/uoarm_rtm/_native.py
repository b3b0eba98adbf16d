"""Two ports of other components, connected directly: they move the data, we watch."""

from __future__ import annotations

from collections.abc import Callable, Mapping

from uoarm.bridge import Channel
from uoarm.model import Health
from uoarm_rtm._connector import asked
from uoarm_rtm._place import Place, Trouble
from uoarm_rtm._settings import Settings

__all__ = ["Native"]


class Native(Channel):
    """A connector from one component's OutPort to another's InPort.

    Args:
        source: the OutPort.
        sink: the InPort.
        settings: what the options of both ends ask together.
        report: that of the bridge.

    Raises:
        BridgeError: a port refuses; nothing stays connected.
    """

    def __init__(
        self,
        source: Place,
        sink: Place,
        settings: Settings,
        report: Callable[..., None],
    ) -> None:
        super().__init__(source.endpoint)
        self._ends = source, sink
        self._where = f"{source.where} to {sink.where}"
        self._report = report
        self._lost = False
        self._idle = dict.fromkeys(range(2), "")
        self._states = ["", ""]
        properties = asked(settings, source.port.data_type)
        self._connector = source.connections.connect(
            self._where, properties, source.port, sink.port
        )

    def facts(self) -> Mapping[str, object]:
        """Return which ports are connected, and the states of both components."""
        return {"native": self._where, "states": tuple(self._states)}

    def tick(self) -> None:
        """Look at both ends, about once a second; the one with the surest sign is blamed.

        When an end dies the other drops the connection: what is gone is the cause of what ended.
        """
        if self._lost or self.closed:
            return
        looks = [place.look(self._connector, end) for end, place in enumerate(self._ends)]
        self._states = [look.state for look in looks]
        worst = max(range(2), key=lambda end: looks[end].trouble)
        if looks[worst].trouble > Trouble.INACTIVE:
            self._lost = True
            text = f"{looks[worst].cause}; it was connected from {self._where}"
            if all(look.trouble is Trouble.ENDED for look in looks):
                text = f"{self._where}: the components have ended the connection"
            self._tell(worst, Health.LOST, text)
            return
        for end, seen in enumerate(looks):
            if seen.cause != self._idle[end]:
                self._idle[end] = seen.cause
                text = f"{self._ends[end].where} works again"
                self._tell(end, Health.DEGRADED if seen.cause else Health.OK, seen.cause or text)

    def _tell(self, end: int, health: Health, cause: str) -> None:
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
            for place in self._ends:
                place.ended()
