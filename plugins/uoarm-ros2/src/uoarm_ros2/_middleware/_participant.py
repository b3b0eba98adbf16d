"""One context of rclpy, and the nodes in it."""

from __future__ import annotations

import atexit
import threading
import time

from rclpy.context import Context

from uoarm_ros2._middleware._station import Station

__all__ = ["Participant"]

_EXIT_SECONDS = 2.0


class Participant:
    """One rclpy context and the stations in it; the context goes when the last station has."""

    def __init__(self, domain_id: int | None, namespace: str) -> None:
        self._namespace = namespace
        self._lock = threading.Lock()
        self._stations: list[Station] = []
        self._names: set[str] = set()
        self._alive = 1
        self._closed = False
        self._context = Context()
        self._context.init(args=[], domain_id=domain_id, initialize_logging=False)
        # A thread that is inside rclpy while the interpreter ends brings down the whole process.
        atexit.register(self.close, _EXIT_SECONDS)

    @property
    def domain_id(self) -> int:
        """The DDS domain that the context joined."""
        return int(self._context.get_domain_id())

    def station(self, name: str) -> Station:
        """Start a node with a thread of its own."""
        with self._lock:
            self._alive += 1
        try:
            station = Station(self._context, name, self._namespace, self._release)
        except BaseException:
            self._release()
            raise
        with self._lock:
            self._stations.append(station)
            self._names.add(station.node.get_fully_qualified_name())
        return station

    def node_names(self) -> frozenset[str]:
        """Return the full names that the participant's nodes have, or had."""
        return frozenset(self._names)

    def close(self, limit: float) -> None:
        """Stop every station; a thread that a callback holds ends when the callback does.

        Happens by itself when the interpreter ends; idempotent.
        """
        atexit.unregister(self.close)
        with self._lock:
            closed, self._closed = self._closed, True
        if closed:
            return
        deadline = time.monotonic() + limit
        with self._lock:
            stations, self._stations = self._stations, []
        for station in stations:
            station.stop(max(0.0, deadline - time.monotonic()))
        self._release()

    def _release(self) -> None:
        with self._lock:
            self._alive -= 1
            last = self._alive == 0
        if last:
            self._context.try_shutdown()
            self._context.destroy()
