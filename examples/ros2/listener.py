"""A ROS 2 node that prints where the face is. It knows nothing of uoarm."""

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
from sensor_msgs.msg import RegionOfInterest


def main() -> None:
    """Print from /face until interrupted, or as many as the first argument says."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("most", type=int, nargs="?", help="how many; else until interrupted")
    most = parser.parse_args().most
    rclpy.init(signal_handler_options=SignalHandlerOptions.NO)
    node = Node("listener")
    received = 0

    def show(face: RegionOfInterest) -> None:
        nonlocal received
        received += 1
        place = f"({face.x_offset}, {face.y_offset})"
        print(f"face at {place}, {face.width} x {face.height}", flush=True)
        if received == most:
            raise ExternalShutdownException

    node.create_subscription(RegionOfInterest, "/face", show, 10)
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, signal.default_int_handler)
    with suppress(KeyboardInterrupt, ExternalShutdownException):
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
