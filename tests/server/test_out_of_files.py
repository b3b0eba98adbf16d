"""A process that may open no more files goes on, says so once, and takes clients again."""

from __future__ import annotations

import asyncio
import errno
import logging
import re
import resource
import select
import socket
import subprocess
import sys
import threading
from asyncio.constants import ACCEPT_RETRY_DELAY
from contextlib import ExitStack, suppress
from pathlib import Path
from typing import Any

import pytest
from tests.server.robot import CONFIGURATION
from tests.server.talk import Talk, eventually
from tests.server.test_serving import ROOT
from websockets.exceptions import WebSocketException

from uoarm import RobotManager
from uoarm.server import Server, ServerOptions
from uoarm.server.http._listener import ListeningSocket, NoRoomError, connections_possible, listen
from uoarm.testing import ManualClock, patience

FILES = 64
LEFT = 8
HALF_OPEN = 200


def test_half_open_sockets_beyond_all_descriptors_are_logged_once_and_outlived(
    tmp_path: Path,
) -> None:
    file = tmp_path / "robot.yaml"
    file.write_text(CONFIGURATION, encoding="utf-8")
    with ExitStack() as stack:
        process = stack.enter_context(
            subprocess.Popen(
                [
                    "prlimit", f"--nofile={FILES}:{FILES}",
                    sys.executable, "-m", "uoarm", "serve", str(file), "--port", "0",
                ],
                stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
                env={"PYTHONPATH": str(ROOT), "PYTHONUNBUFFERED": "1", "PATH": "/usr/bin:/bin"},
            )
        )  # fmt: skip
        stack.callback(process.kill)
        assert process.stdout is not None
        found = re.search(r"ws://127\.0\.0\.1:(\d+)/", process.stdout.readline())
        assert found
        port = int(found[1])
        reports: list[str] = []
        reading = threading.Thread(target=lambda: reports.extend(process.stderr or ()))
        reading.start()
        # Of its half it would refuse those that are too many: another process has the rest.
        used = sum(1 for _ in Path(f"/proc/{process.pid}/fd").iterdir())
        resource.prlimit(process.pid, resource.RLIMIT_NOFILE, (used + LEFT, FILES))
        with ExitStack() as half_open:
            for _ in range(HALF_OPEN):
                half_open.enter_context(
                    socket.create_connection(("127.0.0.1", port), timeout=patience())
                )
            eventually(lambda: reports, "what cannot be taken is reported")

        def comes_in() -> bool:
            try:
                with Talk(f"ws://127.0.0.1:{port}/") as client:
                    return bool(client.ask("List"))
            except (OSError, EOFError, WebSocketException):
                return False

        eventually(comes_in, "a client comes in again")
        process.terminate()
        assert process.wait(patience()) == 0
        reading.join(patience())
    text = "".join(reports)
    assert text.count("no connection can be taken: Too many open files") == 1
    assert "Traceback" not in text
    assert len(reports) == 1, text


def test_failures_in_a_pause_are_not_tried_and_those_in_silence_are_counted(
    monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    tried = 0

    def full(_: socket.socket) -> object:
        nonlocal tried
        tried += 1
        raise OSError(errno.EMFILE, "Too many open files")

    monkeypatch.setattr(socket.socket, "accept", full)
    clock = ManualClock()
    with ListeningSocket(socket.AF_INET, socket.SOCK_STREAM, clock=clock) as listener:
        for second in range(121):
            with pytest.raises(NoRoomError):
                listener.accept()
            for _ in range(100):
                with pytest.raises(BlockingIOError):
                    listener.accept()
            assert tried == second + 1
            clock.advance(1)
    assert [record.args for record in caplog.records] == [
        ("Too many open files", 0),
        ("Too many open files", 59),
        ("Too many open files", 59),
    ]
    assert all(record.levelno == logging.ERROR for record in caplog.records)


def test_a_server_that_stops_in_a_pause_says_nothing_more(
    monkeypatch: pytest.MonkeyPatch, robot: RobotManager
) -> None:
    """asyncio puts the socket back into its loop after a second, closed or not."""
    reports: list[dict[str, Any]] = []
    failed = asyncio.Event()

    def full(_: socket.socket) -> object:
        failed.set()
        raise OSError(errno.EMFILE, "Too many open files")

    async def stop_in_a_pause() -> None:
        loop = asyncio.get_running_loop()
        server = Server(robot, ServerOptions(port=0))
        await server.start()
        loop.set_exception_handler(lambda _, context: reports.append(context))
        with socket.create_connection(("127.0.0.1", server.ports[0]), timeout=patience()):
            await failed.wait()
            await server.stop()
        after_the_pause = asyncio.Event()  # which began earlier, and is as long
        loop.call_later(ACCEPT_RETRY_DELAY, after_the_pause.set)
        await after_the_pause.wait()

    with monkeypatch.context() as patch:
        patch.setattr(socket.socket, "accept", full)
        asyncio.run(stop_in_a_pause())
    assert reports
    assert all(isinstance(report["exception"], NoRoomError) for report in reports), reports


def test_other_failures_are_passed_on(monkeypatch: pytest.MonkeyPatch) -> None:
    def gone(_: socket.socket) -> object:
        raise ConnectionAbortedError(errno.ECONNABORTED, "gone")

    monkeypatch.setattr(socket.socket, "accept", gone)
    with ListeningSocket(socket.AF_INET, socket.SOCK_STREAM) as listener:
        for _ in range(2):
            with pytest.raises(ConnectionAbortedError):
                listener.accept()


def test_those_who_wait_are_accepted_a_few_at_a_time() -> None:
    """Between them the loop serves others: asyncio asks until there is none."""
    [listener] = asyncio.run(listen("127.0.0.1", 0))
    with ExitStack() as stack:
        stack.callback(listener.close)
        for _ in range(5):
            stack.enter_context(socket.create_connection(listener.getsockname()))
        accepted: list[int] = []
        while sum(accepted) < 5:
            select.select([listener], [], [], patience())
            accepted.append(0)
            with suppress(BlockingIOError):
                while True:
                    listener.accept()[0].close()
                    accepted[-1] += 1
    assert accepted == [2, 2, 1]


def test_all_addresses_of_a_name_listen_on_one_port() -> None:
    sockets = asyncio.run(listen("localhost", 0))
    try:
        assert {listener.getsockname()[1] for listener in sockets} == {sockets[0].getsockname()[1]}
        with pytest.raises(OSError, match="in use"):
            asyncio.run(listen("localhost", sockets[0].getsockname()[1]))
    finally:
        for listener in sockets:
            listener.close()


def test_half_of_all_files_are_left_to_the_robot(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(resource, "getrlimit", lambda _: (1024, 4096))
    assert connections_possible(4160) == 512
    assert connections_possible(100) == 100
    monkeypatch.setattr(resource, "getrlimit", lambda _: (resource.RLIM_INFINITY,) * 2)
    assert connections_possible(4160) == 4160
