"""Programs that use a served robot, and what is played to them meanwhile."""

from __future__ import annotations

import subprocess
from collections.abc import Iterable
from functools import partial

import pytest
from tests.server.robot import script
from tests.server.talk import eventually

from uoarm import RobotManager
from uoarm.model import ConnectionState
from uoarm.testing import patience

# What is played once a program has opened a function.
PLAYED: dict[str, tuple[object, ...]] = {
    "doubled": ({"value": 1}, {"value": 2}, {"value": 3}),
    "picture": ({"width": 16, "data": bytes(range(256))},),
}


def run(command: list[str], robot: RobotManager, functions: Iterable[str]) -> str:
    """Run a program that opens these functions in turn, and return what it printed.

    What is played is for a connection that is new, and the only one: a former one of the function,
    which the program has given back, would take it, too.
    """
    met: set[str] = set()

    def opened(function: str) -> bool:
        if process.poll() is not None:
            pytest.fail(f"it ended with {process.returncode}:\n{process.communicate()[0]}")
        states = {
            connection.id: connection.state
            for connection in robot.status().connections
            if connection.function == function
        }
        if met.isdisjoint(states) and list(states.values()) == [ConnectionState.RUNNING]:
            met.update(states)
            return True
        return False

    with subprocess.Popen(
        command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True
    ) as process:
        try:
            for function in functions:
                eventually(partial(opened, function), f"it listens to {function}")
                script.put(*PLAYED[function])
            out, _ = process.communicate(timeout=patience())
        finally:
            process.kill()
    assert process.returncode == 0, out
    return out
