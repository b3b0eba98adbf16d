"""What a ROS 2 bridge costs that only looks at a large graph: its start, and what it uses idle.

Fifty nodes with four topics each stand in a process of their own; the observers, one after another
in processes of their own, see all of them and then do nothing.

And how long a graph that is not complete yet stands still: twelve nodes in twelve processes, seen
by a bare node time and again. A listing that ended once nothing has changed for that long would
lack what came after.
"""

from __future__ import annotations

import os
import statistics
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path

from bench.tables import print_table

NODES, TOPICS = 50, 4
SECONDS = 10.0
MOST_SECONDS = 60.0
OBSERVERS = ("a bare rclpy node", "uoarm bridge")
PROCESSES, STARTS = 12, 20
APART_TOPICS = 10


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
    with crowds(1, NODES, TOPICS):
        rows = [(observer, *observed(observer)) for observer in OBSERVERS * 2]
    columns = ("observer", "all seen after s", "idle CPU %", "memory MiB")
    print_table(f"ROS 2: {NODES} nodes with {NODES * TOPICS} topics", columns, rows)
    with crowds(PROCESSES, 1, APART_TOPICS):
        seen = [tuple(map(float, observed("changes"))) for _ in range(STARTS)]
    seen_after, stood_still = zip(*seen, strict=True)
    summed = [
        ("all seen after s", *summary(seen_after)),
        ("stood still before that for s", *summary(stood_still)),
    ]
    columns = (f"{STARTS} starts", "median", "most", "more than 1 s")
    print_table(f"ROS 2: {PROCESSES} processes, a bare rclpy node looks", columns, summed)
    return 0


def summary(times: Sequence[float]) -> tuple[str, str, str]:
    """Return the median, the most, and how many are more than a second."""
    return (
        f"{statistics.median(times):.2f}",
        f"{max(times):.2f}",
        str(sum(one > 1 for one in times)),
    )


@contextmanager
def crowds(processes: int, nodes: int, topics: int) -> Iterator[None]:
    """Start processes with so many nodes each, with so many topics each, and end them."""
    with ExitStack() as stack:
        started = []
        for number in range(processes):
            words = ["crowd", str(number), str(nodes), str(topics)]
            command = [sys.executable, "-m", "bench.ros2_graph", *words]
            made = subprocess.Popen(
                command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
            )
            started.append(stack.enter_context(made))
        for one in started:
            assert one.stdout is not None
            one.stdout.readline()
        yield
        for one in started:
            one.communicate("", timeout=60)


def observed(observer: str) -> list[str]:
    """Return what an observer in a process of its own prints."""
    command = [sys.executable, "-m", "bench.ros2_graph", observer]
    done = subprocess.run(command, check=True, capture_output=True, text=True, timeout=300)
    return done.stdout.split()


def crowd(number: str, nodes: int, topics: int) -> None:
    """Be so many nodes until standard input ends."""
    import rclpy  # noqa: PLC0415
    from rclpy.node import Node  # noqa: PLC0415
    from std_msgs.msg import String  # noqa: PLC0415

    rclpy.init(args=[])
    kept = []
    for each in range(nodes):
        name = f"{number}_{each}"
        node = Node(f"node_{name}")
        kept += [node.create_publisher(String, f"/t_{name}_{one}", 10) for one in range(topics)]
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


def observe_changes() -> None:
    """See twelve processes; print when the last of them was, and how long nothing changed before.

    The wait for the first sight of anything does not count: nobody would take that for complete.
    """
    import rclpy  # noqa: PLC0415
    from rclpy.node import Node  # noqa: PLC0415

    rclpy.init(args=[])
    began = time.monotonic()
    node = Node("observer")
    before, changed, still = (0, 0, 0), began, 0.0
    nodes, topics = PROCESSES + 1, 0
    while before[0] < nodes or topics < PROCESSES * APART_TOPICS:
        assert time.monotonic() - began < MOST_SECONDS
        names = node.get_topic_names_and_types()
        topics = sum(name.startswith("/t_") for name, _ in names)
        listed = len(node.get_node_names()), len(names), len(node.get_service_names_and_types())
        now = time.monotonic()
        if listed != before:
            still = max(still, now - changed if before[0] > 1 else 0.0)
            before, changed = listed, now
        time.sleep(0.005)
    print(f"{changed - began:.3f} {still:.3f}", flush=True)
    rclpy.shutdown()


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
    if sys.argv[1:2] == ["crowd"]:
        crowd(sys.argv[2], int(sys.argv[3]), int(sys.argv[4]))
    elif sys.argv[1:] == ["changes"]:
        observe_changes()
    elif sys.argv[1:]:
        observe_by_hand() if sys.argv[1] == OBSERVERS[0] else observe_with_uoarm()
    else:
        raise SystemExit(main())
