"""The node's own part of every graph: what it says on /rosout, and the time that /clock says."""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import suppress

from uoarm.errors import MessageError
from uoarm.model import Health
from uoarm_ros1._node import Node
from uoarm_ros1._publication import Publication
from uoarm_ros1._structures import framed_writer, reader
from uoarm_ros1._subscription import Subscription, Wanted
from uoarm_ros1._types import TypeStore

__all__ = ["Clock", "Rosout"]

_INFO, _WARN, _ERROR = 2, 4, 8
_LEVELS = {
    Health.OK: _INFO,
    Health.FINISHED: _INFO,
    Health.DEGRADED: _WARN,
    Health.LOST: _ERROR,
}


class Rosout:
    """Says on /rosout what the bridge reports, once the master is there."""

    def __init__(self, node: Node, types: TypeStore) -> None:
        self._node = node
        self._record = types.require("rosgraph_msgs/Log")
        self._write = framed_writer(self._record)
        self._publication: Publication | None = None
        self._count = 0

    def open(self) -> None:
        """Publish the topic, unless it is published.

        Raises:
            BridgeError: the master cannot be reached.
        """
        if self._publication is None:
            self._publication = self._node.advertise("/rosout", self._record)

    def say(self, health: Health, text: str) -> None:
        """Say what was reported; returns at once, and never raises."""
        publication = self._publication
        if publication is None:
            return
        self._count += 1
        message = {
            "header": {"seq": self._count, "stamp": self._node.stamp(), "frame_id": ""},
            "level": _LEVELS[health],
            "name": self._node.name,
            "msg": text,
            "file": "",
            "function": "",
            "line": 0,
            "topics": [],
        }
        with suppress(MessageError):
            publication.send(self._write(message))

    def close(self) -> None:
        """Publish it no more."""
        if self._publication is not None:
            self._node.withdraw(self._publication)


class Clock:
    """The seconds of /clock; they stand still until it says something."""

    def __init__(self, node: Node, types: TypeStore) -> None:
        record = types.require("rosgraph_msgs/Clock")
        self._node = node
        self._read = reader(record, node.settings.budget)
        self._wanted = Wanted(node.name, "/clock", record.name, record.md5)
        self._subscription: Subscription | None = None
        self._time: Mapping[str, int] = {"secs": 0, "nsecs": 0}
        node.stamp = self.stamp

    def now(self) -> float:
        """Return the seconds that were said last."""
        return self._time["secs"] + self._time["nsecs"] / 1_000_000_000

    def stamp(self) -> Mapping[str, int]:
        """Return the time that was said last, as headers have it."""
        return self._time

    def open(self) -> None:
        """Subscribe to it, unless it is done.

        Raises:
            BridgeError: the master cannot be reached.
        """
        if self._subscription is None:
            made = Subscription(self._wanted, self._take, lambda _: None, lambda *_: None)
            self._node.subscribe(made)
            self._subscription = made

    def close(self) -> None:
        """Subscribe to it no more."""
        if self._subscription is not None:
            self._node.unsubscribe(self._subscription)

    def _take(self, frame: bytes | bytearray, _: str) -> None:
        with suppress(MessageError):
            self._time = self._read(frame)["clock"]
