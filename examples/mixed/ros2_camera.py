"""A camera of ROS 2 with rclpy. It knows nothing of uoarm."""

from __future__ import annotations

import signal

if __name__ == "__main__":  # an import may lose what Ctrl-C raises
    signal.signal(signal.SIGINT, signal.SIG_DFL)

from contextlib import suppress

import rclpy
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions
from sensor_msgs.msg import Image

WIDTH, HEIGHT, BRIGHT = 64, 48, 200


def main() -> None:
    """Publish on /camera/image until interrupted."""
    rclpy.init(signal_handler_options=SignalHandlerOptions.NO)
    node = Node("camera")
    publisher = node.create_publisher(Image, "/camera/image", 10)
    image = Image(height=HEIGHT, width=WIDTH, encoding="mono8", step=WIDTH)
    image.data = bytes([BRIGHT]) * (WIDTH * HEIGHT)

    def take() -> None:
        image.header.stamp = node.get_clock().now().to_msg()
        publisher.publish(image)

    node.create_timer(0.05, take)
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, signal.default_int_handler)
    with suppress(KeyboardInterrupt):
        while True:
            rclpy.spin_once(node, timeout_sec=0.2)
    rclpy.shutdown()


if __name__ == "__main__":
    main()
