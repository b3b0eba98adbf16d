"""The modelled person and robot do what their models say, and the faults are the ones asked for."""

from __future__ import annotations

import itertools
import math
import socket
import threading
from typing import Any, ClassVar

import pytest
from lines import LIMIT
from rigs import running
from uoarm_rocos._catalogue import (
    Api,
    ApiKind,
    DataMessage,
    DeviceCatalogue,
    Direction,
    Fields,
    IntegerField,
    NamedField,
    OpenMessage,
    WireMessage,
)
from uoarm_rocos._codec import XmlCodec
from uoarm_rocos._framing import LengthFramer
from uoarm_rocos.devices._oximeters import ContecDecoder
from uoarm_rocos.simulate import (
    BloodPressureMonitor,
    LineFaults,
    Oximeter,
    Person,
    ProfileServer,
    Scenario,
    SimulatedRobot,
    TcpEnd,
)
from uoarm_rocos.simulate._run import _FaultyTransport


def test_the_pulse_wave_has_the_persons_rate_and_keeps_its_bounds() -> None:
    person = Person(pulse=75, spo2=96)
    waves = [person.at(n / 100).wave for n in range(6000)]
    assert 0.0 <= min(waves) < 0.2
    assert 0.85 < max(waves) <= 1.0
    assert person.at(60).beat == pytest.approx(75, abs=1)
    middle = (max(waves) + min(waves)) / 2
    pairs = itertools.pairwise(waves)
    rising = sum(value < middle <= two for value, two in pairs)
    assert rising == pytest.approx(75, abs=2)


def test_the_rate_that_is_reported_is_the_rate_at_which_the_heart_beats() -> None:
    person = Person()
    for start in (3.0, 17.5, 40.2):
        step = 0.001
        report = person.at(start).pulse
        beats = person._beats(
            start + step, *(math.tau * hz * (start + step) for hz in (0.25, 0.1))
        ) - person._beats(start, *(math.tau * hz * start for hz in (0.25, 0.1)))
        assert beats / step * 60 == pytest.approx(report, abs=0.05)


def test_apnoea_lowers_the_saturation_and_lets_it_recover() -> None:
    person = Person(spo2=97, apnoea=60)
    levels = [person.at(second).spo2 for second in range(61)]
    assert levels[0] == 97
    assert min(levels) == pytest.approx(91, abs=0.1)
    assert levels[60] == pytest.approx(97, abs=0.1)


def test_an_oximeter_sends_sixty_frames_a_second_and_skips_what_is_long_past() -> None:
    oximeter = Oximeter("contec", scenario=Scenario(found=0.0))
    oximeter.begin(100.0)
    frames = oximeter.step(101.0)
    assert len(frames) == 60
    assert len(oximeter.step(201.0)) == 60
    messages = ContecDecoder().feed(b"".join(frames))
    assert {message["quality"] for message in messages} == {"good"}
    assert any(message["beat"] for message in messages)


def test_a_finger_is_out_then_searched_for_a_while_then_measured_and_out_again() -> None:
    oximeter = Oximeter("contec", scenario=Scenario(finger_in=2.0, found=3.0, finger_out=6.0))
    oximeter.begin(0.0)
    decoder = ContecDecoder()
    found = [decoder.feed(b"".join(oximeter.step(second)))[-1] for second in (1.5, 3.5, 5.5, 6.5)]
    qualities = [message["quality"] for message in found]
    assert qualities == ["finger-out", "searching", "good", "finger-out"]


def test_a_reading_is_sent_until_it_is_accepted() -> None:
    monitor = BloodPressureMonitor(interval=1.0)
    monitor.begin(0.0)
    assert monitor.step(0.5) == []
    (frame,) = monitor.step(1.0)
    assert monitor.step(1.1) == []
    assert monitor.receive(b"PW", 1.2) == []
    monitor.receive(b"A0", 1.3)
    assert monitor.step(1.4) == []  # refused: sent again, but not in a storm
    assert monitor.step(3.5) == [frame]
    monitor.receive(b"PWA1", 3.6)
    assert monitor.step(3.7) != [frame]  # the next reading


def test_the_robot_drives_a_circle() -> None:
    robot = SimulatedRobot()
    robot.sample("odometry", 0.0)
    for step in range(629):
        robot.take("velocity", {"linear": 0.5, "angular": 1.0}, step / 100)
    end = robot.sample("odometry", 6.29)
    assert end
    assert (end["x"], end["y"]) == (pytest.approx(0, abs=0.01), pytest.approx(0, abs=0.01))


def test_the_robot_stops_half_a_second_after_the_last_command() -> None:
    robot = SimulatedRobot()
    robot.sample("odometry", 0.0)
    robot.take("velocity", {"linear": 0.5, "angular": 0.0}, 0.0)
    end = robot.sample("odometry", 10.0)
    assert end
    assert end["x"] == pytest.approx(0.25)


def test_a_new_command_interrupts_a_drive() -> None:
    robot = SimulatedRobot()
    job = robot.call("driveStraight", {"distance": 1.0, "speed": 0.5}, 0.0)
    assert callable(job)
    assert job(1.0) is None
    robot.take("velocity", {"linear": 0.0, "angular": 0.0}, 1.0)
    assert job(1.0) == {"outcome": "interrupted", "driven": 0.5}


def test_what_came_before_a_flow_was_opened_is_not_sent_to_it() -> None:
    """Though all of it comes in one read."""
    flow: Fields = {"value": NamedField(IntegerField(0, 9))}

    class Mirror(SimulatedRobot):
        came: ClassVar[list[tuple[str, dict[str, Any]]]] = []

        def take(self, api: str, values: dict[str, Any], now: float) -> None:
            self.came.append((api, values))

        def events(self, now: float) -> list[tuple[str, dict[str, Any]]]:
            came = self.came.copy()
            self.came.clear()
            return came

    mirror = Mirror(DeviceCatalogue("mirror", {"loop": Api("loop", ApiKind.FLOW, flow, flow)}))
    codec, framer = XmlCodec(), LengthFramer()
    sent: list[WireMessage] = [
        OpenMessage(0, 1, "loop", Direction.INPUT),
        OpenMessage(1, 2, "loop", Direction.OUTPUT),
        DataMessage(2, 1, {"value": 7}, 0.0),
        OpenMessage(3, 3, "loop", Direction.OUTPUT),
        DataMessage(4, 1, {"value": 8}, 0.0),
    ]
    device = ProfileServer(mirror, LengthFramer)
    octets = b"".join(framer.frame(codec.write(message)) for message in sent)
    answered = [*device.receive(octets, 0.0), *device.step(0.0)]
    came = [codec.read(part) for frame in answered for part in LengthFramer().feed(frame)]
    values = [(data.id, data.values["value"]) for data in came if isinstance(data, DataMessage)]
    assert values == [(2, 7), (2, 8), (3, 8)]


class _Sent:
    def __init__(self) -> None:
        self.frames: list[bytes] = []

    def write(self, data: bytes) -> None:
        self.frames.append(data)


def sent_with(faults: LineFaults, count: int) -> tuple[list[bytes], _FaultyTransport, _Sent]:
    end = _Sent()
    way = _FaultyTransport(end, faults)  # type: ignore[arg-type]  # an end of which only write is used
    for number in range(count):
        way.send([bytes([number] * 10)], float(number))
    return end.frames, way, end


def test_faults_are_as_frequent_as_asked_and_the_same_again() -> None:
    dropped, _, _ = sent_with(LineFaults(drop=0.3, seed=1), 200)
    assert 110 < len(dropped) < 170
    assert dropped == sent_with(LineFaults(drop=0.3, seed=1), 200)[0]
    garbled, _, _ = sent_with(LineFaults(garble=0.5, seed=2), 200)
    broken = [frame for frame in garbled if len(set(frame)) > 1]
    assert 70 < len(broken) < 130


def test_delayed_frames_come_later_and_in_order() -> None:
    frames, way, end = sent_with(LineFaults(delay=2.5), 10)
    assert [frame[0] for frame in frames] == list(range(7))
    way.send([], 20.0)
    assert [frame[0] for frame in end.frames] == list(range(10))


def test_the_cable_is_pulled_out_when_asked_and_put_in_again() -> None:
    _, way, _ = sent_with(LineFaults(disconnect=2.5), 1)
    assert not way.cut_due(2.4)
    assert way.cut_due(2.5)
    device, end = _Numbered(), TcpEnd()
    where = ("127.0.0.1", int(end.where.rpartition(":")[2]))
    with running(device, end, LineFaults(disconnect=0.0)):
        for _ in range(2):
            with socket.create_connection(where, LIMIT) as host:
                assert host.recv(1) == b""
    assert device.hosts == 2


class _Numbered:
    """Answers every host with its number."""

    def __init__(self) -> None:
        self.hosts = 0
        self.asked = threading.Event()

    def begin(self, now: float) -> None:
        self.hosts += 1

    def receive(self, data: bytes, now: float) -> list[bytes]:
        self.asked.set()
        return [b"%d" % self.hosts]

    def step(self, now: float) -> list[bytes]:
        return []


def test_what_is_late_for_a_host_that_has_gone_never_reaches_the_next() -> None:
    device = _Numbered()
    end = TcpEnd()
    where = ("127.0.0.1", int(end.where.rpartition(":")[2]))
    with running(device, end, LineFaults(delay=0.2)):
        with socket.create_connection(where, LIMIT) as first:
            first.sendall(b"?")
            assert device.asked.wait(LIMIT)
        with socket.create_connection(where, LIMIT) as second:
            second.sendall(b"?")
            assert second.recv(1) == b"2"
