"""A ROS 2 node as anyone would write it: prints what is said on /chatter, knows no uoarm."""

from __future__ import annotations

import signal

if __name__ == "__main__":  # an import may lose what Ctrl-C raises
    signal.signal(signal.SIGINT, signal.SIG_DFL)

import argparse
import os
import sys
from contextlib import suppress
from pathlib import Path

import rclpy
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions
from std_msgs.msg import String


def main() -> None:
    """Print as many messages as the first argument says, with the name of this environment."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("left", type=int, help="how many")
    left = parser.parse_args().left
    rclpy.init(signal_handler_options=SignalHandlerOptions.NO)
    node = Node("listener")
    name = Path(sys.prefix).name

    def show(message: String) -> None:
        nonlocal left
        left -= 1
        print(f"{name} received: {message.data}", flush=True)

    node.create_subscription(String, "/chatter", show, 10)
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, signal.default_int_handler)
    with suppress(KeyboardInterrupt):
        while left > 0:
            rclpy.spin_once(node, timeout_sec=0.5)
    node.destroy_node()
    rclpy.shutdown()


if __name__ == "__main__":
    try:
        main()
    except OSError as failure:  # what it prints is read no more, as by `head`, or a disk is full
        if not isinstance(failure, BrokenPipeError):
            print(failure.strerror or failure, file=sys.stderr)
        os._exit(1)
