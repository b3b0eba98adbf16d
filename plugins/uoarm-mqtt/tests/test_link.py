"""The connection to the broker while it is closed in the middle of a call, by a real Mosquitto."""

from __future__ import annotations

import os
import resource
import socket
import struct
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from typing import Any

import pytest
from brokers import Broker
from paho.mqtt.client import MQTTMessage
from uoarm_mqtt import _link
from uoarm_mqtt._link import BrokerConnection, PacketOutcome
from uoarm_mqtt._options import BrokerOptions, connection_options
from uoarm_mqtt._subscriptions import ReceivedMessage, Receiver

from uoarm.errors import BridgeError, FailureReason
from uoarm.model import Health
from uoarm.testing import Background, patience, wait


class Gate:
    """Holds callers until it is opened, and says that a caller has come."""

    def __init__(self) -> None:
        self.reached, self.opened = threading.Event(), threading.Event()

    def before(self, call: Callable[..., Any]) -> Callable[..., Any]:
        def late(*given: Any, **more: Any) -> Any:
            self.reached.set()
            assert self.opened.wait(patience())
            return call(*given, **more)

        return late


def close_during(link: BrokerConnection, gate: Gate) -> None:
    """Close while a call is at the gate: it is waited for."""
    assert gate.reached.wait(patience())
    under_way: list[int] = []
    disconnect, waiting = link._client.disconnect, vars(link._changed)["_waiters"]

    def noted(**more: Any) -> Any:
        under_way.append(link._calls)
        return disconnect(**more)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(_link, "_STEP_SECONDS", patience())
        patch.setattr(link._client, "disconnect", noted)
        closing = Background(link.close)
        # Either it waits, and no other caller does, or it did not and has gone on to disconnect.
        wait(lambda: waiting or under_way)
        gate.opened.set()
        closing.result()
    assert under_way[0] == 0
    thread = link._client._thread
    assert thread is None or not thread.is_alive()
    assert not link._up


@pytest.fixture
def link(broker: Broker) -> BrokerConnection:
    options = connection_options("m", BrokerOptions.of({"url": broker.url}))
    return BrokerConnection("m", options, lambda *_: None)


@pytest.mark.parametrize("qos", [0, 1])
def test_what_is_published_as_it_closes_is_answered_once(
    link: BrokerConnection, monkeypatch: pytest.MonkeyPatch, qos: int
) -> None:
    link.require_up()
    gate, reports = Gate(), list[PacketOutcome]()
    monkeypatch.setattr(BrokerConnection, "_note", gate.before(BrokerConnection._note))
    publishing = Background(lambda: link.publish("a", b"x", reports.append, qos=qos))
    assert gate.reached.wait(patience())
    monkeypatch.undo()
    close_during(link, gate)
    publishing.result()
    assert len(reports) == 1
    assert not link._pending


@pytest.mark.parametrize("is_answered", [False, True])
def test_what_is_noted_after_a_break_is_answered(
    link: BrokerConnection, monkeypatch: pytest.MonkeyPatch, *, is_answered: bool
) -> None:
    """Published before it and noted after: its answer was there by then, or never comes."""
    link.require_up()
    gate, reports = Gate(), list[PacketOutcome]()
    monkeypatch.setattr(BrokerConnection, "_note", gate.before(BrokerConnection._note))
    if not is_answered:
        monkeypatch.setattr(link._client, "_packet_queue", lambda *_: 0)  # it is never sent
    qos = int(is_answered)
    publishing = Background(lambda: link.publish("a", b"x", reports.append, qos=qos))
    assert gate.reached.wait(patience())
    monkeypatch.undo()
    if is_answered:
        wait(lambda: link._early, "not answered")
    breaks = link.breaks
    broken = link._client.socket()
    assert isinstance(broken, socket.socket)
    broken.shutdown(socket.SHUT_RDWR)
    wait(lambda: link.breaks > breaks, "it did not break")
    gate.opened.set()
    publishing.result()
    wait(lambda: reports, "never answered", 10.0)
    assert [bool(report.failure) for report in reports] == [not is_answered]
    assert not link._early
    assert not link._pending
    link.close()


def test_without_a_thread_it_says_so_and_tries_again(
    link: BrokerConnection, monkeypatch: pytest.MonkeyPatch
) -> None:
    def start(_: threading.Thread) -> None:
        raise RuntimeError("can't start new thread")

    with monkeypatch.context() as without:
        without.setattr(threading.Thread, "start", start)
        for _ in range(2):
            with pytest.raises(BridgeError, match="can't start new thread"):
                link.require_up()
    link.require_up()
    link.close()


def test_what_wakes_the_client_stays_until_no_caller_publishes(
    link: BrokerConnection, monkeypatch: pytest.MonkeyPatch
) -> None:
    link.require_up()
    gate = Gate()
    monkeypatch.setattr(link._client, "_packet_queue", gate.before(link._client._packet_queue))
    publishing = Background(lambda: link.publish("a", b"x", lambda _: None, qos=0))
    assert gate.reached.wait(patience())
    monkeypatch.undo()
    close_during(link, gate)
    publishing.result()


@pytest.mark.parametrize("comes_up", [False, True])
def test_a_first_call_as_it_closes_leaves_no_connection(
    link: BrokerConnection, monkeypatch: pytest.MonkeyPatch, *, comes_up: bool
) -> None:
    gate, disconnect = Gate(), link._client.disconnect

    def once_it_is_up(**more: Any) -> Any:
        wait(lambda: link._up, "it does not come up")
        return disconnect(**more)

    if comes_up:
        monkeypatch.setattr(link._client, "disconnect", once_it_is_up)
    monkeypatch.setattr(BrokerConnection, "_start", gate.before(BrokerConnection._start))
    requiring = Background(link.require_up)
    close_during(link, gate)
    with pytest.raises(BridgeError, match="is closed"):
        requiring.result()


def test_a_process_with_many_descriptors_open_connects(link: BrokerConnection) -> None:
    limits = resource.getrlimit(resource.RLIMIT_NOFILE)
    resource.setrlimit(resource.RLIMIT_NOFILE, (limits[1], limits[1]))
    taken = [os.dup(0)]
    try:
        while taken[-1] < 1024:  # the last that `select` takes is below it
            taken.append(os.dup(0))
        link.require_up()
        link.barrier()
    finally:
        link.close()
        for descriptor in taken:
            os.close(descriptor)
        resource.setrlimit(resource.RLIMIT_NOFILE, limits)


def test_two_clients_of_one_name_end_each_other_less_and_less_often(broker: Broker) -> None:
    options = connection_options("m", BrokerOptions.of({"url": broker.url, "client_id": "same"}))
    breaks: list[tuple[float, str]] = []

    def report(health: Health, cause: str) -> None:
        if health is not Health.OK:
            breaks.append((time.monotonic(), cause))

    first = BrokerConnection("m", options, report)
    second = BrokerConnection("m", options, lambda *_: None)
    try:
        first.require_up()
        second.require_up()
        wait(lambda: len(breaks) > 4)
    finally:
        first.close()
        second.close()
    assert breaks[4][0] - breaks[0][0] >= 0.1 + 0.2 + 0.4 + 0.8
    assert "has another client the same `client_id`?" in breaks[4][1]


def test_a_closed_one_says_so(link: BrokerConnection) -> None:
    link.require_up()
    link.close()
    with pytest.raises(BridgeError, match="the connection to the broker is closed") as caught:
        link.publish("a", b"x", print)
    assert caught.value.reason is FailureReason.CLOSED


def test_a_receiver_that_raises_ends_no_other(
    link: BrokerConnection, caplog: pytest.LogCaptureFixture
) -> None:
    came: list[ReceivedMessage] = []

    def give(message: ReceivedMessage) -> None:
        raise (SystemExit if message.payload == b"1" else ValueError)(message.payload)

    link.subscribe(Receiver("raising/+", give))
    link.subscribe(Receiver("raising/a", came.append))
    for payload in (b"1", b"2"):
        link.publish("raising/a", payload, lambda _: None)
        wait(lambda: came and came[-1].payload == payload, lambda: f"{came}")  # noqa: B023
    assert link._up
    link.close()
    assert "m: a message on raising/a was not taken" in caplog.text


CONNACK = bytes((0x20, 3, 0, 0, 0))
ENDLESS = b"\x30\xff\xff\xff\x7f"  # the beginning of a message of 256 MiB


def unfinished(number: int) -> bytes:
    """Return a message of QoS 2 with an identifier, which the broker does not let go."""
    content = struct.pack(">H1sHB", 1, b"a", number, 0) + bytes(1000)
    return b"\x34" + bytes((len(content) % 128 | 128, len(content) // 128)) + content


@contextmanager
def pretended() -> Iterator[tuple[socket.socket, BrokerConnection, list[str]]]:
    """Give a broker's end of a connection, the other end, and why that is not well."""
    causes: list[str] = []
    with socket.create_server(("127.0.0.1", 0)) as server:
        url = f"mqtt://127.0.0.1:{server.getsockname()[1]}"
        options = connection_options("m", BrokerOptions.of({"url": url, "max_octets": 1_000_000}))
        link = BrokerConnection("m", options, lambda _, said: causes.append(said))
        connecting = Background(link.require_up)
        connection, _ = server.accept()
        with connection:
            connection.settimeout(patience())
            assert connection.recv(4096)
            connection.sendall(CONNACK)
            connecting.result()
            yield connection, link, causes
        server.close()
        link.close()


def test_a_broker_that_sends_more_than_it_was_asked_for_is_left() -> None:
    with pretended() as (connection, _, causes):
        with suppress(ConnectionError):
            connection.sendall(ENDLESS)
        wait(lambda: causes, "it is not left", patience())
        assert "268,435,455 octets; 1,065,536 are allowed" in causes[0]


def test_of_what_a_broker_does_not_let_go_the_number_is_kept() -> None:
    with pretended() as (connection, link, _):
        connection.sendall(b"".join(map(unfinished, range(1, 5000))))
        held = link._client._in_messages
        wait(lambda: len(held) == 4999, "they are not taken", patience())
        assert not any(message.payload for message in held.values())


def test_a_burst_of_qos_2_arrives_once_and_in_order(link: BrokerConnection) -> None:
    """Through a break, after which no more may be under way than the broker takes."""
    came: list[int] = []
    link.subscribe(Receiver("burst", lambda message: came.append(int(message.payload)), qos=2))
    for number in range(500):
        link.publish("burst", str(number).encode(), qos=2)
    connection = link._client.socket()
    assert isinstance(connection, socket.socket)
    connection.shutdown(socket.SHUT_RDWR)
    wait(lambda: len(came) >= 500, "it does not arrive", patience())
    assert link.breaks == 1
    link.close()
    assert came == list(range(500))


def test_what_a_broker_has_forgotten_is_under_way_no_more(link: BrokerConnection) -> None:
    link._client._in_messages[7] = MQTTMessage(7)
    link.require_up()
    assert not link._client._in_messages
    link.close()


RESUMED = bytes((0x20, 3, 1, 0, 0))
ANSWERS = {0x82: 0x90, 0xA2: 0xB0}  # of SUBSCRIBE and UNSUBSCRIBE


def asked(connection: socket.socket) -> tuple[bytes, int]:
    """Return the answer to the next packet, a subscription or the end of one, and its kind."""
    packet = connection.recv(4096)
    return bytes((ANSWERS[packet[0]], 4, *packet[2:4], 0, 0)), packet[0]


def test_what_is_left_in_a_break_is_left_before_it_is_up_again() -> None:
    is_left = threading.Event()
    reports: list[tuple[Health, bool]] = []
    with socket.create_server(("127.0.0.1", 0)) as server:
        url = f"mqtt://127.0.0.1:{server.getsockname()[1]}"
        options = connection_options("m", BrokerOptions.of({"url": url, "grace": patience()}))

        def report(health: Health, _: str) -> None:
            reports.append((health, is_left.is_set()))

        link = BrokerConnection("m", options, report)
        receiver = Receiver("$share/work/a", lambda _: None)
        subscribing = Background(lambda: link.subscribe(receiver))
        first, _ = server.accept()
        with first:
            first.settimeout(patience())
            assert first.recv(4096)
            first.sendall(CONNACK)
            first.sendall(asked(first)[0])
            subscribing.result()
        wait(lambda: reports, "the break is not noticed")
        link.unsubscribe(receiver)
        second, _ = server.accept()
        with second:
            second.settimeout(patience())
            assert second.recv(4096)
            second.sendall(RESUMED)
            answer, kind = asked(second)
            assert kind == 0xA2
            is_left.set()
            second.sendall(answer)
            wait(lambda: len(reports) > 1, "it is not up again")
        server.close()
        link.close()
    assert reports[:2] == [(Health.DEGRADED, False), (Health.OK, True)]
