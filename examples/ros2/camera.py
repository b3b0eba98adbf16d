"""A ROS 2 camera: paints a face-coloured patch that wanders over a dark wall, 10 pictures a second.

It knows nothing of uoarm.
"""

from __future__ import annotations

import signal

if __name__ == "__main__":  # an import may lose what Ctrl-C raises
    signal.signal(signal.SIGINT, signal.SIG_DFL)

import os
import sys
from contextlib import suppress

import numpy as np
import rclpy
from rclpy.node import Node
from rclpy.qos import qos_profile_sensor_data
from rclpy.signals import SignalHandlerOptions
from sensor_msgs.msg import Image

HEIGHT, WIDTH, SIDE = 240, 320, 48
SKIN = (224, 172, 105)


def main() -> None:
    """Publish on /image_raw until interrupted."""
    rclpy.init(signal_handler_options=SignalHandlerOptions.NO)
    node = Node("camera")
    publisher = node.create_publisher(Image, "/image_raw", qos_profile_sensor_data)
    taken = 0

    def take() -> None:
        nonlocal taken
        taken += 1
        picture = np.full((HEIGHT, WIDTH, 3), 20, np.uint8)
        left = taken * 4 % (WIDTH - SIDE)
        picture[96 : 96 + SIDE, left : left + SIDE] = SKIN
        image = Image(height=HEIGHT, width=WIDTH, encoding="rgb8", step=WIDTH * 3)
        image.header.stamp = node.get_clock().now().to_msg()
        image.data = picture.tobytes()
        publisher.publish(image)

    node.create_timer(0.1, take)
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, signal.default_int_handler)
    with suppress(KeyboardInterrupt):
        print("showing pictures on /image_raw", flush=True)
        while True:
            rclpy.spin_once(node, timeout_sec=0.2)
    rclpy.shutdown()


if __name__ == "__main__":
    try:
        main()
    except OSError as failure:  # what it prints is read no more, as by `head`, or a disk is full
        if not isinstance(failure, BrokenPipeError):
            print(failure.strerror or failure, file=sys.stderr)
        os._exit(1)
