"""Two ROS 2 nodes as anyone would write them, for the bench of two versions; they know no uoarm.

`client` sends octets on /ping, waits for each on /pong, and prints the microseconds of every
round as JSON; `echo` sends back on /pong what comes on /ping.
"""

from __future__ import annotations

import json
import sys
import time

import rclpy
from rclpy.node import Node
from std_msgs.msg import UInt8MultiArray

WARM = 50


def client(size: int, rounds: int) -> None:
    """Measure rounds of one size, after those that warm up."""
    node = Node("client")
    seen = 0

    def take(_: UInt8MultiArray) -> None:
        nonlocal seen
        seen += 1

    node.create_subscription(UInt8MultiArray, "/pong", take, 10)
    publisher = node.create_publisher(UInt8MultiArray, "/ping", 10)
    message = UInt8MultiArray(data=bytes(size))
    while not seen:
        publisher.publish(message)
        rclpy.spin_once(node, timeout_sec=0.2)
    while rclpy.spin_once(node, timeout_sec=0.5):
        pass
    found = []
    for number in range(WARM + rounds):
        before, begun = seen, time.perf_counter_ns()
        publisher.publish(message)
        while seen == before:
            rclpy.spin_once(node, timeout_sec=1.0)
        if number >= WARM:
            found.append((time.perf_counter_ns() - begun) / 1000)
    print(json.dumps(found), flush=True)


def echo() -> None:
    """Send everything back until the process is ended."""
    node = Node("echo")
    publisher = node.create_publisher(UInt8MultiArray, "/pong", 10)
    node.create_subscription(UInt8MultiArray, "/ping", publisher.publish, 10)
    rclpy.spin(node)


if __name__ == "__main__":
    rclpy.init()
    if sys.argv[1] == "client":
        client(int(sys.argv[2]), int(sys.argv[3]))
    else:
        echo()
