"""The one folder that imports rclpy: everything that the bridge needs of it, in plain values.

One `Participant` is one rclpy context with nodes of its own. The process's default context, its
signal handlers, its logging and its global executor are left to the application.
"""

from uoarm_ros2._middleware._actions import GoalRequest, GoalServer
from uoarm_ros2._middleware._native import deserialised, publish_released, serialised, untyped_class
from uoarm_ros2._middleware._node_runner import NodeRunner
from uoarm_ros2._middleware._participant import Participant, environment
from uoarm_ros2._middleware._translation import UNNAMED, Peer, rclpy_errors

__all__ = [
    "UNNAMED",
    "GoalRequest",
    "GoalServer",
    "NodeRunner",
    "Participant",
    "Peer",
    "deserialised",
    "environment",
    "publish_released",
    "rclpy_errors",
    "serialised",
    "untyped_class",
]
