"""Channels of the bridge over open flows of its devices."""

from __future__ import annotations

from collections.abc import Callable, Mapping

from uoarm.bridge import Channel, Sink, Source
from uoarm.model import Endpoint, Health, Message
from uoarm_rocos._device import Feed, Flow

__all__ = ["SinkChannel", "SourceChannel"]

Report = Callable[[Channel, Health, str], None]


class SourceChannel(Source):
    """A flow from a device. Made before the flow, so that the flow can tell of itself."""

    def __init__(self, endpoint: Endpoint, report: Report) -> None:
        super().__init__(endpoint)
        self._report = report
        self._flow: Flow | None = None

    def told(self, health: Health, cause: str) -> None:
        """Pass a change on to the manager."""
        self._report(self, health, cause)

    def attach(self, flow: Flow) -> None:
        """Take the open flow."""
        self._flow = flow

    def facts(self) -> Mapping[str, object]:
        """Return the flow's counters."""
        return {} if self._flow is None else self._flow.facts()

    def _close(self) -> None:
        if self._flow is not None:
            self._flow.close()


class SinkChannel(Sink):
    """A flow into a device; `send` blocks as long as the line does."""

    def __init__(self, endpoint: Endpoint, report: Report) -> None:
        super().__init__(endpoint)
        self._report = report
        self._feed: Feed | None = None

    def told(self, health: Health, cause: str) -> None:
        """Pass a change on to the manager."""
        self._report(self, health, cause)

    def attach(self, feed: Feed) -> None:
        """Take the open flow."""
        self._feed = feed

    def _send(self, message: Message) -> None:
        """Send one message to the device.

        Raises:
            BridgeError: it does not fit, or the line is gone.
        """
        assert self._feed is not None, "attached before anybody had the channel"
        self._feed.send(message)

    def facts(self) -> Mapping[str, object]:
        """Return the flow's counters."""
        return {} if self._feed is None else self._feed.facts()

    def _close(self) -> None:
        if self._feed is not None:
            self._feed.close()
