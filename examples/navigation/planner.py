"""A planner as a ROS 2 node: `grid` goes along the axes, `straight` as the crow flies."""

from __future__ import annotations

import signal

if __name__ == "__main__":  # an import may lose what Ctrl-C raises
    signal.signal(signal.SIGINT, signal.SIG_DFL)

import argparse
import os
import sys
from contextlib import suppress

import rclpy
from geometry_msgs.msg import PoseStamped
from nav_msgs.srv import GetPlan
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions


def _pose(x: float, y: float) -> PoseStamped:
    pose = PoseStamped()
    pose.header.frame_id = "map"
    pose.pose.position.x, pose.pose.position.y, pose.pose.orientation.w = x, y, 1.0
    return pose


def main() -> None:
    """Answer on /KIND/plan until interrupted."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("kind", choices=("grid", "straight"))
    kind = parser.parse_args().kind
    rclpy.init(signal_handler_options=SignalHandlerOptions.NO)
    node = Node(f"{kind}_planner")

    def plan(request: GetPlan.Request, response: GetPlan.Response) -> GetPlan.Response:
        start, goal = request.start.pose.position, request.goal.pose.position
        response.plan.header.frame_id = "map"
        corner = [_pose(goal.x, start.y)] if kind == "grid" else []
        response.plan.poses = [_pose(start.x, start.y), *corner, _pose(goal.x, goal.y)]
        return response

    node.create_service(GetPlan, f"/{kind}/plan", plan)
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, signal.default_int_handler)
    with suppress(KeyboardInterrupt):
        print(f"planning on /{kind}/plan", flush=True)
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
