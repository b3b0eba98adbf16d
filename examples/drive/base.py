"""A simulated base, as any ROS 2 node: drives as /cmd_vel says, and publishes on /odom where it is.

Like many a real one it has no timeout of its own: it goes on until a command stops it.
"""

from __future__ import annotations

import signal

if __name__ == "__main__":  # an import may lose what Ctrl-C raises
    signal.signal(signal.SIGINT, signal.SIG_DFL)

import os
import sys
from contextlib import suppress
from math import cos, sin

import rclpy
from geometry_msgs.msg import Twist
from nav_msgs.msg import Odometry
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions

_SECONDS = 0.05


class Base(Node):  # type: ignore[misc]  # rclpy has no types
    """A base that follows each command at once."""

    def __init__(self) -> None:
        super().__init__("base")
        self._command = Twist()
        self._x = self._y = self._heading = 0.0
        self._odometry = self.create_publisher(Odometry, "/odom", 10)
        self.create_subscription(Twist, "/cmd_vel", self._take, 10)
        self.create_timer(_SECONDS, self._move)

    def _take(self, twist: Twist) -> None:
        if twist != self._command:
            speed, turn = twist.linear.x, twist.angular.z
            text = f"driving at {speed:.2f} m/s, turning at {turn:.2f} rad/s"
            print(text if speed or turn else "standing still", flush=True)
        self._command = twist

    def _move(self) -> None:
        self._heading += _SECONDS * self._command.angular.z
        self._x += _SECONDS * self._command.linear.x * cos(self._heading)
        self._y += _SECONDS * self._command.linear.x * sin(self._heading)
        report = Odometry()
        report.pose.pose.position.x, report.pose.pose.position.y = self._x, self._y
        report.pose.pose.orientation.z = sin(self._heading / 2)
        report.pose.pose.orientation.w = cos(self._heading / 2)
        report.twist.twist = self._command
        self._odometry.publish(report)


def main() -> None:
    """Drive until interrupted."""
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, signal.default_int_handler)
    with suppress(KeyboardInterrupt):  # also as it begins
        rclpy.init(signal_handler_options=SignalHandlerOptions.NO)
        base = Base()
        print("standing still", flush=True)
        while True:
            rclpy.spin_once(base, timeout_sec=0.2)
    rclpy.try_shutdown()


if __name__ == "__main__":
    try:
        main()
    except OSError as failure:  # what it prints is read no more, as by `head`, or a disk is full
        if not isinstance(failure, BrokenPipeError):
            print(failure.strerror or failure, file=sys.stderr)
        os._exit(1)
