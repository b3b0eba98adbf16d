"""A node of ROS 2 behind a rosbridge server: topics, an echo, a service, an action, a parameter."""

# mypy: ignore-errors
# rclpy has no types, and need not be there.
from __future__ import annotations

import signal
import sys
from typing import Any

import rclpy
from rclpy.action import ActionServer
from rclpy.executors import MultiThreadedExecutor
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions
from sensor_msgs.msg import Image, LaserScan, NavSatFix
from std_msgs.msg import String
from std_srvs.srv import SetBool
from test_msgs.action import Fibonacci

WIDTH, HEIGHT = 64, 48
HERTZ = 20.0


def main() -> None:
    """Run until the process is ended."""
    rclpy.init(signal_handler_options=SignalHandlerOptions.NO)
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    node = Node("behind")
    node.declare_parameter("speed", 7)
    picture = Image(width=WIDTH, height=HEIGHT, encoding="mono8", step=WIDTH)
    picture.data = bytes(index % 256 for index in range(WIDTH * HEIGHT))
    scan = LaserScan(ranges=[0.5, float("inf"), float("nan")], range_max=2.5)
    pictures = node.create_publisher(Image, "/behind/picture", 10)
    scans = node.create_publisher(LaserScan, "/behind/scan", 10)
    fixes = node.create_publisher(NavSatFix, "/behind/fix", 10)

    def publish() -> None:
        pictures.publish(picture)
        scans.publish(scan)
        fixes.publish(NavSatFix(position_covariance=[float(place) for place in range(9)]))

    node.create_timer(1 / HERTZ, publish)
    echo = node.create_publisher(String, "/behind/echoed", 1000)
    node.create_subscription(String, "/behind/asked", echo.publish, 1000)
    node.create_service(SetBool, "/behind/set", _set)
    ActionServer(node, Fibonacci, "/behind/count", _count)
    executor = MultiThreadedExecutor(4)
    executor.add_node(node)
    sys.stdout.write("ready\n")
    sys.stdout.flush()
    try:
        while True:
            executor.spin_once(timeout_sec=0.2)
    except KeyboardInterrupt:
        return


def _set(request: Any, response: Any) -> Any:
    response.success, response.message = request.data, f"data is {request.data}"
    return response


def _count(goal: Any) -> Any:
    if goal.request.order < 0:
        goal.abort()
        return Fibonacci.Result()
    goal.succeed()
    return Fibonacci.Result(sequence=[0, 1, 1, 2, 3, 5][: goal.request.order])


if __name__ == "__main__":
    main()
