"""Native links: two topics of one type, joined without making messages of what passes."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from contextlib import suppress

from attrs import evolve

from uoarm.bridge import Channel
from uoarm.errors import BridgeError
from uoarm.model import Health
from uoarm_ros2._end import Place
from uoarm_ros2._sink import TopicSink
from uoarm_ros2._source import TopicSource

__all__ = ["Relay", "SameTopic"]


class Relay(Channel):
    """Passes serialised bytes from one topic to another of the same type."""

    def __init__(self, source: Place, sink: Place) -> None:
        super().__init__(source.endpoint)
        report = source.report

        def told(channel: Channel, health: Health, cause: str) -> None:
            del channel  # the halves are ours alone
            report(self, health, cause)

        self._out = TopicSink(_reporting(sink, told), bytes)
        try:
            self._into = TopicSource(_reporting(source, told), bytes, self._out.send)
        except BaseException:
            self._out.close()
            raise

    def wait(self) -> None:
        """Wait for both other ends, the reading one first so that no first message is lost.

        Raises:
            BridgeError: one is missing although it is required.
        """
        self._out.wait()
        self._into.wait()

    def tick(self) -> None:
        """Look after both halves."""
        self._into.tick()
        self._out.tick()

    def facts(self) -> Mapping[str, object]:
        """Return the facts of both halves, by side."""
        halves = (("from", self._into), ("to", self._out))
        return {
            f"{side} {name}": fact for side, half in halves for name, fact in half.facts().items()
        }

    def _close(self) -> None:
        self._into.close()
        self._out.close()


class SameTopic(Channel):
    """Two endpoints on one topic, which ROS 2 connects by itself: only watched.

    Lost when no publisher, or no subscription, is left.
    """

    def __init__(self, source: Place, sink: Place) -> None:
        super().__init__(source.endpoint)
        self._source = source
        self._sink = sink
        self._state = ""

    def tick(self) -> None:
        """Look at the graph."""
        missing = self._missing()
        if missing == self._state:
            return
        self._state = missing
        if missing:
            self._source.report(self, Health.LOST, missing)
        else:
            self._source.report(self, Health.OK, "both ends are there")

    def facts(self) -> Mapping[str, object]:
        """Return how many publishers and subscriptions the topic has; nothing after the end."""
        station, name = self._source.station, self._source.topic.name
        with suppress(BridgeError):  # the bridge was closed
            return {
                "publishers": len(station.publishers(name)),
                "subscriptions": len(station.subscriptions(name)),
            }
        return {}

    def _missing(self) -> str:
        station, name = self._source.station, self._source.topic.name
        if self._source.settings.peer_required and not station.publishers(name):
            return f"topic {name} has no publisher"
        if self._sink.settings.peer_required and not station.subscriptions(name):
            return f"topic {name} has no subscription"
        return ""

    def _close(self) -> None:
        pass


def _reporting(place: Place, report: Callable[[Channel, Health, str], None]) -> Place:
    return evolve(place, report=report)
