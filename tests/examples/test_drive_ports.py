"""What examples/drive says where its port is taken. Needs no ROS 2: nothing has been started."""

from __future__ import annotations

import socket
import subprocess
import sys
from pathlib import Path

from uoarm.testing import patience

EXAMPLE = Path(__file__).resolve().parents[2] / "examples" / "drive"


def test_a_port_that_is_taken_is_reported_before_anything_is_started() -> None:
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = str(taken.getsockname()[1])
        done = subprocess.run(
            [sys.executable, str(EXAMPLE / "drive.py"), "--page-port", port],
            capture_output=True,
            text=True,
            timeout=patience(),
            check=False,
        )
    assert done.returncode == 2
    assert done.stdout == ""
    assert f"127.0.0.1:{port}" in done.stderr
    assert done.stderr.endswith("--page-port takes another\n")
    assert len(done.stderr.splitlines()) == 1
