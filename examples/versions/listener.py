"""A ROS 2 node as anyone would write it: prints what is said on /chatter, knows no uoarm."""

from __future__ import annotations

import signal
import sys
from contextlib import suppress
from pathlib import Path

import rclpy
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions
from std_msgs.msg import String


def main() -> None:
    """Print as many messages as the first argument says, with the name of this environment."""
    left = int(sys.argv[1])
    rclpy.init(signal_handler_options=SignalHandlerOptions.NO)
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    node = Node("listener")
    name = Path(sys.prefix).name

    def show(message: String) -> None:
        nonlocal left
        left -= 1
        print(f"{name} received: {message.data}", flush=True)

    node.create_subscription(String, "/chatter", show, 10)
    with suppress(KeyboardInterrupt):
        while left > 0:
            rclpy.spin_once(node, timeout_sec=0.5)
    node.destroy_node()
    rclpy.shutdown()


if __name__ == "__main__":
    main()
