"""A desk in a process of its own, which a test commands by lines; see `test_managers_apart`."""

# ruff: noqa: T201 - it is read by its lines
from __future__ import annotations

import asyncio
import sys
import threading
from collections.abc import Iterator
from contextlib import suppress
from itertools import count, pairwise
from pathlib import Path
from typing import TypedDict

from uoarm import Connection, QueuePolicy, RobotManager
from uoarm.client import connect
from uoarm.config import loads
from uoarm.model import ConnectionStatus
from uoarm.testing import patience, wait

DESK = """
version: 1
bridges:
  far: {{plugin: remote, options: {{url: "{url}", token_file: "{token}", silence: 1, grace: 3600}}}}
functions:
  drive: {{components: [{{name: far_base, bridge: far, input: {{endpoint: [drive]}}}}]}}
  counter: {{components: [{{name: far_counter, bridge: far, output: {{endpoint: [counter]}}}}]}}
"""
BESIDE = """
version: 1
bridges:
  far: {{plugin: remote, options: {{url: "{url}", token_file: "{token}", silence: 1, grace: 1}}}}
  near: {{plugin: python}}
failover: {{return_after: 1}}
functions:
  drive:
    components:
      - {{name: far_base, bridge: far, priority: 1, input: {{endpoint: [drive]}}}}
      - {{name: near_base, bridge: near, input: {{endpoint: ["__main__:drive"]}}}}
  counter:
    components:
      - {{name: far_counter, bridge: far, priority: 1, output: {{endpoint: [counter]}}}}
      - {{name: near_counter, bridge: near, output: {{endpoint: ["__main__:counter"]}}}}
"""
driven: list[float] = []


class Speed(TypedDict):
    speed: float


class Value(TypedDict):
    value: int


def drive(command: Speed) -> None:
    driven.append(command["speed"])


def counter() -> Iterator[Value]:
    """Count downwards, unlike the robot's."""
    pace = threading.Event()
    for value in count(-1, -1):
        yield {"value": value}
        pace.wait(0.01)


def read_until_line() -> threading.Event:
    over = threading.Event()

    def wait_for_line() -> None:
        sys.stdin.readline()
        over.set()

    threading.Thread(target=wait_for_line, daemon=True).start()
    return over


def connection_status(robot: RobotManager, connection: Connection) -> ConnectionStatus:
    return next(item for item in robot.status().connections if item.id == connection.id)


def accounted_for(robot: RobotManager, connection: Connection) -> int:
    """Return how many messages of a connection were taken, or dropped and counted."""
    ended = connection_status(robot, connection).ended
    open_now = [route for route in robot.status().routes if route.producer == connection.id]
    return sum(
        route.delivered + sum(number for _, number in route.dropped)
        for route in (*ended, *open_now)
    )


def take_over(url: str, token: str) -> None:
    """Command and count beside a robot that may be cut off, until a line is read.

    Then wait until every command is accounted for, and say how often the plans were replaced, and
    how many numbers are missing where no replacement is reported.
    """
    with (
        RobotManager(loads(BESIDE.format(url=url, token=token))) as robot,
        robot.request("drive") as drive,
        robot.request("counter") as counter,
    ):
        over = read_until_line()
        numbers: list[int] = []
        sent = 0
        while not over.wait(0.05):
            drive.send({"speed": 0.5})
            sent += 1
            with suppress(TimeoutError):
                while True:
                    numbers.append(counter.get(0)["value"])
            parts = [connection_status(robot, item).components[0] for item in (drive, counter)]
            print(*parts, bool(driven), flush=True)
        wait(lambda: accounted_for(robot, drive) == sent, "a command is not accounted for")
        replaced = {gap.position for gap in counter.gaps}
        missing = sum(
            abs(after - before) - 1
            for place, (before, after) in enumerate(pairwise(numbers), 1)
            if place not in replaced
        )
        print("gaps", len(drive.gaps), len(counter.gaps), missing, flush=True)


def import_functions(url: str, token: str) -> None:
    """Renew a command and count what comes until a line is read; then say what was lost."""
    with (
        RobotManager(loads(DESK.format(url=url, token=token))) as robot,
        robot.request("drive") as drive,
        robot.request("counter", queue=QueuePolicy(100_000)) as counter,
    ):
        over = read_until_line()
        numbers: list[int] = []
        while not over.wait(0.05):
            drive.send({"speed": 0.5})
            print("breaks", dict(robot.status().bridges[0].facts)["breaks"], flush=True)
            with suppress(TimeoutError):
                while True:
                    numbers.append(counter.get(0)["value"])
        numbers.append(counter.get(patience())["value"])
        components = {item.name: item for item in robot.status().components}
        facts = dict(components["far_counter"].channels[0].facts)
        missing = numbers[-1] - numbers[0] + 1 - len(numbers)
        print("lost", missing, facts["lost_on_link"], facts["gaps"], flush=True)


async def send_lines(url: str, token: str) -> None:
    """Send a command at each line, without waiting for the answer."""
    async with connect(url, token=token, resume=False, reconnect=0.0) as robot:
        drive = await robot.request("drive", receive=False)
        print("open", flush=True)
        sending = []
        while line := await asyncio.to_thread(sys.stdin.readline):
            sending.append(asyncio.ensure_future(drive.send({"speed": float(line)})))
            await asyncio.sleep(0.01)  # turns in which it is written to the socket
            print("sent", flush=True)


if __name__ == "__main__":
    kind, url, token = sys.argv[1:]
    if kind == "import":
        import_functions(url, token)
    elif kind == "take-over":
        take_over(url, token)
    else:
        asyncio.run(send_lines(url, Path(token).read_text(encoding="ascii")))
