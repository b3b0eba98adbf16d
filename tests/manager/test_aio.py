"""Reading a connection from an event loop: time limits and cancellation."""

from __future__ import annotations

import asyncio
from collections.abc import Iterator

import pytest

from uoarm import RobotManager
from uoarm.config import loads
from uoarm.manager import AsyncRobotManager
from uoarm.testing import Emitter, MemoryBridge

NUMBER = {"type": "integer"}
ROBOT = """
version: 1
bridges: {one: {plugin: memory}}
functions:
  camera:
    components: [{name: camera, bridge: one, output: {endpoint: [camera]}}]
"""


@pytest.fixture
def bridge() -> MemoryBridge:
    return MemoryBridge("one")


@pytest.fixture
def camera(bridge: MemoryBridge) -> Emitter:
    return bridge.emitter("camera", NUMBER)


@pytest.fixture
def robot(bridge: MemoryBridge, camera: Emitter) -> Iterator[RobotManager]:
    del camera  # is there first
    with RobotManager(loads(ROBOT), bridges={"one": bridge}) as robot:
        yield robot


def test_nothing_in_time_is_a_timeout(robot: RobotManager) -> None:
    async def play() -> None:
        async with await AsyncRobotManager(robot).request("camera") as connection:
            with pytest.raises(TimeoutError, match=r"no message within 0\.01 s"):
                await connection.get(0.01)

    asyncio.run(play())


def test_what_is_there_needs_no_time(camera: Emitter, robot: RobotManager) -> None:
    async def play() -> object:
        async with await AsyncRobotManager(robot).request("camera") as connection:
            camera.emit(5)
            return await connection.get(0)

    assert asyncio.run(play()) == 5


@pytest.mark.parametrize("turns", range(6))
def test_a_cancellation_is_never_lost_and_takes_no_message_with_it(
    camera: Emitter, robot: RobotManager, turns: int
) -> None:
    async def play() -> None:
        async with await AsyncRobotManager(robot).request("camera") as connection:
            reading = asyncio.ensure_future(connection.get(60))
            await asyncio.sleep(0)  # it waits now
            camera.emit(5)
            for _ in range(turns):
                await asyncio.sleep(0)
            asked = reading.cancel()
            await asyncio.wait({reading})
            assert reading.cancelled() is asked
            assert (await connection.get(60) if asked else reading.result()) == 5

    asyncio.run(play())
