"""Unmodified clients of rosbridge, as people use them.

npm brings roslib, unless UOARM_ROSLIB names a folder in which `npm install roslib@2` was run.
"""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
from tests.server.programs import PLAYED, run  # type: ignore[import-not-found]

from uoarm import RobotManager
from uoarm.server import Server
from uoarm.testing import patience

CLIENTS = Path(__file__).parent / "clients"
ROSLIB = os.environ.get("UOARM_ROSLIB", "")


def test_roslibpy(server: Server, robot: RobotManager) -> None:
    url = f"ws://127.0.0.1:{server.ports[0]}/rosbridge"
    out = run([sys.executable, str(CLIENTS / "with_roslibpy.py"), url], robot, PLAYED)
    assert out.strip().endswith("done"), out


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
    out = run(command, robot, ["doubled", *["picture"] * 3])
    assert out.strip().endswith("done"), out
