"""The one file that imports rclpy: everything that the bridge needs of it, in plain values.

One `Participant` is one rclpy context with nodes of its own. The process's default context, its
signal handlers, its logging and its global executor are left to the application.
"""

from __future__ import annotations

import faulthandler
import logging
import os
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from functools import partial
from pathlib import Path
from typing import Any, TypeVar

import rclpy
from attrs import frozen
from rclpy.action import ActionClient
from rclpy.action.graph import get_action_names_and_types
from rclpy.context import Context
from rclpy.duration import Duration
from rclpy.event_handler import (
    PublisherEventCallbacks,
    SubscriptionEventCallbacks,
    UnsupportedEventTypeError,
)
from rclpy.exceptions import InvalidHandle
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.publisher import Publisher
from rclpy.qos import (
    DurabilityPolicy,
    HistoryPolicy,
    LivelinessPolicy,
    QoSProfile,
    ReliabilityPolicy,
)
from rclpy.task import Future

from uoarm_ros2._installation import installation, wheels
from uoarm_ros2._qos import Policies

try:
    from rclpy.experimental.events_executor import EventsExecutor
except ImportError:
    EventsExecutor = None

__all__ = ["Future", "Participant", "Peer", "Station", "environment"]

_SPIN_SECONDS = 0.2
_PERFORM_SECONDS = 2.0
_DISCARD_SECONDS = 0.1
_PREFIX_BYTES = 12
_NANOSECONDS = 1_000_000_000
T = TypeVar("T")
_log = logging.getLogger("uoarm.ros2")


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
        "executor": "standard" if EventsExecutor is None else "events, standard",
    }


def _discovery() -> str:
    if os.environ.get("ROS_LOCALHOST_ONLY", "0") == "1":
        return "this machine only (ROS_LOCALHOST_ONLY)"
    return os.environ.get("ROS_AUTOMATIC_DISCOVERY_RANGE", "SUBNET (default)")


@frozen
class Peer:
    """One publisher or subscription on the graph, with what it offers or asks.

    `participant` names the DDS participant behind it, by the prefix of its identifier;
    `definition` is the hash of its type's definition, empty where it is not told (REP-2011).
    """

    node: str
    type: str
    policies: Policies
    participant: bytes = b""
    definition: str = ""


class Station:
    """One node, its executor and the thread that spins it.

    `stop` returns within its limit whatever a callback does; the thread itself puts everything
    away when it ends, and `done` is called last. `tick` is called a few times a second, `cut_off`
    once if the context is shut down from outside; both in the thread.
    """

    def __init__(
        self, context: Any, name: str, namespace: str, executor: str, done: Callable[[], None]
    ) -> None:
        self._executor = _executor(executor, context)
        # The events executor crashes when entities come or go beside it in other threads, and when
        # one goes whose event is still in its queue (it drops Python objects without the lock).
        self._alone = self.without_events = executor != "standard"
        self.node = Node(
            name,
            context=context,
            namespace=namespace or None,
            cli_args=[],
            use_global_arguments=False,
            enable_rosout=False,
            start_parameter_services=False,
            parameter_overrides=[Parameter("start_type_description_service", value=False)],
        )
        self.tick: Callable[[], None] = _nothing
        self.cut_off: Callable[[], None] = _nothing
        self._context = context
        self._executor.add_node(self.node)
        self._stopping = False
        self._done = done
        self._ended = threading.Event()
        self._thread = threading.Thread(target=self._run, name=f"ros2 {name}", daemon=True)
        self._thread.start()

    def stop(self, limit: float) -> bool:
        """End the thread; whether it ended within `limit` seconds."""
        self._stopping = True
        with suppress(Exception):  # it may have put itself away already
            self._executor.create_task(_nothing)  # work, which ends a spin at once; wake() does not
        return threading.current_thread() is self._thread or self._ended.wait(limit)

    def _run(self) -> None:
        due = time.monotonic() + _SPIN_SECONDS
        try:
            while not self._stopping:
                try:
                    self._executor.spin_once(timeout_sec=_SPIN_SECONDS)
                    if time.monotonic() >= due:
                        due = time.monotonic() + _SPIN_SECONDS
                        self.tick()
                except InvalidHandle:
                    pass  # an entity went between its event and our look at it
                except Exception as error:  # noqa: BLE001 - one failure is nobody else's
                    self._failed(error)
                if not self._context.ok():
                    break
            if not self._stopping:
                self.cut_off()
        finally:
            self._put_away()

    def _failed(self, error: Exception) -> None:
        if not self._stopping and self._context.ok():
            _log.error("a callback of ROS 2 failed", exc_info=error)

    def _put_away(self) -> None:
        try:
            self._executor.remove_node(self.node)
            self.node.destroy_node()
            self._executor.shutdown(timeout_sec=0)
        except Exception:  # noqa: BLE001 - the context must go all the same
            _log.exception("putting away a ROS 2 node failed")
        finally:
            self._done()
            self._ended.set()

    def discard(self, entity: Any) -> None:
        """Destroy a publisher or subscription; does not wait for a thread that is held up."""
        if isinstance(entity, Publisher):
            self._perform(lambda: self.node.destroy_publisher(entity), needed=False)
        else:
            self._perform(lambda: self.node.destroy_subscription(entity), needed=False)

    def _perform(self, action: Callable[[], T], *, needed: bool = True) -> T | None:
        """Create or destroy an entity in the thread in which this executor can bear it."""
        if not self._alone or threading.current_thread() is self._thread:
            return action()
        made: list[T] = []
        failed: list[Exception] = []
        done = threading.Event()

        def perform() -> None:
            try:
                made.append(action())
            except Exception as error:  # noqa: BLE001 - raised again in the caller's thread
                failed.append(error)
            done.set()

        self._executor.create_task(perform)
        if not done.wait(_PERFORM_SECONDS if needed else _DISCARD_SECONDS) and needed:
            raise RuntimeError("the thread of the events executor is held up by a delivery")
        if failed and needed:
            raise failed[0]
        return made[0] if made else None

    def subscribe(
        self,
        native: type,
        topic: str,
        policies: Policies,
        take: Callable[[Any], None],
        *,
        raw: bool,
        events: dict[str, Callable[[Any], None]],
    ) -> Any:
        """Create a subscription; events that rmw or executor cannot bear are left out."""
        profile = _profile(policies)
        for callbacks in _fewer({} if self.without_events else events):
            with suppress(UnsupportedEventTypeError):
                known = SubscriptionEventCallbacks(use_default_callbacks=False, **callbacks)
                return self._perform(
                    partial(
                        self.node.create_subscription,
                        native,
                        topic,
                        take,
                        profile,
                        raw=raw,
                        event_callbacks=known,
                    )
                )
        raise AssertionError("a subscription without event callbacks is always supported")

    def advertise(
        self,
        native: type,
        topic: str,
        policies: Policies,
        *,
        events: dict[str, Callable[[Any], None]],
    ) -> Any:
        """Create a publisher; events that rmw or executor cannot bear are left out."""
        profile = _profile(policies)
        for callbacks in _fewer({} if self.without_events else events):
            with suppress(UnsupportedEventTypeError):
                known = PublisherEventCallbacks(use_default_callbacks=False, **callbacks)
                return self._perform(
                    partial(
                        self.node.create_publisher, native, topic, profile, event_callbacks=known
                    )
                )
        raise AssertionError("a publisher without event callbacks is always supported")

    def action_client(self, native: type, name: str) -> Any:
        """Create an action client; its callbacks run in this station's thread."""
        return self._perform(lambda: ActionClient(self.node, native, name))

    def client(self, native: type, name: str) -> Any:
        """Create a service client; its replies arrive in this station's thread."""
        return self._perform(lambda: self.node.create_client(native, name))

    def server(self, native: type, name: str, answer: Callable[[Any, Any], Any]) -> None:
        """Create a service whose requests are answered in this station's thread."""
        self._perform(lambda: self.node.create_service(native, name, answer))

    def publishers(self, topic: str) -> tuple[Peer, ...]:
        """Return the publishers of a topic that are on the graph now."""
        return tuple(map(_peer, self.node.get_publishers_info_by_topic(topic)))

    def subscriptions(self, topic: str) -> tuple[Peer, ...]:
        """Return the subscriptions of a topic that are on the graph now."""
        return tuple(map(_peer, self.node.get_subscriptions_info_by_topic(topic)))

    def own_definition(self, topic: str, type_name: str) -> str:
        """Return the hash of our definition of a type, as our own end of a topic tells it."""
        node = self.node.get_fully_qualified_name()
        ends = (*self.publishers(topic), *self.subscriptions(topic))
        own = (end for end in ends if (end.node, end.type) == (node, type_name))
        return next((end.definition for end in own), "")

    def has_server(self, service: str) -> bool:
        """Whether a server of this full name is on the graph; clients do not count."""
        return bool(self.node.count_services(service))

    def servers(self, service: str) -> tuple[Peer, ...]:
        """Return the servers of a full name, as their reply topics show them.

        Empty where the middleware names these topics otherwise than DDS does in ROS 2:
        https://design.ros2.org/articles/topic_and_service_names.html
        """
        found = self.node.get_publishers_info_by_topic(f"rr{service}Reply", no_mangle=True)
        return tuple(map(_peer, found))

    def services(self) -> dict[str, list[str]]:
        """Return the services on the graph now, with their types."""
        return dict(self.node.get_service_names_and_types())

    def actions(self) -> dict[str, list[str]]:
        """Return the actions on the graph now, with their types."""
        return dict(get_action_names_and_types(self.node))


class Participant:
    """One rclpy context and the stations in it; the context goes when the last station has."""

    def __init__(self, domain_id: int | None, namespace: str, executor: str) -> None:
        self._namespace = namespace
        self._executor = executor
        self._lock = threading.Lock()
        self._stations: list[Station] = []
        self._names: set[str] = set()
        self._alive = 1
        self._context = Context()
        self._context.init(args=[], domain_id=domain_id, initialize_logging=False)

    @property
    def domain_id(self) -> int:
        """The DDS domain that the context joined."""
        return int(self._context.get_domain_id())

    def station(self, name: str) -> Station:
        """Start a node with a thread of its own."""
        with self._lock:
            self._alive += 1
        try:
            station = Station(self._context, name, self._namespace, self._executor, self._release)
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

    def dismiss(self, station: Station, limit: float) -> None:
        """Stop one station."""
        with self._lock:
            self._stations.remove(station)
        station.stop(limit)

    def close(self, limit: float) -> None:
        """Stop every station; a thread that a callback holds ends when the callback does."""
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


def _nothing() -> None:
    pass


def _executor(kind: str, context: Any) -> Any:
    if kind == "standard":
        return SingleThreadedExecutor(context=context)
    if EventsExecutor is None:
        raise RuntimeError("this rclpy has no events executor; set executor: standard")
    with _same_faulthandler():
        return EventsExecutor(context=context)


@contextmanager
def _same_faulthandler() -> Iterator[None]:
    """Undo what making an events executor does to the whole process."""
    before = faulthandler.is_enabled()
    yield
    if not before:
        faulthandler.disable()


def _fewer(
    events: dict[str, Callable[[Any], None]],
) -> Iterator[dict[str, Callable[[Any], None]]]:
    """Yield the callbacks, then only those that every rmw has, then none."""
    yield events
    yield {name: each for name, each in events.items() if name == "incompatible_qos"}
    yield {}


def _profile(policies: Policies) -> Any:
    times = {
        "deadline": policies.deadline,
        "lifespan": policies.lifespan,
        "liveliness_lease_duration": policies.lease_duration,
    }
    return QoSProfile(
        reliability=ReliabilityPolicy[policies.reliability.upper()],
        durability=DurabilityPolicy[policies.durability.upper()],
        history=HistoryPolicy[policies.history.upper()],
        depth=policies.depth,
        liveliness=LivelinessPolicy[policies.liveliness.upper()],
        **{
            name: Duration(nanoseconds=round(value * _NANOSECONDS))
            for name, value in times.items()
            if value is not None
        },
    )


def _peer(info: Any) -> Peer:
    node = f"{info.node_namespace.rstrip('/')}/{info.node_name}"
    participant = bytes(info.endpoint_gid[:_PREFIX_BYTES])
    return Peer(node, info.topic_type, _policies(info.qos_profile), participant, _definition(info))


def _definition(info: Any) -> str:
    """Return a type's hash as ROS 2 writes it; Humble and nodes older than it tell none."""
    told = getattr(info, "topic_type_hash", None)
    if told is None or told.version < 1:
        return ""
    return f"RIHS{told.version:02}_{bytes(told.value).hex()}"


def _policies(profile: Any) -> Policies:
    """Return what a graph entry says; history and depth are not told across the wire."""
    return Policies(
        reliability="best_effort" if profile.reliability.name == "BEST_EFFORT" else "reliable",
        durability=(
            "transient_local" if profile.durability.name == "TRANSIENT_LOCAL" else "volatile"
        ),
        deadline=_seconds(profile.deadline),
        lifespan=_seconds(profile.lifespan),
        liveliness=(
            "manual_by_topic" if profile.liveliness.name == "MANUAL_BY_TOPIC" else "automatic"
        ),
        lease_duration=_seconds(profile.liveliness_lease_duration),
    )


def _seconds(duration: Any) -> float | None:
    """Return a duration in seconds, None for "no limit" (zero, or longer than a century)."""
    seconds = duration.nanoseconds / _NANOSECONDS
    return seconds if 0 < seconds < 3_000_000_000 else None  # noqa: PLR2004 - rmw's infinity
