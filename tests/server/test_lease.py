"""Clients that command one input: who may, who is notified, and that what a client held stops."""

from __future__ import annotations

import asyncio
import json
import logging
import threading
from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path

import pytest
from tests.leases import ACCESS, TOKENS, lease, leased_robot
from tests.processes import run_program
from tests.server.conftest import Between, Serve
from tests.server.serving import access_file, url
from tests.server.talk import Talk

from uoarm import RobotManager
from uoarm._renewal import renewed_in_task
from uoarm.client import connect
from uoarm.errors import CommandRefusedError, ConnectionClosedError
from uoarm.model import LeaseHolder, Message, StatusEvent
from uoarm.server import Limits, Server, ServerOptions, serve_in_thread
from uoarm.testing import MemoryBridge, patience, wait
from uoarm.testing._components import Taker


@pytest.fixture
def base(memory: MemoryBridge) -> Taker:
    return memory.taker("base", {"type": "number"})


@pytest.fixture
def robot(memory: MemoryBridge, base: Taker) -> Iterator[RobotManager]:
    del base
    with leased_robot(memory) as robot:
        yield robot


@pytest.fixture
def guarded(serve: Serve, tmp_path: Path) -> Server:
    return serve(access=access_file(tmp_path, ACCESS, TOKENS))


def enter(server: Server, name: str) -> Talk:
    return Talk(url(server), additional_headers={"Authorization": f"Bearer {TOKENS[name]}"})


def test_one_client_commands_and_the_other_learns_which(
    guarded: Server, robot: RobotManager, base: Taker, caplog: pytest.LogCaptureFixture
) -> None:
    caplog.set_level(logging.INFO, "uoarm.audit")
    with enter(guarded, "driver") as first, enter(guarded, "driver") as second:
        drive = first.open("drive")
        assert second.open("drive") == drive, "they share a connection, and have a lease each"
        first.ask("Data", drive, 1)
        holder = LeaseHolder(f"session {first.hello['session']}", "driver")
        assert lease(robot).holder == holder
        error = second.refused("Data", drive, 2)
        assert error["code"] == "leased"
        assert f"base.default: {holder} holds its lease" in error["text"]
        second.ask("Data", drive, 3, **{"x-take-over": True})
        with enter(guarded, "safety") as fence:
            fenced = LeaseHolder(f"session {fence.hello['session']}", "safety")
            fence.open("drive")
            fence.ask("Data", drive, 4)
            assert second.refused("Data", drive, 5, **{"x-take-over": True})["code"] == "leased"
            second.ask("Stop", drive)
            assert base.taken.messages == [1, 3, 4], "it stops nothing that another commands"
        wait(lambda: base.taken.messages == [1, 3, 4, 0])
        wait(lambda: lease(robot).holder is None)

    def audited() -> list[str]:
        leases = (json.loads(record.getMessage()).get("lease", "") for record in caplog.records)
        return [item for item in leases if item]

    wait(lambda: audited()[-1:] == [f"base.default: {fenced} gave its lease back"])
    assert audited()[0] == f"base.default: {holder} holds its lease"


def test_what_happened_before_a_server_stops_is_audited_and_reported(
    robot: RobotManager, tmp_path: Path
) -> None:
    """Also while a listener of the program holds up all that listen after it."""
    go_on, log, access = (
        threading.Event(),
        tmp_path / "audit.log",
        access_file(tmp_path, ACCESS, TOKENS),
    )

    def hold_up(event: StatusEvent) -> None:
        del event
        go_on.wait(patience())

    robot.listen(hold_up)
    options = ServerOptions(port=0, access=access, audit=log)
    with ExitStack() as stack:
        stack.callback(go_on.set)
        with serve_in_thread(robot, options) as server:
            driver = stack.enter_context(enter(server, "driver"))
            driver.ask("Status", "watch")
            holder = LeaseHolder(f"session {driver.hello['session']}", "driver")
            driver.ask("Data", driver.open("drive"), 1)
        changes: list[str] = []
        while "leased" not in changes:
            changes.append(driver.next("change")["jsonMessage"]["change"])
        leases = [json.loads(line).get("lease") for line in log.read_text().splitlines()]
    assert [lease for lease in leases if lease] == [
        f"base.default: {holder} holds its lease",
        f"base.default: {holder} gave its lease back",
    ]


def test_a_client_stops_what_it_moves_and_what_it_may_not_stop_is_reported(
    guarded: Server, base: Taker
) -> None:
    with enter(guarded, "driver") as driver:
        drive = driver.open("drive")
        driver.ask("Data", drive, 1)
        driver.ask("Stop", f"{drive}.default")
        driver.ask("Stop", drive)
        assert base.taken.messages == [1, 0]
        assert driver.refused("Stop", f"{drive}.other")["code"] == "usage"
        assert driver.refused("Stop", "c99")["code"] == "unknown"
        assert driver.refused("Stop", drive, {"release": True})["code"] == "usage"
        assert driver.refused("Stop")["code"] == "denied", "to stop all is a right of its own"


def test_what_a_client_moved_that_is_gone_stops_and_others_may(
    guarded: Server, robot: RobotManager, base: Taker
) -> None:
    with enter(guarded, "driver") as second:
        drive = second.open("drive")
        with enter(guarded, "driver") as first:
            first.ask("Data", first.open("drive"), 1)
            second.refused("Data", drive, 2)
        wait(lambda: base.taken.messages == [1, 0])
        wait(lambda: lease(robot).holder is None)
        second.ask("Data", drive, 3)


def test_the_python_client_renews_while_it_holds_and_stops_then(
    guarded: Server, base: Taker, caplog: pytest.LogCaptureFixture
) -> None:
    async def run() -> None:
        async with connect(url(guarded), token=TOKENS["driver"]) as robot:
            drive = await robot.request("drive")
            assert drive.lifetimes == {"default": 3600}
            async with drive.hold(1, period=0.001) as held:
                await asyncio.to_thread(wait, lambda: base.taken.messages.count(1) >= 3)
                held.message = 2
                await asyncio.to_thread(wait, lambda: 2 in base.taken.messages)
            assert base.taken.messages[-1] == 0
            held_before = len(base.taken.messages)
            async with connect(url(guarded), token=TOKENS["driver"]) as other:
                same = await other.request("drive")
                async with same.hold(3, period=3600):
                    with pytest.raises(CommandRefusedError, match="holds its lease"):
                        await drive.hold(4).__aenter__()
            assert base.taken.messages[held_before:] == [3, 0]

    asyncio.run(asyncio.wait_for(run(), patience()))
    assert "commands live for 3600 s, and are renewed every 3600 s" in caplog.text


async def test_a_block_that_is_cancelled_as_it_begins_is_stopped() -> None:
    done: list[Message] = []

    async def send(message: Message) -> None:
        done.append(message)
        await asyncio.Event().wait()  # its answer does not come

    async def stop() -> None:
        done.append("stopped")
        raise ConnectionClosedError("the link is down")

    asked = asyncio.ensure_future(renewed_in_task(1, send, stop, 3600).__aenter__())
    await asyncio.sleep(0)
    asked.cancel()
    await asyncio.wait({asked})
    assert asked.cancelled()
    assert done == [1, "stopped"]


async def test_a_block_that_outlives_the_link_says_so(
    serve: Serve, between: Between, base: Taker
) -> None:
    del base
    proxy = between(serve(Limits(resume_seconds=0.2)))
    async with connect(f"ws://127.0.0.1:{proxy.port}/", reconnect=0) as robot:
        drive = await robot.request("drive")
        with pytest.raises(ConnectionClosedError, match="dropped"):
            async with drive.hold(1, period=3600):
                proxy.cut(admit=False)


@pytest.mark.needs("node")
def test_the_javascript_client_renews_while_it_holds_and_stops_then(
    serve: Serve, base: Taker
) -> None:
    script = Path(__file__).parent / "clients" / "with_holds.mjs"
    flags = ["--experimental-websocket", "--no-warnings"]
    done = run_program("node", *flags, script, url(serve()))
    assert done.stdout == "done\n", done.stdout + done.stderr
    assert base.taken.messages[:3] == [1, 1, 1]
    assert base.taken.messages[-1] == 0, "the stop comes last, whenever the button was let go"
    assert 9 not in base.taken.messages
