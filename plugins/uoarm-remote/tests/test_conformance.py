"""The bridge passes the suite that every bridge passes, in this process and in a host."""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Sequence

import pytest
from parts import stage
from robots import ROBOT, ServedRobot, here
from tests.harness._hosts import SharesHost, renamed, shared_host  # type: ignore[import-not-found]

from uoarm.bridge import Bridge
from uoarm.config import loads
from uoarm.model import BridgeSpec, Endpoint, Message, Role
from uoarm.testing import patience
from uoarm.testing.conformance import BridgeConformance, Pair, Served, Victim, World

# Pings of websockets draw numbers beside what hypothesis draws.
pytestmark = pytest.mark.filterwarnings("ignore:Do not use the `random` module")
KINDS: tuple[str, ...] = ("integers", "image", "text", "pose")
SERVICES = ("double", "failing", "silent")
NUMBERS = itertools.count()


class ManagerWorld(World):
    """Functions of another manager, behind its server.

    Args:
        robot: that has them.
        suffix: of their names; where there is one, the robot is given functions of such names.
    """

    def __init__(self, robot: ServedRobot, suffix: str = "") -> None:
        self._robot = robot
        self._suffix = suffix
        if suffix:
            robot.manager.apply(loads(renamed(ROBOT, suffix), origin=here()), force=True)

    def spec(self) -> BridgeSpec:
        options = {
            "url": self._robot.url,
            "discover": True,
            "timeout": min(patience(), 60.0),
            "grace": patience(),
        }
        return BridgeSpec("far", "remote", options)

    def pair(self, kind: str) -> Pair:
        return Pair(self.at(kind, Role.INPUT), self.at(kind, Role.OUTPUT))

    def missing(self) -> Endpoint:
        return self.at("nowhere", Role.OUTPUT)

    def samples(self, kind: str) -> Sequence[Message]:
        if kind == "text":
            return ["", "Kia ora \u2192 \U0001f916\r\n\t\0", "{" * 1000]
        if kind == "image":
            return [{"width": 1024, "data": bytes(range(256)) * 8192}]
        if kind == "integers":
            return [{"value": value} for value in (-(2**63), 2**53 + 1, 2**63 - 1)]
        return [{"x": -0.0, "y": 5e-324, "name": "\U0001f916"}]

    def victims(self) -> Sequence[Victim]:
        return [Victim(self.at(name, Role.OUTPUT), end.set) for name, end in stage.ends.items()]

    def broken(self) -> bool:
        self._robot.stop()
        return True

    def mended(self) -> None:
        self._robot.start()

    def at(self, name: str, role: Role) -> Endpoint:
        name += self._suffix
        return Endpoint("far", name, role, (name,), options={"backlog": 20_000})

    def served(self) -> Served:
        first, failing, silent = (self.at(name, Role.SERVICE) for name in SERVICES)
        more = [({"value": number}, {"value": 2 * number}) for number in range(3)]
        text = self.at("length", Role.SERVICE), "Kia ora"
        return Served(first, {"value": 21}, {"value": 42}, failing, silent, more, text)


class TestRemoteManager(BridgeConformance):
    """The whole suite."""

    kinds = KINDS

    @pytest.fixture
    def world(self, robot: ServedRobot) -> World:
        return ManagerWorld(robot)


@pytest.fixture(scope="module")
def lasting() -> Iterator[ServedRobot]:
    """A robot for all tests that do not end its server; each has functions of its own there."""
    made = ServedRobot()
    yield made
    made.close()


@pytest.fixture(scope="module")
def shared(lasting: ServedRobot) -> Iterator[Bridge]:
    with shared_host(ManagerWorld(lasting).spec()) as made:
        made.discover()  # connects it to the server, whose sockets are in this process
        yield made


# Threads of the lasting server: they begin with the first large message, or again after a rest.
@pytest.mark.keeps("thread 'uoarm-decode", "thread 'uoarm-encode", "thread 'uoarm-serve-")
class TestInAHost(SharesHost, TestRemoteManager):  # type: ignore[misc]
    """The whole suite with the bridge in a process of its own."""

    kinds = KINDS[:2]

    @pytest.fixture
    def world(self, lasting: ServedRobot, request: pytest.FixtureRequest) -> World:
        if self.has_own(request):
            return ManagerWorld(request.getfixturevalue("robot"))
        return ManagerWorld(lasting, f"_{next(NUMBERS)}")
