"""The emergency stop from outside: who may, what is reported, and that nothing stands before it."""

from __future__ import annotations

import asyncio
import json
import logging
import threading
from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path

import click
import pytest
from click.testing import CliRunner
from tests.server.conftest import Between, Serve
from tests.server.serving import access_file, url
from tests.server.talk import Talk

from uoarm import RobotManager
from uoarm._safety import StopFile
from uoarm.bridge import Registry
from uoarm.cli import main
from uoarm.client import ServerError, connect
from uoarm.config import loads
from uoarm.errors import UsageError
from uoarm.model import Message
from uoarm.server import (
    Limits,
    Server,
    ServerOptions,
    make_token,
    serve_in_thread,
)
from uoarm.server.streams import Outbox
from uoarm.testing import Background, MemoryBridge, patience, wait
from uoarm.testing._components import Taker

ROBOT = """
version: 1
bridges: {memory: {plugin: python}}
functions:
  drive:
    components: [{name: base, bridge: memory, input: {endpoint: [base], stop: {message: 0}}}]
  lift:
    components: [{name: arm, bridge: memory, input: {endpoint: [arm], stop: {message: 0}}}]
  hang: {components: [{name: hang, bridge: memory, service: {endpoint: [hang]}}]}
"""
TOKENS = {"driver": make_token(), "keeper": make_token(), "viewer": make_token()}
ACCESS = """
version: 1
roles:
  driver: {{see: all, request: ["*"], send: ["*"], call: ["*"], stop: all}}
  keeper: {{see: all, release: all}}
  viewer: {{see: all}}
tokens:
  - {{name: driver, role: driver, sha256: {driver}}}
  - {{name: keeper, role: keeper, sha256: {keeper}}}
  - {{name: viewer, role: viewer, sha256: {viewer}}}
"""
NUMBER = {"type": "number"}


@pytest.fixture
def hang() -> Iterator[threading.Event]:
    event = threading.Event()
    yield event
    event.set()


@pytest.fixture
def memory(hang: threading.Event) -> MemoryBridge:
    def answer(message: Message) -> Message:
        hang.wait(patience())
        return message

    memory = MemoryBridge()
    memory.service("hang", NUMBER, NUMBER, answer)
    return memory


@pytest.fixture
def base(memory: MemoryBridge) -> Taker:
    return memory.taker("base", NUMBER)


@pytest.fixture
def arm(memory: MemoryBridge) -> Taker:
    return memory.taker("arm", NUMBER)


@pytest.fixture
def robot(memory: MemoryBridge, base: Taker, arm: Taker) -> Iterator[RobotManager]:
    del base, arm
    with RobotManager(loads(ROBOT), registry=Registry(()), bridges={"memory": memory}) as robot:
        yield robot


@pytest.fixture
def guarded(serve: Serve, tmp_path: Path) -> Server:
    return serve(Limits(calls=1, workers=1), access=access_file(tmp_path, ACCESS, TOKENS))


def enter(server: Server, name: str) -> Talk:
    return Talk(url(server), additional_headers={"Authorization": f"Bearer {TOKENS[name]}"})


def test_a_stop_is_reported_as_it_is_and_only_a_role_with_the_right_releases(
    guarded: Server, base: Taker
) -> None:
    with enter(guarded, "driver") as driver, enter(guarded, "keeper") as keeper:
        drive = driver.open("drive")
        driver.ask("Data", drive, 5)
        report = driver.ask("Stop")
        assert report["stopped"]
        (one,) = report["inputs"]
        assert (one["function"], one["component"], one["stopped"]) == ("drive", "base", True)
        assert base.taken.messages == [5, 0]
        assert driver.refused("Data", drive, 6)["code"] == "held"
        assert driver.refused("Stop", message={"release": True})["code"] == "denied"
        assert keeper.refused("Stop")["code"] == "denied"
        keeper.ask("Stop", message={"release": True})
        driver.ask("Data", drive, 7)
        wait(lambda: base.taken.messages == [5, 0, 7])


def test_who_stopped_and_released_is_in_the_audit_log(
    guarded: Server, base: Taker, memory: MemoryBridge, caplog: pytest.LogCaptureFixture
) -> None:
    del base
    caplog.set_level(logging.INFO, "uoarm.audit")
    with enter(guarded, "driver") as driver, enter(guarded, "keeper") as keeper:
        driver.open("drive")
        memory.cut("no radio")
        driver.ask("Stop")
        memory.mend()
        wait(lambda: driver.ask("Stop")["stopped"])
        keeper.ask("Stop", message={"release": True})
    reports = [
        json.loads(record.getMessage()) for record in caplog.records if record.name == "uoarm.audit"
    ]
    stops = [report for report in reports if report.get("operation") == "stop" and "done" in report]
    assert {stop["role"] for stop in stops} == {"driver"}
    assert (stops[0]["done"], stops[0]["left"]) == (False, ["base.default"])
    assert (stops[-1]["done"], stops[-1]["left"]) == (True, [])
    (released,) = [
        report for report in reports if report.get("operation") == "release" and "done" in report
    ]
    assert (released["role"], released["done"]) == ("keeper", True)


def test_a_right_for_one_function_stops_nothing(guarded: Server) -> None:
    with enter(guarded, "viewer") as viewer:
        assert viewer.refused("Stop")["code"] == "denied"


def test_a_stop_waits_for_no_call_that_hangs_and_no_limit(guarded: Server, base: Taker) -> None:
    with enter(guarded, "driver") as driver:
        driver.open("drive")
        driver.send("Call", "hang", 1)
        assert driver.refused("Call", "hang", 1)["code"] == "limit"
        assert driver.ask("Stop")["stopped"]
        assert base.taken.messages == [0]


def test_where_the_system_gives_no_thread_all_is_stopped_and_released(
    guarded: Server, base: Taker, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refuse(_: threading.Thread) -> None:
        raise RuntimeError("can't start new thread")

    with enter(guarded, "driver") as driver, enter(guarded, "keeper") as keeper:
        driver.ask("Data", driver.open("drive"), 7)
        with monkeypatch.context() as patch:
            patch.setattr(threading.Thread, "start", refuse)
            assert driver.ask("Stop")["stopped"]
            assert base.taken.messages == [7, 0]
            keeper.ask("Stop", message={"release": True})


def test_a_stop_after_a_release_stops_again_though_the_one_before_it_lasts(
    guarded: Server, base: Taker, arm: Taker
) -> None:
    with ExitStack() as stack:
        first, second, keeper = (
            stack.enter_context(enter(guarded, role)) for role in ("driver", "driver", "keeper")
        )
        first.open("drive")
        lift = second.open("lift")
        stack.enter_context(base.stalled())
        first.send("Stop")
        arm.taken.wait(1)
        keeper.ask("Stop", message={"release": True})
        second.ask("Data", lift, 7)
        arm.taken.wait(2)
        report = second.ask("Stop")
        assert arm.taken.messages == [0, 7, 0]
        stopped = {entry["component"]: entry["stopped"] for entry in report["inputs"]}
        assert stopped == {"base": False, "arm": True}


async def test_the_python_client(guarded: Server) -> None:
    async with connect(url(guarded), token=TOKENS["driver"]) as driver:
        assert (await driver.stop_all())["inputs"] == []
        with pytest.raises(ServerError, match="may not release"):
            await driver.release()
    async with connect(url(guarded), token=TOKENS["keeper"]) as keeper:
        await keeper.release()


async def test_what_has_no_output_is_not_read(guarded: Server) -> None:
    async with connect(url(guarded), token=TOKENS["driver"]) as driver:
        drive = await driver.request("drive")
        with pytest.raises(UsageError, match="'drive' has no output"):
            await drive.get(patience())


def test_the_command_line_says_who_has_not_stopped(
    guarded: Server,
    robot: RobotManager,
    memory: MemoryBridge,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    def stop(who: str, *more: str) -> tuple[int, str]:
        given = ["stop", "--url", url(guarded), "--token", TOKENS[who], *more]
        result = CliRunner().invoke(main, given)
        return result.exit_code, result.output

    robot.request("drive")
    code, text = stop("driver")
    assert (code, "stopped      base.default (drive)" in text) == (0, True)
    memory.cut("no radio")
    code, text = stop("driver")
    assert (code, "NOT STOPPED  base.default (drive)" in text, "no radio" in text) == (
        1,
        True,
        True,
    )
    memory.mend()
    (tmp_path / "file").write_text("no folder", encoding="utf-8")
    stops = robot._driver.live.emergency_stop
    monkeypatch.setattr(stops, "_file", StopFile(tmp_path / "file" / "stopped"))
    code, text = stop("driver")
    assert "stopped      base.default" in text
    assert (code, "NOT STOPPED AFTER A RESTART" in text) == (1, True)
    monkeypatch.undo()
    assert stop("keeper")[0] == 4
    assert stop("keeper", "--release") == (0, "commands are let through again\n")


@pytest.mark.parametrize("command", ["stop", "apply", "history"])
def test_who_names_no_server_asks_the_one_that_serve_starts_here(command: str) -> None:
    found_command = main.get_command(click.Context(main), command)
    assert found_command is not None
    found = {parameter.name: parameter.default for parameter in found_command.params}
    settings = ServerOptions()
    assert found["url"] == f"ws://{settings.host}:{settings.port}/"


def test_what_clients_move_stops_before_a_server_that_ends_waits_for_them(
    robot: RobotManager, base: Taker, monkeypatch: pytest.MonkeyPatch
) -> None:
    waits, go_on = threading.Event(), threading.Event()
    options = ServerOptions(port=0, limits=Limits(stop_seconds=4 * patience()))
    emptied = Outbox.emptied

    async def empty_late(outbox: Outbox) -> None:
        waits.set()
        await asyncio.to_thread(go_on.wait, patience())
        await emptied(outbox)

    monkeypatch.setattr(Outbox, "emptied", empty_late)
    serving = ExitStack()
    server = serving.enter_context(serve_in_thread(robot, options))
    with serving, Talk(url(server)) as driver:
        drive = driver.open("drive")
        driver.ask("Data", drive, 5)
        ending = Background(serving.close)
        assert waits.wait(patience())
        wait(lambda: base.taken.messages == [5, 0])
        refused = [driver.refused("Data", drive, 6)["code"] for _ in range(20)]
        refused.append(driver.refused("Request", "drive")["code"])
        go_on.set()
        ending.result(patience())
    assert base.taken.messages == [5, 0]
    assert set(refused) == {"closed"}


async def test_a_stop_waits_for_nothing_that_its_client_sent_before(
    serve: Serve, between: Between, base: Taker
) -> None:
    proxy = between(serve())
    async with connect(f"ws://127.0.0.1:{proxy.port}/", resume=False) as client:
        drive = await client.request("drive")
        await drive.send(5)
        proxy.jam(to_server=True)
        large = asyncio.ensure_future(client.call("hang", "x" * 8_000_000))
        while not client._link.holds_up:  # noqa: ASYNC110 - a socket has no event of it
            await asyncio.sleep(0)
        report = await asyncio.wait_for(client.stop_all(), patience())
        large.cancel()
        client.drop()
    assert (report["stopped"], base.taken.messages) == (True, [5, 0])
