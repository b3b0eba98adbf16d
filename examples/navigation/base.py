"""A simulated mobile base as a ROS 2 node: an action server as Nav2 has it, odometry, tf, laser."""

from __future__ import annotations

import signal

if __name__ == "__main__":  # an import may lose what Ctrl-C raises
    signal.signal(signal.SIGINT, signal.SIG_DFL)

import math
import os
import sys
import threading
import time
from contextlib import suppress
from itertools import pairwise
from typing import Any

import rclpy
from geometry_msgs.msg import PoseStamped, TransformStamped
from nav_msgs.msg import Odometry
from nav_msgs.srv import GetPlan
from rclpy.action import ActionServer, CancelResponse
from rclpy.callback_groups import ReentrantCallbackGroup
from rclpy.executors import MultiThreadedExecutor
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions
from sensor_msgs.msg import LaserScan

try:
    from nav2_msgs.action import NavigateToPose
    from tf2_msgs.msg import TFMessage
except ImportError as error:  # neither is on PyPI
    sys.exit(f"{error}: `uoarm ros2 build-interfaces` makes it, see examples/navigation/README.md")

_METRES_PER_SECOND = 5.0
_STEP_SECONDS = 0.02
_PLAN_SECONDS = 5.0
_ATTEMPTS = 12
_NO_PLAN = 1
_REPORT_SECONDS = 0.1
_WALL_METRES = 25.0
_BEAMS = 36


class Base:
    """Stands at the origin of the map, and drives along the paths that it asks for at /plan."""

    def __init__(self) -> None:
        self.node = Node("base")
        self._ended = threading.Event()
        group = ReentrantCallbackGroup()  # a goal is cancelled while it is driven
        self._x = self._y = 0.0
        self._odometry = self.node.create_publisher(Odometry, "/odom", 10)
        self._frames = self.node.create_publisher(TFMessage, "/tf", 10)
        self._laser = self.node.create_publisher(LaserScan, "/scan", 10)
        self.node.create_timer(_REPORT_SECONDS, self._publish, callback_group=group)
        self._planner = self.node.create_client(GetPlan, "/plan", callback_group=group)
        self._server = ActionServer(
            self.node,
            NavigateToPose,
            "/navigate_to_pose",
            self._drive,
            cancel_callback=lambda _: CancelResponse.ACCEPT,
            callback_group=group,
        )

    def _drive(self, handle: Any) -> Any:
        """Drive to the pose of a goal, until it is there or the goal is cancelled."""
        result, recoveries = NavigateToPose.Result(), 0
        path = self._path(handle)
        while path is None and recoveries < _ATTEMPTS and not self._is_over(handle):
            recoveries += 1
            path = self._path(handle)
        if path is not None and all(
            self._goes_to(handle, x, y, path[number:], recoveries)
            for number, (x, y) in enumerate(path)
        ):
            handle.succeed()
        elif handle.is_cancel_requested:
            handle.canceled()
        else:
            if path is None:
                result.error_code, result.error_msg = _NO_PLAN, "there is no planner"
            handle.abort()
        return result

    def end(self) -> None:
        """Abort the goal that is driven, and stand."""
        self._ended.set()

    def _is_over(self, handle: Any) -> bool:
        return self._ended.is_set() or handle.is_cancel_requested

    def _goes_to(
        self, handle: Any, x: float, y: float, path: list[tuple[float, float]], recoveries: int
    ) -> bool:
        """Drive to a point; returns whether nothing ended the goal meanwhile."""
        while (left := math.hypot(x - self._x, y - self._y)) > 0:
            if self._is_over(handle):
                return False
            feedback = NavigateToPose.Feedback()
            feedback.current_pose = self._pose()
            feedback.number_of_recoveries = recoveries
            feedback.distance_remaining = left + _length(path)
            handle.publish_feedback(feedback)
            part = _METRES_PER_SECOND * _STEP_SECONDS / left
            if part < 1:
                self._x += part * (x - self._x)
                self._y += part * (y - self._y)
            else:
                self._x, self._y = x, y
            time.sleep(_STEP_SECONDS)
        return True

    def _path(self, handle: Any) -> list[tuple[float, float]] | None:
        """Return the points of a path; None where no planner answers in time."""
        answered, until = threading.Event(), time.monotonic() + _PLAN_SECONDS
        request = GetPlan.Request(start=self._pose(), goal=handle.request.pose)
        future = self._planner.call_async(request)
        future.add_done_callback(lambda _: answered.set())
        while not answered.wait(_STEP_SECONDS):
            if self._is_over(handle) or time.monotonic() >= until:
                self._planner.remove_pending_request(future)
                return None
        positions = [pose.pose.position for pose in future.result().plan.poses]
        return [(position.x, position.y) for position in positions]

    def _pose(self) -> PoseStamped:
        pose = PoseStamped()
        pose.header.frame_id = "map"
        pose.header.stamp = self.node.get_clock().now().to_msg()
        pose.pose.position.x, pose.pose.position.y = self._x, self._y
        pose.pose.orientation.w = 1.0
        return pose

    def _publish(self) -> None:
        odometry = Odometry()
        odometry.header.frame_id, odometry.child_frame_id = "map", "base_link"
        odometry.header.stamp = self.node.get_clock().now().to_msg()
        odometry.pose.pose = self._pose().pose
        self._odometry.publish(odometry)
        frame = TransformStamped(header=odometry.header, child_frame_id="base_link")
        frame.transform.translation.x, frame.transform.translation.y = self._x, self._y
        frame.transform.rotation.w = 1.0
        self._frames.publish(TFMessage(transforms=[frame]))
        scan = LaserScan(
            angle_max=2 * math.pi, angle_increment=2 * math.pi / _BEAMS, range_max=100.0
        )
        scan.header.frame_id, scan.header.stamp = "base_link", odometry.header.stamp
        scan.ranges = [self._range(number * scan.angle_increment) for number in range(_BEAMS)]
        self._laser.publish(scan)

    def _range(self, angle: float) -> float:
        """Return how far the wall of the square room is; infinite where the base is outside."""
        if max(abs(self._x), abs(self._y)) > _WALL_METRES:
            return math.inf
        beams = (self._x, math.cos(angle)), (self._y, math.sin(angle))
        return min(
            (_WALL_METRES - at * math.copysign(1, step)) / abs(step or 1e-9) for at, step in beams
        )


def _length(path: list[tuple[float, float]]) -> float:
    return sum(math.dist(start, end) for start, end in pairwise(path))


def main() -> None:
    """Serve /navigate_to_pose until interrupted."""
    rclpy.init(signal_handler_options=SignalHandlerOptions.NO)
    executor = MultiThreadedExecutor(num_threads=4)
    base = Base()
    executor.add_node(base.node)
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, signal.default_int_handler)
    with suppress(KeyboardInterrupt):
        print("driving on /navigate_to_pose", flush=True)
        while True:
            executor.spin_once(timeout_sec=0.2)
    base.end()  # or this process would go on until the goal is reached
    executor.shutdown(timeout_sec=_PLAN_SECONDS)
    rclpy.shutdown()


if __name__ == "__main__":
    try:
        main()
    except OSError as failure:  # what it prints is read no more, as by `head`, or a disk is full
        if not isinstance(failure, BrokenPipeError):
            print(failure.strerror or failure, file=sys.stderr)
        os._exit(1)
