"""What goes wrong on real lines: the cable, garbage, floods, silence, other devices."""

from __future__ import annotations

import math
import re
import socket
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack, contextmanager, suppress
from functools import partial
from pathlib import Path
from threading import Event
from typing import Any

import pytest
from attrs import evolve
from lines import LIMIT, PseudoTerminal, fresh_link, listening
from rigs import Events, bridged, endpoint, running, unplugged_by
from uoarm_rocos import _profile
from uoarm_rocos._catalogue import (
    BooleanField,
    CallMessage,
    CatalogueMessage,
    DataMessage,
    DescribeMessage,
    DeviceCatalogue,
    NamedField,
    OpenMessage,
    ResultMessage,
    WireMessage,
)
from uoarm_rocos._codec import XmlCodec
from uoarm_rocos._device import PendingReply
from uoarm_rocos._framing import Framer, LengthFramer, LineError, StuffedFramer
from uoarm_rocos._options import Timing
from uoarm_rocos._transport import LineTransport
from uoarm_rocos.devices._blood_pressure import Monitor
from uoarm_rocos.simulate import Job, ProfileServer, PtyEnd, SimulatedRobot, TcpEnd, robot_catalogue

from uoarm import RobotManager
from uoarm.bridge import Backoff
from uoarm.config import loads
from uoarm.errors import BridgeError, BridgeTimeoutError, FailureReason
from uoarm.model import Health, MessageStructure
from uoarm.testing import Background, Collector, slowness, wait

ANY = MessageStructure(True)
ODOMETRY = endpoint("robot", "odometry")
ECHO = endpoint("robot", "echo", "service")
CODEC = XmlCodec()


def other_catalogue() -> DeviceCatalogue:
    """The robot's catalogue with another odometry and another echo."""
    apis = dict(robot_catalogue().apis)
    for name in ("odometry", "echo"):
        more = {**apis[name].output, "more": NamedField(BooleanField(), required=False)}
        apis[name] = evolve(apis[name], output=more)
    return evolve(robot_catalogue(), apis=apis)


def port_of(url: str) -> int:
    return int(url.rpartition(":")[2])


def server(catalogue: DeviceCatalogue | None = None) -> ProfileServer:
    return ProfileServer(SimulatedRobot(catalogue), LengthFramer)


def test_a_device_that_comes_back_goes_on_with_its_flows() -> None:
    got, pulled = Events(), Event()
    with (
        running(server(), unplugged_by(TcpEnd(), pulled)) as url,
        bridged(robot={"url": url}) as (bridge, events),
    ):
        source = bridge.open_source(ODOMETRY, ANY, got)
        pulled.set()
        lost = events.until(lambda item: item.channel is source)
        assert lost.health is Health.DEGRADED
        assert "closed the connection" in lost.cause
        back = events.until(lambda item: item.channel is source)
        assert (back.health, back.cause) == (
            Health.OK,
            "flow odometry of robot: a peer is connected",
        )
        while not got.queue.empty():
            got.get()
        assert "x" in got.get()


def test_a_device_that_stays_away_is_lost_after_its_grace_with_the_cause() -> None:
    with ExitStack() as stack:
        with running(server(), TcpEnd()) as url:
            robot: dict[str, object] = {"url": url, "grace": 0.3}
            bridge, events = stack.enter_context(bridged(robot=robot))
            source = bridge.open_source(ODOMETRY, ANY, Events())
            bridge.describe(ECHO)
        assert events.until(lambda item: item.channel is source).health is Health.DEGRADED
        events.until(lambda item: item.component == "robot" and item.health is Health.LOST)
        lost = events.until(lambda item: item.channel is source)
        assert lost.health is Health.LOST
        assert "refused" in lost.cause
        with pytest.raises(BridgeError, match="refused") as raised:
            bridge.call(ECHO, {"text": "gone"}, timeout=0.3)
        assert raised.value.reason is FailureReason.UNAVAILABLE


class Garbling:
    """Writes what the device says as it is, but for what should be garbled."""

    def __init__(self, *kinds: type) -> None:
        self._kinds = kinds

    def write(self, message: WireMessage) -> bytes:
        return b"<garbled" if isinstance(message, self._kinds) else CODEC.write(message)

    def read(self, frame: bytes) -> WireMessage:
        return CODEC.read(frame)


@pytest.mark.parametrize("what", ["call", "flow"])
def test_an_answer_that_cannot_be_read_is_named_where_it_is_waited_for(
    monkeypatch: pytest.MonkeyPatch, what: str
) -> None:
    device = ProfileServer(SimulatedRobot(), StuffedFramer)
    device._codec = Garbling(ResultMessage, OpenMessage)  # type: ignore[assignment] # what is used of it
    with (
        running(device, PtyEnd(fresh_link())) as url,
        bridged(robot={"url": url}) as (bridge, _),
    ):
        bridge.describe(ECHO)
        robot: Any = bridge._devices["robot"]  # type: ignore[attr-defined] # no public way to see
        give_up = PendingReply.wait

        def wait_too_long(reply: PendingReply, timeout: float) -> bool:
            """Have the time be up once something came, and not before."""
            wait(lambda: robot._conversation.refused)
            return give_up(reply, 0.0)

        monkeypatch.setattr(PendingReply, "wait", wait_too_long)

        def ask() -> object:
            if what == "call":
                return bridge.call(ECHO, {"text": "a"}, timeout=LIMIT)
            return bridge.open_source(ODOMETRY, ANY, Events(), timeout=LIMIT)

        with pytest.raises(
            BridgeTimeoutError, match=r"no answer .*; a message came that cannot be"
        ):
            ask()


def test_a_catalogue_that_cannot_be_read_is_named_where_none_comes(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    tick = _profile.Conversation.tick

    def tick_late(conversation: _profile.Conversation, now: float) -> None:
        """Have the time be up once something came, and not before."""
        came = conversation.refused > conversation._refused_before
        _profile._CATALOGUE_SECONDS = 0.0 if came else math.inf
        tick(conversation, now)

    monkeypatch.setattr(_profile, "_CATALOGUE_SECONDS", math.inf)
    monkeypatch.setattr(_profile.Conversation, "tick", tick_late)
    device = ProfileServer(SimulatedRobot(), StuffedFramer)
    device._codec = Garbling(CatalogueMessage)  # type: ignore[assignment] # as above
    with (
        running(device, PtyEnd(fresh_link())) as url,
        bridged(robot={"url": url, "wait": 0.1}) as (bridge, _),
    ):

        def cause() -> str:
            with pytest.raises(BridgeError) as caught:
                bridge.describe(ECHO, timeout=LIMIT)
            return str(caught.value)

        wait(lambda: re.search(r"no catalogue within .*came that cannot be read", cause()))


def test_a_call_under_way_fails_at_once_when_the_cable_is_out() -> None:
    pulled = Event()

    class Driving(SimulatedRobot):
        """Has its cable pulled out when it begins to drive."""

        def call(self, api: str, values: dict[str, Any], now: float) -> dict[str, Any] | Job:
            pulled.set()
            return super().call(api, values, now)

    with (
        running(ProfileServer(Driving(), LengthFramer), unplugged_by(TcpEnd(), pulled)) as url,
        bridged(robot={"url": url}) as (bridge, _),
    ):
        drive = endpoint("robot", "driveStraight", "service")
        with pytest.raises(BridgeError, match=r"lost: .*closed the connection"):
            bridge.call(drive, {"distance": 5, "speed": 0.01}, timeout=2 * LIMIT)


def test_another_catalogue_after_reconnecting_is_refused_with_the_difference() -> None:
    got = Events()
    with ExitStack() as stack:
        with running(server(), TcpEnd()) as url:
            bridge, events = stack.enter_context(bridged(robot={"url": url}))
            source = bridge.open_source(ODOMETRY, ANY, got)
            structure = bridge.describe(ODOMETRY).message
            bridge.describe(ECHO)
            got.get()
        with running(server(other_catalogue()), TcpEnd(port_of(url))):
            assert structure
            changed = events.until(lambda item: item.component and item.health is Health.LOST)
            assert "'echo' changed" in changed.cause
            lost = events.until(lambda item: item.channel is source)
            assert lost.health is Health.LOST
            assert (
                "refused: flow odometry of robot: after reconnecting, API 'odometry' changed"
                in lost.cause
            )
            assert "output.more is new" in lost.cause
            with pytest.raises(BridgeError, match="more is new") as raised:
                bridge.call(ECHO, {"text": "no"})
            assert raised.value.reason is FailureReason.CONTRACT
            with pytest.raises(BridgeError, match="another catalogue"):
                bridge.open_source(ODOMETRY, structure, got)
            fresh = bridge.describe(ODOMETRY).message
            assert fresh
            assert fresh != structure
            bridge.open_source(ODOMETRY, fresh, got)  # checked again, so it may be used again


def test_a_service_is_well_again_only_with_the_catalogue_that_it_was_described_with() -> None:
    with ExitStack() as stack:
        with running(server(), TcpEnd()) as url:
            bridge, events = stack.enter_context(bridged(robot={"url": url}))
            for name in ("echo", "driveStraight"):
                bridge.describe(endpoint("robot", name, "service"))

        def judged() -> Any:
            return events.until(lambda item: item.component and "disconnected" not in item.cause)

        for catalogue, health in (
            (other_catalogue(), Health.LOST),
            (other_catalogue(), Health.LOST),  # the same once more mends nothing
            (robot_catalogue(), Health.OK),
        ):
            with running(server(catalogue), TcpEnd(port_of(url))):
                assert judged().health is health


CALLED = """
version: 1
bridges: {rocos: {plugin: rocos, options: {devices: {robot: {url: "tcp://127.0.0.1:1"}}}}}
functions:
  echo: {components: [{name: echo, bridge: rocos, service: {endpoint: [robot, echo]}}]}
"""


def test_a_user_sees_how_a_device_is_that_is_called() -> None:
    with ExitStack() as stack:
        with running(server(), TcpEnd()) as url:
            bridge, _ = stack.enter_context(bridged(robot={"url": url, "grace": 0.3}))
            manager = stack.enter_context(RobotManager(loads(CALLED), bridges={"rocos": bridge}))

            def shown() -> list[str]:
                return [
                    f"{item.health.value}: {item.cause}" for item in manager.status().components
                ]

            manager.call("echo", {"text": "hi"}, timeout=LIMIT)
            assert shown() == []
        wait(lambda: str(shown()).startswith("['lost: disconnected: the line to robot is lost"))
        with running(server(other_catalogue()), TcpEnd(port_of(url))):
            wait(lambda: "API 'echo' changed" in str(shown()))
        with running(server(robot_catalogue()), TcpEnd(port_of(url))):
            wait(lambda: not shown())
            manager.call("echo", {"text": "hi"}, timeout=LIMIT)


def test_a_serial_device_may_be_unplugged_and_plugged_in_elsewhere(tmp_path: Path) -> None:
    link = str(tmp_path / "robot-port")
    got, pulled = Events(), Event()
    device = ProfileServer(SimulatedRobot(), StuffedFramer)
    with (
        running(device, unplugged_by(PtyEnd(link), pulled)) as url,
        bridged(robot={"url": url}) as (bridge, events),
    ):
        assert url == link
        source = bridge.open_source(ODOMETRY, ANY, got)
        pulled.set()
        assert events.until(lambda item: item.channel is source).health is Health.DEGRADED
        assert events.until(lambda item: item.channel is source).health is Health.OK


class Scripted:
    """A device that says what the test wants, on a socket."""

    def __init__(self, connection: socket.socket) -> None:
        connection.settimeout(LIMIT)
        self.connection = connection
        self.framer: Framer = LengthFramer()
        self.seq = 0
        self.flow = 0
        self._read: list[WireMessage] = []

    def say(self, build: Callable[[int], WireMessage]) -> None:
        self.connection.sendall(self.framer.frame(CODEC.write(build(self.seq))))
        self.seq += 1

    def receive(self, kind: type[WireMessage]) -> WireMessage:
        """Return the first message of a kind; others wait for their turn."""
        while True:
            for place, message in enumerate(self._read):
                if isinstance(message, kind):
                    return self._read.pop(place)
            data = self.connection.recv(10_000)
            assert data
            self._read += [CODEC.read(part) for part in self.framer.feed(data)]

    def begin(self, heartbeat: float = 20.0) -> None:
        """Give the robot's catalogue, with time to think on a busy machine."""
        asked = self.receive(DescribeMessage)
        assert isinstance(asked, DescribeMessage)
        catalogue = evolve(robot_catalogue(), heartbeat=heartbeat)
        self.say(lambda seq: CatalogueMessage(seq, asked.id, catalogue))

    def opened(self) -> int:
        """Confirm a flow and return its id."""
        asked = self.receive(OpenMessage)
        assert isinstance(asked, OpenMessage)
        self.say(lambda seq: evolve(asked, seq=seq))
        return asked.id


@contextmanager
def scripted(
    heartbeat: float = 20.0, **options: object
) -> Iterator[tuple[Scripted, Events, Events]]:
    """A scripted device whose odometry is open: device, messages, events."""
    got = Events()
    with (
        listening() as (listener, port),
        bridged(robot={"url": f"tcp://127.0.0.1:{port}", **options}) as (bridge, events),
    ):
        opening = Background(partial(bridge.open_source, ODOMETRY, ANY, got))
        device = Scripted(listener.accept()[0])
        device.begin(heartbeat)
        device.flow = device.opened()
        opening.result()
        with device.connection:
            yield device, got, events


GOOD = {"x": 1.0, "y": 0.0, "heading": 0.0}


def test_silence_of_a_flow_degrades_it_and_then_loses_it() -> None:
    with scripted(grace=0.3 * slowness()) as (_, _got, events):
        said = events.until(lambda item: item.channel is not None)
        assert said.health is Health.DEGRADED
        assert said.cause == "silent: flow odometry of robot: no message for 1 s"
        assert events.until(lambda item: item.channel is not None).health is Health.LOST


def test_a_device_without_a_heartbeat_is_dropped() -> None:
    with scripted(heartbeat=1.0) as (device, _, events):
        lost = events.until(lambda item: item.channel and "line" in item.cause)
        assert "said nothing for" in lost.cause
        with suppress(OSError):
            while device.connection.recv(10_000):
                pass  # what the host still had to say


def test_a_call_on_a_line_that_is_lost_before_it_is_ready_again_fails_at_once(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    with (
        listening() as (listener, port),
        bridged(robot={"url": f"tcp://127.0.0.1:{port}"}) as (bridge, _),
    ):
        robot = bridge._named("robot")  # type: ignore[attr-defined]  # no public way to it
        first = Scripted(listener.accept()[0])
        first.begin()
        api = robot.catalogue(LIMIT).apis["echo"]
        first.connection.close()
        second = Scripted(listener.accept()[0])
        second.receive(DescribeMessage)
        # A call that saw the device there a moment before it was lost.
        monkeypatch.setattr(robot, "_await", lambda timeout: None)
        call = Background(partial(robot.call, api, {"text": "x"}, 60))
        second.receive(CallMessage)
        second.connection.close()
        with pytest.raises(BridgeError, match="was lost"):
            call.result()


def test_a_transport_that_cannot_be_made_is_tried_again_and_its_cause_is_reported() -> None:
    attempts = Events()

    def made() -> LineTransport:
        attempts("tried")
        raise ImportError("no module named vendor")

    line = Monitor("cuff", made, Timing(backoff=Backoff(0.001, 0.001)), lambda *_: None)
    attempts.get()
    attempts.get()
    with pytest.raises(LineError, match="ImportError: no module named vendor"):
        line.catalogue(0.0)
    line.close()


def test_data_that_break_the_catalogue_are_dropped_and_shown() -> None:
    with scripted() as (device, got, events):
        flow = device.flow
        device.say(lambda seq: DataMessage(seq, flow, {"x": "far", "y": 0.0, "heading": 0.0}))
        device.say(lambda seq: DataMessage(seq, flow, GOOD))
        assert got.get() == GOOD
        [said] = got.unread
        assert said.startswith("the device breaks its catalogue: data of odometry.x: expected a ")
        assert events.queue.empty(), "the core judges by it, not the bridge"


def test_what_waits_for_a_slow_receiver_is_bounded_in_octets() -> None:
    collector = Collector()
    with (
        listening() as (listener, port),
        bridged(robot={"url": f"tcp://127.0.0.1:{port}"}) as (bridge, _),
        ThreadPoolExecutor(1) as pool,
        collector.held(),
    ):
        opening = pool.submit(bridge.open_source, ODOMETRY, ANY, collector)
        device = Scripted(listener.accept()[0])
        with device.connection:
            device.begin()
            flow = device.opened()
            source = opening.result(LIMIT)
            for seq in range(device.seq, device.seq + 20):
                written = CODEC.write(DataMessage(seq, flow, GOOD))
                wide = written.replace(b"</data>", b" " * 1_000_000 + b"</data>")
                device.connection.sendall(device.framer.frame(wide))
            wait(lambda: source.facts()["received"] == 20, lambda: f"{source.facts()}", LIMIT)
            # 8 of them wait, and the first may have been delivered before.
            assert source.facts()["lost_on_link"] in {11, 12}


@pytest.mark.parametrize(
    ("sent", "said"),
    [
        (b"GET / HTTP/1.1\r\n\r\n", "this is not the profile over TCP"),
        (b"\x00\x00\x00\x05hello", "no XML"),
        (b"\x00\x00\x00\x14<heartbeat seq=", "closed the connection"),
        (b"\xff" * 5_000_000, "expected 1 to 1,048,576"),
    ],
    ids=["another protocol", "garbage", "half a frame", "flood"],
)
def test_what_cannot_be_read_over_tcp_ends_the_line_with_its_cause(sent: bytes, said: str) -> None:
    with scripted() as (device, _, events):
        with suppress(OSError):
            device.connection.sendall(sent)
            device.connection.shutdown(socket.SHUT_WR)
        lost = events.until(lambda item: item.channel is not None)
        assert lost.health is Health.DEGRADED
        assert said in lost.cause


def test_a_device_that_begins_anew_on_the_same_line_is_greeted_anew() -> None:
    with scripted() as (device, _, events):
        device.seq = 0
        flow = device.flow
        device.say(lambda seq: DataMessage(seq, flow, GOOD))
        assert "begun anew" in events.until(lambda item: item.channel is not None).cause


def test_garbage_and_a_flood_on_a_serial_line_harm_no_later_frame() -> None:
    with PseudoTerminal() as device, bridged(robot={"url": device.path}) as (bridge, _):
        framer = StuffedFramer()
        asking = Background(partial(bridge.describe, ODOMETRY))
        received: list[bytes] = []
        while not received:
            received = framer.feed(device.read(1))
        asked = CODEC.read(received[0])
        assert isinstance(asked, DescribeMessage)
        for _ in range(50):
            device.write(b"\x7e<half a frame \xff\x00\x7d" + b"noise" * 700)
        answer = CatalogueMessage(0, asked.id, robot_catalogue())
        device.write(framer.frame(CODEC.write(answer)))
        assert asking.result().message
        robot = bridge._devices["robot"]  # type: ignore[attr-defined]  # of this bridge
        assert robot.facts()["damaged"] == 50
        robot._conversation.connected()  # as where the line is opened again
        assert robot.facts()["damaged"] == 50
