"""The bridge passes the suite that every bridge passes, in this process and in a host."""

from __future__ import annotations

from collections.abc import Sequence

import pytest
from parts import stage
from robots import ServedRobot

from uoarm.model import BridgeSpec, Endpoint, Message, Role
from uoarm.testing import patience
from uoarm.testing.conformance import BridgeConformance, Pair, Served, Victim, World

# Pings of websockets draw numbers beside what hypothesis draws.
pytestmark = pytest.mark.filterwarnings("ignore:Do not use the `random` module")
KINDS: tuple[str, ...] = ("integers", "image", "text", "pose")
SERVICES = ("double", "failing", "silent")


class ManagerWorld(World):
    """Functions of another manager, behind its server."""

    def __init__(self, robot: ServedRobot) -> None:
        self._robot = robot

    def spec(self) -> BridgeSpec:
        options = {
            "url": self._robot.url,
            "discover": True,
            "timeout": min(patience(), 60.0),
            "grace": patience(),
        }
        return BridgeSpec("far", "remote", options)

    def pair(self, kind: str) -> Pair:
        return Pair(at(kind, Role.INPUT), at(kind, Role.OUTPUT))

    def missing(self) -> Endpoint:
        return at("nowhere", Role.OUTPUT)

    def samples(self, kind: str) -> Sequence[Message]:
        if kind == "text":
            return ["", "Kia ora \u2192 \U0001f916\r\n\t\0", "{" * 1000]
        if kind == "image":
            return [{"width": 1024, "data": bytes(range(256)) * 8192}]
        if kind == "integers":
            return [{"value": value} for value in (-(2**63), 2**53 + 1, 2**63 - 1)]
        return [{"x": -0.0, "y": 5e-324, "name": "\U0001f916"}]

    def victim(self) -> Victim:
        return self.victims()[0]

    def victims(self) -> Sequence[Victim]:
        return [Victim(at(name, Role.OUTPUT), end.set) for name, end in stage.ends.items()]

    def broken(self) -> bool:
        self._robot.stop()
        return True

    def mended(self) -> None:
        self._robot.start()

    def served(self) -> Served:
        first, failing, silent = (at(name, Role.SERVICE) for name in SERVICES)
        more = [({"value": number}, {"value": 2 * number}) for number in range(3)]
        return Served(first, {"value": 21}, {"value": 42}, failing, silent, more)


def at(name: str, role: Role) -> Endpoint:
    return Endpoint("far", name, role, (name,), options={"backlog": 20_000})


class TestRemoteManager(BridgeConformance):
    """The whole suite."""

    kinds = KINDS

    @pytest.fixture
    def world(self, robot: ServedRobot) -> World:
        return ManagerWorld(robot)


class TestInAHost(TestRemoteManager):
    """The whole suite with the bridge in a process of its own."""

    hosted = True
    kinds = KINDS[:2]
