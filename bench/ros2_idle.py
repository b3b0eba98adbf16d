"""What a ROS 2 bridge costs while many topics are open: CPU time, and messages that arrive.

A world in a process of its own has a hundred idle topics and a busy one; the listeners, one after
another in processes of their own, subscribe to all of them.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

from bench.tables import print_table, spread
from bench.turns import module, running

SECONDS = 5.0
SETTLE_SECONDS = 3.0
TOPICS = [f"/bench/t{number}" for number in range(100)]
BUSY, HERTZ = "/bench/hz200", 200
Take = Callable[[str], object]


def main() -> int:
    """Print the table; 0 also when there is no ROS 2 to measure."""
    os.environ["ROS_AUTOMATIC_DISCOVERY_RANGE"] = "LOCALHOST"
    os.environ.setdefault("ROS_DOMAIN_ID", str(20 + os.getpid() % 80))
    try:
        import rclpy  # noqa: F401, PLC0415
        import uoarm_ros2  # noqa: F401, PLC0415
    except ImportError as error:
        print(f"no table of idle topics: {error}", file=sys.stderr)
        return 0
    rows = []
    with running(module("bench._ros2_world", str(len(TOPICS)))) as world:
        world.said("(ready)")
        for listener in LISTENERS:
            words = module("bench.ros2_idle", listener)
            done = subprocess.run(words, check=True, stdout=subprocess.PIPE, timeout=120)
            rows.append((listener, *json.loads(done.stdout)))
    columns = ("listener", "CPU %", "CPU us a message", "came %", "age us, median / p99")
    print_table(f"ROS 2: {len(TOPICS)} idle topics beside one at {HERTZ} Hz", columns, rows)
    return 0


def listen(listener: str) -> None:
    """Be a listener for a while, and print its row."""
    ages: list[float] = []

    def take(text: str) -> None:
        sent = text[:64].split(" ")
        if len(sent) > 1:  # not of an idle topic
            ages.append((time.monotonic_ns() - int(sent[1])) / 1000)

    with LISTENERS[listener](take):
        time.sleep(SETTLE_SECONDS)
        ages.clear()
        cpu, clock = time.process_time(), time.monotonic()
        time.sleep(SECONDS)
        cpu, clock = time.process_time() - cpu, time.monotonic() - clock
        came = list(ages)
    figures = 100 * cpu / clock, 1e6 * cpu / len(came), 100 * len(came) / HERTZ / clock
    print(json.dumps([*(f"{figure:.1f}" for figure in figures), spread(came)]))


@contextmanager
def _by_hand(take: Take) -> Iterator[None]:
    """Subscribe with rclpy's own executor."""
    import rclpy  # noqa: PLC0415
    from rclpy.executors import SingleThreadedExecutor  # noqa: PLC0415
    from rclpy.node import Node  # noqa: PLC0415
    from std_msgs.msg import String  # noqa: PLC0415

    rclpy.init(args=[])
    node = Node("listener")
    for topic in (*TOPICS, BUSY):
        node.create_subscription(String, topic, lambda message: take(message.data), 100)
    executor = SingleThreadedExecutor()
    executor.add_node(node)
    ended = threading.Event()

    def spin() -> None:
        while not ended.is_set():
            executor.spin_once(timeout_sec=0.5)

    spinning = threading.Thread(target=spin)
    spinning.start()
    yield
    ended.set()
    spinning.join()
    rclpy.shutdown()


@contextmanager
def _by_bridge(take: Take) -> Iterator[None]:
    """Open every topic as a source of the bridge."""
    from uoarm.bridge import Registry  # noqa: PLC0415
    from uoarm.model import BridgeSpec, Endpoint, Role  # noqa: PLC0415

    def taken(message: Any) -> None:
        take(message["data"])

    bridge = Registry().create(BridgeSpec("ros", "ros2", {"settle": 0}))
    for topic in (*TOPICS, BUSY):
        at = Endpoint("ros", topic, Role.OUTPUT, (topic, "std_msgs/msg/String"))
        structure = bridge.describe(at).message
        assert structure is not None
        bridge.open_source(at, structure, taken)
    yield
    bridge.close()


LISTENERS = {"a bare rclpy executor": _by_hand, "uoarm bridge": _by_bridge}

if __name__ == "__main__":
    if sys.argv[1:]:
        listen(sys.argv[1])
    else:
        sys.exit(main())
