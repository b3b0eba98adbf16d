"""Programs in other languages, as people use them."""

from __future__ import annotations

import subprocess
from functools import partial
from pathlib import Path

import pytest
from tests.server.robot import script
from tests.server.talk import eventually

from uoarm import RobotManager
from uoarm.model import ConnectionState
from uoarm.server import Server
from uoarm.testing import patience

CLIENTS = Path(__file__).parent / "clients"


def run(command: list[str], robot: RobotManager, *, rounds: int) -> None:
    """Run a program, playing to it what it waits for, round by round.

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
            for _ in range(rounds):
                eventually(partial(opened, "doubled"), "it listens to numbers")
                script.put(*({"value": value} for value in (1, 2, 3)))
                eventually(partial(opened, "picture"), "it listens to pictures")
                script.put({"width": 16, "data": bytes(range(256))})
            out, _ = process.communicate(timeout=patience())
        finally:
            process.kill()
    assert process.returncode == 0, out
    assert "done" in out.splitlines(), out  # what ends with the process may speak after it


@pytest.mark.needs("node")
def test_the_javascript_client(server: Server, robot: RobotManager) -> None:
    flags = ["--experimental-websocket", "--no-warnings"]
    url = f"ws://127.0.0.1:{server.ports[0]}/"
    command = ["node", *flags, str(CLIENTS / "with_uoarm.mjs"), url, str(patience())]
    run(command, robot, rounds=2)
