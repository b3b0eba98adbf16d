"""A ROS 2 node that prints where the face is. It knows nothing of uoarm."""

from __future__ import annotations

import signal
import sys
from contextlib import suppress

import rclpy
from rclpy.executors import ExternalShutdownException
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions
from sensor_msgs.msg import RegionOfInterest


def main() -> None:
    """Print from /face until interrupted, or as many as the first argument says."""
    most = int(sys.argv[1]) if len(sys.argv) > 1 else None
    rclpy.init(signal_handler_options=SignalHandlerOptions.NO)
    signal.signal(signal.SIGTERM, signal.default_int_handler)
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
    with suppress(KeyboardInterrupt, ExternalShutdownException):
        while True:
            rclpy.spin_once(node, timeout_sec=0.2)
    rclpy.shutdown()


if __name__ == "__main__":
    main()
