"""Reading a connection from an event loop: time limits and cancellation."""

from __future__ import annotations

import asyncio
import inspect
import threading
from collections.abc import Callable, Coroutine, Iterator
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import Any

import pytest
from typing_extensions import assert_type

from uoarm import AsyncConnection, AsyncRobotManager, Connection, RobotManager
from uoarm._renewal import HeldCommand, renewed
from uoarm._support.workers import WorkerExecutor
from uoarm.config import loads
from uoarm.model import (
    ConnectionState,
    ConnectionStatus,
    Health,
    Message,
    Plan,
    StatusEvent,
    StatusMap,
)
from uoarm.testing import Emitter, Hang, Loop, MemoryBridge, Taker, hanging, patience, wait

NUMBER = {"type": "integer"}
ROBOT = """
version: 1
bridges: {one: {plugin: memory}}
functions:
  camera:
    components: [{name: camera, bridge: one, output: {endpoint: [camera]}}]
  echo:
    components:
      - {name: echo, bridge: one, input: {endpoint: [echo]}, output: {endpoint: [echo]}}
"""
MOVING = """
version: 1
bridges: {one: {plugin: memory}}
functions:
  drive:
    components:
      - name: base
        bridge: one
        input: {endpoint: [base], lifetime: 3600, stop: {message: 0}}
"""


@pytest.fixture
def bridge() -> MemoryBridge:
    return MemoryBridge("one")


@pytest.fixture
def camera(bridge: MemoryBridge) -> Emitter:
    return bridge.emitter("camera", NUMBER)


@pytest.fixture
def echo(bridge: MemoryBridge) -> Loop:
    return bridge.loop("echo", NUMBER)


@pytest.fixture
def robot(bridge: MemoryBridge, camera: Emitter, echo: Loop) -> Iterator[RobotManager]:
    del camera, echo  # are there first
    with RobotManager(loads(ROBOT), bridges={"one": bridge}) as robot:
        yield robot


async def test_nothing_in_time_is_a_timeout(robot: RobotManager) -> None:
    async with await AsyncRobotManager(robot).request("camera") as connection:
        with pytest.raises(TimeoutError, match=r"no message within 0\.01 s"):
            await connection.get(0.01)


def test_what_is_there_needs_no_time(camera: Emitter, robot: RobotManager) -> None:
    async def play() -> object:
        async with await AsyncRobotManager(robot).request("camera") as connection:
            camera.emit(5)
            return await connection.get(0)

    assert asyncio.run(play()) == 5


@pytest.mark.parametrize("turns", range(6))
async def test_a_cancellation_is_never_lost_and_takes_no_message_with_it(
    camera: Emitter, robot: RobotManager, turns: int
) -> None:
    async with await AsyncRobotManager(robot).request("camera") as connection:
        reading = asyncio.ensure_future(connection.get(patience()))
        await asyncio.sleep(0)  # it waits now
        camera.emit(5)
        for _ in range(turns):
            await asyncio.sleep(0)
        asked = reading.cancel()
        await asyncio.wait({reading})
        assert reading.cancelled() is asked
        assert (await connection.get(patience()) if asked else reading.result()) == 5


async def test_twins_that_are_made_have_the_types_of_what_they_await(robot: RobotManager) -> None:
    twin = AsyncRobotManager(robot)
    assert_type(await twin.resolve("camera", timeout=patience()), Plan)
    assert_type(twin.status(), StatusMap)
    async with await twin.request("camera", as_type=int) as connection:
        assert_type(await connection.flush(patience()), bool)
        assert_type(connection.status(), ConnectionStatus)


def _members(one: object) -> dict[str, Any]:
    return {name: member for name, member in vars(one).items() if not name.startswith("_")}


def _parameters(member: Callable[..., object]) -> list[inspect.Parameter]:
    return list(inspect.signature(getattr(member, "__func__", member)).parameters.values())


@pytest.mark.parametrize(
    ("threaded", "twin"), [(RobotManager, AsyncRobotManager), (Connection, AsyncConnection)]
)
def test_each_method_has_a_twin_with_the_same_parameters(threaded: type, twin: type) -> None:
    wanted = _members(threaded)
    found = _members(twin)
    assert wanted.keys() - found.keys() == set()
    for name, member in wanted.items():
        assert type(found[name]) is type(member), name
        if not isinstance(member, property):
            assert _parameters(found[name]) == _parameters(member), name


async def test_attributes_have_twins(robot: RobotManager) -> None:
    twin = AsyncRobotManager(robot)
    assert (twin.config, twin.registry) == (robot.config, robot.registry)
    async with await twin.request("camera") as connection:
        (threaded,) = robot.connections()
        for name in _members(threaded):
            assert getattr(connection, name) == getattr(threaded, name)
        assert repr(connection) == "<AsyncConnection c1 to 'camera': running, camera>"
        (same,) = twin.connections()
        assert same.id == "c1"
    assert repr(twin) == "<AsyncRobotManager in memory: 2 functions, 0 connections>"


async def test_a_request_that_is_cancelled_leaves_nothing_open(
    bridge: MemoryBridge, robot: RobotManager
) -> None:
    twin = AsyncRobotManager(robot)
    for turns in range(10):
        with hanging(bridge, "_open_source") as hang:
            asked = asyncio.ensure_future(twin.request("camera"))
            await asyncio.to_thread(hang.entered.wait, 10)
            if turns % 2:
                hang.release()  # it opens as it is cancelled
            asked.cancel()
            await asyncio.wait({asked})
            assert asked.cancelled()
        await asyncio.to_thread(wait, lambda: not robot.connections())
        await asyncio.to_thread(wait, lambda: bridge.open_channels == 0)


@pytest.fixture
def base(bridge: MemoryBridge) -> Taker:
    return bridge.taker("base", NUMBER)


@pytest.fixture
def moving(bridge: MemoryBridge, base: Taker) -> Iterator[RobotManager]:
    del base  # is there first
    with RobotManager(loads(MOVING), bridges={"one": bridge}) as robot:
        yield robot


async def test_a_command_whose_holder_is_cancelled_as_it_begins_is_stopped(
    moving: RobotManager, base: Taker, monkeypatch: pytest.MonkeyPatch
) -> None:
    begun, go = threading.Event(), threading.Event()

    @contextmanager
    def slow(*given: Any) -> Iterator[HeldCommand]:
        with renewed(*given) as held:
            begun.set()
            assert go.wait(patience())
            yield held

    monkeypatch.setattr("uoarm._control.connection.renewed", slow)
    async with await AsyncRobotManager(moving).request("drive") as drive:
        asked = asyncio.ensure_future(drive.hold(1, period=0.001).__aenter__())
        assert await asyncio.to_thread(begun.wait, patience())
        asked.cancel()
        await asyncio.wait({asked})
        assert asked.cancelled()
        go.set()
        await asyncio.to_thread(wait, lambda: not _renewing(), "it is renewed no more")
        await asyncio.to_thread(wait, lambda: base.taken.messages[-1] == 0, "it stands")


def _renewing() -> bool:
    return any(thread.name == "uoarm-renewal" for thread in threading.enumerate())


@pytest.mark.parametrize("how", ["kill", "stop", "end of a hold", "close", "stop_all"])
async def test_what_ends_or_stops_is_done_though_its_task_is_cancelled_before(
    moving: RobotManager, base: Taker, how: str
) -> None:
    twin = AsyncRobotManager(moving)
    drive = await twin.request("drive")
    held = drive.hold(1, period=3600)
    if how == "end of a hold":
        await held.__aenter__()
    else:
        await drive.send(1)
    ways: dict[str, Callable[[], Coroutine[object, object, object]]] = {
        "kill": drive.kill,
        "stop": drive.stop,
        "close": twin.close,
        "stop_all": twin.stop_all,
        "end of a hold": partial(held.__aexit__, None, None, None),
    }
    twin._stopping = WorkerExecutor("stopping", 1)
    hang = Hang()
    for executor in (*[twin._handling] * 32, twin._stopping):
        executor.submit(hang.wait)
    try:
        asked = asyncio.ensure_future(ways[how]())
        await asyncio.sleep(0)  # it waits for a thread
        asked.cancel()
        await asyncio.wait({asked})
        assert asked.cancelled()
    finally:
        hang.release()
    await asyncio.to_thread(wait, lambda: base.taken.messages == [1, 0], "it stands")


def test_one_that_hangs_does_not_keep_others_from_being_killed(
    bridge: MemoryBridge, robot: RobotManager
) -> None:
    async def play() -> None:
        twin = AsyncRobotManager(robot)
        connection = await twin.request("echo")
        with hanging(bridge, "_open_source") as hang:
            asked = [asyncio.ensure_future(twin.request("camera")) for _ in range(40)]
            await asyncio.to_thread(hang.entered.wait, 10)
            await connection.kill()
            assert connection.state is ConnectionState.CLOSED
            for task in asked:
                task.cancel()

    asyncio.run(play())
    wait(lambda: not robot.connections())


async def test_callbacks_and_listeners_are_called_in_the_loop(
    bridge: MemoryBridge, camera: Emitter, robot: RobotManager
) -> None:
    twin, loop = AsyncRobotManager(robot), threading.current_thread()
    received: asyncio.Queue[tuple[threading.Thread, object]] = asyncio.Queue()

    def receive(what: Message | StatusEvent) -> None:
        received.put_nowait((threading.current_thread(), what))

    async with await twin.request("camera", on_message=receive) as connection:
        camera.emit(1)
        assert await received.get() == (loop, 1)
        end = connection.subscribe(lambda _: end())  # may end itself
        camera.emit(2)
        assert await received.get() == (loop, 2)
        end_listening = twin.listen(receive)
        bridge.report(Health.DEGRADED, "hot")
        thread, event = await received.get()
        while isinstance(event, StatusEvent) and event.subject != "bridge one":
            thread, event = await received.get()  # of the request
        assert thread is loop
        assert isinstance(event, StatusEvent)
        end_listening()


async def test_what_is_sent_can_be_flushed(robot: RobotManager) -> None:
    async with await AsyncRobotManager(robot).request("echo") as connection:
        await connection.send(3)
        assert await connection.flush(patience())
        assert await connection.get(patience()) == 3
        await connection.close()
        assert (connection.ended, connection.cause, connection.gaps) == (True, "", ())


async def test_another_loop_may_read_on(camera: Emitter, robot: RobotManager) -> None:
    connection = await AsyncRobotManager(robot).request("camera")

    async def read() -> object:
        reading = asyncio.ensure_future(connection.get(patience()))
        await asyncio.sleep(0)  # it waits
        camera.emit(1)
        return await reading

    assert await read() == 1
    assert await asyncio.to_thread(asyncio.run, read()) == 1


async def test_it_reads_a_file_and_says_what_can_be_had(tmp_path: Path) -> None:
    file = tmp_path / "robot.yaml"
    file.write_text("{version: 1, bridges: {}, functions: {}}")

    async with AsyncRobotManager.from_file(file) as twin:
        assert await twin.check_availability() == ()
        assert not twin.status().bridges
