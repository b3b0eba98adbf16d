"""What examples/drive says where its port is taken. Needs no ROS 2: nothing has been started."""

from __future__ import annotations

import socket
from pathlib import Path

from tests.processes import run_python

EXAMPLE = Path(__file__).resolve().parents[2] / "examples" / "drive"


def test_a_port_that_is_taken_is_reported_before_anything_is_started() -> None:
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = str(taken.getsockname()[1])
        done = run_python(EXAMPLE / "drive.py", "--page-port", port)
    assert done.returncode == 2
    assert done.stdout == ""
    assert f"127.0.0.1:{port}" in done.stderr
    assert done.stderr.endswith("--page-port takes another\n")
    assert len(done.stderr.splitlines()) == 1
