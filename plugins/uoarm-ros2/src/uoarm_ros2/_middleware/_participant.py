"""One context of rclpy, and the nodes in it."""

from __future__ import annotations

import os
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from functools import partial

from rclpy.context import Context

from uoarm.bridge import at_exit
from uoarm.errors import BridgeError, FailureReason
from uoarm_ros2._middleware._station import Station
from uoarm_ros2._middleware._wait_set import Turns
from uoarm_ros2._settings import HIGHEST_DOMAIN

__all__ = ["Participant"]

_EXIT_SECONDS = 2.0
_DOMAIN = "ROS_DOMAIN_ID"
_TRANSPORTS = "FASTDDS_BUILTIN_TRANSPORTS"
_RANGE = "ROS_AUTOMATIC_DISCOVERY_RANGE"
_setting = threading.Lock()  # what is set is the environment of the whole process


class Participant:
    """One rclpy context and the stations in it; the context goes when the last station has.

    Args:
        domain_id: of DDS; None: what the environment says.
        namespace: of every station's node.
        shared_memory: MiB through which messages go to readers on this machine; None: the
            middleware's own.

    Raises:
        BridgeError: the environment says what does not go with `shared_memory`, or names no domain.
    """

    def __init__(
        self, domain_id: int | None, namespace: str, shared_memory: int | None = None
    ) -> None:
        _check_transports(shared_memory)
        if domain_id is None:
            _check_domain(os.environ.get(_DOMAIN, ""))
        self._shared_memory = shared_memory
        self._namespace = namespace
        self._lock = threading.Lock()
        self._stations: list[Station] = []
        self._names: set[str] = set()
        self._alive = 1
        self._closed = False
        self._context = Context()
        self._context.init(args=[], domain_id=domain_id, initialize_logging=False)
        # A thread that is inside rclpy while the interpreter ends brings down the whole process.
        self._forget_exit = at_exit(partial(self.close, _EXIT_SECONDS))

    @property
    def domain_id(self) -> int:
        """The DDS domain that the context joined."""
        return int(self._context.get_domain_id())

    def station(self, name: str) -> Station:
        """Start a node with a thread of its own.

        Raises:
            BridgeError: the participant was closed.
        """
        with self._lock:
            self._require_open()
            self._alive += 1
        try:
            with _transports(self._shared_memory):
                station = Station(self._context, name, self._namespace, self._release)
        except BaseException:
            self._release()
            raise
        try:
            with self._lock:
                self._require_open()
                self._stations.append(station)
                self._names.add(station.node.get_fully_qualified_name())
        except BaseException:
            station.stop(0.0)
            raise
        return station

    def _require_open(self) -> None:
        if self._closed:
            raise BridgeError("the bridge was closed", FailureReason.CLOSED)

    def node_names(self) -> frozenset[str]:
        """Return the full names that the participant's nodes have, or had."""
        return frozenset(self._names)

    def turns(self) -> Turns:
        """Return how often the loops of all stations have turned, and how often for nothing."""
        with self._lock:
            found = [station.turns for station in self._stations]
        return Turns(sum(turns.all for turns in found), sum(turns.empty for turns in found))

    def close(self, limit: float) -> None:
        """Stop every station; a thread that a callback holds ends when the callback does.

        Happens by itself when the interpreter ends; idempotent.
        """
        self._forget_exit()
        with self._lock:
            closed, self._closed = self._closed, True
            stations, self._stations = self._stations, []
        if closed:
            return
        deadline = time.monotonic() + limit
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


def _check_domain(told: str) -> None:
    """Raise BridgeError for what is no domain: Fast DDS ends the process for one too high."""
    if told and not (told.isascii() and told.isdigit() and int(told) <= HIGHEST_DOMAIN):
        text = f"the environment says {_DOMAIN}={told!r:.40}, expected 0 to {HIGHEST_DOMAIN}"
        raise BridgeError(text, FailureReason.UNSUPPORTED)


def _check_transports(mebibytes: int | None) -> None:
    """Raise BridgeError if a size of shared memory is asked for that would have no effect."""
    text = ""
    if mebibytes is not None and "?" in os.environ.get(_TRANSPORTS, ""):
        text = f"{_TRANSPORTS}={os.environ[_TRANSPORTS]} has options of its own"
    elif mebibytes is not None and os.environ.get(_RANGE) == "LOCALHOST":
        text = f"with {_RANGE}=LOCALHOST, ROS 2 makes its own transports"
    if text:
        why = f"the option shared_memory has no effect: {text}; take one away"
        raise BridgeError(why, FailureReason.UNSUPPORTED)


@contextmanager
def _transports(mebibytes: int | None) -> Iterator[None]:
    """Have Fast DDS make participants with so much shared memory, which only its environment says.

    It reads the variable when the first node of a context makes the participant, and shares twice
    the size of its sockets' buffers; the kernel gives sockets what it allows.
    """
    if mebibytes is None:
        yield
        return
    with _setting:
        before = os.environ.get(_TRANSPORTS)
        os.environ[_TRANSPORTS] = f"{before or 'DEFAULT'}?sockets_size={mebibytes * 2**19}"
        try:
            yield
        finally:
            del os.environ[_TRANSPORTS]
            if before is not None:
                os.environ[_TRANSPORTS] = before
