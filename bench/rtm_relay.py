"""A ROS 2 topic to an RT-Component and back to another topic, end to end.

Three processes: this one publishes and listens, a manager moves the messages, a component gives
back what it gets. The component blocks in the call, so that a round trip is two hops of ROS 2, two
of CORBA and two of the manager.
"""

from __future__ import annotations

import os
import subprocess
import sys
import time
from typing import Any

from bench.tables import print_table, row

DOMAIN = str(20 + os.getpid() % 80)
ROUNDS = 2000
PAPER_US = 1000.0
CONFIGURATION = """
version: 1
bridges:
  ros: {{plugin: ros2}}
  rtm: {{plugin: rtm, options: {{nameserver: "{address}"}}}}
functions:
  asked:
    components:
      - name: asker
        bridge: ros
        output: {{endpoint: [/asked, std_msgs/msg/Int32]}}
  echo:
    components:
      - name: echo
        bridge: rtm
        input:
          from: asked
          endpoint: [Echo0.rtc, small_in]
          map: {{data: data, tm.sec: {{const: 0}}, tm.nsec: {{const: 0}}}}
        output: {{endpoint: [Echo0.rtc, small_out]}}
  answered:
    components:
      - name: answerer
        bridge: ros
        input:
          from: echo
          endpoint: [/answered, std_msgs/msg/Int32]
          map: {{data: data}}
          allow_loss: [tm]
"""


def main() -> int:
    """Print the table; 0 also when ROS 2 or omniORB is missing."""
    os.environ["ROS_AUTOMATIC_DISCOVERY_RANGE"] = "LOCALHOST"
    os.environ["ROS_DOMAIN_ID"] = DOMAIN
    try:
        import rclpy  # noqa: F401, PLC0415
        import uoarm_ros2  # noqa: F401, PLC0415
        from uoarm_rtm._nameserver import NameServer  # noqa: PLC0415
    except ImportError as error:
        print(f"no relay table: {error}", file=sys.stderr)
        return 0
    with NameServer() as names:
        peer = [sys.executable, "-m", "bench.rtm_ports", "serve", names.address]
        manager = [sys.executable, "-m", "bench.rtm_relay", names.address]
        with (
            subprocess.Popen(peer, stdin=subprocess.PIPE, stdout=subprocess.PIPE) as component,
            subprocess.Popen(manager, stdin=subprocess.PIPE) as moving,
        ):
            samples = _round_trips()
            for process in (moving, component):
                process.communicate(timeout=20)
    share = sum(each < PAPER_US for each in samples) / len(samples)
    rows = [row("topic, InPort, OutPort, topic", samples, f"{share:.1%}")]
    head = ("way", "median", "p99", "below the paper's 1 ms")
    print_table("ROS 2 to an RT-Component and back (us)", head, rows)
    return 0


def _round_trips() -> list[float]:
    import rclpy  # noqa: PLC0415
    from rclpy.node import Node  # noqa: PLC0415
    from std_msgs.msg import Int32  # noqa: PLC0415

    rclpy.init(args=[])
    node = Node("asker")
    seen = [-1]

    def take(message: Any) -> None:
        seen[0] = message.data

    node.create_subscription(Int32, "/answered", take, 10)
    publisher = node.create_publisher(Int32, "/asked", 10)
    deadline = time.monotonic() + 30.0
    while seen[0] < 0:
        if time.monotonic() > deadline:
            raise RuntimeError("nothing comes back")
        publisher.publish(Int32(data=0))
        rclpy.spin_once(node, timeout_sec=0.2)
    samples = []
    for number in range(1, ROUNDS):
        start = time.perf_counter_ns()
        publisher.publish(Int32(data=number))
        while seen[0] != number:
            rclpy.spin_once(node, timeout_sec=1.0)
        samples.append((time.perf_counter_ns() - start) / 1000)
    rclpy.shutdown()
    return sorted(samples)


def manage(address: str) -> None:
    """Be the manager until standard input ends."""
    from uoarm._control import RobotManager  # noqa: PLC0415
    from uoarm.config import loads  # noqa: PLC0415

    with (
        RobotManager(loads(CONFIGURATION.format(address=address))) as robot,
        robot.request("answered", timeout=20.0),
    ):
        sys.stdin.read()


if __name__ == "__main__":
    if len(sys.argv) > 1:
        manage(sys.argv[1])
    else:
        sys.exit(main())
