"""Which ROS 2 this process uses."""

from __future__ import annotations

import os
from pathlib import Path

import rclpy

from uoarm_ros2._installation import installation, wheels

__all__ = ["environment"]


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
