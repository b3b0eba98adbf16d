"""Flows: order, windows, and a count for every message that is lost."""

from __future__ import annotations

import struct
import threading
from collections.abc import Callable, Iterator
from typing import Any

import msgpack
import pytest

from uoarm._host.agent import flows as flows_module
from uoarm._host.agent.flows import OpenFlows, OutboundFlow
from uoarm._host.transport import flow as flow_module
from uoarm._host.transport.flow import FlowEnding, FlowReceiver, FlowSender
from uoarm._host.transport.keys import flow
from uoarm._host.transport.shared_counters import SharedCounters
from uoarm._host.transport.transport import Transport
from uoarm.bridge import Sink, Source
from uoarm.errors import BridgeError, FailureReason, MessageError
from uoarm.model import Deliver, Endpoint, MessageStructure, Role
from uoarm.testing import Background, MemoryBridge, patience, wait

Ends = tuple[Transport, Transport]


class _Taker:
    """Takes messages, each after the gate lets it."""

    def __init__(self) -> None:
        self.got: list[Any] = []
        self.endings: list[FlowEnding] = []
        self.gate = threading.Event()
        self.gate.set()

    def take(self, message: object) -> None:
        self.gate.wait(patience())
        if message == "bad":
            raise ValueError("it was bad")
        self.got.append(message)

    def incoming(self, link: Transport) -> FlowReceiver:
        return FlowReceiver(link, "flow/1", name="test", take=self.take, ended=self.endings.append)


def test_messages_arrive_in_order_from_the_first_one_on(ends: Ends) -> None:
    near, far = ends
    taker = _Taker()
    incoming = taker.incoming(near)
    outgoing = FlowSender(far, "flow/1", patience=patience())
    for number in range(5000):
        outgoing.send(number)
    wait(lambda: len(taker.got) == 5000)
    assert taker.got == list(range(5000))
    assert (incoming.received, incoming.lost) == (5000, 0)


def test_whose_a_message_is_and_what_stands_no_more_comes_in_order(ends: Ends) -> None:
    near, far = ends
    got: list[Any] = []
    incoming = FlowReceiver(
        near,
        "flow/1",
        name="test",
        take=lambda *message: got.append(message),
        ended=lambda _: None,
        let_go=got.append,
    )
    outgoing = FlowSender(far, "flow/1", patience=patience())
    outgoing.send(1, "a")
    outgoing.send(2)
    outgoing.let_go("a")
    outgoing.send(3, "b")
    wait(lambda: len(got) == 4)
    assert got == [(1, "a"), (2,), "a", (3, "b")]
    assert (incoming.received, incoming.lost) == (3, 0)


def test_what_cannot_be_read_is_said_in_order_and_is_no_message(ends: Ends) -> None:
    near, far = ends
    got: list[Any] = []
    incoming = FlowReceiver(
        near, "flow/1", name="test", take=got.append, ended=lambda _: None, read=got.append
    )
    outgoing = FlowSender(far, "flow/1", patience=patience())
    outgoing.send(1)
    outgoing.send_read("it is cut short")
    outgoing.send_read("")
    outgoing.send(2)
    wait(lambda: len(got) == 4)
    assert got == [1, "it is cut short", "", 2]
    assert (incoming.received, incoming.lost) == (2, 0)
    wait(lambda: outgoing.sent == 4)


def test_more_that_cannot_be_read_than_the_manager_takes_waits_and_is_dropped(
    ends: Ends,
) -> None:
    near, far = ends
    gate = threading.Event()

    def wait_for_gate(_: str) -> None:
        gate.wait(patience())

    FlowReceiver(near, "flow/1", name="test", take=print, ended=lambda _: None, read=wait_for_gate)
    outbound = OutboundFlow(
        Endpoint("memory", "numbers", Role.OUTPUT, ("numbers",)),
        FlowSender(far, "flow/1", patience=0.01),
        None,
    )
    for _ in range(1000):
        outbound.unreadable("it is cut short")
    assert outbound.sent < 100
    gate.set()
    outbound.close()


def test_large_messages_arrive_whole(ends: Ends) -> None:
    near, far = ends
    taker = _Taker()
    incoming = taker.incoming(near)
    outgoing = FlowSender(far, "flow/1", patience=patience())
    for number in range(30):
        outgoing.send({"n": number, "data": bytes([number]) * 2_000_000})
    wait(lambda: len(taker.got) + incoming.lost == 30)
    assert incoming.lost == 0
    assert all(item["data"] == bytes([item["n"]]) * 2_000_000 for item in taker.got)


def test_a_slow_consumer_slows_its_producer_and_loses_nothing(ends: Ends) -> None:
    near, far = ends
    taker = _Taker()
    incoming = taker.incoming(near)
    outgoing = FlowSender(far, "flow/1", patience=patience())
    taker.gate.clear()

    def fill() -> None:
        for number in range(500):
            outgoing.send(number)

    thread = threading.Thread(target=fill)
    thread.start()
    wait(lambda: outgoing.unconfirmed >= 64)
    assert outgoing.unconfirmed <= 80
    assert thread.is_alive()
    taker.gate.set()
    thread.join(patience())
    wait(lambda: len(taker.got) == 500)
    assert incoming.lost == 0


def test_a_consumer_that_hangs_costs_the_producer_its_patience_once(
    ends: Ends, monkeypatch: pytest.MonkeyPatch
) -> None:
    near, far = ends
    taker = _Taker()
    incoming = taker.incoming(near)
    outgoing = FlowSender(far, "flow/1", patience=0.1)
    room = outgoing._room
    waited: list[float | None] = []

    def count(ready: Callable[[], bool], timeout: float | None = None) -> bool:
        waited.append(timeout)
        return threading.Condition.wait_for(room, ready, timeout)

    monkeypatch.setattr(room, "wait_for", count)
    monkeypatch.setattr(flow_module, "_TRY_SECONDS", 10 * patience())  # which never pass here
    taker.gate.clear()
    refused = 0
    for number in range(400):
        try:
            outgoing.send(number)
        except BridgeError as error:
            assert error.reason is FailureReason.UNAVAILABLE
            outgoing.skip()
            refused += 1
    assert refused == 400 - 64 - 1  # the window is full, and one more is a try
    assert waited == [0.1]
    taker.gate.set()
    wait(lambda: outgoing.unconfirmed < 64)
    outgoing.send("last")
    wait(lambda: bool(taker.got) and taker.got[-1] == "last")
    assert incoming.received + incoming.lost == 401
    assert incoming.lost >= refused


def test_what_a_closed_link_refuses_was_not_sent(ends: Ends) -> None:
    """Who gets the error counts the message: as sent and not taken, it would be lost as well."""
    _, far = ends
    outgoing = FlowSender(far, "flow/1", patience=patience())
    outgoing.send("good")
    far.close()
    with pytest.raises(BridgeError, match="flow/1"):
        outgoing.send("late")
    assert outgoing.sent == 1


def test_a_flow_that_is_cut_lets_its_sender_go(ends: Ends) -> None:
    near, far = ends
    taker = _Taker()
    taker.incoming(near)
    outgoing = FlowSender(far, "flow/1", patience=patience())
    taker.gate.clear()
    failures: list[str] = []

    def fill() -> None:
        try:
            for number in range(500):
                outgoing.send(number)
        except BridgeError as error:
            failures.append(str(error))

    thread = threading.Thread(target=fill)
    thread.start()
    wait(lambda: outgoing.unconfirmed >= 64)
    outgoing.cut("the host died")
    thread.join(patience())
    assert not thread.is_alive()
    assert failures == ["flow/1: the host died"]
    taker.gate.set()


def test_the_end_comes_after_the_last_message(ends: Ends) -> None:
    near, far = ends
    taker = _Taker()
    seen: list[int] = []
    FlowReceiver(
        near,
        "flow/1",
        name="test",
        take=taker.take,
        ended=lambda ending: seen.append(len(taker.got)),
    )
    outgoing = FlowSender(far, "flow/1", patience=patience())
    for number in range(50):
        outgoing.send(number)
    outgoing.finish(FlowEnding("finished", "no more"))
    wait(lambda: bool(seen))
    assert seen == [50]


def test_what_the_consumer_raises_is_counted_and_reported(ends: Ends) -> None:
    near, far = ends
    taker = _Taker()
    incoming = taker.incoming(near)
    outgoing = FlowSender(far, "flow/1", patience=patience())
    for number in range(64):
        outgoing.send("bad" if number % 2 else number)
    wait(lambda: incoming.received == 64)
    outgoing.confirm(incoming.handled())
    assert outgoing.failed == incoming.failed == 32
    assert outgoing.unconfirmed == 0
    assert outgoing.last_error == "ValueError: it was bad"


def test_a_message_that_cannot_be_written_is_refused_and_uses_no_number(ends: Ends) -> None:
    near, far = ends
    taker = _Taker()
    incoming = taker.incoming(near)
    outgoing = FlowSender(far, "flow/1", patience=patience())
    with pytest.raises(MessageError):
        outgoing.send(object())
    outgoing.send("good")
    wait(lambda: taker.got == ["good"])
    assert incoming.lost == 0


def test_a_closed_receiver_takes_nothing_more(ends: Ends) -> None:
    near, far = ends
    taker = _Taker()
    incoming = taker.incoming(near)
    outgoing = FlowSender(far, "flow/1", patience=patience())
    outgoing.send(1)
    wait(lambda: taker.got == [1])
    incoming.close()
    others = _Taker()
    behind = FlowReceiver(
        near, "flow/2", name="test", take=others.take, ended=others.endings.append
    )
    outgoing.send(2)
    FlowSender(far, "flow/2", patience=patience()).send("behind it")
    wait(lambda: others.got == ["behind it"])
    assert taker.got == [1]
    behind.close()


@pytest.fixture
def counters() -> Iterator[SharedCounters]:
    """Counters that are let go of: a thread that is still at a message may hold them."""
    with SharedCounters.make_file() as file:
        made = SharedCounters(file.fileno(), gives=True)
    yield made
    made.close()


def test_a_message_counts_as_taken_from_when_something_comes_of_it(
    ends: Ends, counters: SharedCounters
) -> None:
    near, far = ends
    taken, given = counters.counter(), counters.counter()
    assert taken is not None
    assert given is not None
    onward = FlowSender(near, "flow/2", patience=patience())  # which is never confirmed
    endpoint = Endpoint("memory", "finder", Role.OUTPUT, ("finder",))
    outbound = OutboundFlow(endpoint, onward, given)
    FlowReceiver(
        near,
        "flow/1",
        name="finder",
        take=outbound.deliver,
        ended=lambda _: None,
        counter=taken,
    )
    outgoing = FlowSender(far, "flow/1", patience=patience())
    for number in range(65):  # of the last one, what came of it waits for room
        outgoing.send(number)
    wait(lambda: (taken.read(), given.read()) == (65, 65))
    assert onward.sent == 64
    onward.close()


class _Calls(MemoryBridge):
    """A framework that goes on calling back when its source is closed."""

    def __init__(self) -> None:
        super().__init__("calls")
        self.deliver: Deliver = lambda _: None

    def _open_source(
        self, endpoint: Endpoint, structure: MessageStructure, deliver: Deliver
    ) -> Source:
        self.deliver = deliver
        return Source(endpoint, lambda: deliver("as it closes"))


def test_what_a_framework_hands_over_when_its_source_is_closed_counts_as_taken(
    ends: Ends, counters: SharedCounters
) -> None:
    """The manager knows so that these messages are lost, also where it shares no memory."""
    near, far = ends
    taken = counters.counter()
    assert taken is not None
    bridge, endpoint = _Calls(), Endpoint("calls", "camera", Role.OUTPUT, ("camera",))
    flows, got = OpenFlows(far, counters), _Taker()
    FlowReceiver(near, flow(1), name="test", take=got.take, ended=got.endings.append)
    with flows.outbound(1, taken.slot, endpoint) as outbound:
        outbound.channel = bridge.open_source(endpoint, MessageStructure({}), outbound.deliver)
    bridge.deliver(1)
    wait(lambda: got.got == [1])
    assert flows.close(1, 0, patience()) == 2
    bridge.deliver("late")
    assert taken.read() == 3
    assert got.got == [1]


def test_a_source_that_is_to_lose_nothing_waits_for_its_reader_as_long_as_it_says(
    ends: Ends, monkeypatch: pytest.MonkeyPatch
) -> None:
    near, far = ends
    monkeypatch.setattr(flows_module, "_PATIENCE_SECONDS", 0.01)
    flows, got = OpenFlows(far, None), _Taker()
    got.gate.clear()
    FlowReceiver(near, flow(1), name="test", take=got.take, ended=got.endings.append)
    endpoint = Endpoint("memory", "numbers", Role.OUTPUT, ("numbers",))
    with flows.outbound(1, None, endpoint) as outbound:
        outbound.channel = source = Source(endpoint, lambda: None)
        source.patience = patience()

    def fill() -> None:
        for number in range(200):
            outbound.deliver(number)

    filling = threading.Thread(target=fill)
    filling.start()
    filling.join(0.5)
    got.gate.set()
    wait(lambda: got.got == [*range(200)])
    filling.join()
    flows.close(1, 0, patience())


class _Buffered(Sink):
    """Hands what it is sent to a framework that says when it has arrived."""

    def __init__(self, endpoint: Endpoint) -> None:
        super().__init__(endpoint, lambda _: None, lambda: None)
        self.arrived = False

    def drain(self, timeout: float) -> bool:
        return self.arrived


def test_drained_is_what_has_left_the_buffers_of_the_framework_too(ends: Ends) -> None:
    near, far = ends
    sink = _Buffered(Endpoint("memory", "drive", Role.INPUT, ("drive",)))
    flows = OpenFlows(near, None)
    flows.inbound(1, None, sink, MessageStructure({}))
    outgoing = FlowSender(far, flow(1), patience=patience())
    outgoing.send(1)
    assert flows.handled(1, 1, patience())
    assert not flows.drain(1, 1, patience())
    sink.arrived = True
    assert flows.drain(1, 1, patience())
    flows.close(1, 1, patience())
    outgoing.close()


def test_an_input_is_found_until_it_is_closed_and_so_has_stopped(ends: Ends) -> None:
    """What takes its place has it held first, and moves at once where there is none."""
    near, _ = ends
    begun, free = threading.Event(), threading.Event()

    def close() -> None:
        begun.set()
        assert free.wait(patience())

    sink = Sink(Endpoint("memory", "drive", Role.INPUT, ("drive",)), lambda _: None, close)
    flows = OpenFlows(near, None)
    flows.inbound(1, None, sink, MessageStructure({}))
    closing = Background(lambda: flows.close(1, 0, patience()))
    assert begun.wait(patience())
    found = flows.sink(1)
    free.set()
    closing.result()
    assert (found, flows.sink(1)) == (sink, None)


def test_a_counter_that_is_given_out_anew_leaves_what_it_was(
    counters: SharedCounters,
) -> None:
    first = counters.counter()
    assert first is not None
    first.set(7)
    counters.take_back(first)
    others = [counters.counter() for _ in range(4096)]
    last = others[-1]
    assert last is not None
    assert last.slot == first.slot
    last.set(1)
    assert (first.read(), last.read()) == (7, 1)


def header(number: int, more: bytes = b"", kind: bytes = b"flow") -> bytes:
    """Return the header of a frame, or what looks like one."""
    return struct.pack("<4sQQq", kind, number, 0, 0) + more


HEADERS = [
    b"",
    b"\xc1",
    b"\x91" * 5000,
    msgpack.packb([50, 0, 0, None]),
    header(50)[:-1],
    header(50, kind=b"flaw"),
    header(2**63, msgpack.packb(5)),
    header(50, b"\xc1"),
    header(50, b"\x91" * 5000),
    header(50, msgpack.packb(["lost"])),
    header(50, msgpack.packb([1, 2])),
    header(0),
]


def test_frames_that_are_none_and_frames_that_came_before_change_nothing_but_a_count(
    ends: Ends,
) -> None:
    """A recorded frame that is sent once more, or rubbish, by a peer that may write to the flow."""
    near, far = ends
    taker = _Taker()
    incoming = taker.incoming(near)
    outgoing = FlowSender(far, "flow/1", patience=patience())
    recorded: list[tuple[bytes, bytes]] = []
    publish = far.publish

    def record(key: str, payload: bytes, header: bytes, *, must_arrive: bool = False) -> None:
        recorded.append((payload, header))
        publish(key, payload, header, must_arrive=must_arrive)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(far, "publish", record)
        for number in range(3):
            outgoing.send(number)
    for payload, header in recorded:
        publish("flow/1", payload, header, must_arrive=True)
    for header in HEADERS:
        publish("flow/1", b"", header, must_arrive=True)
    outgoing.send("good")
    wait(lambda: "good" in taker.got)
    assert taker.got == [0, 1, 2, "good"]
    assert (incoming.received, incoming.lost) == (4, 0)
    assert incoming.failed == len(recorded) + len(HEADERS)
    assert "came before" in incoming.last_error
    assert taker.endings == []


def test_an_end_that_another_thread_says_comes_behind_the_message_under_way(ends: Ends) -> None:
    near, far = ends
    taker = _Taker()
    incoming = taker.incoming(near)
    outgoing = FlowSender(far, "flow/1", patience=patience())
    publish, is_sending, go_on = far.publish, threading.Event(), threading.Event()

    def hold_up(key: str, payload: bytes, header: bytes, *, must_arrive: bool = False) -> None:
        if not must_arrive:
            is_sending.set()
            assert go_on.wait(patience())
        publish(key, payload, header, must_arrive=must_arrive)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(far, "publish", hold_up)
        sending = Background(lambda: outgoing.send("last"))
        assert is_sending.wait(patience())
        ending = Background(lambda: outgoing.finish(FlowEnding("finished", "all was said")))
        wait(lambda: not ending._thread.is_alive() or outgoing._putting.locked())
        go_on.set()
        sending.result()
        ending.result()
    wait(lambda: taker.endings)
    wait(lambda: taker.got == ["last"])
    assert (incoming.lost, incoming.failed) == (0, 0)


def test_confirmations_that_are_none_change_nothing(ends: Ends) -> None:
    near, far = ends
    outgoing = FlowSender(far, "flow/1", patience=patience())
    beyond, untyped = [10**6, 0, "", 0, 0, 0], [1, 0, 5, 0, 0, 0]
    for header in [*HEADERS, msgpack.packb(beyond), msgpack.packb(untyped)]:
        near.publish("flow/1/handled", b"", header, must_arrive=True)
    taker = _Taker()
    incoming = taker.incoming(near)
    outgoing.send("good")
    wait(lambda: outgoing.unconfirmed == 0)
    assert (outgoing.failed, outgoing.lost, outgoing.last_error) == (0, 0, "")
    assert incoming.received == 1


def test_the_first_failure_is_reported_at_once_and_what_is_reported_twice_counts_once(
    ends: Ends,
) -> None:
    near, far = ends
    taker = _Taker()
    incoming = taker.incoming(near)
    outgoing = FlowSender(far, "flow/1", patience=patience())
    reports: list[tuple[int, int, int, str]] = []
    outgoing.watch(lambda *what: reports.append(what))
    for number in range(40):
        outgoing.send(number)
    outgoing.send("bad")
    wait(lambda: sum(raised for _, raised, _, _ in reports) == 1)
    assert reports[-1][1:] == (1, 0, "ValueError: it was bad")
    outgoing.confirm(incoming.handled())
    assert sum(taken for taken, _, _, _ in reports) == 40
    assert sum(raised for _, raised, _, _ in reports) == 1
