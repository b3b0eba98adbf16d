"""A manager in a process of its own, which answers a test line by line; see `test_nat`."""

# ruff: noqa: T201 - it is read by its lines
from __future__ import annotations

import json
import sys
from typing import Any

from uoarm import Connection, RobotManager
from uoarm.testing import patience


def answer(manager: RobotManager, ticks: Connection, question: str) -> Any:
    """Answer with what JSON can say."""
    if question == "call":
        return manager.call("where", 0, timeout=patience())
    if question == "doubled":
        return list(manager.request("doubled"))
    if question == "tick":
        return ticks.get(patience())
    if question == "gaps":
        return [[gap.cause, *gap.after] for gap in ticks.gaps]
    (machine,) = manager.status().machines
    return machine.present


if __name__ == "__main__":
    with (
        RobotManager.from_file(sys.argv[1]) as manager,
        manager.request("ticks") as ticks,
    ):
        for line in sys.stdin:
            print(json.dumps(answer(manager, ticks, line.strip())), flush=True)
