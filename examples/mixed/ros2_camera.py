"""A camera of ROS 2 with rclpy. It knows nothing of uoarm."""

from __future__ import annotations

import rclpy
from rclpy.executors import ExternalShutdownException
from rclpy.node import Node
from sensor_msgs.msg import Image

WIDTH, HEIGHT, BRIGHT = 64, 48, 200


def main() -> None:
    """Publish on /camera/image until interrupted."""
    rclpy.init()
    node = Node("camera")
    publisher = node.create_publisher(Image, "/camera/image", 10)
    image = Image(height=HEIGHT, width=WIDTH, encoding="mono8", step=WIDTH)
    image.data = bytes([BRIGHT]) * (WIDTH * HEIGHT)

    def take() -> None:
        image.header.stamp = node.get_clock().now().to_msg()
        publisher.publish(image)

    node.create_timer(0.05, take)
    try:
        rclpy.spin(node)
    except (KeyboardInterrupt, ExternalShutdownException):
        rclpy.try_shutdown()


if __name__ == "__main__":
    main()
