"""A ROS 2 process that only counts pictures: what the transport brings before any server."""

from __future__ import annotations

import sys
import time

import rclpy
from rclpy.executors import SingleThreadedExecutor
from rclpy.qos import QoSProfile
from sensor_msgs.msg import Image

_SETTLE_SECONDS = 2.0


def main(seconds: float) -> None:
    """Print the pictures a second that come."""
    rclpy.init()
    node = rclpy.create_node("uoarm_bench_reader")
    executor = SingleThreadedExecutor()
    executor.add_node(node)
    came: list[None] = []
    node.create_subscription(
        Image, "/bench/pictures", lambda _: came.append(None), QoSProfile(depth=10)
    )

    def spin(duration: float) -> None:
        end = time.perf_counter() + duration
        while time.perf_counter() < end:
            executor.spin_once(timeout_sec=0.1)

    spin(_SETTLE_SECONDS)
    came.clear()
    spin(seconds)
    print(len(came) / seconds, flush=True)


if __name__ == "__main__":
    main(float(sys.argv[1]))
