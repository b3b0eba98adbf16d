"""`uoarm status --url`: the live status of a robot that runs behind the server."""

from __future__ import annotations

import json
import os
import re
import signal
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest
from click.testing import CliRunner
from tests.host import joined as machines
from tests.redirects import redirecting
from tests.server.robot import END, script
from tests.server.serving import url
from websockets.datastructures import Headers
from websockets.exceptions import InvalidStatus, InvalidURI
from websockets.http11 import Response

from uoarm import RobotManager
from uoarm.bridge import redirection
from uoarm.cli import main
from uoarm.server import Server, ServerOptions, serve_in_thread
from uoarm.server.access import AccessRole, Operation, RoleViews
from uoarm.server.session._views import visible_status
from uoarm.testing import free_port, patience


@contextmanager
def watching(*arguments: str) -> Iterator[subprocess.Popen[str]]:
    command = [sys.executable, "-m", "uoarm", "status", *arguments]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
    try:
        yield process
    finally:
        process.kill()
        process.communicate(timeout=patience())


def test_the_status_of_a_running_robot_is_shown(server: Server, robot: RobotManager) -> None:
    with robot.request("numbers"):
        shown = CliRunner().invoke(main, ["status", "--url", url(server)])
        assert shown.exit_code == 0, shown.output
        assert "connections: 1" in shown.output
        assert "numbers" in shown.output
        report = CliRunner().invoke(main, ["status", "--url", url(server), "--json"])
        assert json.loads(report.stdout)["connections"][0]["state"] == "running"
        script.put(END)


def test_events_are_followed_until_an_interrupt(server: Server, robot: RobotManager) -> None:
    with watching("--url", url(server), "--watch", "--json", "--every", "60") as process:
        assert process.stdout is not None
        assert json.loads(process.stdout.readline())["connections"] == []
        with robot.request("numbers"):
            event = json.loads(process.stdout.readline())["event"]
            while event["change"] != "running":
                event = json.loads(process.stdout.readline())["event"]
            assert event["subject"].startswith("connection")
        process.send_signal(signal.SIGINT)
        assert process.wait(patience()) == 0


@pytest.mark.parametrize(
    ("room", "code", "said"), [("full", 6, "nothing more can be"), ("", 6, "")]
)
def test_what_cannot_be_printed_is_not_said_of_the_server(
    server: Server, room: str, code: int, said: str
) -> None:
    """Without room, and in a pipe of which `head` has read enough."""
    reading, writing = os.pipe()
    os.close(reading)
    with os.fdopen(writing, "wb") as pipe, Path("/dev/full").open("wb") as full:
        done = subprocess.run(
            [sys.executable, "-m", "uoarm", "status", "--url", url(server)],
            stdout=full if room else pipe,
            stderr=subprocess.PIPE,
            text=True,
            check=False,
            timeout=2 * patience(),
        )
    assert (done.returncode, said in done.stderr) == (code, True), done.stderr
    assert "reached" not in done.stderr


def test_a_server_that_is_not_there_is_named() -> None:
    shown = CliRunner().invoke(main, ["status", "--url", "ws://127.0.0.1:1/"])
    assert shown.exit_code == 4
    assert "ws://127.0.0.1:1/: nothing listens there: is uoarm serve running?" in shown.output


def test_a_server_without_tls_and_a_token_that_is_none_are_said(server: Server) -> None:
    address = url(server)
    for code, given, said in (
        (4, ["--url", address.replace("ws:", "wss:")], "no TLS"),
        (2, ["--url", address, "--token", "s3cret\nmore"], "token: expected one line"),
    ):
        shown = CliRunner().invoke(main, ["status", *given])
        assert shown.exit_code == code
        assert said in shown.output
        assert "s3cret" not in shown.output
    assert CliRunner().invoke(main, ["status", "--url", address, "--token", "x\n"]).exit_code == 0


def test_what_the_server_says_as_it_refuses_is_said(server: Server) -> None:
    """A name of this machine that the server does not know, as behind a proxy."""
    place = url(server).replace("127.0.0.1", "127.1")
    shown = CliRunner().invoke(main, ["status", "--url", place])
    assert shown.exit_code == 4
    assert f"{place}: it refuses: Host '127.1:" in shown.output


def test_a_redirection_is_said_with_what_to_do() -> None:
    with redirecting("http://robot.example/ros/") as place:
        shown = CliRunner().invoke(main, ["status", "--url", place])
    assert shown.exit_code == 4
    assert f"{place}: it redirects: give ws://robot.example/ros/ as the address" in shown.output


def test_a_redirection_within_the_server_that_a_library_does_not_follow_is_said() -> None:
    for location in ("/ros/", "ws://a:1/ros/", "http://a:1/ros/"):
        error = InvalidStatus(Response(301, "", Headers(Location=location)))
        assert (
            redirection(error, "ws://a:1/ros") == "it redirects: give ws://a:1/ros/ as the address"
        )
    assert redirection(InvalidStatus(Response(404, "", Headers())), "ws://a:1/ros") == ""
    assert redirection(InvalidURI("ftp://a", "no"), "ftp://a") == ""


def test_what_is_no_address_of_a_server_is_wrong_usage() -> None:
    shown = CliRunner().invoke(main, ["status", "--url", "http://127.0.0.1:1/"])
    assert shown.exit_code == 2
    assert "expected ws://HOST:PORT/ or wss://HOST:PORT/" in shown.output


def test_other_machines_are_shown_to_who_may_see_a_function_there(tmp_path: Path) -> None:
    file = machines.robot(tmp_path, free_port())
    guest = AccessRole("guest", {Operation.SEE: ("ticks",)})
    stranger = AccessRole("stranger", {Operation.SEE: ("other",)})
    with RobotManager.from_file(file) as robot:
        status = robot.status()
        views = RoleViews(lambda: robot.config)
        assert not visible_status(status, views.of(stranger)).machines
        (shown,) = visible_status(status, views.of(guest)).machines
        assert shown.cause == "waiting for its bridge far"
        with serve_in_thread(robot, ServerOptions(port=0)) as server:
            live = CliRunner().invoke(main, ["status", "--url", url(server)])
    assert "machines: 1" in live.output
    (of_machine,) = re.findall(r"^  arm .*", live.output, re.MULTILINE)
    assert of_machine.split() == ["arm", "no", "waiting", "for", "its", "bridge", "far"]
    (of_bridge,) = re.findall(r"^  far .*", live.output, re.MULTILINE)
    assert of_bridge.endswith("  waiting for machine 'arm'")
