"""A ROS 2 camera that plays footage on /image_raw; a node that knows nothing of uoarm."""

from __future__ import annotations

import sys
from collections.abc import Iterator

import rclpy
from rclpy.executors import ExternalShutdownException
from rclpy.node import Node
from rclpy.qos import qos_profile_sensor_data
from sensor_msgs.msg import Image
from uoarm_vision.camera import camera
from uoarm_vision.messages import Frame

_RATE = 5.0


def main() -> None:
    """Publish the footage that is named on the command line until interrupted."""
    rclpy.init()
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
    print("ready", flush=True)
    try:
        rclpy.spin(node)
    except (KeyboardInterrupt, ExternalShutdownException):
        rclpy.try_shutdown()


if __name__ == "__main__":
    main()
