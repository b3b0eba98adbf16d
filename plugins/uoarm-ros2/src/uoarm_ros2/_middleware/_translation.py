"""Values and errors of rclpy in terms of this plugin: quality of service, ends on the graph."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

from attrs import frozen
from rclpy.duration import Duration
from rclpy.exceptions import InvalidHandle
from rclpy.impl.implementation_singleton import rclpy_implementation as _rclpy
from rclpy.qos import (
    DurabilityPolicy,
    HistoryPolicy,
    LivelinessPolicy,
    QoSProfile,
    ReliabilityPolicy,
)
from rosidl_generator_py.import_type_support_impl import UnsupportedTypeSupport

from uoarm.errors import BridgeError, FailureReason
from uoarm_ros2._qos import Policies


@contextmanager
def rclpy_errors(what: str) -> Iterator[None]:
    """Raise errors of rclpy in a block as BridgeErrors that name the operation.

    Threads of ours may ask for something while, or after, another one closes the bridge, or
    rclpy's signal handlers end its context.

    Raises:
        BridgeError: with CLOSED, the handle was put away; with UNSUPPORTED, the libraries of a type
            are not found; with RAISED, anything else.
    """
    try:
        yield
    except InvalidHandle:
        raise BridgeError(f"{what}: the bridge was closed", FailureReason.CLOSED) from None
    except _rclpy.RCLError as error:
        raise BridgeError(f"{what}: {error}", FailureReason.RAISED) from error
    except UnsupportedTypeSupport as error:
        text = (
            f"{what}: the libraries of package {error.pkg_name!r} cannot be loaded "
            f"({error.__context__}): source the workspace that provides them, or build it anew"
        )
        raise BridgeError(text, FailureReason.UNSUPPORTED) from error


_NANOSECONDS = 1_000_000_000


_MOST_REQUESTS = 256


def server_profile() -> Any:
    """Return the profile of a service of ours.

    That of ROS 2 keeps ten requests: of more that come at once, the rest is lost without a report.
    """
    return QoSProfile(
        reliability=ReliabilityPolicy.RELIABLE,
        durability=DurabilityPolicy.VOLATILE,
        history=HistoryPolicy.KEEP_LAST,
        depth=_MOST_REQUESTS,
    )


def new_profile(policies: Policies) -> Any:
    """Return the profile that an end of ours is made with."""
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


def read_profile(profile: Any) -> Policies:
    """Return what a graph entry says; history and depth are not sent across the wire."""
    return Policies(
        reliability="best_effort" if profile.reliability.name == "BEST_EFFORT" else "reliable",
        durability=(
            "transient_local" if profile.durability.name == "TRANSIENT_LOCAL" else "volatile"
        ),
        history="",
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


_PREFIX_BYTES = 12
UNNAMED = "NAME_UNKNOWN"  # the node of an end that reached the graph before its node


@frozen
class Peer:
    """One publisher or subscription on the graph, with what it offers or asks.

    `identity` is its own for as long as it lives, also while the graph does not know its node yet;
    `definition` is the hash of its type's definition, empty where it is not known (REP-2011).
    """

    node: str
    type: str
    policies: Policies
    identity: bytes = b""
    definition: str = ""

    @property
    def participant(self) -> bytes:
        """What its identity has in common with every other end of its DDS participant."""
        return self.identity[:_PREFIX_BYTES]


def read_peer(info: Any) -> Peer:
    """Return the end that an entry of the graph describes."""
    node = f"{info.node_namespace.rstrip('/')}/{info.node_name}"
    policies, identity = read_profile(info.qos_profile), bytes(info.endpoint_gid)
    return Peer(node, info.topic_type, policies, identity, _definition(info))


def _definition(info: Any) -> str:
    """Return a type's hash as ROS 2 writes it; Humble and nodes older than it have none."""
    report = getattr(info, "topic_type_hash", None)
    if report is None or report.version < 1:
        return ""
    return f"RIHS{report.version:02}_{bytes(report.value).hex()}"
