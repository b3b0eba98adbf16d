"""How old a command from the network is: an old one is refused where it moves something."""

from __future__ import annotations

import asyncio
import math
from collections.abc import Callable, Iterator

import pytest
from hypothesis import given
from hypothesis import strategies as st
from tests.server.conftest import Serve
from tests.server.talk import Talk

from uoarm import RobotManager
from uoarm.bridge import Registry
from uoarm.client import connect
from uoarm.config import loads
from uoarm.server import Server
from uoarm.server.streams import CommandAges
from uoarm.testing import MemoryBridge, wait
from uoarm.testing._components import Taker

LIFETIME = 3600.0
ROBOT = f"""
version: 1
bridges: {{memory: {{plugin: python}}}}
functions:
  drive:
    components:
      - name: base
        bridge: memory
        input: {{endpoint: [base], lifetime: {LIFETIME}, stop: {{message: 0}}}}
"""
seconds = st.floats(0, 1e6)


@given(st.floats(-1e9, 1e9), st.lists(st.tuples(seconds, st.floats(0, 10)), min_size=1))
def test_an_age_is_never_more_than_the_true_one(
    apart: float, messages: list[tuple[float, float]]
) -> None:
    """Whatever the clocks say, and less than it by what the quickest message took."""
    ages, quickest = CommandAges(), math.inf
    for came, took in sorted(messages):
        quickest = min(quickest, took)
        age = ages.age(came - took + apart, came)
        assert age <= took + 1e-5
        assert age >= took - quickest - 1e-3 * 1e6 - 1e-5


def test_a_message_that_was_held_up_is_old() -> None:
    ages = CommandAges()
    assert ages.age(500.0, 10.0) == 0
    assert ages.age(501.0, 11.8) == pytest.approx(0.8, abs=0.01)
    assert ages.age(502.0, 12.0) == pytest.approx(0.0, abs=0.01)


def test_a_clock_that_is_slow_makes_nothing_old() -> None:
    ages = CommandAges()
    assert max(ages.age(now * 0.9995, float(now)) for now in range(100_000)) < 0.001


@pytest.mark.parametrize("sent", [None, math.nan, math.inf, "soon"])
def test_who_does_not_say_when_sends_nothing_old(sent: object) -> None:
    ages = CommandAges()
    ages.age(0.0, 0.0)
    assert ages.age(sent, 1000.0) == 0
    assert ages.age(1000.0, 1001.0) == pytest.approx(0.0, abs=1.1)


@pytest.fixture
def base(memory: MemoryBridge) -> Taker:
    return memory.taker("base", {"type": "number"})


@pytest.fixture
def robot(memory: MemoryBridge, base: Taker) -> Iterator[RobotManager]:
    del base
    with RobotManager(loads(ROBOT), registry=Registry(()), bridges={"memory": memory}) as robot:
        yield robot


def dropped(robot: RobotManager) -> dict[str, int]:
    return dict(robot.status().routes[0].dropped)


def test_a_command_older_than_its_lifetime_is_refused(
    talk: Callable[[], Talk], base: Taker, robot: RobotManager
) -> None:
    client = talk()
    drive = client.open("drive")
    client.ask("Data", drive, 1, **{"x-sent": 100_000.5})
    wait(lambda: base.taken.messages == [1], "it was not taken")
    client.ask("Data", drive, 2, **{"x-sent": 100_001.5 - 2 * LIFETIME})
    wait(lambda: dropped(robot) == {"late": 1}, "the old one was not refused")
    client.ask("Data", drive, 3, **{"x-sent": 100_002.5})
    wait(lambda: base.taken.messages == [1, 3], "a new one was refused")


async def test_the_python_client_says_when_it_sent(
    serve: Serve, base: Taker, robot: RobotManager, monkeypatch: pytest.MonkeyPatch
) -> None:
    server: Server = serve()

    async with connect(f"ws://127.0.0.1:{server.ports[0]}/") as client:
        drive = await client.request("drive")
        await drive.send(1)
        await asyncio.to_thread(wait, lambda: base.taken.messages == [1])
        with monkeypatch.context() as patched:
            # The clock goes on while this one is held up.
            patched.setattr("uoarm.client._stream.boot_seconds", lambda: -2 * LIFETIME)
            await drive.send(2)
            await asyncio.to_thread(wait, lambda: dropped(robot) == {"late": 1})
        await drive.send(3)
        await asyncio.to_thread(wait, lambda: base.taken.messages == [1, 3])
