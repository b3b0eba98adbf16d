"""A mobile robot as a ROS 2 node with an action server; it finds its own way along a path.

Subscribes `amr/path` (nav_msgs/Path, the time of whose stamp names the leg; an empty one lets it
stand), `amr/carry` and `amr/cmd_vel` (geometry_msgs/Twist, which steers it by hand, each for half a
second, while it has no path to drive); serves the action `amr/drive`, whose goal is a leg. It
drives while there is a goal and a path of the same leg. The wheels of ROS 2 bring no action types
for navigation, so that of test_msgs stands in: `order` is the leg, `sequence` what is left of it.
"""

from __future__ import annotations

import math
import signal
import sys
import threading
import time
from contextlib import suppress
from typing import Any, Final

import rclpy
from geometry_msgs.msg import Twist
from nav_msgs.msg import Odometry, Path
from rclpy.action import ActionServer, CancelResponse
from rclpy.callback_groups import ReentrantCallbackGroup
from rclpy.executors import MultiThreadedExecutor
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions
from sensor_msgs.msg import BatteryState
from std_msgs.msg import Bool, Int32, String
from test_msgs.action import Fibonacci
from warehouse_floor.bodies import Sense, Triple
from warehouse_floor.link import Base
from warehouse_floor.navigator import STAND, Driver

_SECONDS: Final = 0.05
_EVERY: Final = 2
_FEEDBACK: Final = 0.2
_LIVE: Final = 1.2  # as long as the configuration has a path live, and the way to here
_LIVE_BY_HAND: Final = 0.6


class Amr:
    """The node.

    Args:
        name: of the vehicle; its topics begin with it.
        home: where it stands at first.
    """

    def __init__(self, name: str, home: str) -> None:
        self.node = Node(name)
        self._base = Base(name, home)
        self._driver = Driver()
        self._lock = threading.Lock()
        self._path: tuple[int, tuple[tuple[float, float], ...]] = (0, ())
        self._until = float("-inf")
        self._carry = ""
        self._by_hand: tuple[Triple, float] = (STAND, float("-inf"))
        self._goal = 0
        self._left: tuple[int, int] = (0, 0)
        self._ticks = 0
        self._sense: Sense | None = None
        group = ReentrantCallbackGroup()
        node = self.node
        node.create_subscription(Path, f"{name}/path", self._take_path, 1)
        node.create_subscription(String, f"{name}/carry", self._take_carry, 1)
        node.create_subscription(Twist, f"{name}/cmd_vel", self._take_twist, 1)
        self._server = ActionServer(
            node, Fibonacci, f"{name}/drive", self._execute, callback_group=group,
            cancel_callback=lambda _: CancelResponse.ACCEPT,
        )  # fmt: skip
        self._out = {
            part: node.create_publisher(kind, f"{name}/{part}", 5)
            for part, kind in (
                ("odom", Odometry), ("battery", BatteryState), ("load", String),
                ("localised", Bool), ("blocked", Bool), ("stopped", Int32),
            )
        }  # fmt: skip
        node.create_timer(_SECONDS, self._drive)

    def _take_path(self, path: Any) -> None:
        points = tuple((pose.pose.position.x, pose.pose.position.y) for pose in path.poses)
        with self._lock:
            self._path = (path.header.stamp.sec, points)
            self._until = time.monotonic() + _LIVE

    def _take_carry(self, carry: Any) -> None:
        with self._lock:
            self._carry = carry.data

    def _take_twist(self, twist: Any) -> None:
        with self._lock:
            velocity = (twist.linear.x, 0.0, twist.angular.z)
            self._by_hand = (velocity, time.monotonic() + _LIVE_BY_HAND)

    def _drive(self) -> None:
        """One step of the control loop."""
        with self._lock:
            (leg, points), until, carry = self._path, self._until, self._carry
            is_wanted = leg == self._goal
            velocity, live = self._by_hand
        self._driver.go(leg, points if is_wanted else ())
        now = time.monotonic()
        if live > now and not (points and until > now):
            self._sense = self._base.drive(velocity, live, self._driver.carry)
        else:
            self._sense = self._base.drive(*self._along(carry, until))
        if self._sense is not None and self._ticks % _EVERY == 0:
            self._publish(self._sense)
        self._ticks += 1

    def _along(self, carry: str, until: float) -> tuple[Triple, float, str]:
        sense = self._sense
        # The controller's own timeout, should the stop message have got lost.
        if sense is None or not sense.is_localised or time.monotonic() > until:
            return STAND, until, self._driver.carry
        step = self._driver.step((sense.x, sense.y, sense.heading), sense.load, carry)
        self._left = (len(self._path[1]) - step.passed, self._path[0])
        return step.velocity, until, self._driver.carry

    def _publish(self, sense: Sense) -> None:
        odometry = Odometry()
        odometry.header.stamp = self.node.get_clock().now().to_msg()
        odometry.header.frame_id, odometry.child_frame_id = "floor", self.node.get_name()
        position, turned = odometry.pose.pose.position, odometry.pose.pose.orientation
        position.x, position.y = sense.x, sense.y
        turned.z, turned.w = math.sin(sense.heading / 2), math.cos(sense.heading / 2)
        odometry.twist.twist.linear.x = sense.speed
        self._out["load"].publish(String(data=sense.load))
        self._out["localised"].publish(Bool(data=sense.is_localised))
        self._out["blocked"].publish(Bool(data=sense.is_blocked))
        leg, points = self._path
        self._out["stopped"].publish(Int32(data=0 if points else leg))
        self._out["battery"].publish(BatteryState(percentage=sense.battery / 100, present=True))
        self._out["odom"].publish(odometry)

    def _execute(self, handle: Any) -> Any:
        """Carry one goal out; the newest one is in force."""
        leg = handle.request.order
        with self._lock:
            self._goal = leg
        while rclpy.ok():
            if self._driver.done == leg:
                handle.succeed()
                break
            if handle.is_cancel_requested:
                with self._lock:
                    self._goal = 0 if self._goal == leg else self._goal
                handle.canceled()
                break
            if self._goal != leg:
                handle.abort()
                break
            handle.publish_feedback(Fibonacci.Feedback(sequence=list(self._left)))
            time.sleep(_FEEDBACK)
        return Fibonacci.Result(sequence=[leg])


def main() -> None:
    """Run `NAME HOME` until interrupted."""
    rclpy.init(signal_handler_options=SignalHandlerOptions.NO)
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    amr = Amr(sys.argv[1], sys.argv[2])
    executor = MultiThreadedExecutor(num_threads=6)
    executor.add_node(amr.node)
    with suppress(KeyboardInterrupt):
        print("ready", flush=True)
        while True:
            executor.spin_once(timeout_sec=0.2)
    rclpy.shutdown()


if __name__ == "__main__":
    main()
