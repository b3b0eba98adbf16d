"""Simulated devices of real makers on a real tty, through the bridge."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from functools import partial
from typing import Any

import pytest
from attrs import field, frozen
from lines import LIMIT, PseudoTerminal, fresh_link
from rigs import Events, bridged, endpoint, running, unplugged_by
from tests.processes import signal_beside  # type: ignore[import-not-found]
from uoarm_rocos._catalogue import DeviceCatalogue
from uoarm_rocos._device import PendingReply
from uoarm_rocos._framing import LineError
from uoarm_rocos._options import (
    DRIVERS,
    LineOptions,
    RocosOptions,
    Timing,
)
from uoarm_rocos._transport import LineTransport
from uoarm_rocos.devices._blood_pressure import Measurement, Monitor, ua767_frame
from uoarm_rocos.devices._oximeters import contec_frame
from uoarm_rocos.simulate import (
    BloodPressureMonitor,
    Oximeter,
    Person,
    PtyEnd,
    Scenario,
    TcpEnd,
)

from uoarm.bridge import Backoff
from uoarm.errors import BridgeError, BridgeTimeoutError, FailureReason
from uoarm.model import Health, MessageStructure
from uoarm.testing import Background, patience, wait

ANY = MessageStructure(True)
PULSE = endpoint("clip", "pulseOximetry")
PRESSURE = endpoint("cuff", "bloodPressure", "service")
OXIMETERS = [("contec-cms50dplus", "contec"), ("nonin-1", "nonin-1"), ("nonin-2", "nonin-2")]


def wait_open(bridge: Any, name: str) -> None:
    """Opening a port throws away what waits in it, so wait until it is open."""
    line = bridge._named(name)._line
    wait(lambda: line._transport is not None)


@frozen
class Finger(Scenario):
    """A finger of which the test says what becomes of it, not the time."""

    states: list[str] = field(factory=lambda: ["finger-out"])

    def state(self, time: float) -> str:
        del time
        return self.states[-1]


@pytest.mark.parametrize(("driver", "kind"), OXIMETERS)
def test_an_oximeter_says_finger_out_then_searching_then_numbers(driver: str, kind: str) -> None:
    finger, got = Finger(), Events()
    oximeter = Oximeter(kind, Person(pulse=60, spo2=95), finger)
    with (
        running(oximeter, PtyEnd(fresh_link())) as url,
        bridged(clip={"driver": driver, "url": url, "wait": LIMIT}) as (bridge, _),
    ):
        source = bridge.open_source(PULSE, ANY, got)
        away = got.until(lambda item: item["quality"] in {"finger-out", "probe-error"})
        assert not {"pulse", "spo2", "waveform"} & away.keys()
        finger.states.append("searching")
        searching = got.until(lambda item: item["quality"] == "searching")
        assert not {"pulse", "spo2"} & searching.keys()
        finger.states.append("good")
        good = got.until(lambda item: "pulse" in item)
        assert good["spo2"] == 95
        assert 55 <= good["pulse"] <= 65
        assert int(str(source.facts()["discarded"])) < 5  # opening a port may cut one frame in two


@pytest.mark.parametrize(("driver", "options"), list(DRIVERS.items()))
def test_line_settings_are_the_makers_own(driver: str, options: LineOptions | None) -> None:
    url = {} if options is None else {"url": "/dev/ttyS0"}
    made = RocosOptions.of({"devices": {"d": {"driver": driver, **url}}}).devices["d"]
    if options is not None:
        assert made.line == options
    if driver.startswith("contec"):
        assert (made.line.baud, made.line.parity, made.line.xonxoff) == (19200, "O", False)
    if driver.startswith("nonin"):
        assert (made.line.baud, made.line.parity, made.line.xonxoff) == (9600, "N", False)


def test_what_the_options_say_of_drivers_and_limits_is_so() -> None:
    usual: dict[str, object] = {"url": "tcp://robot:1"}
    given: dict[str, object] = {**usual, "wait": 1, "grace": 2, "backoff": [0.3, 0.4]}
    made = RocosOptions.of({"devices": {"usual": usual, "given": given}}).devices
    assert made["usual"].timing == Timing(3.0, 5.0, Backoff(0.1, 2.0))
    assert made["given"].timing == Timing(1, 2, Backoff(0.3, 0.4))


def test_octets_that_look_like_flow_control_are_numbers() -> None:
    with (
        PseudoTerminal() as device,
        bridged(clip={"driver": "contec-cms50dplus", "url": device.path}) as (bridge, _),
    ):
        got = Events()
        wait_open(bridge, "clip")
        device.write(contec_frame(pulse=70, spo2=97))
        bridge.open_source(PULSE, ANY, got)
        device.write(contec_frame(pulse=0x11, spo2=0x13, wave=0x13))
        low = got.until(lambda item: item["pulse"] == 0x11)
        assert (low["spo2"], low["waveform"]) == (0x13, 0x13 / 127)


def test_an_oximeter_over_a_network_socket() -> None:
    got = Events()
    with running(Oximeter("contec"), TcpEnd()) as url:
        clip: dict[str, object] = {
            "driver": "contec-cms50dplus",
            "url": url.replace("tcp://", "socket://"),
        }
        with bridged(clip=clip) as (bridge, _):
            bridge.open_source(PULSE, ANY, got)
            assert got.get()["quality"] == "searching"


def test_two_receivers_get_the_same() -> None:
    one, two = Events(), Events()
    with (
        running(Oximeter("contec"), PtyEnd(fresh_link())) as url,
        bridged(clip={"driver": "contec-cms50dplus", "url": url}) as (bridge, _),
    ):
        first = bridge.open_source(PULSE, ANY, one)
        bridge.open_source(PULSE, ANY, two)
        both_receive = two.get()
        one.until(lambda message: message == both_receive)
        mine = [one.get() for _ in range(120)]
        first.close()
        other = [two.get() for _ in range(120)]
        assert [message for message in mine if message in other] == mine
        assert first.facts()["lost_on_link"] == 0


def test_an_oximeter_that_is_switched_off_is_degraded_then_lost_and_said_why() -> None:
    with PseudoTerminal() as device:
        clip = {"driver": "contec-cms50dplus", "url": device.path, "grace": 0.3}
        with bridged(clip=clip) as (bridge, events):
            wait_open(bridge, "clip")
            device.write(contec_frame(pulse=70, spo2=97))
            source = bridge.open_source(PULSE, ANY, Events())
            silent = events.until(lambda item: item.channel is source)
            assert silent.health is Health.DEGRADED
            assert silent.cause.startswith(
                "silent: flow pulseOximetry of clip: no message for 1 s: is"
            )
            assert events.until(lambda item: item.channel is source).health is Health.LOST


def test_a_port_where_nothing_speaks_is_unavailable() -> None:
    with PseudoTerminal() as device:
        clip = {"driver": "nonin-1", "url": device.path, "wait": 0.3}
        with (
            bridged(clip=clip) as (bridge, _),
            pytest.raises(BridgeError, match="is the device on"),
        ):
            bridge.describe(PULSE)


def test_octets_of_no_frame_are_named_and_counted_over_connections() -> None:
    with PseudoTerminal() as device:
        clip = {"driver": "contec-cms50dplus", "url": device.path, "wait": 0.3}
        with bridged(clip=clip) as (bridge, _):
            wait_open(bridge, "clip")
            clip_device = bridge._named("clip")  # type: ignore[attr-defined]  # of this bridge
            device.write(bytes(7))
            wait(lambda: clip_device.facts() == {"discarded": 7})
            with pytest.raises(BridgeError, match="7 octets came that are no frame: are its"):
                bridge.describe(PULSE)
            device.write(contec_frame(spo2=97))
            source = bridge.open_source(PULSE, ANY, Events())
            clip_device.connected()  # as where the line is opened again
            assert source.facts()["discarded"] == 7


def test_an_unplugged_oximeter_comes_back() -> None:
    got, pulled = Events(), threading.Event()
    with (
        running(Oximeter("contec"), unplugged_by(TcpEnd(), pulled)) as url,
        bridged(clip={"driver": "contec-cms50dplus", "url": url.replace("tcp", "socket")}) as (
            bridge,
            events,
        ),
    ):
        source = bridge.open_source(PULSE, ANY, got)
        pulled.set()
        lost = events.until(lambda item: item.channel is source)
        assert lost.health is Health.DEGRADED
        assert "lost" in lost.cause
        assert events.until(lambda item: item.channel is source).health is Health.OK


def test_a_call_waits_for_a_measurement_and_the_monitor_gets_its_acknowledgement() -> None:
    monitor = BloodPressureMonitor(Person(systolic=120, diastolic=80), interval=0.3)
    with (
        running(monitor, PtyEnd(fresh_link())) as url,
        bridged(cuff={"driver": "and-ua767pbt", "url": url}) as (bridge, _),
    ):
        structure = bridge.describe(PRESSURE).reply
        assert structure
        reading = bridge.call(PRESSURE, {}, timeout=LIMIT)
        assert abs(reading["systolic"] - 120) <= 6
        assert abs(reading["diastolic"] - 80) <= 3
        assert reading["diastolic"] < reading["mean"] < reading["systolic"]
        assert reading["serialNumber"] == "SIMULATED"
        again = bridge.call(PRESSURE, {}, timeout=LIMIT)
        assert again["diastolic"] > 0
    assert set(monitor.answers) == {b"PWA1"}


def test_a_measurement_without_a_call_is_not_acknowledged_and_a_broken_one_is_refused() -> None:
    frame = ua767_frame(Measurement(105, 76, 82, 65))
    with PseudoTerminal() as device:
        cuff: dict[str, object] = {"driver": "and-ua767pbt", "url": device.path}
        with bridged(cuff=cuff) as (bridge, _):
            bridge.describe(PRESSURE)
            device.write(frame)
            device.write(frame[:-1] + b"?")
            assert device.read(4) == b"PWA0"
            call = Background(partial(bridge.call, PRESSURE, {}))
            waiting = bridge._devices["cuff"]  # type: ignore[attr-defined]  # no public way to see
            wait(lambda: waiting._waiting)
            device.write(frame)
            assert device.read(4) == b"PWA1"
            assert call.result()["systolic"] == 105


def test_a_call_ends_without_a_measurement_and_when_the_cable_is_out() -> None:
    with PseudoTerminal() as device:
        cuff: dict[str, object] = {"driver": "and-ua767pbt", "url": device.path}
        with bridged(cuff=cuff) as (bridge, _):
            bridge.describe(PRESSURE)  # which waits for the device, as the short call cannot
            with pytest.raises(BridgeTimeoutError):
                bridge.call(PRESSURE, {}, timeout=0.2)
            monitor = bridge._devices["cuff"]  # type: ignore[attr-defined]  # no public way to see
            wait(lambda: not monitor._waiting)  # the first call, which the core has given up
            call = Background(partial(bridge.call, PRESSURE, {}, timeout=2 * LIMIT))
            wait(lambda: monitor._waiting)
            device.cut()
            with pytest.raises(BridgeError, match="is lost"):
                call.result()


def test_a_measurement_that_is_acknowledged_as_the_time_is_up_is_the_reply(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    with PseudoTerminal() as device:
        cuff: dict[str, object] = {"driver": "and-ua767pbt", "url": device.path}
        with bridged(cuff=cuff) as (bridge, _):
            bridge.describe(PRESSURE)
            ended = PendingReply.wait

            def wait_too_long(reply: PendingReply, timeout: float) -> bool:
                monkeypatch.setattr(PendingReply, "wait", ended)
                device.write(ua767_frame(Measurement(105, 76, 82, 65)))
                assert device.read(4) == b"PWA1"
                return False

            monkeypatch.setattr(PendingReply, "wait", wait_too_long)
            assert bridge.call(PRESSURE, {}, timeout=LIMIT)["systolic"] == 105


class DeafTransport(LineTransport):
    """Brings octets and takes none."""

    def __init__(self, brings: bytes) -> None:
        self.brings = brings

    def open(self, timeout: float) -> None:
        """Is open."""

    def read(self) -> bytes:
        brought, self.brings = self.brings, b""
        return brought

    def write(self, data: bytes) -> None:
        raise LineError("it takes nothing")

    def close(self) -> None:
        """Has nothing to let go of."""


@pytest.fixture
def deaf() -> Iterator[tuple[Monitor, DeafTransport]]:
    """A monitor whose measurements cannot be acknowledged."""
    line = DeafTransport(b"")
    monitor = Monitor("cuff", lambda: line, Timing(), lambda *_: None)
    yield monitor, line
    monitor.close()


def test_a_call_whose_measurement_cannot_be_acknowledged_fails_at_once(
    deaf: tuple[Monitor, DeafTransport],
) -> None:
    monitor, line = deaf
    (api,) = monitor.catalogue(LIMIT).apis.values()
    call = Background(partial(monitor.call, api, {}, 2 * LIMIT))
    wait(lambda: monitor._waiting)
    line.brings = ua767_frame(Measurement(105, 76, 82, 65))
    with pytest.raises(BridgeError, match=r"^the line to cuff is lost: it takes nothing$"):
        call.result()


def test_a_call_that_is_made_while_the_monitor_is_closed_does_not_wait(
    deaf: tuple[Monitor, DeafTransport], monkeypatch: pytest.MonkeyPatch
) -> None:
    monitor, _ = deaf
    (api,) = monitor.catalogue(LIMIT).apis.values()

    def closed_after(timeout: float) -> DeviceCatalogue:
        found = Monitor.catalogue(monitor, timeout)
        monitor.close()
        return found

    monkeypatch.setattr(monitor, "catalogue", closed_after)
    with pytest.raises(BridgeError, match="cuff is closed") as raised:
        monitor.call(api, {}, LIMIT)
    assert raised.value.reason is FailureReason.CLOSED


def test_a_signal_that_came_in_another_thread_is_handled_while_a_reply_is_awaited() -> None:
    reply = PendingReply()
    with signal_beside(lambda: reply.give("handled"), PendingReply.wait):
        assert reply.wait(patience())
