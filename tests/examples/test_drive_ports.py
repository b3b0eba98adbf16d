"""What examples/drive says where an address does not do. Needs no ROS 2: nothing is started."""

from __future__ import annotations

import re
import socket
import subprocess
import sys
import threading
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path

from tests.processes import run_python

from uoarm.testing import patience

ROBOT = """
version: 1
bridges: {python: {}}
functions:
  drive:
    components:
      - {name: base, bridge: python, input: {endpoint: ["base:drive"], structure: {}}}
"""
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


def test_a_port_that_is_none_is_reported() -> None:
    done = run_python(EXAMPLE / "drive.py", "--page-port", "65536")
    assert done.returncode == 2
    assert len(done.stderr.splitlines()) == 1, done.stderr


def test_a_robot_port_that_is_taken_is_reported_with_its_option() -> None:
    """In the words of `uoarm serve`, whose option it is, too."""
    done = run_python(EXAMPLE / "drive.py", "--help")
    assert re.search(r"^  --port PORT", done.stdout, re.MULTILINE)


def test_the_terminal_ends_with_its_server(tmp_path: Path) -> None:
    (tmp_path / "robot.yaml").write_text(ROBOT)
    (tmp_path / "base.py").write_text("def drive(twist: object) -> None: print('drives')")
    command = sys.executable, "-u", "-m", "uoarm", "serve", str(tmp_path / "robot.yaml")
    pipe = subprocess.PIPE
    with subprocess.Popen((*command, "--port", "0"), stdout=pipe, stderr=pipe, text=True) as server:
        try:
            assert server.stdout is not None
            assert server.stderr is not None
            url = server.stdout.readline().split()[1]
            terminal = (sys.executable, str(EXAMPLE / "terminal.py"), "--url", url)
            with subprocess.Popen(terminal, stderr=pipe, text=True) as driving:
                assert server.stderr.readline() == "drives\n"
                server.kill()
                _, said = driving.communicate(timeout=patience())
        finally:
            server.kill()
    assert driving.returncode == 1
    assert len(said.splitlines()) == 1, said
    assert "connecting again" not in said


def test_the_terminal_reports_a_server_that_is_no_robot() -> None:
    server = ThreadingHTTPServer(("127.0.0.1", 0), BaseHTTPRequestHandler)
    thread = threading.Thread(target=server.serve_forever)
    thread.start()
    try:
        url = f"ws://127.0.0.1:{server.server_port}/"
        done = run_python(EXAMPLE / "terminal.py", "--url", url)
    finally:
        server.shutdown()
        thread.join()
        server.server_close()
    assert done.returncode == 1
    assert len(done.stderr.splitlines()) == 1, done.stderr
