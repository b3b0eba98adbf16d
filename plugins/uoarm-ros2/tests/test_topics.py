"""Topics with publishers and subscriptions in other processes: order, loss, QoS, death."""

from __future__ import annotations

import ctypes
import os
import re
import threading
from collections.abc import Callable
from contextlib import nullcontext, suppress
from functools import partial
from pathlib import Path
from typing import Any

import pytest
from attrs import evolve
from endpoints import INT64, Make, Start, await_quiet_watch, endpoint, known, matched, sink, source
from peers import DOMAIN, MORTAL
from tests.inbox import Inbox  # type: ignore[import-not-found]
from uoarm_ros2._middleware import NodeRunner, _native

from uoarm.bridge import Bridge
from uoarm.errors import BridgeError, FailureReason, MessageError
from uoarm.model import CommandPolicy, Health, Role, StopMessage
from uoarm.testing import Background, Collector, ResourceSnapshot, patience, slowness, wait

UNKNOWN = "_NODE_NAMESPACE_UNKNOWN_/_NODE_NAME_UNKNOWN_"


def test_no_first_message_is_lost(make_bridge: Make, peer: Start) -> None:
    # Our subscription is known to the talker only some time after the talker's to us.
    bridge, talker = make_bridge(settle=slowness()), peer("talker")
    for attempt in range(2):
        topic = f"/first_{attempt}"
        talker.do("advertise", topic=topic)
        inbox = Inbox()
        channel = source(bridge, endpoint(Role.OUTPUT, topic, INT64), inbox)
        talker.do("publish", topic=topic, count=20, unmatched=True)
        inbox.wait_for(20)
        assert inbox.numbers() == list(range(1, 21))
        channel.close()


def test_ten_thousand_numbered_messages_pass_a_relay_whole(make_bridge: Make, peer: Start) -> None:
    bridge = make_bridge()
    talker, listener = peer("talker"), peer("listener")
    talker.do("advertise", topic="/numbers", history="keep_all")
    listener.do("subscribe", topic="/relayed", history="keep_all")
    qos = {"history": "keep_all"}
    out = sink(bridge, endpoint(Role.INPUT, "/relayed", INT64, qos=qos))
    into = source(bridge, endpoint(Role.OUTPUT, "/numbers", INT64, qos=qos), out.send)
    talker.do("publish", topic="/numbers", count=10_000)
    seen = listener.do("report", topic="/relayed", expected=10_000)
    assert seen == list(range(1, 10_001))
    assert into.facts()["messages"] == out.facts()["messages"] == 10_000
    assert into.facts()["lost_by_middleware"] == 0


class _Hanging(dict[str, Any]):
    """A message whose field is read only when it may be."""

    def __init__(self, number: int) -> None:
        super().__init__(data=number)
        self.is_read, self.go_on = threading.Event(), threading.Event()

    def __getitem__(self, name: str) -> Any:
        self.is_read.set()
        assert self.go_on.wait(patience())
        return super().__getitem__(name)


def test_the_stop_message_waits_for_no_command_that_hangs(bridge: Bridge, peer: Start) -> None:
    listener = peer("listener")
    listener.do("subscribe", topic="/moved")
    policy = CommandPolicy(stop=StopMessage({"data": 0}))
    out = sink(bridge, evolve(endpoint(Role.INPUT, "/moved", INT64), command=policy))
    hanging = _Hanging(7)
    sending = threading.Thread(target=out.send, args=(hanging,))
    sending.start()
    assert hanging.is_read.wait(patience())
    holding = threading.Thread(target=out.hold, args=(patience(),))
    holding.start()
    assert listener.do("report", topic="/moved", expected=1) == [0]
    hanging.go_on.set()  # the command arrives behind the stop, which is sent once more
    assert listener.do("report", topic="/moved", expected=3) == [0, 7, 0]
    sending.join(patience())
    holding.join(patience())
    assert out.facts()["messages"] == 3


def test_drained_is_what_the_reader_has_acknowledged(bridge: Bridge, peer: Start) -> None:
    listener = peer("listener")
    listener.do("subscribe", topic="/acked")
    out = sink(bridge, endpoint(Role.INPUT, "/acked", INT64))
    listener.freeze()
    out.send({"data": 1})
    assert not out.drain(0)
    draining = Background(partial(out.drain, patience()))
    listener.thaw()  # which it could not, if draining kept the interpreter's lock
    assert draining.result(2 * patience())
    out.close()
    assert listener.do("report", topic="/acked", expected=1) == [1]


class Slow:
    """Stands for rclpy's publisher of a middleware that waits for room: half a second here."""

    def __init__(self) -> None:
        self.time = (ctypes.c_long * 2)(0, 500_000_000)
        self.pointer = ctypes.addressof(self.time)
        self.handle = nullcontext(self)
        self.handle.pointer = self.pointer  # type: ignore[attr-defined]


def test_others_go_on_while_a_sender_waits_for_room(
    bridge: Bridge, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Who sees another thread sleep in a call of the system has the interpreter's lock itself."""
    sleep = ctypes.CDLL(None).nanosleep
    sleep.argtypes = (ctypes.c_void_p, ctypes.c_void_p, ctypes.c_void_p)
    functions = (lambda pointer: pointer, sleep, print, print)
    monkeypatch.setattr(_native, "_functions", lambda: functions)
    keep = {"history": "keep_all"}
    out = sink(bridge, endpoint(Role.INPUT, "/full", INT64, qos=keep, peer="optional"))
    out._publisher.native, native = Slow(), out._publisher.native
    sending = threading.Thread(target=out.send, args=({"data": 7},))
    sending.start()
    calls = set()
    while sending.is_alive():
        with suppress(FileNotFoundError, ProcessLookupError):  # it has ended
            text = Path(f"/proc/self/task/{sending.native_id}/syscall").read_text()
            calls.add(text.split()[0])
    out._publisher.native = native
    assert calls & {"35", "230"}  # nanosleep, clock_nanosleep


def test_images_of_six_megabytes_flow(bridge: Bridge, peer: Start) -> None:
    camera = peer("camera")
    camera.do("advertise", topic="/image", kind="Image")
    inbox = Inbox()
    at = endpoint(Role.OUTPUT, "/image", "sensor_msgs/msg/Image", qos={"depth": 20})
    source(bridge, at, inbox)
    camera.do("publish", topic="/image", count=20, size=6_000_000, period=0.03)
    images = inbox.wait_for(20)
    assert [image["height"] for image in images] == list(range(1, 21))
    assert all(len(image["data"]) == 6_000_000 for image in images)


@pytest.mark.parametrize(
    ("kind", "depth"),
    [
        ("sensor_msgs/msg/Image", 5),
        ("sensor_msgs/msg/PointCloud2", 5),
        ("sensor_msgs/msg/Imu", 100),
    ],
)
def test_of_what_is_large_few_are_kept(bridge: Bridge, kind: str, depth: int) -> None:
    options: dict[str, Any] = {"peer": "optional", "wait": 0.0}
    into = source(bridge, endpoint(Role.OUTPUT, "/kept", kind, **options), print)
    out = sink(bridge, endpoint(Role.INPUT, "/kept", kind, **options))
    options["qos"] = {"depth": 7}
    stated = source(bridge, endpoint(Role.OUTPUT, "/kept", kind, **options), print)
    kept = [str(item.facts()["qos"]).rsplit(" ", 1)[1] for item in (into, out, stated)]
    assert kept == [str(depth), str(depth), "7"]


def test_as_much_memory_is_shared_as_is_asked_for(
    make_bridge: Make, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", "SYSTEM_DEFAULT")
    monkeypatch.setenv("FASTDDS_BUILTIN_TRANSPORTS", "SHM")  # nothing leaves the machine
    before = _shared_memory()
    make_bridge(shared_memory=64)
    after = _shared_memory()
    assert max(after[name] for name in after.keys() - before.keys()) >= 64 * 2**20
    assert os.environ["FASTDDS_BUILTIN_TRANSPORTS"] == "SHM"


def _shared_memory() -> dict[str, int]:
    """Return how many octets of each segment this process has mapped: others have theirs."""
    found: dict[str, int] = {}
    for line in Path("/proc/self/maps").read_text(encoding="utf-8").splitlines():
        if "/dev/shm/fastrtps_" in line:
            begin, end = (int(word, 16) for word in line.split()[0].split("-"))
            found[line.split()[5]] = found.get(line.split()[5], 0) + end - begin
    return found


@pytest.mark.parametrize(
    ("name", "value", "words"),
    [
        ("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST", "ROS 2 makes its own transports"),
        ("FASTDDS_BUILTIN_TRANSPORTS", "LARGE_DATA?max_msg_size=2MB", "has options of its own"),
    ],
)
def test_shared_memory_that_would_have_no_effect_is_refused(
    make_bridge: Make, monkeypatch: pytest.MonkeyPatch, name: str, value: str, words: str
) -> None:
    monkeypatch.setenv(name, value)
    with pytest.raises(BridgeError, match=f"shared_memory has no effect: .*{words}"):
        make_bridge(shared_memory=64)


def test_what_is_open_still_sends_after_its_context_ended_until_it_is_closed(
    make_bridge: Make, peer: Start
) -> None:
    bridge: Any = make_bridge()
    listener = peer("listener")
    listener.do("subscribe", topic="/late")
    events = Inbox(bridge)
    out = sink(bridge, endpoint(Role.INPUT, "/late", INT64))
    bridge._participant._context.try_shutdown()
    events.event(Health.LOST, "the ROS 2 context was shut down from outside")
    out.send({"data": 7})
    assert listener.do("report", topic="/late", expected=1) == [7]
    bridge.close()
    runners = [thread for thread in threading.enumerate() if thread.name.startswith("ros2 ")]
    for thread in runners:
        thread.join(patience())
        assert not thread.is_alive()


def test_a_latched_message_arrives_late(bridge: Bridge, peer: Start) -> None:
    talker = peer("talker")
    talker.do("advertise", topic="/latched", durability="transient_local", depth=1)
    talker.do("publish", topic="/latched", count=3)
    inbox = Inbox()
    assert source(bridge, endpoint(Role.OUTPUT, "/latched", INT64), inbox).latched
    assert inbox.wait_for(1)[0] == {"data": 3}


def test_what_cannot_be_read_is_said_and_the_next_message_arrives(
    bridge: Bridge, peer: Start
) -> None:
    talker, got = peer("talker"), Collector()
    talker.do("advertise", topic="/torn")
    opened: Any = source(bridge, endpoint(Role.OUTPUT, "/torn", INT64), got)
    opened._receive(b"\x00\x01\x00\x00\x07")
    talker.do("publish", topic="/torn", count=1)
    got.wait(1)
    assert opened.unreadable == 1
    assert got.unread[0].startswith("topic /torn: std_msgs/msg/Int64: cannot be read: ")


def test_a_silence_names_what_came_and_could_not_be_read(bridge: Bridge, peer: Start) -> None:
    talker, got = peer("talker"), Collector()
    talker.do("advertise", topic="/torn")
    events = Inbox(bridge)
    at = endpoint(Role.OUTPUT, "/torn", INT64, stale_after=patience())
    opened: Any = source(bridge, at, got)
    opened._receive(b"\x00\x01\x00\x00\x07")
    opened._health.expect(0.1)  # only now: it is silent from its opening on
    events.event(Health.LOST, "s; the last message that came cannot be read: topic /torn")


def test_who_comes_while_the_type_is_looked_for_is_fitted(
    bridge: Any, peer: Start, monkeypatch: pytest.MonkeyPatch
) -> None:
    talker, find = peer("talker"), bridge._types.find
    topic = "/meanwhile"
    at = endpoint(Role.OUTPUT, topic, INT64, peer="optional")
    structure = bridge.describe(at).message
    assert structure is not None

    def find_late(*wanted: Any) -> Any:
        talker.do("advertise", topic=topic, durability="transient_local", depth=1)
        talker.do("publish", topic=topic, count=1)
        wait(lambda: bridge._runner.publishers(topic))
        return find(*wanted)

    monkeypatch.setattr(bridge._types, "find", find_late)
    inbox = Inbox()
    assert bridge.open_source(at, structure, inbox).latched
    assert inbox.wait_for(1) == [{"data": 1}]


def test_auto_takes_what_is_offered_and_offers_what_is_asked(bridge: Bridge, peer: Start) -> None:
    other = peer("other")
    other.do("advertise", topic="/loose", reliability="best_effort")
    other.do("subscribe", topic="/strict", durability="transient_local", deadline=0.5)
    inbox = Inbox()
    source(bridge, endpoint(Role.OUTPUT, "/loose", INT64), inbox)
    other.do("publish", topic="/loose", count=3)
    assert inbox.wait_for(3)
    out = sink(bridge, endpoint(Role.INPUT, "/strict", INT64))
    out.send({"data": 7})
    assert other.do("report", topic="/strict", expected=1) == [7]
    assert "deadline 0.5 s" in out.facts()["qos"]


def test_a_deadline_that_a_reader_asks_for_makes_no_writer_lost(
    bridge: Bridge, peer: Start
) -> None:
    other, events = peer("other"), Inbox(bridge)
    other.do("subscribe", topic="/seldom", deadline=0.2)
    out = sink(bridge, endpoint(Role.INPUT, "/seldom", INT64))
    out.send({"data": 1})
    # Three deadlines, and a second at least, are a silence for who reads.
    wait(lambda: int(str(out.facts()["deadlines_missed"])) >= 8, lambda: str(out.facts()))
    assert {event.health for event in events.messages if event.channel is out} == {Health.DEGRADED}
    wait(lambda: out.send({"data": 2}) or _is_well(events), lambda: str(events.messages))


def _is_well(events: Inbox) -> bool:
    return events.messages[-1].health is Health.OK


def test_auto_follows_a_publisher_that_comes_back_with_less(bridge: Bridge, peer: Start) -> None:
    talker = peer("talker")
    talker.do("advertise", topic="/changing")
    inbox = Inbox()
    channel = source(bridge, endpoint(Role.OUTPUT, "/changing", INT64), inbox)
    talker.do("unadvertise", topic="/changing")
    talker.do("advertise", topic="/changing", reliability="best_effort")
    assert talker.do("subscriptions", topic="/changing", expected=1) == 1
    talker.do("publish", topic="/changing", count=200, period=0.01)
    assert inbox.wait_for(1)
    assert "best_effort" in str(channel.facts()["qos"])


def test_auto_adapts_to_what_is_left_when_the_better_publisher_goes(
    make_bridge: Make, peer: Start
) -> None:
    bridge = make_bridge()
    events, inbox = Inbox(bridge), Inbox()
    good, bad = peer("good"), peer("bad")
    good.do("advertise", topic="/leaving")
    channel = source(bridge, endpoint(Role.OUTPUT, "/leaving", INT64), inbox)
    bad.do("advertise", topic="/leaving", reliability="best_effort")
    events.event(Health.DEGRADED, "topic /leaving: incompatible QoS")
    good.do("unadvertise", topic="/leaving")
    assert bad.do("subscriptions", topic="/leaving", expected=1) == 1
    bad.do("publish", topic="/leaving", count=200, period=0.01)
    assert inbox.wait_for(1)
    assert "best_effort" in str(channel.facts()["qos"])


def test_a_clash_is_refused_with_both_sides_and_the_policy(bridge: Bridge, peer: Start) -> None:
    talker = peer("talker")
    talker.do("advertise", topic="/loose", reliability="best_effort")
    asked = endpoint(Role.OUTPUT, "/loose", INT64, qos={"reliability": "reliable"}, wait=1.0)
    with pytest.raises(BridgeError) as caught:
        source(bridge, asked, print)
    text = str(caught.value)
    assert "publisher /talker offers (best_effort, volatile)" in text
    assert "this subscription asks (reliable" in text
    assert "clash on reliability" in text
    assert bridge.open_channels == 0


@pytest.mark.parametrize("role", [Role.OUTPUT, Role.INPUT])
def test_a_clash_that_is_known_is_not_waited_for(bridge: Bridge, peer: Start, role: Role) -> None:
    other = peer("other")
    if role is Role.OUTPUT:
        other.do("advertise", topic="/stern", reliability="best_effort")
        asked = {"reliability": "reliable"}
    else:
        other.do("subscribe", topic="/stern", durability="transient_local")
        asked = {"durability": "volatile"}
    at = endpoint(role, "/stern", INT64, qos=asked, wait=60.0)
    structure = bridge.describe(at).message
    assert structure is not None
    limit = min(30.0, patience())  # to wait longer is another error
    opening: Callable[[], object]
    if role is Role.OUTPUT:
        opening = partial(bridge.open_source, at, structure, print, timeout=limit)
    else:
        opening = partial(bridge.open_sink, at, structure, timeout=limit)
    with pytest.raises(BridgeError, match="clash on") as caught:
        opening()
    assert caught.value.reason is FailureReason.UNAVAILABLE


def test_a_publisher_that_no_longer_says_that_it_is_alive_is_lost(
    bridge: Bridge, peer: Start
) -> None:
    events, inbox = Inbox(bridge), Inbox()
    talker = peer("talker")
    talker.do("advertise", topic="/alive", lease=0.5)
    channel = source(bridge, endpoint(Role.OUTPUT, "/alive", INT64), inbox)
    talker.do("publish", topic="/alive", count=1)
    event = events.event(Health.LOST, "no longer says that it is alive")
    assert event.channel is channel
    talker.do("publish", topic="/alive", count=1)
    events.event(Health.OK, "says again that it is alive")


def test_a_clash_that_comes_later_is_an_event(make_bridge: Make, peer: Start) -> None:
    bridge = make_bridge()
    events = Inbox(bridge)
    good, bad = peer("good"), peer("bad")
    good.do("advertise", topic="/mixed")
    channel = source(bridge, endpoint(Role.OUTPUT, "/mixed", INT64), print)
    bad.do("advertise", topic="/mixed", reliability="best_effort")
    event = events.event(Health.DEGRADED, "topic /mixed: incompatible QoS")
    assert event.channel is channel
    assert "publisher /bad offers (best_effort" in event.cause
    assert channel.facts()["qos_clashes"] == 1
    bad.do("unadvertise", topic="/mixed")
    assert events.event(Health.OK, "topic /mixed: every publisher fits").channel is channel


def test_a_peer_is_counted_once_although_its_node_is_named_later(
    make_bridge: Make, peer: Start, monkeypatch: pytest.MonkeyPatch
) -> None:
    looks: list[str] = []
    publishers = NodeRunner.publishers

    def named_late(runner: NodeRunner, topic: str) -> tuple[Any, ...]:
        found = publishers(runner, topic)
        looks.extend(item.node for item in found if item.node == "/bad")
        if len(looks) > 4:
            return found
        return tuple(evolve(item, node=UNKNOWN) if item.node == "/bad" else item for item in found)

    monkeypatch.setattr(NodeRunner, "publishers", named_late)
    bridge = make_bridge()
    events = Inbox(bridge)
    good, bad = peer("good"), peer("bad")
    good.do("advertise", topic="/named")
    channel = source(bridge, endpoint(Role.OUTPUT, "/named", INT64), print)
    bad.do("advertise", topic="/named", reliability="best_effort")
    event = events.event(Health.DEGRADED, "publisher /bad offers (best_effort")
    assert "UNKNOWN" not in event.cause
    wait(lambda: len(looks) > 12)
    assert channel.facts()["qos_clashes"] == 1


def test_a_subscription_that_asks_for_more_is_an_event(bridge: Bridge, peer: Start) -> None:
    events = Inbox(bridge)
    listener = peer("listener")
    listener.do("subscribe", topic="/out")
    sink(bridge, endpoint(Role.INPUT, "/out", INT64, qos={"durability": "volatile"}))
    listener.do("subscribe", topic="/out", durability="transient_local")
    events.event(Health.DEGRADED, "clash on durability (offered volatile, asked tran")


def test_a_killed_publisher_is_lost_and_its_successor_resumes(
    make_bridge: Make, peer: Start
) -> None:
    bridge = make_bridge()
    events, inbox = Inbox(bridge), Inbox()
    talker = peer("talker", **MORTAL)
    talker.do("advertise", topic="/mortal", history="keep_all")
    whole = {"history": "keep_all"}
    channel = source(bridge, endpoint(Role.OUTPUT, "/mortal", INT64, qos=whole), inbox)
    talker.start("publish", topic="/mortal", count=100_000, period=0.001)
    inbox.wait_for(100)
    talker.kill()
    assert events.event(Health.LOST, "topic /mortal: the last publisher is gone").channel is channel
    before = inbox.numbers()
    # Each once and in order. A process that stands still for its lease's second, as under load, is
    # forgotten and met again, and DDS never brings what was published meanwhile.
    assert before == sorted(set(before))
    successor = peer("successor")
    successor.do("advertise", topic="/mortal")
    assert events.event(Health.OK, "topic /mortal: a peer is connected").channel is channel
    assert successor.do("subscriptions", topic="/mortal", expected=1) == 1
    successor.do("publish", topic="/mortal", first=1_000_000, count=5)
    inbox.wait_for(len(before) + 5)
    assert inbox.numbers()[len(before) :] == list(range(1_000_000, 1_000_005))


def test_a_frozen_publisher_goes_stale_and_recovers(bridge: Bridge, peer: Start) -> None:
    events, inbox = Inbox(bridge), Inbox()
    talker = peer("talker")
    talker.do("advertise", topic="/sluggish")
    source(bridge, endpoint(Role.OUTPUT, "/sluggish", INT64, stale_after=0.4), inbox)
    talker.start("publish", topic="/sluggish", count=1_000_000, period=0.005)
    inbox.wait_for(20)
    talker.freeze()
    events.event(Health.LOST, "no message for 0.4 s")
    talker.thaw()
    events.event(Health.OK, "")


def test_in_simulated_time_a_topic_grows_stale_by_the_clock(make_bridge: Make) -> None:
    bridge, world, events = make_bridge(use_sim_time=True), make_bridge("world"), Inbox()
    bridge.watch(events)
    clock_type = "rosgraph_msgs/msg/Clock"
    clock = sink(world, endpoint(Role.INPUT, "/clock", clock_type, peer="optional"))
    numbers = sink(world, endpoint(Role.INPUT, "/ticks", INT64, peer="optional", wait=0))
    channel = source(bridge, endpoint(Role.OUTPUT, "/ticks", INT64, stale_after=36_000), Inbox())
    matched(numbers, 1)
    second = 0

    def stale() -> bool:
        nonlocal second
        second += 40_000
        clock.send({"clock": {"sec": second, "nanosec": 0}})
        return any(message.health is Health.LOST for message in events.messages)

    wait(stale)
    assert events.event(Health.LOST, "no message for 36000 s").channel is channel


def test_a_missed_deadline_is_an_event(bridge: Bridge, peer: Start) -> None:
    events, inbox = Inbox(bridge), Inbox()
    talker = peer("talker")
    talker.do("advertise", topic="/timely", deadline=0.1)
    source(bridge, endpoint(Role.OUTPUT, "/timely", INT64, qos={"deadline": 0.1}), inbox)
    talker.do("publish", topic="/timely", count=1)
    events.event(Health.DEGRADED, "the deadline passed")


def test_messages_that_the_middleware_lost_are_counted_and_reported(
    bridge: Bridge, peer: Start
) -> None:
    events, inbox = Inbox(bridge), Inbox()
    camera = peer("camera")
    qos = {"reliability": "best_effort", "depth": 1}
    camera.do("advertise", topic="/flood", kind="Image", **qos)
    at = endpoint(Role.OUTPUT, "/flood", "sensor_msgs/msg/Image", qos=qos)
    channel = source(bridge, at, inbox)
    camera.do("publish", topic="/flood", count=200, size=2_000_000)
    event = events.event(Health.DEGRADED, "lost by the middleware")
    assert event.channel is channel
    lost = channel.facts()["lost_by_middleware"]
    assert isinstance(lost, int)
    assert 0 < lost <= 200 - len(inbox.messages)
    camera.do("publish", topic="/flood", count=300, period=0.01)
    events.event(Health.OK, "messages come as they should")


def test_two_types_on_one_topic_are_reported(bridge: Bridge, peer: Start) -> None:
    events = Inbox(bridge)
    first, second = peer("first"), peer("second", **MORTAL)
    first.do("advertise", topic="/both")
    second.do("advertise", topic="/both", kind="String")
    known(bridge, "/first", "/second")
    with pytest.raises(BridgeError, match=r"several types: std_msgs/msg/Int64 \(/first\); std_msg"):
        bridge.describe(endpoint(Role.OUTPUT, "/both"))
    described = bridge.describe(endpoint(Role.OUTPUT, "/both", INT64))
    assert "carries other types than std_msgs/msg/Int64" in described.note
    channel = source(bridge, endpoint(Role.OUTPUT, "/both", INT64), print)
    events.event(Health.DEGRADED, "carries other types than std_msgs/msg/Int64")
    second.kill()
    events.event(Health.OK, "carries std_msgs/msg/Int64 only")
    assert {event.channel for event in events.messages if "carries" in event.cause} == {channel}


def test_a_type_that_joins_later_is_an_event(bridge: Bridge, peer: Start) -> None:
    events = Inbox(bridge)
    first, second = peer("first"), peer("second", **MORTAL)
    first.do("advertise", topic="/joined")
    channel = source(bridge, endpoint(Role.OUTPUT, "/joined", INT64), print)
    second.do("subscribe", topic="/joined", kind="String")
    event = events.event(Health.DEGRADED, "other types than std_msgs/msg/Int64 too: std_msgs/msg/S")
    assert event.channel is channel
    assert "/second" in event.cause
    second.kill()
    events.event(Health.OK, "carries std_msgs/msg/Int64 only")


@pytest.mark.parametrize("other", ["type", "policies"])
def test_what_is_wrong_still_beside_a_publisher_that_is_back_is_reported_still(
    bridge: Bridge, peer: Start, other: str
) -> None:
    events = Inbox(bridge)
    first, second = peer("first"), peer("second")
    first.do("advertise", topic="/back")
    at = endpoint(Role.OUTPUT, "/back", INT64, qos={"reliability": "reliable"}, peer="optional")
    channel = source(bridge, at, print)
    matched(channel, 1)
    if other == "type":
        second.do("subscribe", topic="/back", kind="String")
    else:
        second.do("advertise", topic="/back", reliability="best_effort")
    words = "other types" if other == "type" else "incompatible QoS"
    events.event(
        Health.DEGRADED, f"refused: topic /back: {'it carries ' * (other == 'type')}{words}"
    )
    first.end()
    events.event(Health.DEGRADED, "disconnected: topic /back: the last publisher is gone")
    peer("third").do("advertise", topic="/back")

    def is_reported() -> bool:
        last = [event for event in events.messages if event.channel is channel][-1]
        return last.cause.startswith("refused") and words in last.cause

    wait(is_reported, "what is wrong was covered up")
    matched(channel, 1)
    of_channel = [event.health for event in events.messages if event.channel is channel]
    assert Health.OK not in of_channel, "for a moment"


def test_latched_messages_beside_a_volatile_publisher_are_reported_and_reachable(
    bridge: Bridge, peer: Start
) -> None:
    events, inbox = Inbox(bridge), Inbox()
    latched, volatile = peer("latched"), peer("volatile")
    latched.do("advertise", topic="/static", durability="transient_local")
    latched.do("publish", topic="/static", count=1)
    volatile.do("advertise", topic="/static")
    known(bridge, "/latched", "/volatile")
    wait(lambda: len(_publishers(bridge, "/static")) == 2)
    channel = source(bridge, endpoint(Role.OUTPUT, "/static", INT64), print)
    event = events.event(Health.DEGRADED, "does not come since /volatile latch nothing")
    assert event.channel is channel
    asked = endpoint(Role.OUTPUT, "/static", INT64, qos={"durability": "transient_local"})
    source(bridge, asked, inbox)
    assert inbox.wait_for(1) == [{"data": 1}]


def _publishers(bridge: Bridge, topic: str) -> list[str]:
    found = bridge.discover()
    return [
        discovered.name
        for discovered in found
        for at, _ in discovered.endpoints
        if at.address[0] == topic
    ]


def test_a_killed_publisher_that_promised_its_rate_is_lost_before_the_middleware_knows(
    bridge: Bridge, peer: Start
) -> None:
    """Nothing shortens the time for which Fast DDS believes in it, and no option is stated."""
    events = Inbox(bridge)
    talker = peer("talker")
    talker.do("advertise", topic="/promised", deadline=0.3)
    channel = source(bridge, endpoint(Role.OUTPUT, "/promised", INT64), print)
    wait(lambda: channel.facts()["stale_after"] == 1.0)
    talker.do("publish", topic="/promised", count=1)
    talker.kill()
    event = events.event(Health.LOST, "no message for 1 s, 3 times the deadline of its QoS")
    assert event.channel is channel


def test_what_is_not_there_says_so(bridge: Bridge, peer: Start) -> None:
    talker = peer("talker")
    talker.do("advertise", topic="/there")
    with pytest.raises(BridgeError, match="/nowhere is not on the graph") as caught:
        bridge.describe(endpoint(Role.OUTPUT, "/nowhere", INT64))
    assert caught.value.reason is FailureReason.NOT_FOUND
    near = (
        rf"/ther is not on the graph of domain {DOMAIN}; did you mean '/there'\?; `uoarm discover`"
    )
    with pytest.raises(BridgeError, match=near):
        bridge.describe(endpoint(Role.OUTPUT, "/ther", INT64))
    with pytest.raises(BridgeError, match="/there has no subscription; to publish without"):
        bridge.describe(endpoint(Role.INPUT, "/there", INT64))
    with pytest.raises(BridgeError, match=r"no publisher of type std_msgs/msg/String, but std_ms"):
        bridge.describe(endpoint(Role.OUTPUT, "/there", "std_msgs/msg/String"))
    found = bridge.describe(endpoint(Role.OUTPUT, "/there")).message
    assert found is not None
    assert found.native_type == INT64


def test_what_is_there_with_another_type_or_as_another_kind_is_named(
    bridge: Bridge, peer: Start
) -> None:
    """Of a topic that has only its other end, and of a service in the place of a topic."""
    talker = peer("talker")
    talker.do("advertise", topic="/spoken")
    talker.do("subscribe", topic="/taken")
    talker.do("serve", name="/served")
    text, ends = "std_msgs/msg/String", r"std_msgs/msg/Int64 \(/talker\)"
    for role, topic, words in (
        (Role.OUTPUT, "/taken", f"/taken has no publisher of type {text}, and subscriptions of"),
        (Role.INPUT, "/spoken", f"/spoken has no subscription of type {text}, and publishers of"),
    ):
        wait(partial(_is_there, bridge, topic))
        with pytest.raises(BridgeError, match=f"{words} type {ends}"):
            bridge.describe(endpoint(role, topic, text))
    with pytest.raises(BridgeError, match=r"; there is a service of that name, of type \w+/srv/"):
        bridge.describe(endpoint(Role.OUTPUT, "/served", INT64))
    with pytest.raises(BridgeError, match=f"; there is a topic of that name, of type {INT64};"):
        bridge.describe(endpoint(Role.SERVICE, "/spoken", "std_srvs/srv/Trigger"))


def _is_there(bridge: Bridge, topic: str) -> bool:
    return any(end.address[0] == topic for found in bridge.discover() for end, _ in found.endpoints)


@pytest.mark.parametrize(
    ("address", "options", "words"),
    [
        ((), {}, r"expected \[name, type\]"),
        (("/a b", INT64), {}, "not a ROS 2 name"),
        (("/a", "Int64"), {}, "is not spelt package/msg/Name"),
        (("/a", "std_msgs/Int64"), {}, r"action/Name; did you mean 'std_msgs/msg/Int64'\?"),
        (("/a", "std_srvs/SetBool"), {}, r"did you mean 'std_srvs/srv/SetBool'\?"),
        (("/a", "test_msgs/Fibonacci"), {}, r"did you mean 'test_msgs/action/Fibonacci'\?"),
        (("/a", "own_msgs/Own"), {}, r"did you mean 'own_msgs/msg/Own'\?"),
        (("/a", INT64, "goal"), {}, "only an action has parts"),
        (("/a", INT64), {"peers": "optional"}, r'option \$.peers: unknown key "peers"'),
        (("/a", INT64), {"peer": "maybe"}, r"option \$.peer: expected required or optional, got"),
        (
            ("/a", INT64),
            {"qos": {"reliability": "good"}},
            "expected auto, reliable or best",
        ),
        (("/a", INT64), {"qos": {"depth": 0}}, r"option \$.qos.depth: expected at least 1"),
        (
            ("/a", INT64),
            {"qos": {"depht": 1}},
            r"qos.depht: unknown key .* \(did you mean",
        ),
        (
            ("/a", INT64),
            {"qos": {"deadline": -1}},
            "qos.deadline: expected at least 1e-09",
        ),
        (
            ("/a", INT64),
            {"qos": {"deadline": 1e12}},
            "qos.deadline: expected at most 1000000000",
        ),
        (
            ("/a", INT64),
            {"qos": {"lifespan": 1e12}},
            "qos.lifespan: expected at most 1000000000",
        ),
        (
            ("/a", INT64),
            {"qos": "atuo"},
            r"option \$.qos: expected text such as auto, or a mapping, got",
        ),
        (
            ("/a", INT64),
            {"qos": {"deadline": "atuo"}},
            r"qos.deadline: expected text such as auto, or a number or nothing, got",
        ),
        (("/a", INT64), {"node": "a b"}, r"option \$.node: expected text such as /camera"),
        (("/a", INT64), {"activate": "on"}, r"activate: expected false, true or keep"),
        (("/a", INT64), {"stale_after": 0}, r"option \$.stale_after: expected more than 0"),
    ],
)
def test_a_mistake_in_an_address_is_found_without_middleware(
    bridge: Bridge, address: tuple[str, ...], options: dict[str, object], words: str
) -> None:
    from uoarm_ros2 import uoarm_bridge_types

    kind = uoarm_bridge_types()[0]
    assert kind.check_endpoint is not None
    assert kind.endpoint_options is not None
    found = kind.check_endpoint(address, options)
    if not found:
        with pytest.raises(ValueError, match=words):
            kind.endpoint_options.of(options)
    else:
        assert re.search(words, found)
    with pytest.raises(BridgeError, match=words) as caught:
        bridge.describe(endpoint(Role.OUTPUT, *address, **options))  # type: ignore[arg-type]  # wrong on purpose
    assert caught.value.reason is FailureReason.BAD_ENDPOINT


def test_a_message_that_does_not_fit_is_the_senders_mistake(bridge: Bridge) -> None:
    out = sink(bridge, endpoint(Role.INPUT, "/outward", INT64, peer="optional"))
    with pytest.raises(MessageError, match=r"\$\.data: expected an integer"):
        out.send({"data": "1"})
    out.close()
    with pytest.raises(BridgeError, match="is closed"):
        out.send({"data": 1})


def test_a_publisher_without_readers_appears_to_ros(bridge: Bridge, peer: Start) -> None:
    out = sink(bridge, endpoint(Role.INPUT, "/outward", INT64, peer="optional"))
    listener = peer("listener")
    listener.do("subscribe", topic="/outward")
    matched(out, 1)
    out.send({"data": 5})
    assert listener.do("report", topic="/outward", expected=1) == [5]


def test_close_ends_deliveries_also_from_within_one(bridge: Bridge, peer: Start) -> None:
    talker = peer("talker")
    talker.do("advertise", topic="/busy")
    inbox = Inbox()

    def take(message: object) -> None:
        inbox(message)
        if len(inbox.messages) == 3:
            channel.close()

    channel = source(bridge, endpoint(Role.OUTPUT, "/busy", INT64), take)
    talker.do("publish", topic="/busy", count=100)
    inbox.wait_for(3)
    assert talker.do("subscriptions", topic="/busy", expected=0) == 0
    assert len(inbox.messages) == 3
    assert bridge.open_channels == 0


@pytest.mark.long
def test_a_thousand_openings_while_messages_flow_leave_nothing(
    make_bridge: Make, peer: Start
) -> None:
    bridge, talker, listener = make_bridge(settle=0), peer("talker"), peer("listener")
    talker.do("advertise", topic="/coming")
    listener.do("subscribe", topic="/going")
    came = Inbox()

    def turns(count: int) -> None:
        for _ in range(count):
            into = source(bridge, endpoint(Role.OUTPUT, "/coming", INT64), came)
            out = sink(bridge, endpoint(Role.INPUT, "/going", INT64))
            out.send({"data": 1})
            into.close()
            out.close()

    turns(1)
    await_quiet_watch(sink(bridge, endpoint(Role.INPUT, "/going", INT64)))
    snapshot = ResourceSnapshot()
    talker.start("publish", topic="/coming", count=10_000_000, period=0.001, unmatched=True)
    for working in [Background(partial(turns, 125)) for _ in range(4)]:
        working.result(20 * patience())
    while not came.messages:  # a talker that is starved begins late
        turns(1)
    assert bridge.open_channels == 0
    snapshot.check()


def test_a_native_link_passes_bytes_between_topics(bridge: Bridge, peer: Start) -> None:
    talker, listener = peer("talker"), peer("listener")
    talker.do("advertise", topic="/from")
    listener.do("subscribe", topic="/to")
    link = bridge.link(endpoint(Role.OUTPUT, "/from", INT64), endpoint(Role.INPUT, "/to", INT64))
    assert link is not None
    talker.do("publish", topic="/from", count=50)
    assert listener.do("report", topic="/to", expected=50) == list(range(1, 51))
    assert link.facts()["from messages"] == 50


def test_a_link_of_one_topic_is_only_watched(bridge: Bridge, peer: Start) -> None:
    talker, listener = peer("talker", **MORTAL), peer("listener")
    talker.do("advertise", topic="/shared")
    listener.do("subscribe", topic="/shared")
    events = Inbox(bridge)
    ends = endpoint(Role.OUTPUT, "/shared", INT64), endpoint(Role.INPUT, "/shared", INT64)
    link = bridge.link(*ends)
    assert link is not None
    assert link.facts() == {"publishers": 1, "subscriptions": 1}
    talker.kill()
    assert events.event(Health.LOST, "topic /shared: it has no publisher").channel is link
    bridge.close()
    assert link.facts() == {}


def test_topics_of_two_types_are_not_linked(bridge: Bridge, peer: Start) -> None:
    talker, listener = peer("talker"), peer("listener")
    talker.do("advertise", topic="/from")
    listener.do("subscribe", topic="/to", kind="String")
    string = "std_msgs/msg/String"
    ends = endpoint(Role.OUTPUT, "/from", INT64), endpoint(Role.INPUT, "/to", string)
    assert bridge.link(*ends) is None
