"""Buffers and what is pushed out of them: the policies alone, then between real processes."""

from __future__ import annotations

import re
import threading
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import pytest
from _uoarm_rtm_stubs import RTC
from endpoints import Start, endpoint, sink, source, stamped
from hypothesis import given
from hypothesis import strategies as st
from peers import Peer
from tests.inbox import Inbox  # type: ignore[import-not-found]
from uoarm_rtm._dataflow import Buffer, ThreadedPusher
from uoarm_rtm._options import (
    BufferPolicy,
    PushPolicy,
    RtmEndpointOptions,
    buffer_policy,
    push_policy,
)
from uoarm_rtm._peer import pairs

from uoarm.bridge import Bridge
from uoarm.errors import BridgeError, FailureReason
from uoarm.model import Role
from uoarm.testing import patience, wait

OUT = Role.OUTPUT, "Talker.rtc", "out"
IN = Role.INPUT, "Listener.rtc", "in"

LENGTHS = st.integers(1, 4)
FULL = st.sampled_from(["overwrite", "do_nothing"])
EMPTY = st.sampled_from(["do_nothing", "readback"])


@given(LENGTHS, FULL, EMPTY, st.lists(st.booleans(), max_size=30))
def test_a_buffer_behaves_like_a_list(length: int, full: str, empty: str, writes: Any) -> None:
    buffer = Buffer(BufferPolicy(length, full, empty=empty))
    waiting: list[bytes] = []
    last, dropped = None, 0
    for number, write in enumerate(writes):
        data = bytes([number])
        if not write:
            fresh = waiting.pop(0) if waiting else None
            last = fresh or last
            assert buffer.read() == (last if fresh or empty == "readback" else None)
        elif len(waiting) < length:
            assert buffer.write(data)
            waiting.append(data)
        else:
            dropped += 1
            assert buffer.write(data) is (full == "overwrite")
            waiting = [*waiting[1:], data] if full == "overwrite" else waiting
        assert buffer.dropped == dropped
    if waiting:
        assert buffer.take() == waiting


def test_a_buffer_that_blocks_waits_for_the_other_side() -> None:
    buffer = Buffer(BufferPolicy(1, "block", 20.0, "block", 20.0))
    with ThreadPoolExecutor(1) as executor:
        reading = executor.submit(buffer.read)
        assert buffer.write(b"a")
        assert reading.result(patience()) == b"a"
        assert buffer.write(b"b")
        writing = executor.submit(buffer.write, b"c")
        assert buffer.read() == b"b"
        assert writing.result(patience())
        assert buffer.take() == [b"c"]
        taking = executor.submit(buffer.take)
        buffer.close()
        assert taking.result(patience()) == []
    assert not buffer.write(b"d")


def test_a_buffer_that_blocks_gives_up_in_time() -> None:
    buffer = Buffer(BufferPolicy(1, "block", 0.0, "block", 0.0))
    assert buffer.read() is None
    assert buffer.write(b"a")
    assert not buffer.write(b"b")
    assert buffer.dropped == 1


WORDS = st.sampled_from(["overwrite", "do_nothing", "block"])
TABLES = st.fixed_dictionaries(
    {"full_policy": st.just("block"), "empty_policy": st.just("block")},
    optional={
        "length": st.integers(1, 10_000),
        "write_timeout": st.floats(0, 60),
        "read_timeout": st.integers(0, 60),
    },
) | st.fixed_dictionaries({}, optional={
    "length": st.integers(1, 10_000),
    "full_policy": WORDS,
    "empty_policy": st.sampled_from(["readback", "do_nothing", "block"]),
})  # fmt: skip


@given(TABLES, st.none() | TABLES)
def test_what_is_asked_is_what_the_other_side_reads(both: Any, ours: Any) -> None:
    options = {"buffer": both} if ours is None else {"buffer": both, "outport_buffer": ours}
    properties = RtmEndpointOptions.of(options).requested_properties
    names = ("length", "full_policy", "write_timeout", "empty_policy", "read_timeout")
    for side, table in (("inport", both), ("outport", {**both, **(ours or {})})):
        usual = BufferPolicy()
        wanted = (usual.length, usual.full, usual.write_seconds, usual.empty, usual.read_seconds)
        policy = buffer_policy(properties, side)
        got = (policy.length, policy.full, policy.write_seconds, policy.empty, policy.read_seconds)
        assert got == tuple(
            table.get(name, value) for name, value in zip(names, wanted, strict=True)
        )


def test_what_is_said_of_both_sides_holds_for_each_that_says_nothing() -> None:
    properties = {
        "dataport.buffer.length": "5",
        "dataport.buffer.write.full_policy": " BLOCK ",
        "dataport.inport.buffer.length": "2",
        "dataport.publisher.push_policy": "Skip",
        "dataport.publisher.skip_count": "3",
    }
    assert buffer_policy(properties, "inport") == BufferPolicy(2, "block")
    assert buffer_policy(properties, "outport") == BufferPolicy(5, "block")
    assert (push_policy(properties).which, push_policy(properties).skipped) == ("skip", 3)


MISTAKES: list[tuple[dict[str, Any], str]] = [
    ({"buffer": 4}, "option $.buffer: expected a mapping, got 4"),
    (
        {"buffer": {"size": 4}},
        'option $.buffer.size: unknown key "size"',
    ),
    ({"buffer": {"length": 0}}, "option $.buffer.length: expected at least 1, got 0"),
    ({"buffer": {"length": 1.5}}, "option $.buffer.length: expected a whole number, got 1.5"),
    (
        {"inport_buffer": {"full_policy": "wait"}},
        "option $.inport_buffer.full_policy: expected overwrite, ",
    ),
    (
        {"outport_buffer": {"empty_policy": "overwrite"}},
        "option $.outport_buffer.empty_policy: expected ",
    ),
    ({"buffer": {"write_timeout": 1}}, "buffer: write_timeout means nothing without full_policy: "),
    (
        {"buffer": {"empty_policy": "block", "read_timeout": 61}},
        "option $.buffer.read_timeout: expected at most 60.0 s, got 61",
    ),
    ({"push_policy": "all"}, "push_policy means nothing without flow: push and subscription: new"),
    (
        {"subscription": "new", "push_policy": "most"},
        "option $.push_policy: expected new, fifo, skip or all",
    ),
    (
        {"subscription": "new", "push_policy": "all", "skip_count": 1},
        "skip_count means nothing without push_policy: skip",
    ),
    (
        {"subscription": "new", "push_policy": "skip", "skip_count": -1},
        "option $.skip_count: expected at least 0, got -1",
    ),
    (
        {"properties": {"dataport.inport.buffer.length": "many"}},
        "dataport.inport.buffer.length must be a whole number from 1 to 10000, got 'many'",
    ),
]


@pytest.mark.parametrize(("options", "words"), MISTAKES, ids=lambda item: str(item)[:40])
def test_a_mistake_in_an_option_is_named(options: dict[str, Any], words: str) -> None:
    with pytest.raises(ValueError, match=re.escape(words)):
        RtmEndpointOptions.of(options)


def ask(component: Peer, pool: ThreadPoolExecutor, command: str, *arguments: Any) -> Any:
    return pool.submit(getattr(component, command), *arguments)


@pytest.mark.parametrize(("options", "expected"), [
    ({"push_policy": "all"}, list(range(60))),
    ({"push_policy": "fifo"}, list(range(60))),
    ({"push_policy": "skip", "skip_count": 9}, [9, 19, 29, 39, 49, 59]),
], ids=["all", "fifo", "skip"])  # fmt: skip
@pytest.mark.parametrize("subscription", ["new", "periodic"])
def test_an_out_port_pushes_what_the_policy_says(
    bridge: Bridge, peer: Start, subscription: str, options: dict[str, Any], expected: list[int]
) -> None:
    component = peer("Talker")
    inbox = Inbox()
    asked: dict[str, Any] = {
        "subscription": subscription,
        "rate": 1000,
        "outport_buffer": {"length": 60},
        **options,
    }
    source(bridge, endpoint(*OUT, **asked), inbox)
    component.count(0, 60)
    inbox.wait_for(len(expected))
    assert inbox.numbers() == expected


@pytest.mark.parametrize(("policy", "expected"), [
    ("overwrite", [0, 7, 8, 9]),
    ("do_nothing", [0, 1, 2, 3]),
    ("block", list(range(10))),
])  # fmt: skip
def test_the_buffer_of_an_out_port_overflows_as_asked(
    bridge: Bridge, peer: Start, policy: str, expected: list[int]
) -> None:
    component = peer("Talker")
    inbox, taken, free = Inbox(), threading.Event(), threading.Event()

    def take(message: Any) -> None:
        taken.set()
        assert free.wait(patience())
        inbox(message)

    buffer: dict[str, Any] = {"length": 3, "full_policy": policy}
    if policy == "block":
        buffer["write_timeout"] = 20
    asked: dict[str, Any] = {"subscription": "new", "push_policy": "all", "outport_buffer": buffer}
    source(bridge, endpoint(*OUT, **asked), take)
    component.count(0, 1)
    assert taken.wait(patience())
    with ThreadPoolExecutor(1) as pool:
        writing = ask(component, pool, "count", 1, 10)
        if policy != "block":
            writing.result(patience())
        free.set()
        writing.result(patience())
    inbox.wait_for(len(expected))
    assert inbox.numbers() == expected


def test_an_out_port_that_is_asked_says_what_is_empty(bridge: Bridge, peer: Start) -> None:
    component = peer("Talker")
    usual, all_of_them, again, waiting = (Inbox() for _ in range(4))
    policies = {"do_nothing": all_of_them, "readback": again, "block": waiting}
    pull: dict[str, Any] = {"flow": "pull", "rate": 200}
    source(bridge, endpoint(*OUT, **pull), usual)
    for policy, inbox in policies.items():
        source(bridge, endpoint(*OUT, **pull, outport_buffer={"empty_policy": policy}), inbox)
    for _ in range(2):
        component.count(7, 8)
    assert [len(inbox.wait_for(2)) for inbox in (all_of_them, waiting)] == [2, 2]
    again.wait_for(5)
    component.count(8, 9)
    usual.wait_for(2)
    assert usual.numbers() == [7, 8]


@pytest.mark.parametrize(("policy", "expected"), [
    ("overwrite", [0, 7, 8, 9]),
    ("do_nothing", [0, 1, 2, 3]),
])  # fmt: skip
def test_our_buffer_before_an_in_port_overflows_as_asked(
    bridge: Bridge, peer: Start, policy: str, expected: list[int]
) -> None:
    component = peer("Listener")
    buffer: dict[str, Any] = {"length": 3, "full_policy": policy}
    asked: dict[str, Any] = {"subscription": "new", "push_policy": "all", "outport_buffer": buffer}
    into = sink(bridge, endpoint(*IN, activate=True, **asked))
    assert not into.blocking
    component.hold()
    into.send(stamped(0))
    assert component.held()
    for number in range(1, 4):
        into.send(stamped(number))
    for number in range(4, 10):
        if policy == "overwrite":
            into.send(stamped(number))
            continue
        with pytest.raises(BridgeError, match="our buffer of 3 for it is full") as caught:
            into.send(stamped(number))
        assert caught.value.reason is FailureReason.REFUSED
    component.release()
    wait(lambda: [item["data"] for item in component.received()] == expected)
    assert into.facts()["dropped"] == 6
    wait(lambda: into.facts()["count"] == len(expected))


def test_our_buffer_before_an_in_port_may_wait_for_room(bridge: Bridge, peer: Start) -> None:
    component = peer("Listener")
    buffer: dict[str, Any] = {"length": 1, "full_policy": "block", "write_timeout": 20}
    asked: dict[str, Any] = {"subscription": "new", "push_policy": "fifo", "outport_buffer": buffer}
    into = sink(bridge, endpoint(*IN, activate=True, **asked))
    assert into.blocking
    for number in range(20):
        into.send(stamped(number))
    assert into.drain(20)
    assert [item["data"] for item in component.received()] == list(range(20))
    assert into.facts()["dropped"] == 0


def test_an_in_port_that_pulls_finds_what_our_policy_leaves(bridge: Bridge, peer: Start) -> None:
    component = peer("Listener")
    buffer: dict[str, Any] = {"length": 2, "full_policy": "do_nothing", "empty_policy": "readback"}
    into = sink(bridge, endpoint(*IN, activate=True, flow="pull", outport_buffer=buffer))
    into.send(stamped(1))
    into.send(stamped(2))
    assert not into.drain(0)
    with pytest.raises(BridgeError, match="our buffer of 2 for it is full"):
        into.send(stamped(3))
    assert [component.fetch() for _ in range(4)] == [1, 1, 1, 1]
    assert [item["data"] for item in component.received()] == [1, 2, 2, 2]
    assert into.drain(0)


def test_an_in_port_that_pulls_may_wait_for_a_message(bridge: Bridge, peer: Start) -> None:
    component = peer("Listener")
    buffer: dict[str, Any] = {"empty_policy": "block", "read_timeout": 20}
    into = sink(bridge, endpoint(*IN, activate=True, flow="pull", outport_buffer=buffer))
    with ThreadPoolExecutor(1) as pool:
        fetching = ask(component, pool, "fetch")
        into.send(stamped(1))
        assert fetching.result(patience()) == 1


def test_a_death_behind_our_buffer_is_reported_and_ends_the_sending(
    bridge: Bridge, peer: Start
) -> None:
    component = peer("Listener")
    events = Inbox(bridge)
    into = sink(bridge, endpoint(*IN, activate=True, subscription="new"))
    component.kill()

    def is_refused() -> bool:
        try:
            into.send(stamped(1))
        except BridgeError as error:
            return error.reason is FailureReason.UNAVAILABLE
        return False

    wait(is_refused)
    assert any(message.channel is into for message in events.messages)


def test_a_wrong_policy_is_refused_by_our_own_port(
    bridge: Bridge, peer: Start, nameserver: str
) -> None:
    talker, listener = peer("Talker"), peer("Listener")
    asked = {
        "dataport.interface_type": "corba_cdr",
        "dataport.dataflow_type": "push",
        "dataport.subscription_type": "new",
    }
    wrong = {**asked, "dataport.outport.buffer.write.full_policy": "sideways"}
    assert talker.connect(nameserver, "Listener.rtc", "in", wrong) == "BAD_PARAMETER"
    assert [talker.connectors(), listener.connectors()] == [[0, 0], [0, 0]]
    assert talker.connect(nameserver, "Listener.rtc", "in", asked) == "RTC_OK"


@pytest.mark.parametrize(
    ("push", "unsent"),
    [
        (PushPolicy("all"), 4),
        (PushPolicy("fifo"), 4),
        (PushPolicy("new"), 1),
        (PushPolicy("skip", 1), 2),
    ],
    ids=str,
)
def test_what_waits_to_be_pushed_is_known_also_when_it_is_over(
    push: PushPolicy, unsent: int
) -> None:
    reached, go = threading.Event(), threading.Event()

    def put(_: bytes) -> None:
        reached.set()
        assert go.wait(patience())

    pusher = ThreadedPusher(put, BufferPolicy(8), push)
    if push.which == "skip":
        pusher.write(b"0")  # the first is left out
    pusher.write(b"1")
    assert reached.wait(patience())
    for number in range(4):
        pusher.write(bytes([number]))
    assert (pusher.unsent, pusher.under_way) == (unsent, unsent + 1)
    pusher.close()
    go.set()
    wait(lambda: pusher.under_way == unsent)
    assert pusher.unsent == unsent
    assert not pusher.dropped


def test_what_waits_before_an_in_port_is_under_way_and_lost_with_it(
    bridge: Bridge, peer: Start
) -> None:
    listener = peer("Listener")
    at = endpoint(*IN, subscription="new", push_policy="all", activate=True, timeout=patience())
    into = sink(bridge, at)
    listener.hold()
    into.send(stamped(0))
    wait(listener.held)
    for number in range(1, 4):
        into.send(stamped(number))
    assert into.facts()["under_way"] == 4
    listener.kill()
    wait(lambda: into.facts()["lost_on_link"])
    into.close()
    wait(lambda: sum(into.facts()[name] for name in ("under_way", "lost_on_link")) == 4)


def test_what_waits_for_a_reader_of_ours_is_dropped_as_it_ends(bridge: Bridge) -> None:
    made: Any = bridge
    into = sink(bridge, endpoint(Role.INPUT, "self", "said", "RTC::TimedLong"))
    port = made._own.component.ports[0]
    pull = {"dataport.interface_type": "corba_cdr", "dataport.dataflow_type": "pull"}
    profile = RTC.ConnectorProfile("reader", "reader", [port.reference], pairs(pull))
    assert port.connect(profile)[0] == RTC.RTC_OK
    for number in range(3):
        into.send(stamped(number))
    assert into.facts()["dropped"] == 0
    assert port.disconnect("reader") == RTC.RTC_OK
    assert into.facts()["dropped"] == 3


def test_without_a_thread_nothing_stays_connected(
    bridge: Bridge, peer: Start, monkeypatch: pytest.MonkeyPatch
) -> None:
    start = threading.Thread.start

    def no_more(thread: threading.Thread) -> None:
        if thread.name in {"uoarm-rtm-pull", "uoarm-rtm-push"}:
            raise RuntimeError("can't start new thread")
        start(thread)

    component = peer("Talker")
    monkeypatch.setattr(threading.Thread, "start", no_more)
    with pytest.raises(BridgeError, match="can't start new thread"):
        source(bridge, endpoint(*OUT, flow="pull"), Inbox())
    with pytest.raises(BridgeError, match="can't start new thread"):
        sink(bridge, endpoint(Role.INPUT, "Talker.rtc", "in", subscription="new"))
    assert component.connectors() == [0, 0]
