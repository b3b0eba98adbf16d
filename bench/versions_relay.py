"""Jazzy to Kilted and back: through the manager and two hosts, and straight on one ROS domain.

Needs the environments `jazzy` and `kilted`, which `examples/versions/run.py` makes.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from bench.tables import print_table, row
from uoarm import Connection, ResolutionError, RobotManager, environments
from uoarm.config import loads

NODES = Path(__file__).with_name("_versions_nodes.py")
SIZES = {"100 B": (100, 500), "10 KB": (10_000, 500), "1 MB": (1_000_000, 50)}
KIND = "std_msgs/msg/UInt8MultiArray"
ONE_DOMAIN = 63
LIMIT_SECONDS = 180.0
ROBOT = f"""
version: 1
bridges:
  jazzy: {{plugin: ros2, host: {{environment: jazzy}}}}
  kilted: {{plugin: ros2, host: {{environment: kilted}}}}
functions:
  asked:
    components:
      - {{name: jazzy_ping, bridge: jazzy, output: {{endpoint: [/ping, {KIND}]}}}}
  answered:
    components:
      - {{name: kilted_pong, bridge: kilted, output: {{endpoint: [/pong, {KIND}]}}}}
  there:
    components:
      - name: kilted_ping
        bridge: kilted
        input: {{from: asked, endpoint: [/ping, {KIND}]}}
  back:
    components:
      - name: jazzy_pong
        bridge: jazzy
        input: {{from: answered, endpoint: [/pong, {KIND}]}}
"""


def main() -> int:
    """Print the table; 0 also where an environment is missing."""
    missing = {"jazzy", "kilted"} - {one.name for one in environments.listed()}
    if missing:
        print(f"no table of versions: no environment {', '.join(missing)}", file=sys.stderr)
        return 0
    rows = []
    with _node("kilted", ONE_DOMAIN, "echo"):
        for label, (size, rounds) in SIZES.items():
            rows.append((*_times("straight, on one domain", ONE_DOMAIN, size, rounds), label))
    with RobotManager(loads(ROBOT)) as robot:
        jazzy, kilted = (
            robot.config.bridges[one].options["domain_id"] for one in ("jazzy", "kilted")
        )
        with _node("kilted", kilted, "echo"):
            for label, (size, rounds) in SIZES.items():
                name = f"manager, domains {jazzy} and {kilted}"
                rows.append((*_times(name, jazzy, size, rounds, robot), label))
    head = ("Jazzy to Kilted and back", "median", "p99", "size")
    print_table("Two versions of ROS 2, round trip (us)", head, rows)
    return 0


def _times(
    name: str, domain: object, size: int, rounds: int, robot: RobotManager | None = None
) -> tuple[str, ...]:
    with _node("jazzy", domain, "client", size, rounds) as client:
        relays = [] if robot is None else [_open(robot, one) for one in ("there", "back")]
        told, _ = client.communicate(timeout=LIMIT_SECONDS)
        for relay in relays:
            relay.kill()
    return row(name, sorted(json.loads(told)))[:3]


def _open(robot: RobotManager, function: str) -> Connection:
    """Open a relay as soon as its nodes are seen."""
    deadline = time.monotonic() + LIMIT_SECONDS
    while True:
        try:
            return robot.request(function)
        except ResolutionError:
            if time.monotonic() > deadline:
                raise
            time.sleep(0.2)


@contextmanager
def _node(version: str, domain: object, *words: object) -> Iterator[subprocess.Popen[str]]:
    """Run a node of one version in its own environment, ended with the block."""
    variables = dict(os.environ, ROS_DOMAIN_ID=str(domain))
    for trace in ("LD_LIBRARY_PATH", "_ROS_WHEELS_BOOTSTRAP_COMPLETE", "PYTHONPATH"):
        variables.pop(trace, None)
    command = [str(environments.environment_python(version)), str(NODES), *map(str, words)]
    process = subprocess.Popen(command, env=variables, stdout=subprocess.PIPE, text=True)
    try:
        yield process
    finally:
        process.kill()
        process.communicate()


if __name__ == "__main__":
    sys.exit(main())
