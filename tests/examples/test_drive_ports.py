"""What examples/drive says where an address does not do. Needs no ROS 2: nothing is started."""

from __future__ import annotations

import socket
import threading
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
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


def test_a_port_that_is_none_is_reported() -> None:
    done = run_python(EXAMPLE / "drive.py", "--page-port", "65536")
    assert done.returncode == 2
    assert len(done.stderr.splitlines()) == 1, done.stderr


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
