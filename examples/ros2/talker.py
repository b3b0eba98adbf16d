"""A ROS 2 node as anyone would write it: says a number twice a second. Knows nothing of uoarm."""

from __future__ import annotations

import sys

import rclpy
from rclpy.executors import ExternalShutdownException
from rclpy.node import Node
from rclpy.utilities import remove_ros_args
from std_msgs.msg import String


def main() -> None:
    """Publish on /chatter until interrupted, or as many times as the first argument says."""
    arguments = remove_ros_args(sys.argv)
    most = int(arguments[1]) if len(arguments) > 1 else None
    rclpy.init()
    node = Node("talker")
    publisher = node.create_publisher(String, "chatter", 10)
    said = 0

    def say() -> None:
        nonlocal said
        said += 1
        publisher.publish(String(data=f"hello {said}"))
        if said == most:
            raise ExternalShutdownException

    node.create_timer(0.5, say)
    print("talking on /chatter", flush=True)
    try:
        rclpy.spin(node)
    except (KeyboardInterrupt, ExternalShutdownException):
        rclpy.try_shutdown()


if __name__ == "__main__":
    main()
