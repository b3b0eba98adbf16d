"""Wheels of a lab's own messages, made without a ROS installation: generators and a compiler."""

from __future__ import annotations

from uoarm_ros2._interfaces._build import build_wheels

__all__ = ["build_wheels"]
