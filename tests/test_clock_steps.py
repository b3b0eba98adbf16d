"""The clock of the machine is set while a robot is served: what is measured in seconds goes on."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from collections.abc import Callable, Iterator
from datetime import datetime, timedelta, timezone
from pathlib import Path

import pytest
from tests.harness._needs import NEEDS
from tests.server.talk import Talk, eventually
from websockets.exceptions import ConnectionClosed, InvalidStatus

from uoarm.server import hash_token
from uoarm.testing import patience

pytest.importorskip("zenoh", reason="hosts need zenoh")
pytestmark = [
    pytest.mark.needs("faketime"),
    pytest.mark.skipif(
        sys.version_info < (3, 11), reason="CPython 3.10 waits by the clock that can be set"
    ),
]
ROBOT = """
version: 1
bridges: {far: {plugin: python, host: {silence: 600, start: 600}}}
functions:
  numbers: {components: [{name: counter, bridge: far, output: {endpoint: ["clock_parts:count"]}}]}
"""
PARTS = """
import threading
from collections.abc import Iterator

def count() -> Iterator[int]:
    number, pause = 0, threading.Event()
    while True:
        yield number
        number += 1
        pause.wait(0.01)
"""
ACCESS = """
version: 1
roles: {{all: {{see: all, request: ["*"]}}}}
tokens:
  - {{name: ends, role: all, sha256: {ends}, expires: {end}}}
  - {{name: stays, role: all, sha256: {stays}}}
"""
Set = Callable[[timedelta], None]


@pytest.fixture
def clock(tmp_path: Path) -> Path:
    """A file that says by how much the clock of a process is off."""
    path = tmp_path / "clock"
    path.write_text("+0d")
    return path


@pytest.fixture
def port(tmp_path: Path, clock: Path) -> Iterator[int]:
    (tmp_path / "robot.yaml").write_text(ROBOT)
    (tmp_path / "clock_parts.py").write_text(PARTS)
    end = datetime.now(timezone.utc) + timedelta(days=5)
    hashes = {"ends": hash_token("ends"), "stays": hash_token("stays")}
    access = ACCESS.format(end=end.strftime("%Y-%m-%dT%H:%M:%SZ"), **hashes)
    (tmp_path / "access.yaml").write_text(access)
    variables = {
        "LD_PRELOAD": str(NEEDS["faketime"].found[0]),
        "FAKETIME_TIMESTAMP_FILE": str(clock),
        "FAKETIME_NO_CACHE": "1",
        "FAKETIME_DONT_FAKE_MONOTONIC": "1",
        "PYTHONUNBUFFERED": "1",
    }
    command = [sys.executable, "-m", "uoarm", "serve", "--port", "0", "--access", "access.yaml"]
    with subprocess.Popen(
        [*command, "robot.yaml"],
        cwd=tmp_path, env={**os.environ, **variables}, stdout=subprocess.PIPE, text=True,
    ) as process:  # fmt: skip
        assert process.stdout is not None
        found = re.search(r":(\d+)/", process.stdout.readline())
        assert found
        yield int(found[1])
        process.terminate()
        assert process.wait(patience()) == 0


def test_a_clock_that_is_set_ends_what_has_a_date_and_nothing_else(port: int, clock: Path) -> None:
    def enter(token: str) -> Talk:
        return Talk(f"ws://127.0.0.1:{port}/?token={token}")

    with enter("stays") as client, enter("ends") as other:
        connection = client.open("numbers")
        client.data(connection, 5)

        clock.write_text("+10d")
        with pytest.raises(ConnectionClosed) as closed:
            other.answer(None)
        assert closed.value.rcvd is not None
        assert closed.value.rcvd.code == 1008
        with pytest.raises(InvalidStatus):
            enter("ends")
        client.data(connection, 200)

        clock.write_text("-20d")

        def comes_in_again() -> bool:
            try:
                with enter("ends") as again:
                    return bool(again.ask("List"))
            except (InvalidStatus, ConnectionClosed):
                return False

        eventually(comes_in_again, "a token lives again where the clock was set back")
        client.data(connection, 200)
        shown = client.ask("Status")
    assert [item["state"] for item in shown["connections"]] == ["running"]
    assert [item["gaps"] for item in shown["connections"] if "gaps" in item] in ([], [[]], [0])
    assert [component["health"] for component in shown["components"]] == ["ok"]
