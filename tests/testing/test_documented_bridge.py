"""The plugin that the page on writing bridges shows passes the conformance kit as printed."""

from __future__ import annotations

import itertools
import re
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

import pytest

from uoarm import RobotManager
from uoarm.bridge import Registry
from uoarm.config import loads
from uoarm.model import BridgeSpec, Endpoint, Message, Role
from uoarm.testing import Collector, patience
from uoarm.testing.conformance import BridgeConformance, Pair, World

can = pytest.importorskip("can")
virtual = pytest.importorskip("can.interfaces.virtual")

PAGE = Path(__file__).parents[2] / "docs" / "writing-a-bridge.md"
BLOCK = re.compile(r"^```python\n(.*?)^```$", re.MULTILINE | re.DOTALL)
TEXT = PAGE.read_text(encoding="utf-8")
CODE = next(code for code in BLOCK.findall(TEXT) if "uoarm_bridge_types" in code)
ROBOT = re.findall(r"^```yaml\n(version: 1.*?)^```$", TEXT, re.MULTILINE | re.DOTALL)[-1]
CHANNELS = itertools.count()


class Receivers(list[Any]):
    """Queues of the buses of a virtual channel; a send reaches all that were there as it began.

    python-can goes over them without a lock: one that leaves meanwhile has another one skipped,
    which never gets the message.
    """

    def __iter__(self) -> Iterator[Any]:
        return iter(self.copy())


def plugin() -> dict[str, Any]:
    module: dict[str, Any] = {}
    exec(compile(CODE, str(PAGE), "exec"), module)
    return module


class CanWorld(World):
    """One frame on a virtual bus of this test's own."""

    def __init__(self) -> None:
        self.bus = {"interface": "virtual", "channel": f"test {next(CHANNELS)}"}
        virtual.channels[self.bus["channel"]] = Receivers()
        self._own = can.Bus(**self.bus)  # while it is open, python-can keeps the channel

    def spec(self) -> BridgeSpec:
        return BridgeSpec("can", "can", {**self.bus, "frames": {"wheel": 0x120}})

    def registry(self) -> Registry:
        made = Registry([])
        made.add(plugin()["uoarm_bridge_types"]()[0])
        return made

    def pair(self, kind: str) -> Pair:
        return Pair(at(kind, Role.INPUT), at(kind, Role.OUTPUT))

    def missing(self) -> Endpoint:
        return at("nowhere", Role.OUTPUT)

    def samples(self, kind: str) -> Sequence[Message]:
        return [b"", b"\0\xff", bytes(range(8))]

    def unreadable(self, kind: str) -> Callable[[], object]:
        frame = can.Message(arbitration_id=0x120, is_remote_frame=True, is_extended_id=False)
        return lambda: self._own.send(frame)

    def close(self) -> None:
        self._own.shutdown()


def at(name: str, role: Role) -> Endpoint:
    return Endpoint("can", name, role, (name,))


class TestCanBridge(BridgeConformance):
    """The whole suite."""

    kinds = ("wheel",)

    @pytest.fixture
    def world(self) -> Iterator[World]:
        made = CanWorld()
        yield made
        made.close()


def test_a_bus_that_is_closed_during_a_send_costs_no_other_its_frame() -> None:
    world = CanWorld()
    with (
        can.Bus(**world.bus) as leaving,
        can.Bus(**world.bus) as staying,
        can.Bus(**world.bus) as sending,
    ):
        leaving.queue.put = lambda *_, **__: leaving.shutdown()
        sending.send(can.Message(arbitration_id=0x120, data=b"1", is_extended_id=False))
        frame = staying.recv(0)
    world.close()
    assert frame is not None


def test_the_plugin_is_as_short_as_the_page_says() -> None:
    lines = [line for line in CODE.splitlines() if line.strip()]
    assert len(lines) < 90


def test_the_robot_of_the_page_gets_what_is_on_the_bus() -> None:
    text = ROBOT.replace("channel: can0", "channel: robot, interface: virtual")
    robot = loads(text.replace("stale_after: 2.0", f"stale_after: {patience()}"))
    registry = Registry([])
    registry.add(plugin()["uoarm_bridge_types"]()[0])
    came = Collector()
    with RobotManager(robot, registry=registry) as manager:
        connection = manager.request("wheelSpeed", on_message=came.deliver)
        with can.Bus(interface="virtual", channel="robot") as bus:
            bus.send(can.Message(arbitration_id=0x120, data=b"\x10\x27", is_extended_id=False))
            assert came.wait(1) == [b"\x10\x27"]
        connection.kill()
