"""A ROS 2 node that prints where the face is. It knows nothing of uoarm."""

from __future__ import annotations

import sys

import rclpy
from rclpy.executors import ExternalShutdownException
from rclpy.node import Node
from sensor_msgs.msg import RegionOfInterest


def main() -> None:
    """Print from /face until interrupted, or as many as the first argument says."""
    most = int(sys.argv[1]) if len(sys.argv) > 1 else None
    rclpy.init()
    node = Node("listener")
    received = 0

    def show(face: RegionOfInterest) -> None:
        nonlocal received
        received += 1
        place = f"({face.x_offset}, {face.y_offset})"
        print(f"face at {place}, {face.width} x {face.height}", flush=True)
        if received == most:
            raise ExternalShutdownException

    node.create_subscription(RegionOfInterest, "/face", show, 10)
    try:
        rclpy.spin(node)
    except (KeyboardInterrupt, ExternalShutdownException):
        rclpy.try_shutdown()


if __name__ == "__main__":
    main()
