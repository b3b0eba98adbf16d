"""Our policies as rclpy's quality of service, and back."""

from __future__ import annotations

from typing import Any

from rclpy.duration import Duration
from rclpy.qos import (
    DurabilityPolicy,
    HistoryPolicy,
    LivelinessPolicy,
    QoSProfile,
    ReliabilityPolicy,
)

from uoarm_ros2._qos import Policies

__all__ = ["new_profile", "read_profile", "server_profile"]

_NANOSECONDS = 1_000_000_000


_MOST_REQUESTS = 256


def server_profile() -> Any:
    """Return the profile of a service of ours.

    That of ROS 2 keeps ten requests: of more that come at once, the rest is lost, and nobody told.
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
    """Return what a graph entry says; history and depth are not told across the wire."""
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
