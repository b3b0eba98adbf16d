"""A soak of hosts and failover: `python -m bench._soak SECONDS` (30 minutes when left out).

Two hosts provide one function. Every second one of them is killed, stopped or made to hang; the
connection must go on behind its handle, and at the end threads, descriptors and memory must be
where they were after the first minute.
"""

from __future__ import annotations

import os
import random
import resource
import signal
import sys
import threading
import time
from pathlib import Path

from attrs import evolve

from uoarm import RobotManager
from uoarm.config import loads
from uoarm.errors import BridgeError
from uoarm.host import RemoteBridge
from uoarm.model import ConnectionState, FailoverPolicy
from uoarm.testing import Census

HERE = Path(__file__).parent
HALF_HOUR = 1800.0
PATIENCE_SECONDS = 60.0
GROWTH_KILOBYTES = 30_000
HOST = "{silence: 0.6, restarts: 1000000}"
ROBOT = f"""
version: 1
bridges:
  one: {{plugin: python, host: {HOST}, options: {{path: [{HERE}]}}}}
  two: {{plugin: python, host: {HOST}, options: {{path: [{HERE}]}}}}
functions:
  numbers:
    components:
      - {{name: first, bridge: one, priority: 2, output: {{endpoint: ["_hosted_parts:slowly"]}}}}
      - {{name: second, bridge: two, priority: 1, output: {{endpoint: ["_hosted_parts:slowly"]}}}}
"""


def main() -> int:
    """Harm hosts for as long as the argument says; return 0 when all held."""
    seconds = float(sys.argv[1]) if len(sys.argv) > 1 else HALF_HOUR
    chance = random.Random(1)
    policy = FailoverPolicy(wait=PATIENCE_SECONDS, limit=1_000_000, return_after=0.5)
    with RobotManager(evolve(loads(ROBOT), failover=policy)) as warm:
        warm.request("numbers").get(10)
    before, memory, begun = Census(), 0, time.monotonic()
    harmed = {"SIGKILL": 0, "SIGSTOP": 0}
    with RobotManager(evolve(loads(ROBOT), failover=policy)) as robot:
        arrived = [0]
        numbers = robot.request("numbers", on_message=lambda _: _count(arrived))
        while time.monotonic() - begun < seconds:
            seen = arrived[0]
            if not _flows(arrived, seen):
                print(f"nothing came for {PATIENCE_SECONDS:g} s: {robot.status()}")
                return 1
            assert numbers.state is ConnectionState.RUNNING, numbers.cause
            fault = chance.choice(list(harmed))
            harmed[fault] += _harm(robot, numbers.plan.provider.component.bridge, fault)
            if not memory and time.monotonic() - begun > min(60.0, seconds / 2):
                memory = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
        print(f"{harmed}, {len(numbers.gaps)} changes of provider, {arrived[0]} messages")
        worst = max((gap.seconds for gap in numbers.gaps), default=0.0)
        print(f"longest gap {1000 * worst:.0f} ms")
    before.check(30.0)
    grown = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - memory
    print(f"memory grew by {grown} KB")
    return 0 if grown < GROWTH_KILOBYTES else 1


def _count(arrived: list[int]) -> None:
    arrived[0] += 1


def _flows(arrived: list[int], seen: int) -> bool:
    """Wait for a second of messages that came after `seen`."""
    pause = threading.Event()
    deadline = time.monotonic() + PATIENCE_SECONDS
    while arrived[0] < seen + 300:
        if time.monotonic() > deadline:
            return False
        pause.wait(0.01)
    return True


def _harm(robot: RobotManager, bridge: str, fault: str) -> int:
    """Harm the host that provides now; return how often that was done."""
    try:
        host = robot._bridges.get(bridge)  # noqa: SLF001 - to have somebody to harm
        assert isinstance(host, RemoteBridge)
        os.kill(host.process, getattr(signal, fault))
    except (BridgeError, ProcessLookupError):
        return 0  # it is dead already, and not back yet
    return 1


if __name__ == "__main__":
    sys.exit(main())
