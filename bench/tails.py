"""Where messages wait: each stage of a message's way, and what the slowest ones waited for there.

`python -m bench.tails` sends numbered messages from a thread of a Python source through a function
to the application, and with `--ros2` from an rclpy node in a process of its own. Each stage is one
of: work in one thread, or a wake-up of the next thread. What a stage takes is divided in three:

- processor: time for which its thread ran;
- machine: time for which it could have run and the kernel ran others (`/proc/*/schedstat`, Linux);
- waiting: the rest. In a stage of work that is the interpreter lock; in a wake-up the lock, the
  condition on which it waited, or the framework.

So what is ours (processor, waiting) stands apart from what the machine does (machine). `--busy`
starts threads that keep the interpreter busy in this process, `--switch` sets the interpreter's
switch interval and `--freeze` takes what exists out of the way of garbage collection.
"""

from __future__ import annotations

import argparse
import gc
import itertools
import os
import subprocess
import sys
import threading
import time
from collections import defaultdict
from collections.abc import Callable, Iterator, Mapping
from functools import wraps
from pathlib import Path
from typing import Any, TypedDict

from attrs import frozen

import uoarm
from bench.tables import at, print_table
from uoarm._dataplane import Inbox, Outlet, Route
from uoarm.config import loads

WARM_UP = 100
PYTHON = """
version: 1
bridges: {python: {}}
functions:
  numbers:
    components: [{name: numbers, bridge: python, output: {endpoint: ["bench.tails:numbers"]}}]
  answer:
    components:
      - {name: passes, bridge: python, input: {from: numbers, endpoint: ["bench.tails:pass_on"],
         queue: {length: 100}}, output: {endpoint: ["bench.tails:pass_on"]}}
"""
ROS2 = """
version: 1
bridges: {ros: {plugin: ros2}}
functions:
  answer: {components: [{name: talker, bridge: ros, output: {endpoint: [/bench/tails]}}]}
"""


class Numbered(TypedDict):
    """A message that says when it was made, in nanoseconds of the monotonic clock."""

    data: str


@frozen
class Stamp:
    """One point on a message's way.

    Attributes:
        point: its name.
        time: nanoseconds, as the two below.
        cpu: that its thread has had.
        delay: for which its thread has waited for a processor.
        thread: in which it was passed.
    """

    point: str
    time: int
    cpu: int
    delay: int
    thread: int


@frozen
class Stage:
    """What one message took from one point to the next, in microseconds.

    Attributes:
        name: of the two points.
        wall: in all.
        processor: for which its thread ran.
        machine: for which its thread could have run.
    """

    name: str
    wall: float
    processor: float
    machine: float

    @property
    def waiting(self) -> float:
        """Microseconds that neither its thread nor others of the machine ran."""
        return max(0.0, self.wall - self.processor - self.machine)


class Recorder:
    """Stamps of messages by number. `passed` may be called from any thread."""

    def __init__(self) -> None:
        self._stamps: dict[int, list[Stamp]] = defaultdict(list)
        self._last = threading.local()

    def passed(self, point: str, message: Any) -> None:
        """Note that a message has come to a point, in the calling thread."""
        number, _, made = message["data"].partition(" ")
        if not self._stamps[int(number)]:
            self._stamps[int(number)].append(Stamp("made", int(made), 0, 0, 0))
        file = getattr(self._last, "file", None)
        if file is None:
            path = f"/proc/self/task/{threading.get_native_id()}/schedstat"
            file = self._last.file = os.open(path, os.O_RDONLY)
        cpu, delay, _ = os.pread(file, 100, 0).split()
        thread = threading.get_ident()
        self._stamps[int(number)].append(
            Stamp(point, time.monotonic_ns(), int(cpu), int(delay), thread)
        )

    def messages(self, points: int) -> Iterator[tuple[Stage, ...]]:
        """Yield the stages of each message that passed all points, after the first hundred."""
        last: dict[int, Stamp] = {}
        for number in sorted(self._stamps):
            stamps = self._stamps[number]
            if len(stamps) == points and number > WARM_UP:
                yield tuple(
                    _stage(before, after, last.get(after.thread))
                    for before, after in itertools.pairwise(stamps)
                )
            last.update((stamp.thread, stamp) for stamp in stamps)


def _stage(before: Stamp, after: Stamp, last: Stamp | None) -> Stage:
    """Divide the time between two points; `last` is what the second thread passed before."""
    wall = after.time - before.time
    since = before if before.thread == after.thread else last
    cpu = delay = 0
    if since is not None:
        cpu = after.cpu - since.cpu if since is before else 0
        delay = after.delay - since.delay
    return Stage(f"{before.point} -> {after.point}", wall / 1e3, cpu / 1e3, min(wall, delay) / 1e3)


def watched(recorder: Recorder) -> None:
    """Have the data plane report where messages are."""

    def before(kind: type, name: str, point: Callable[[Any], str]) -> None:
        inner = getattr(kind, name)

        @wraps(inner)
        def call(self: Any, message: Any) -> Any:
            recorder.passed(point(self), message)
            return inner(self, message)

        setattr(kind, name, call)

    before(Outlet, "deliver", lambda _: "in an output")
    before(Route, "_hand_over", lambda route: f"handed to {route.consumer.partition('#')[0]}")
    before(Inbox, "put", lambda _: "in the inbox")


def numbers() -> Iterator[Numbered]:
    """Emit numbered messages at the rate that the environment asks for."""
    period = 1 / float(os.environ["BENCH_HERTZ"])
    due = time.monotonic()
    for number in range(int(os.environ["BENCH_MESSAGES"])):
        due += period
        time.sleep(max(0.0, due - time.monotonic()))
        yield {"data": f"{number} {time.monotonic_ns()}"}


def pass_on(message: Numbered) -> Numbered:
    return message


def talk() -> None:
    """Publish numbered messages with rclpy, in a process of its own."""
    import rclpy  # noqa: PLC0415
    from std_msgs.msg import String  # noqa: PLC0415

    rclpy.init()
    publisher = rclpy.create_node("tails").create_publisher(String, "/bench/tails", 100)
    while not publisher.get_subscription_count():
        time.sleep(0.01)
    for message in numbers():
        publisher.publish(String(data=message["data"]))
    time.sleep(1)
    rclpy.try_shutdown()


def measure(chosen: argparse.Namespace) -> list[tuple[Stage, ...]]:
    """Return the stages of each message of one run."""
    recorder = Recorder()
    watched(recorder)
    robot = loads(ROS2 if chosen.ros2 else PYTHON, origin=str(Path(__file__)))
    seen: list[Mapping[str, Any]] = []
    arguments = [sys.executable, "-m", "bench.tails", "--talk"]
    talker = subprocess.Popen(arguments, stdin=subprocess.DEVNULL) if chosen.ros2 else None
    try:
        with uoarm.RobotManager(robot) as manager:
            connection = manager.request("answer")
            if chosen.freeze:
                gc.freeze()
            while not seen or int(seen[-1]["data"].split()[0]) < chosen.messages - 1:
                seen.append(connection.get(30))
                recorder.passed("with the application", seen[-1])
    except uoarm.errors.UoarmError as error:
        print(f"it ended early: {error}", file=sys.stderr)
    finally:
        if talker is not None:
            talker.terminate()
            talker.wait(20)
    counts = [len(stamps) for stamps in recorder._stamps.values()]  # noqa: SLF001 - its own module
    return list(recorder.messages(max(counts, key=counts.count)))


def main() -> int:
    """Print the tables."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawTextHelpFormatter
    )
    parser.add_argument("--ros2", action="store_true", help="from an rclpy node")
    parser.add_argument("--hertz", type=float, default=200.0)
    parser.add_argument("--messages", type=int, default=2000)
    parser.add_argument("--busy", type=int, default=0, help="threads that compute in this process")
    parser.add_argument("--switch", type=float, default=5.0, help="switch interval, ms")
    parser.add_argument("--freeze", action="store_true", help="gc.freeze() once it is open")
    parser.add_argument("--talk", action="store_true", help=argparse.SUPPRESS)
    chosen = parser.parse_args()
    os.environ.setdefault("BENCH_HERTZ", str(chosen.hertz))
    os.environ.setdefault("BENCH_MESSAGES", str(chosen.messages))
    if chosen.talk:
        talk()
        return 0
    sys.setswitchinterval(chosen.switch / 1000)
    for _ in range(chosen.busy):
        threading.Thread(target=_compute, daemon=True).start()
    _print(measure(chosen))
    print(f"\nload {os.getloadavg()[0]:.1f}, switch interval {chosen.switch:g} ms")
    return 0


def _compute() -> None:
    while True:
        sum(range(1000))


def _print(messages: list[tuple[Stage, ...]]) -> None:
    wholes = sorted(sum(stage.wall for stage in stages) for stages in messages)
    slow = at(wholes, 0.99)
    tail = [stages for stages in messages if sum(stage.wall for stage in stages) >= slow]
    rows = []
    for index, first in enumerate(messages[0]):
        walls = sorted(stages[index].wall for stages in messages)
        shares = [
            sum(getattr(stages[index], what) for stages in tail) / len(tail)
            for what in ("processor", "machine", "waiting")
        ]
        rows.append(
            (first.name, *(f"{share:,.0f}" for share in (at(walls, 0.5), at(walls, 0.99), *shares)))
        )
    rows.append(("all", f"{at(wholes, 0.5):,.0f}", f"{slow:,.0f}", "", "", ""))
    title = f"{len(messages)} messages, us; on the right the slowest {len(tail)}, on average"
    print_table(title, ("stage", "median", "p99", "processor", "machine", "waiting"), rows)


if __name__ == "__main__":
    sys.exit(main())
