"""What host and device say to each other, word by word, from the device's side."""

from __future__ import annotations

import socket
import threading
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from functools import partial

import pytest
from lines import LIMIT, listening
from rigs import bridged, endpoint
from test_faults import GOOD, Scripted, scripted
from uoarm_rocos._bridge import RocosBridge
from uoarm_rocos._catalogue import (
    CallMessage,
    CloseMessage,
    DataMessage,
    DescribeMessage,
    ErrorCode,
    ErrorMessage,
    HeartbeatMessage,
    OpenMessage,
    ResultMessage,
    WireMessage,
)
from uoarm_rocos._profile import ProfileDevice

from uoarm.bridge import Bridge, Channel
from uoarm.errors import BridgeError, BridgeTimeoutError, FailureReason
from uoarm.model import Health
from uoarm.testing import slowness, wait

ECHO = endpoint("robot", "echo", "service")
ODOMETRY = endpoint("robot", "odometry")


def answering(
    script: Callable[[Scripted], object], call: Callable[[Bridge], object], **options: object
) -> object:
    """Run a call of the bridge beside a device that follows a script; return what came of it."""
    with (
        listening() as (listener, port),
        bridged(robot={"url": f"tcp://127.0.0.1:{port}", **options}) as (bridge, _),
        ThreadPoolExecutor(1) as pool,
    ):
        asked = pool.submit(call, bridge)
        device = Scripted(listener.accept()[0])
        with device.connection:
            script(device)
            return asked.result(LIMIT)


def test_a_call_that_is_given_up_is_closed_and_its_late_result_does_no_harm() -> None:
    ids = []

    def script(device: Scripted) -> None:
        device.begin()
        late = device.receive(CallMessage)
        assert isinstance(late, CallMessage)
        closed = device.receive(CloseMessage)
        assert isinstance(closed, CloseMessage)
        ids.append((late.id, closed.id))
        device.say(lambda seq: ResultMessage(seq, late.id, {"text": "too late"}))
        again = device.receive(CallMessage)
        assert isinstance(again, CallMessage)
        ids.append((again.id, again.id))
        device.say(lambda seq: ResultMessage(seq, again.id, again.values))

    def call(bridge: Bridge) -> object:
        bridge.describe(ECHO)  # the device is there
        with pytest.raises(BridgeTimeoutError):
            bridge.call(ECHO, {"text": "one"}, timeout=slowness())
        return bridge.call(ECHO, {"text": "two"}, timeout=LIMIT)

    assert answering(script, call) == {"text": "two"}
    assert ids[0][0] == ids[0][1]
    assert ids[1][0] != ids[0][0]


@pytest.mark.parametrize(
    ("code", "reason"),
    [
        (ErrorCode.UNKNOWN_API, FailureReason.NOT_FOUND),
        (ErrorCode.BAD_INPUT, FailureReason.BAD_MESSAGE),
        (ErrorCode.BUSY, FailureReason.REFUSED),
        (ErrorCode.CANCELLED, FailureReason.REFUSED),
        (ErrorCode.FAILED, FailureReason.RAISED),
        (ErrorCode.LIMIT, FailureReason.BAD_MESSAGE),
    ],
)
def test_an_error_of_the_device_has_its_reason(code: ErrorCode, reason: FailureReason) -> None:
    def script(device: Scripted) -> None:
        device.begin()
        asked = device.receive(CallMessage)
        assert isinstance(asked, CallMessage)
        device.say(lambda seq: ErrorMessage(seq, asked.id, code, "the reason"))

    def call(bridge: Bridge) -> object:
        with pytest.raises(BridgeError, match=f"says {code.value}: the reason") as raised:
            bridge.call(ECHO, {"text": "one"})
        return raised.value.reason

    assert answering(script, call) is reason


def test_a_result_that_breaks_the_catalogue_is_an_error() -> None:
    def script(device: Scripted) -> None:
        device.begin()
        asked = device.receive(CallMessage)
        assert isinstance(asked, CallMessage)
        device.say(lambda seq: ResultMessage(seq, asked.id, {"words": "hello"}))

    def call(bridge: Bridge) -> object:
        with pytest.raises(BridgeError, match="result of echo: there is no field 'words'"):
            bridge.call(ECHO, {"text": "one"})
        return "refused"

    assert answering(script, call) == "refused"


def test_a_device_of_another_profile_says_so() -> None:
    text = "this device speaks 2"

    profiles: set[int] = set()

    def refuse(listener: socket.socket, over: threading.Event) -> None:
        """Answer so each time that it is asked: a silent device is given up for its silence."""
        while True:
            connection = listener.accept()[0]
            # A bridge that is closed while it connects anew goes before it asks, or is answered.
            with connection, suppress(OSError, AssertionError):
                if over.is_set():
                    return
                device = Scripted(connection)
                asked = device.receive(DescribeMessage)
                assert isinstance(asked, DescribeMessage)
                profiles.add(asked.profile)
                device.say(partial(_refusal, asked.id, text))
                while connection.recv(4096):  # until the bridge has read it, and gone
                    pass

    def says_so(bridge: Bridge) -> bool:
        with pytest.raises(BridgeError) as raised:
            bridge.describe(ECHO)
        return text in str(raised.value)

    with listening() as (listener, port), ThreadPoolExecutor(1) as pool:
        over = threading.Event()
        refusing = pool.submit(refuse, listener, over)
        try:
            with bridged(robot={"url": f"tcp://127.0.0.1:{port}", "wait": 0.5}) as (bridge, _):
                wait(lambda: says_so(bridge))
        finally:
            over.set()
            socket.create_connection(("127.0.0.1", port)).close()
        refusing.result(LIMIT)
    assert profiles == {1}


def _refusal(asked: int, report: str, seq: int) -> ErrorMessage:
    return ErrorMessage(seq, asked, ErrorCode.PROFILE, report)


def test_the_host_numbers_what_it_says() -> None:
    def script(device: Scripted) -> None:
        device.begin(heartbeat=2.0)
        asked = device.receive(CallMessage)
        assert isinstance(asked, CallMessage)
        assert asked.seq == 1
        assert device.receive(HeartbeatMessage).seq == 2
        device.say(lambda seq: ResultMessage(seq, asked.id, {"text": ""}))

    answering(script, lambda bridge: bridge.call(ECHO, {"text": ""}))


def test_a_flow_that_the_device_ends_has_finished() -> None:
    with scripted() as (device, got, events):
        device.say(lambda seq: DataMessage(seq, device.flow, GOOD))
        device.say(lambda seq: CloseMessage(seq, device.flow))
        ended = events.until(lambda item: item.channel is not None)
        assert (ended.health, ended.cause) == (
            Health.FINISHED,
            "peer: flow odometry of robot: the device ended the flow",
        )
        assert got.get() == GOOD


def test_a_flow_that_fails_is_lost_with_the_devices_reason() -> None:
    with scripted() as (device, _, events):
        text = "the left wheel is off"
        device.say(lambda seq: ErrorMessage(seq, device.flow, ErrorCode.FAILED, text))
        lost = events.until(lambda item: item.channel is not None)
        assert lost.health is Health.LOST
        assert text in lost.cause


def test_an_error_of_the_whole_line_ends_it() -> None:
    with scripted() as (device, _, events):
        device.say(lambda seq: ErrorMessage(seq, 0, ErrorCode.LIMIT, "low battery"))
        assert "low battery" in events.until(lambda item: item.channel is not None).cause


def test_a_refused_flow_is_not_open() -> None:
    def script(device: Scripted) -> None:
        device.begin()
        asked = device.receive(OpenMessage)
        assert isinstance(asked, OpenMessage)
        device.say(lambda seq: ErrorMessage(seq, asked.id, ErrorCode.BUSY, "one flow only"))

    def call(bridge: Bridge) -> object:
        structure = bridge.describe(ODOMETRY).message
        assert structure
        with pytest.raises(BridgeError, match="busy: one flow only"):
            bridge.open_source(ODOMETRY, structure, print)
        return bridge.open_channels

    assert answering(script, call) == 0


def test_data_of_a_conversation_that_is_over_are_ignored() -> None:
    with scripted() as (device, got, _):
        device.say(lambda seq: DataMessage(seq, 4_000_000_000, GOOD))
        device.say(lambda seq: DataMessage(seq, device.flow, {**GOOD, "x": 2.0}))
        assert got.get()["x"] == 2.0


def open_flow(bridge: Bridge) -> tuple[Channel, ProfileDevice]:
    structure = bridge.describe(ODOMETRY).message
    assert structure
    assert isinstance(bridge, RocosBridge)
    channel = bridge.open_source(ODOMETRY, structure, print)
    device = bridge._devices["robot"]
    assert isinstance(device, ProfileDevice)
    return channel, device


def test_a_flow_that_is_open_since_the_line_came_back_is_not_opened_again() -> None:
    def script(device: Scripted) -> None:
        device.begin()
        device.opened()

    def call(bridge: Bridge) -> object:
        channel, device = open_flow(bridge)
        (flow,) = device._flows
        before = flow.id
        # As the line's thread does, just after that.
        device._open_again(flow, device.catalogue(0.0))
        channel.close()
        return flow.id == before

    assert answering(script, call)


def test_a_flow_that_is_closed_as_the_line_comes_back_is_closed_at_the_device() -> None:
    order: list[tuple[type, int]] = []

    def script(device: Scripted) -> None:
        device.begin()
        device.opened()
        for kind in (OpenMessage, CloseMessage, HeartbeatMessage):
            device.receive(kind)

    def call(bridge: Bridge) -> object:
        channel, device = open_flow(bridge)
        (flow,) = device._flows
        send = device._conversation.send

        def note(build: Callable[[int], WireMessage], within: float | None = None) -> None:
            message = build(0)
            if isinstance(message, OpenMessage):
                channel.close()  # by its user, at the worst moment
            if isinstance(message, OpenMessage | CloseMessage):
                order.append((type(message), message.id))
            send(build, within)

        device._conversation.send = note  # type: ignore[method-assign]
        device._by_id.clear()  # as where the line was lost
        device._open_again(flow, device.catalogue(0.0))
        send(HeartbeatMessage)
        return order

    assert answering(script, call) is order
    kind, identity = order[-1]
    assert kind is CloseMessage
    assert (OpenMessage, identity) in order


def test_a_flow_that_is_closed_as_the_line_is_lost_closes_no_other_conversation() -> None:
    def script(device: Scripted) -> None:
        device.begin()
        device.opened()
        closed = device.receive(CloseMessage)
        assert isinstance(closed, CloseMessage)
        ids.append(closed.id)

    ids: list[int] = []

    def call(bridge: Bridge) -> object:
        channel, device = open_flow(bridge)
        (flow,) = device._flows
        identity = flow.id

        def lose(identity: int) -> bool:
            flow.id = 0  # between the look and the message
            return bool(identity)

        device._answers.forget = lose  # type: ignore[method-assign]
        channel.close()
        return identity

    assert answering(script, call) == ids[0]
