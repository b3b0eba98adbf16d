"""A ROS 2 node as anyone would write it: says a number twice a second. Knows nothing of uoarm."""

from __future__ import annotations

import signal

if __name__ == "__main__":  # an import may lose what Ctrl-C raises
    signal.signal(signal.SIGINT, signal.SIG_DFL)

import argparse
import os
import sys
from contextlib import suppress

import rclpy
from rclpy.executors import ExternalShutdownException
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions
from rclpy.utilities import remove_ros_args
from std_msgs.msg import String


def main() -> None:
    """Publish on /chatter until interrupted, or as many times as the first argument says."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("most", type=int, nargs="?", help="how often; else until interrupted")
    most = parser.parse_args(remove_ros_args(sys.argv)[1:]).most
    rclpy.init(signal_handler_options=SignalHandlerOptions.NO)
    node = Node("talker")
    publisher = node.create_publisher(String, "chatter", 10)
    said = 0

    def say() -> None:
        nonlocal said
        said += 1
        publisher.publish(String(data=f"hello {said}"))
        if said == most:
            raise ExternalShutdownException

    node.create_timer(0.5, say)
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, signal.default_int_handler)
    with suppress(KeyboardInterrupt, ExternalShutdownException):
        print("talking on /chatter", flush=True)
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
