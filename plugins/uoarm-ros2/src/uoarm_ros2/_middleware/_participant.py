"""One context of rclpy, and the nodes in it."""

from __future__ import annotations

import os
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from functools import partial
from pathlib import Path

import rclpy
from rclpy.context import Context

from uoarm.bridge import Turns, at_exit, on_failure
from uoarm.errors import BridgeError, FailureReason
from uoarm_ros2._installed import installation, wheels
from uoarm_ros2._middleware._node_runner import NodeRunner
from uoarm_ros2._options import HIGHEST_DOMAIN

_EXIT_SECONDS = 2.0
_DOMAIN = "ROS_DOMAIN_ID"
_TRANSPORTS = "FASTDDS_BUILTIN_TRANSPORTS"
_RANGE = "ROS_AUTOMATIC_DISCOVERY_RANGE"
# Guards the variable of Fast DDS in the environment, which is that of the whole process, between
# participants that are made at the same time.
_setting = threading.Lock()


class Participant:
    """One rclpy context and the nodes in it; the context goes when the last node has.

    Args:
        domain_id: of DDS; None: what the environment says.
        namespace: of every node.
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
        # Guards the runners and the number of living ones, between `start_node`, `close` and the
        # threads of runners that end: the context is destroyed by the last, and only once.
        self._lock = threading.Lock()
        self._runners: list[NodeRunner] = []
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

    def start_node(self, name: str) -> NodeRunner:
        """Start a node with a thread of its own.

        Raises:
            BridgeError: the participant was closed.
        """
        with self._lock:
            self._require_open()
            self._alive += 1
        with on_failure(self._release), _transports(self._shared_memory):
            runner = NodeRunner(self._context, name, self._namespace, self._release)
        with on_failure(runner.stop, 0.0), self._lock:
            self._require_open()
            self._runners.append(runner)
            self._names.add(runner.node.get_fully_qualified_name())
        return runner

    def _require_open(self) -> None:
        if self._closed:
            raise BridgeError("the bridge was closed", FailureReason.CLOSED)

    def node_names(self) -> frozenset[str]:
        """Return the full names that the participant's nodes have, or had."""
        return frozenset(self._names)

    def turns(self) -> Turns:
        """Return how often the loops of all nodes have turned, and how often for nothing."""
        with self._lock:
            found = [runner.turns for runner in self._runners]
        return Turns(sum(turns.all for turns in found), sum(turns.empty for turns in found))

    def close(self, limit: float) -> None:
        """Stop every node; a thread that a callback holds ends when the callback does.

        Happens by itself when the interpreter ends; idempotent.
        """
        self._forget_exit()
        with self._lock:
            closed, self._closed = self._closed, True
            runners, self._runners = self._runners, []
        if closed:
            return
        deadline = time.monotonic() + limit
        for runner in runners:
            runner.stop(max(0.0, deadline - time.monotonic()))
        self._release()

    def _release(self) -> None:
        with self._lock:
            self._alive -= 1
            last = self._alive == 0
        if last:
            self._context.try_shutdown()
            self._context.destroy()


def _check_domain(value: str) -> None:
    """Raise BridgeError for what is no domain: Fast DDS ends the process for one too high."""
    if value and not (value.isascii() and value.isdigit() and int(value) <= HIGHEST_DOMAIN):
        text = f"the environment says {_DOMAIN}={value!r:.40}, expected 0 to {HIGHEST_DOMAIN}"
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


def environment() -> dict[str, str]:
    """Return which rclpy, distribution, middleware and domain this process uses."""
    folder = Path(rclpy.__file__).parent
    found = installation(folder, os.environ, wheels())
    return {
        "rclpy": str(folder),
        "distribution": f"{found.distribution}, from {found.origin}",
        **({"conflict": found.conflict} if found.conflict else {}),
        "rmw": rclpy.get_rmw_implementation_identifier(),
        "domain": os.environ.get("ROS_DOMAIN_ID", "0 (ROS_DOMAIN_ID is not set)"),
        "discovery": _discovery(),
    }


def _discovery() -> str:
    if os.environ.get("ROS_LOCALHOST_ONLY", "0") == "1":
        return "this machine only (ROS_LOCALHOST_ONLY)"
    return os.environ.get("ROS_AUTOMATIC_DISCOVERY_RANGE", "SUBNET (default)")
