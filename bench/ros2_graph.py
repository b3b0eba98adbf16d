"""What a ROS 2 bridge costs that only looks at a large graph: its start, and what it uses idle.

Fifty nodes with four topics each stand in a process of their own; the observers, one after another
in processes of their own, see all of them and then do nothing.
"""

from __future__ import annotations

import os
import subprocess
import sys
import time
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path

from bench.tables import print_table

NODES, TOPICS = 50, 4
SECONDS = 10.0
MOST_SECONDS = 60.0
OBSERVERS = ("a bare rclpy node", "uoarm bridge")


def main() -> int:
    """Print the table; 0 also when there is no ROS 2 to measure."""
    os.environ["ROS_AUTOMATIC_DISCOVERY_RANGE"] = "LOCALHOST"
    os.environ.setdefault("ROS_DOMAIN_ID", str(20 + os.getpid() % 80))
    try:
        import rclpy  # noqa: F401, PLC0415
        import uoarm_ros2  # noqa: F401, PLC0415
    except ImportError as error:
        print(f"no table of large graphs: {error}", file=sys.stderr)
        return 0
    rows = []
    crowd = [sys.executable, "-m", "bench.ros2_graph", "crowd"]
    with subprocess.Popen(crowd, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as all_:
        assert all_.stdout is not None
        all_.stdout.readline()
        for observer in OBSERVERS * 2:
            command = [sys.executable, "-m", "bench.ros2_graph", observer]
            done = subprocess.run(command, check=True, capture_output=True, text=True, timeout=300)
            rows.append((observer, *done.stdout.split()))
        all_.communicate("", timeout=60)
    columns = ("observer", "all seen after s", "idle CPU %", "memory MiB")
    print_table(f"ROS 2: {NODES} nodes with {NODES * TOPICS} topics", columns, rows)
    return 0


def crowd() -> None:
    """Be fifty nodes until standard input ends."""
    import rclpy  # noqa: PLC0415
    from rclpy.node import Node  # noqa: PLC0415
    from std_msgs.msg import String  # noqa: PLC0415

    rclpy.init(args=[])
    kept = []
    for number in range(NODES):
        node = Node(f"node_{number}")
        kept += [node.create_publisher(String, f"/t_{number}_{each}", 10) for each in range(TOPICS)]
    print("ready", flush=True)
    sys.stdin.read()
    rclpy.shutdown()


def observe_by_hand() -> None:
    """See the graph with a node of rclpy, spun by an executor."""
    import threading  # noqa: PLC0415

    import rclpy  # noqa: PLC0415
    from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor  # noqa: PLC0415
    from rclpy.node import Node  # noqa: PLC0415

    began = time.monotonic()
    rclpy.init(args=[])
    node = Node("observer")
    executor = SingleThreadedExecutor()
    executor.add_node(node)

    def spin() -> None:
        with suppress(ExternalShutdownException):
            executor.spin()

    thread = threading.Thread(target=spin)
    thread.start()
    measure(began, lambda: sum(n.startswith("/t_") for n, _ in node.get_topic_names_and_types()))
    rclpy.shutdown()
    thread.join()


def observe_with_uoarm() -> None:
    """See the graph with a bridge."""
    from uoarm.bridge import Registry  # noqa: PLC0415
    from uoarm.model import BridgeSpec  # noqa: PLC0415

    began = time.monotonic()
    bridge = Registry().create(BridgeSpec("ros", "ros2", {}))
    measure(
        began,
        lambda: sum(
            at.address[0].startswith("/t_")
            for each in bridge.discover(timeout=MOST_SECONDS)
            for at, _ in each.endpoints
        ),
    )
    bridge.close()


def measure(began: float, seen: Callable[[], int]) -> None:
    """Wait until all topics are seen, then measure what idling takes, and print one row."""
    while seen() < NODES * TOPICS:
        assert time.monotonic() - began < MOST_SECONDS
        time.sleep(0.02)
    all_seen = time.monotonic() - began
    time.sleep(3.0)
    cpu, clock = time.process_time(), time.monotonic()
    time.sleep(SECONDS)
    share = 100 * (time.process_time() - cpu) / (time.monotonic() - clock)
    pages = int(Path("/proc/self/statm").read_text().split()[1])
    memory = pages * os.sysconf("SC_PAGE_SIZE") / 2**20
    print(f"{all_seen:.2f} {share:.2f} {memory:.0f}", flush=True)


if __name__ == "__main__":
    if sys.argv[1:] == ["crowd"]:
        crowd()
    elif sys.argv[1:]:
        observe_by_hand() if sys.argv[1] == OBSERVERS[0] else observe_with_uoarm()
    else:
        raise SystemExit(main())
