"""Programs in other languages, as people use them."""

from __future__ import annotations

from pathlib import Path

import pytest
from tests.server.programs import run

from uoarm import RobotManager
from uoarm.server import Server
from uoarm.testing import patience

CLIENTS = Path(__file__).parent / "clients"


@pytest.mark.needs("node")
def test_the_javascript_client(server: Server, robot: RobotManager) -> None:
    flags = ["--experimental-websocket", "--no-warnings"]
    url = f"ws://127.0.0.1:{server.ports[0]}/"
    command = ["node", *flags, str(CLIENTS / "with_uoarm.mjs"), url, str(patience())]
    out = run(command, robot, ["doubled", "picture"] * 2)
    assert "done" in out.splitlines(), out  # what ends with the process may speak after it
