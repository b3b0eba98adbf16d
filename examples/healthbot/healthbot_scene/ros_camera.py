"""A ROS 2 camera that plays footage on /image_raw; a node that knows nothing of uoarm."""

from __future__ import annotations

import signal
import sys
from collections.abc import Iterator
from contextlib import suppress

import rclpy
from rclpy.node import Node
from rclpy.qos import qos_profile_sensor_data
from rclpy.signals import SignalHandlerOptions
from sensor_msgs.msg import Image
from uoarm_vision.camera import camera
from uoarm_vision.messages import Frame

_RATE = 5.0


def main() -> None:
    """Publish the footage that is named on the command line until interrupted."""
    rclpy.init(signal_handler_options=SignalHandlerOptions.NO)
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    node = Node("camera")
    publisher = node.create_publisher(Image, "/image_raw", qos_profile_sensor_data)
    frames: Iterator[Frame] = camera(sys.argv[1], loop=True)

    def take() -> None:
        frame = next(frames)
        image = Image(height=frame["height"], width=frame["width"], encoding="bgr8")
        image.step = frame["width"] * 3
        image.header.stamp = node.get_clock().now().to_msg()
        image.data = frame["data"]
        publisher.publish(image)

    node.create_timer(1 / _RATE, take)
    with suppress(KeyboardInterrupt):
        print("ready", flush=True)
        while True:
            rclpy.spin_once(node, timeout_sec=0.2)
    rclpy.shutdown()


if __name__ == "__main__":
    main()
