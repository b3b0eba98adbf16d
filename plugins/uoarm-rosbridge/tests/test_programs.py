"""Unmodified clients of rosbridge, as people use them.

npm brings roslib, unless UOARM_ROSLIB names a folder in which `npm install roslib@2` was run.
"""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from functools import partial
from pathlib import Path

import pytest
from components import script
from ros import eventually

from uoarm import RobotManager
from uoarm.model import ConnectionState
from uoarm.server import Server
from uoarm.testing import patience

CLIENTS = Path(__file__).parent / "clients"
ROSLIB = os.environ.get("UOARM_ROSLIB", "")


def run(command: list[str], robot: RobotManager, *, pictures: int = 1) -> None:
    """Run a program, playing to it what it waits for, one picture after another.

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
            eventually(partial(opened, "doubled"), "it listens to numbers")
            script.put(*({"value": value} for value in (1, 2, 3)))
            for _ in range(pictures):
                eventually(partial(opened, "picture"), "it listens to pictures")
                script.put({"width": 16, "data": bytes(range(256))})
            out, _ = process.communicate(timeout=patience())
        finally:
            process.kill()
    assert process.returncode == 0, out
    assert out.strip().endswith("done"), out


def test_roslibpy(server: Server, robot: RobotManager) -> None:
    url = f"ws://127.0.0.1:{server.ports[0]}/rosbridge"
    run([sys.executable, str(CLIENTS / "with_roslibpy.py"), url], robot)


@pytest.fixture(scope="module")
def roslib(tmp_path_factory: pytest.TempPathFactory) -> str:
    if ROSLIB:
        return ROSLIB
    if shutil.which("npm") is None:
        pytest.skip("needs npm: apt install npm")
    folder = str(tmp_path_factory.mktemp("roslib"))
    options = ["--silent", "--ignore-scripts", "--no-audit", "--no-fund", "--prefix", folder]
    fetched = subprocess.run(["npm", "install", *options, "roslib@2"], check=False)
    if fetched.returncode:
        pytest.skip("npm cannot fetch roslib")
    return folder


@pytest.mark.skipif(shutil.which("node") is None, reason="needs Node.js 20.10 or later")
def test_roslib(server: Server, robot: RobotManager, roslib: str) -> None:
    url = f"ws://127.0.0.1:{server.ports[0]}/rosbridge"
    command = ["node", str(CLIENTS / "with_roslib.mjs"), url, roslib, str(patience())]
    run(command, robot, pictures=3)
