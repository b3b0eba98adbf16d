"""A ROS 2 process that only subscribes: what the transport brings before any server.

`python -m bench._ros2_reader SECONDS [small]` prints, as JSON, the pictures a second that came, and
with `small` how many of 100 small messages a second beside them, and how old they were, in ms.
"""

from __future__ import annotations

import json
import sys
import time

import rclpy
from rclpy.executors import SingleThreadedExecutor
from rclpy.qos import QoSProfile
from sensor_msgs.msg import Image
from std_msgs.msg import String

from bench.tables import at

_FIRST_SECONDS = 10.0
_SETTLE_SECONDS = 1.0
_DEPTH = 100


def main(seconds: float, *, small: bool) -> None:
    """Count and print."""
    rclpy.init()
    node = rclpy.create_node("uoarm_bench_reader")
    executor = SingleThreadedExecutor()
    executor.add_node(node)
    came: list[None] = []
    ages: list[float] = []

    def take(message: String) -> None:
        sent = int(message.data[:64].split(" ")[1])
        ages.append((time.monotonic_ns() - sent) / 1_000_000)

    node.create_subscription(
        Image, "/bench/pictures", lambda _: came.append(None), QoSProfile(depth=10)
    )
    if small:
        node.create_subscription(String, "/bench/hz100", take, QoSProfile(depth=_DEPTH))

    def spin(duration: float) -> None:
        end = time.perf_counter() + duration
        while time.perf_counter() < end:
            executor.spin_once(timeout_sec=0.1)

    limit = time.perf_counter() + _FIRST_SECONDS
    while not (came and (ages or not small)) and time.perf_counter() < limit:
        spin(0.1)
    spin(_SETTLE_SECONDS)
    came.clear()
    ages.clear()
    spin(seconds)
    reports = {"pictures": len(came) / seconds, "small": len(ages) / seconds}
    if ages:
        ages.sort()
        reports |= {"median": at(ages, 0.5), "p99": at(ages, 0.99)}
    print(json.dumps(reports), flush=True)


if __name__ == "__main__":
    main(float(sys.argv[1]), small="small" in sys.argv[2:])
