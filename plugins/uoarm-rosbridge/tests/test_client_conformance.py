"""The client's bridge passes the suite that every bridge passes, before a server of ours."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import echoes
import pytest
from ros import Ros
from tests.harness._hosts import SharesHost, renamed, shared_host  # type: ignore[import-not-found]

from uoarm import RobotManager
from uoarm.bridge import Bridge
from uoarm.config import loads
from uoarm.model import BridgeSpec, Endpoint, Message, Role
from uoarm.server import ServerOptions, serve_in_thread
from uoarm.testing import patience, wait
from uoarm.testing.conformance import BridgeConformance, Pair, Retained, Served, Victim, World

# Pings of websockets draw numbers beside what hypothesis draws.
pytestmark = pytest.mark.filterwarnings("ignore:Do not use the `random` module")
KINDS: tuple[str, ...] = (
    "between",
    "scalars",
    "arrays",
    "image",
)  # the first is a topic between clients
SCALARS = "test_msgs/msg/Scalars"
HERE = str(Path(__file__).parent / "robot.yaml")
NUMBERS = itertools.count()


class ServedRobot:
    """A robot before which a server can be ended, and be there again on the same port."""

    def __init__(self) -> None:
        echoes.release.clear()
        self._manager = RobotManager(loads(echoes.CONFIGURATION, origin=HERE))
        self._serving = ExitStack()
        self.port = 0

    def start(self) -> None:
        server = self._serving.enter_context(
            serve_in_thread(self._manager, ServerOptions(port=self.port))
        )
        self.port = server.ports[0]
        self._await_types()

    def name(self, suffix: str) -> None:
        """Have all functions of it end, and be there again under names with a suffix."""
        self._manager.apply(loads(renamed(echoes.CONFIGURATION, suffix), origin=HERE), force=True)
        self._await_types()

    def _await_types(self) -> None:
        # What a function's type is a server knows when it has looked.
        with Ros(f"ws://127.0.0.1:{self.port}/rosbridge") as client:
            asked = {"op": "call_service", "id": "1", "service": "/rosapi/message_details"}
            fields = {**asked, "args": {"type": SCALARS}}

            def knows_types() -> bool:
                client.send(**fields)
                return client.receive()["result"] is True

            wait(knows_types, "the server does not know the types of its functions")

    def stop(self) -> None:
        self._serving.close()

    def close(self) -> None:
        self.stop()
        echoes.release.set()
        self._manager.close()


class ServerWorld(World):
    """Functions of a robot as topics and services of rosbridge.

    Args:
        robot: that has them, and is served.
        suffix: of their names and of those of all topics.
    """

    def __init__(self, robot: ServedRobot, suffix: str = "") -> None:
        self._robot, self._suffix = robot, suffix
        self._url = f"ws://127.0.0.1:{robot.port}/rosbridge"
        self._clients: list[Ros] = []

    def spec(self) -> BridgeSpec:
        options = {"url": self._url, "check": 0.2, "wait": min(patience(), 60)}
        return BridgeSpec("far", "rosbridge", options)

    def endpoint(self, name: str, role: Role, *kind: str) -> Endpoint:
        return self.at(f"/uoarm/{name}", role, *kind)

    def at(self, name: str, role: Role, *kind: str, **options: object) -> Endpoint:
        name += self._suffix
        return Endpoint("far", f"{name} component", role, (name, *kind), options=options)

    def pair(self, kind: str) -> Pair:
        if kind == "between":
            topic, free = f"/robot/{kind}", {"peer": "optional", "queue": 10_000}
            return Pair(
                self.at(topic, Role.INPUT, SCALARS, **free),
                self.at(topic, Role.OUTPUT, SCALARS, **free),
            )
        return Pair(self.endpoint(kind, Role.INPUT), self.endpoint(kind, Role.OUTPUT))

    def carried(self, kind: str, message: Message) -> Message:
        """Return what comes of a number: it is a double there."""
        return _rounded(message) if kind != "image" else message

    def missing(self) -> Endpoint:
        return self.endpoint("nowhere", Role.OUTPUT)

    def samples(self, kind: str) -> Sequence[Message]:
        if kind == "image":
            return [{"width": 1024, "data": bytes(range(256)) * 8192}]
        if kind == "arrays":
            points = [{"x": -0.0, "y": 5e-324}] * 300
            return [{"numbers": [1e308, -1e-308], "points": points, "texts": [""]}]
        whole = {"small": 255, "signed": -(2**31), "wide": 2**53 - 1}
        text = "Kia ora \u2192 \U0001f916\r\n\t"
        return [{"flag": True, **whole, "real": 0.1, "text": text}]

    def client(self) -> Ros:
        """Connect a client that plays a node behind the server."""
        self._clients.append(Ros(self._url))
        return self._clients[-1]

    def victims(self) -> Sequence[Victim]:
        made = []
        for name in ("first", "second"):
            client = self.client()
            client.send(op="advertise", topic=f"/robot/{name}{self._suffix}", type=SCALARS)
            client.call("/rosapi/get_time")
            source = self.at(f"/robot/{name}", Role.OUTPUT)
            made.append(Victim(source, client.socket.close))
        return made

    def unreadable(self, kind: str) -> Callable[[], object] | None:
        if kind != "between":  # of a function everything is checked before it is sent
            return None
        client, topic = self.client(), f"/robot/{kind}{self._suffix}"
        return lambda: client.send(op="publish", topic=topic, type=SCALARS, msg={"flag": 1})

    def retained(self) -> Retained:
        client, name = self.client(), f"/robot/speed{self._suffix}"

        def emit() -> Message:
            client.call("/rosapi/set_param", {"name": name, "value": "7"})
            return 7

        client.call("/rosapi/set_param", {"name": name, "value": "6"})
        return Retained(self.at("/robot/speed", Role.OUTPUT, "parameter"), emit)

    def close(self) -> None:
        for client in self._clients:
            client.socket.close()

    def broken(self) -> bool:
        self._robot.stop()
        return True

    def mended(self) -> None:
        self._robot.start()

    def served(self) -> Served:
        more = [
            ({"data": data}, {"success": data, "message": f"data is {data}"})
            for data in (True, False)
        ]
        request, reply = more[0]
        names = ("set", "failing", "silent")
        first, failing, silent = (self.endpoint(name, Role.SERVICE) for name in names)
        text = self.endpoint("measure", Role.SERVICE), {"text": "Kia ora"}
        return Served(first, request, reply, failing, silent, more, text)

    def servable(self) -> tuple[Endpoint, Endpoint]:
        served = self.at("/robot/offered", Role.SERVICE, "std_srvs/srv/SetBool")
        return served, self.at("/robot/offered", Role.SERVICE)


class TestRosbridgeClient(BridgeConformance):
    """The whole suite."""

    kinds = KINDS
    paths = ("between", "scalars")

    @pytest.fixture
    def world(self) -> Iterator[World]:
        robot = ServedRobot()
        robot.start()
        made = ServerWorld(robot)
        yield made
        made.close()
        robot.close()


@pytest.fixture(scope="module")
def lasting() -> Iterator[ServedRobot]:
    """A robot for all tests that do not end its server; each has names of its own there."""
    robot = ServedRobot()
    robot.start()
    yield robot
    robot.close()


@pytest.fixture(scope="module")
def shared(lasting: ServedRobot) -> Iterator[Bridge]:
    world = ServerWorld(lasting)
    with shared_host(world.spec()) as made:
        served = world.served()
        # These make each connection: the server is in this process.
        made.describe(served.endpoint)
        made.call(served.endpoint, served.request)
        yield made


# Threads of the lasting server: they begin with the first large message, or again after a rest.
@pytest.mark.keeps("thread 'uoarm-decode", "thread 'uoarm-encode", "thread 'uoarm-serve-")
class TestInAHost(SharesHost, TestRosbridgeClient):  # type: ignore[misc]
    """The whole suite with the bridge in a process of its own."""

    kinds = ("between", "scalars")

    @pytest.fixture
    def world(
        self, lasting: ServedRobot, shared: Bridge, request: pytest.FixtureRequest
    ) -> Iterator[World]:
        del shared  # begun before the functions have other names
        robot, suffix = lasting, f"_{next(NUMBERS)}"
        if self.has_own(request):
            robot, suffix = ServedRobot(), ""
            robot.start()
        else:
            echoes.release.clear()
            robot.name(suffix)
        made = ServerWorld(robot, suffix)
        yield made
        made.close()
        echoes.release.set()
        if robot is not lasting:
            robot.close()


def _rounded(value: Any) -> Any:
    if isinstance(value, dict):
        exact = ("small", "signed", "wide")
        return {key: item if key in exact else _rounded(item) for key, item in value.items()}
    if isinstance(value, list):
        return [_rounded(item) for item in value]
    return float(value) if type(value) is int else value
