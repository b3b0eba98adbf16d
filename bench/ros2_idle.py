"""What a ROS 2 bridge costs while many topics are open: CPU time, and messages that arrive.

A talker in a process of its own has a hundred idle topics and a busy one; the listeners, one after
another in processes of their own, subscribe to all of them.
"""

from __future__ import annotations

import os
import subprocess
import sys
import threading
import time
from typing import Any

from bench.tables import print_table

DOMAIN = str(20 + os.getpid() % 80)
SECONDS = 5.0
CASES = {  # label: idle topics, messages a second, type
    "100 idle topics, String at 200 Hz": (100, 200, "std_msgs/msg/String"),
    "Imu at 500 Hz alone": (0, 500, "sensor_msgs/msg/Imu"),
    "Odometry at 500 Hz alone": (0, 500, "nav_msgs/msg/Odometry"),
}
LISTENERS = ("a bare rclpy executor", "uoarm bridge")


def main() -> int:
    """Print the table; 0 also when there is no ROS 2 to measure."""
    os.environ["ROS_AUTOMATIC_DISCOVERY_RANGE"] = "LOCALHOST"
    os.environ.setdefault("ROS_DOMAIN_ID", DOMAIN)
    try:
        import rclpy  # noqa: F401, PLC0415
        import uoarm_ros2  # noqa: F401, PLC0415
    except ImportError as error:
        print(f"no table of idle topics: {error}", file=sys.stderr)
        return 0
    rows = []
    for case in CASES:
        talker = [sys.executable, "-m", "bench.ros2_idle", "talk", case]
        with subprocess.Popen(talker, stdin=subprocess.PIPE) as process:
            for listener in LISTENERS:
                command = [sys.executable, "-m", "bench.ros2_idle", listener, case]
                done = subprocess.run(
                    command, check=True, capture_output=True, text=True, timeout=120
                )
                rows.append((case, listener, *done.stdout.split()))
            process.communicate(timeout=20)
    columns = ("case", "listener", "CPU %", "CPU us a message", "came %", "p50 us", "p99 us")
    print_table("ROS 2: open topics", columns, rows)
    return 0


def native_type(name: str) -> Any:
    from uoarm_ros2._types import import_type  # noqa: PLC0415

    return import_type(name)


def stamped(message: Any, now: int) -> Any:
    """Put the time into a message, wherever it has room for one."""
    if hasattr(message, "header"):
        message.header.stamp.sec, message.header.stamp.nanosec = divmod(now, 10**9)
    else:
        message.data = str(now)
    return message


def talk(case: str) -> None:
    """Publish at a steady rate until standard input ends."""
    import rclpy  # noqa: PLC0415
    from rclpy.node import Node  # noqa: PLC0415

    idle, hertz, kind = CASES[case]
    rclpy.init(args=[])
    node, native = Node("talker"), native_type(kind)
    _kept = [node.create_publisher(native, f"/idle_{index}", 10) for index in range(idle)]
    publisher = node.create_publisher(native, "/busy", 100)
    ended = threading.Event()
    threading.Thread(target=_end_with_input, args=(ended,), daemon=True).start()
    message, due = native(), time.monotonic()
    while not ended.is_set():
        publisher.publish(stamped(message, time.monotonic_ns()))
        due += 1 / hertz
        time.sleep(max(0.0, due - time.monotonic()))
    rclpy.shutdown()


def _end_with_input(ended: threading.Event) -> None:
    sys.stdin.read()
    ended.set()


class Meter:
    """Counts what comes, and how long it was under way, once it is started."""

    def __init__(self) -> None:
        self.delays: list[int] = []
        self.started = False

    def take(self, sent: int) -> None:
        """Note one message by the time at which it left."""
        if self.started:
            self.delays.append(time.monotonic_ns() - sent)

    def run(self, hertz: int) -> None:
        """Measure for a while and print one row."""
        time.sleep(3.0)
        self.started = True
        cpu, clock = time.process_time(), time.monotonic()
        time.sleep(SECONDS)
        cpu, clock = time.process_time() - cpu, time.monotonic() - clock
        self.started = False
        delays, expected = sorted(self.delays), hertz * clock
        print(
            f"{100 * cpu / clock:.1f}",
            f"{1e6 * cpu / len(delays):.0f}",
            f"{100 * len(delays) / expected:.1f}",
            f"{delays[len(delays) // 2] / 1000:.0f}",
            f"{delays[len(delays) * 99 // 100] / 1000:.0f}",
            flush=True,
        )


def listen_by_hand(case: str) -> None:
    """Subscribe with rclpy's own executor."""
    import rclpy  # noqa: PLC0415
    from rclpy.executors import SingleThreadedExecutor  # noqa: PLC0415
    from rclpy.node import Node  # noqa: PLC0415

    idle, hertz, kind = CASES[case]
    rclpy.init(args=[])
    node, native, meter = Node("listener"), native_type(kind), Meter()

    def take(message: Any) -> None:
        if hasattr(message, "header"):
            stamp = message.header.stamp
            meter.take(stamp.sec * 10**9 + stamp.nanosec)
        else:
            meter.take(int(message.data))

    for index in range(idle):
        node.create_subscription(native, f"/idle_{index}", take, 10)
    node.create_subscription(native, "/busy", take, 100)
    executor = SingleThreadedExecutor()
    executor.add_node(node)

    ended = threading.Event()

    def spin() -> None:
        while not ended.is_set():
            executor.spin_once(timeout_sec=0.5)

    spinning = threading.Thread(target=spin)
    spinning.start()
    meter.run(hertz)
    ended.set()
    spinning.join()
    rclpy.shutdown()


def listen_by_bridge(case: str) -> None:
    """Open every topic as a source of the bridge."""
    from uoarm.bridge import Registry  # noqa: PLC0415
    from uoarm.model import BridgeSpec, Endpoint, Role  # noqa: PLC0415

    idle, hertz, kind = CASES[case]
    bridge, meter = Registry().create(BridgeSpec("ros", "ros2", {"settle": 0})), Meter()

    def take(message: Any) -> None:
        if "header" in message:
            stamp = message["header"]["stamp"]
            meter.take(stamp["sec"] * 10**9 + stamp["nanosec"])
        else:
            meter.take(int(message["data"]))

    for topic in (*(f"/idle_{index}" for index in range(idle)), "/busy"):
        at = Endpoint("ros", topic, Role.OUTPUT, (topic, kind))
        structure = bridge.describe(at).message
        assert structure is not None
        bridge.open_source(at, structure, take)
    meter.run(hertz)
    bridge.close()


if __name__ == "__main__":
    if len(sys.argv) == 1:
        sys.exit(main())
    role, case = sys.argv[1:]
    {"talk": talk, LISTENERS[0]: listen_by_hand, LISTENERS[1]: listen_by_bridge}[role](case)
