"""The one folder that imports rclpy: everything that the bridge needs of it, in plain values.

One `Participant` is one rclpy context with nodes of its own. The process's default context, its
signal handlers, its logging and its global executor are left to the application.
"""

from uoarm_ros2._middleware._environment import environment
from uoarm_ros2._middleware._errors import rclpy_errors
from uoarm_ros2._middleware._goal_server import GoalRequest, GoalServer
from uoarm_ros2._middleware._participant import Participant
from uoarm_ros2._middleware._peer import Peer
from uoarm_ros2._middleware._station import Station
from uoarm_ros2._middleware._type_support import untyped_class

__all__ = [
    "GoalRequest",
    "GoalServer",
    "Participant",
    "Peer",
    "Station",
    "environment",
    "rclpy_errors",
    "untyped_class",
]
