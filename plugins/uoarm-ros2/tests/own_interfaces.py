"""A node that talks claw_msgs, which were built and installed: plain rclpy, knowing no uoarm."""

from __future__ import annotations

import signal
import sys
from typing import Any

import rclpy
from arm_msgs.msg import Joint
from claw_msgs.action import Squeeze
from claw_msgs.msg import Grip
from claw_msgs.srv import Take
from rclpy.action import ActionServer
from rclpy.qos import DurabilityPolicy, QoSProfile
from rclpy.signals import SignalHandlerOptions


def take(request: Any, response: Any) -> Any:
    response.success = request.wanted.force > 1
    response.message = request.wanted.joints[0].labels[0]
    return response


def squeeze(goal: Any) -> Any:
    goal.publish_feedback(Squeeze.Feedback(force=goal.request.force / 2))
    goal.succeed()
    return Squeeze.Result(done=True)


def main() -> None:
    rclpy.init(signal_handler_options=SignalHandlerOptions.NO)
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    node = rclpy.create_node("claw")
    latched = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
    publisher = node.create_publisher(Grip, "/grip", latched)
    joint = Joint(angles=[1.0, 2.0, 3.0], labels=["elbow"])
    publisher.publish(Grip(force=2.5, joints=[joint], wide="ü"))
    node.create_service(Take, "/take", take)
    server = ActionServer(node, Squeeze, "/squeeze", squeeze)
    sys.stdout.write("ready\n")
    sys.stdout.flush()
    try:
        while True:
            rclpy.spin_once(node, timeout_sec=0.2)
    except KeyboardInterrupt:
        pass
    finally:
        server.destroy()
        node.destroy_node()


if __name__ == "__main__":
    main()
