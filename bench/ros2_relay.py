"""One ROS 2 topic to another: through uoarm, natively linked, and through a bare rclpy node.

Each relay is a process of its own; the client publishes and listens in this one.
"""

from __future__ import annotations

import os
import sys
import threading
import time
from contextlib import suppress
from typing import Any

from bench._ros_relays import RELAYS, relay
from bench.tables import microseconds, print_table, row
from bench.turns import module, running

SIZES = {"100 B": 100, "1 KB": 1_000, "1 MB": 1_000_000}
ROUNDS = {100: 2000, 1_000: 2000, 1_000_000: 300}
BURST = {100: 5000, 1_000: 5000, 1_000_000: 100}
ALL = ("a bare rclpy relay", *RELAYS)
DEPTH = 100  # more than is ever under way; of octets a bridge keeps five by itself
SILENCE_SECONDS = 20.0
KIND = "std_msgs/msg/UInt8MultiArray"


def main() -> int:
    """Print the tables; 0 also when there is no ROS 2 to measure."""
    os.environ["ROS_AUTOMATIC_DISCOVERY_RANGE"] = "LOCALHOST"
    os.environ["ROS_DOMAIN_ID"] = str(20 + os.getpid() % 80)
    try:
        import rclpy  # noqa: F401, PLC0415
        import uoarm_ros2  # noqa: F401, PLC0415
    except ImportError as error:
        print(f"no relay table: {error}", file=sys.stderr)
        return 0
    times: list[tuple[str, ...]] = []
    rates: list[tuple[str, ...]] = []
    for number, name in enumerate(ALL):
        with running(module("bench.ros2_relay", name, str(number))):
            _measure(name, number, times, rates)
    print_table("ROS 2 relay, round trip (us)", ("relay", "median", "p99", "size"), times)
    print_table("ROS 2 relay, one way, reliable", ("relay", "messages/s", "size"), rates)
    return 0


def _measure(
    name: str, number: int, times: list[tuple[str, ...]], rates: list[tuple[str, ...]]
) -> None:
    import rclpy  # noqa: PLC0415
    from rclpy.node import Node  # noqa: PLC0415
    from rclpy.qos import HistoryPolicy, QoSProfile  # noqa: PLC0415
    from std_msgs.msg import UInt8MultiArray  # noqa: PLC0415

    rclpy.init(args=[])
    node = Node(f"client_{number}")
    qos = QoSProfile(depth=100, history=HistoryPolicy.KEEP_ALL)
    seen = [0]

    def take(_: Any) -> None:
        seen[0] += 1

    node.create_subscription(UInt8MultiArray, f"/there_{number}", take, qos)
    publisher = node.create_publisher(UInt8MultiArray, f"/here_{number}", qos)
    deadline = time.monotonic() + 20.0
    ready = UInt8MultiArray(data=b"0")
    while not seen[0]:
        if time.monotonic() > deadline:
            raise RuntimeError(f"{name} passes nothing")
        publisher.publish(ready)
        rclpy.spin_once(node, timeout_sec=0.2)
    for label, size in SIZES.items():
        message = UInt8MultiArray(data=bytes(size))
        times.append(
            (*row(name, _round_trips(node, publisher, message, seen, ROUNDS[size]))[:3], label)
        )
        rates.append((name, f"{_burst(node, publisher, message, seen, BURST[size]):,.0f}", label))
    rclpy.shutdown()


def _round_trips(
    node: Any, publisher: Any, message: Any, seen: list[int], rounds: int
) -> list[float]:
    import rclpy  # noqa: PLC0415

    while rclpy.spin_once(node, timeout_sec=0.2) or seen[0] < 0:
        pass

    def trip() -> None:
        before = seen[0]
        publisher.publish(message)
        _spin_until_more(node, seen, before)

    return microseconds(trip, repeat=rounds)


def _burst(node: Any, publisher: Any, message: Any, seen: list[int], count: int) -> float:
    start, before, sent = time.perf_counter(), seen[0], 0
    while seen[0] - before < count:
        # A window of 50 under way: enough to keep the relay busy, and none is ever refused.
        while sent < count and sent - (seen[0] - before) < 50:
            publisher.publish(message)
            sent += 1
        _spin_until_more(node, seen, seen[0])
    return count / (time.perf_counter() - start)


def _spin_until_more(node: Any, seen: list[int], before: int) -> None:
    import rclpy  # noqa: PLC0415

    deadline = time.monotonic() + SILENCE_SECONDS
    while seen[0] == before:
        if time.monotonic() > deadline:
            raise RuntimeError("a message was lost on the way")
        rclpy.spin_once(node, timeout_sec=1.0)


def relay_by_hand(here: str, there: str) -> None:
    import rclpy  # noqa: PLC0415
    from rclpy.executors import ExternalShutdownException  # noqa: PLC0415
    from rclpy.node import Node  # noqa: PLC0415
    from rclpy.qos import HistoryPolicy, QoSProfile  # noqa: PLC0415
    from std_msgs.msg import UInt8MultiArray  # noqa: PLC0415

    rclpy.init(args=[])
    node = Node("relay")
    qos = QoSProfile(depth=100, history=HistoryPolicy.KEEP_ALL)
    publisher = node.create_publisher(UInt8MultiArray, there, qos)
    node.create_subscription(UInt8MultiArray, here, publisher.publish, qos)
    ended = threading.Thread(target=lambda: (sys.stdin.read(), rclpy.shutdown()), daemon=True)
    ended.start()
    with suppress(KeyboardInterrupt, ExternalShutdownException):
        rclpy.spin(node)


def _relay(name: str, number: str) -> None:
    here, there = f"/here_{number}", f"/there_{number}"
    if name == ALL[0]:
        relay_by_hand(here, there)
        return
    options = ({"qos": {"history": "keep_all"}}, {"qos": {"depth": DEPTH}})
    relay(name, "ros2", ((here, KIND), (there, KIND)), options, {"map": {"data": "data"}})


if __name__ == "__main__":
    if len(sys.argv) > 1:
        _relay(*sys.argv[1:])
    else:
        sys.exit(main())
