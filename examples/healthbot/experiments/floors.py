"""The floors: what one message to and fro costs the frameworks by themselves, without uoarm."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

__all__ = ["FLOORS", "measure"]

FLOORS = {
    "python": "direct call",
    "socket": "TCP socket, another process and back",
    "topic": "rclpy, one node's own topic",
    "topics": "rclpy, topics, another process and back",
    "service": "rclpy, service of another process",
    "call": "omniORB, call of another process",
    "put": "omniORB, put to another process and put back",
}
"""What is measured, by the name of its process."""

_BARE = Path(__file__).with_name("bare.py")


def measure(name: str, count: int) -> list[float]:
    """Return the seconds of each round trip, without a tenth more that warms up.

    Raises:
        RuntimeError: it cannot be measured here; the text has the last line of the cause.
    """
    command = [sys.executable, str(_BARE), name, str(count)]
    done = subprocess.run(command, capture_output=True, text=True, timeout=300, check=False)
    if done.returncode:
        raise RuntimeError(done.stderr.strip().rpartition("\n")[2] or f"{name} failed")
    seconds: list[float] = json.loads(done.stdout)
    return seconds
