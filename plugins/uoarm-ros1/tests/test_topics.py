"""Topics between the bridge and real nodes of rospy: what comes, who dies, and what is said."""

from __future__ import annotations

import os
import socket
import threading
import time
from functools import partial
from operator import lt
from typing import Any
from xmlrpc.client import ServerProxy

import pytest
from endpoints import bridge_to, input_, output, service
from peers import Master, Peer
from ros1_world import large_image, zero
from tests.inbox import Inbox  # type: ignore[import-not-found]
from uoarm_ros1 import _channels, _subscription
from uoarm_ros1._node import Node

from uoarm import RobotManager
from uoarm.bridge import Bridge, Source
from uoarm.config import loads
from uoarm.errors import BridgeError, FailureReason
from uoarm.model import Endpoint, Health, MessageStructure
from uoarm.testing import Collector, ResourceSnapshot, patience, same, slowness, wait

INT = "std_msgs/Int32"
SIZES = (("many", "[]"), ("three", "[3]"))
ANY = MessageStructure(True)


def opened(bridge: Bridge, at: Endpoint) -> tuple[Source, Collector]:
    collector = Collector()
    structure = bridge.describe(at).message
    assert structure is not None
    return bridge.open_source(at, structure, collector.deliver), collector


def test_the_type_and_its_structure_come_from_the_publisher(master: Master, lasting: Peer) -> None:
    lasting.do("advertise", topic="/typed", type="geometry_msgs/PoseStamped")
    with bridge_to(master) as bridge:
        message: Any = bridge.describe(output("/typed")).message
    assert message.native_type == "geometry_msgs/PoseStamped"
    properties = message.schema["properties"]
    assert properties["pose"]["properties"]["position"]["x-type"]["name"] == "geometry_msgs/Point"
    assert properties["header"]["properties"]["stamp"]["properties"].keys() == {"secs", "nsecs"}


NUMBERS = ("int8", "uint8", "int16", "uint16", "int32", "uint32", "int64", "uint64")
PRIMITIVES = (*NUMBERS, "float32", "float64", "bool", "byte", "char", "string", "time", "duration")
EVERYTHING = "\n".join(
    [f"{kind} {kind}_{name}" for kind in (*PRIMITIVES, "Part") for name in ("a", "B")]
    + [f"{kind}{size} {kind}_{name}" for kind in (*PRIMITIVES, "Part") for name, size in SIZES]
    + ["=" * 80, "MSG: test/Part", "float32[] numbers", "time[2] times", "string NAME"]
)


def test_every_primitive_and_every_array_of_them_pass_there_and_back(
    master: Master, lasting: Peer
) -> None:
    native = "test/Everything"
    messages: list[Any] = []
    lasting.do("define", type=native, definition=EVERYTHING)
    lasting.do("advertise", topic="/every/in", type=native)
    lasting.do("subscribe", topic="/every/out", type=native)
    with bridge_to(master) as bridge:
        back = input_("/every/out", native, definition=EVERYTHING, wait=patience(), queue=1000)
        sink = bridge.open_sink(back, ANY)
        at = output("/every/in", wait=patience())
        structure = bridge.describe(at).message
        assert structure is not None

        def pass_on(message: Any) -> None:
            messages.append(message)
            sink.send(message)

        bridge.open_source(at, structure, pass_on)
        lasting.wait_for("connections", bool, topic="/every/in")
        sent = lasting.do("publish_random", topic="/every/in", type=native, count=200)
        lasting.wait_for("count", lambda count: count == 200, topic="/every/out")
        assert same(lasting.do("came", topic="/every/out"), sent)
    assert same(messages, sent)


def test_two_megabytes_pass_both_ways(master: Master, lasting: Peer) -> None:
    lasting.do("echo", topic="/large/in", to="/large/out", type="sensor_msgs/Image")
    with bridge_to(master, max_octets=4 << 20) as bridge:
        _, collector = opened(bridge, output("/large/out", wait=patience()))
        sink = bridge.open_sink(input_("/large/in", wait=patience()), ANY)
        image = large_image()
        sink.send(image)
        (came,) = collector.wait(1)
        came["header"]["seq"] = 0  # which rospy counts itself
        assert same(came, image)


def test_a_message_beyond_the_budget_ends_the_connection_and_is_said(
    master: Master, lasting: Peer
) -> None:
    lasting.do("advertise", topic="/beyond", type="std_msgs/String")
    with bridge_to(master, max_octets=1000) as bridge:
        reports = Inbox(bridge)
        opened(bridge, output("/beyond"))
        lasting.publish("/beyond", type="std_msgs/String", values={"data": "x" * 2000})
        assert "1,000 are allowed (max_octets)" in reports.event(Health.LOST).cause


def test_a_latched_message_comes_first_from_every_publisher(master: Master) -> None:
    peers = [master.peer(f"latching{number}") for number in range(2)]
    for number, peer in enumerate(peers):
        peer.do("advertise", topic="/latched", type=INT, latch=True)
        peer.do("publish", topic="/latched", type=INT, values={"data": number})
    with bridge_to(master) as bridge:
        source, collector = opened(bridge, output("/latched"))
        came = collector.wait(2)
        assert sorted(message["data"] for message in came) == [0, 1]
        assert source.latched
    for peer in peers:
        peer.kill()


def test_who_joins_later_gets_what_every_publisher_has_latched(master: Master) -> None:
    """Frames that stand still: each node latches its own, and takes them along when it goes."""
    peers = [master.peer(f"static{number}") for number in range(2)]
    for number, peer in enumerate(peers):
        peer.do("static_transforms", frames=[f"a{number}", f"b{number}"])

    def frames(messages: list[Any]) -> list[list[str]]:
        return sorted(
            [transform["child_frame_id"] for transform in message["transforms"]]
            for message in messages
        )

    text = f"""
version: 1
bridges: {{ros: {{plugin: ros1, options: {{master: "{master.uri}", wait: 60}}}}}}
functions:
  frames: {{components: [{{name: frames, bridge: ros, output: {{endpoint: [/tf_static]}}}}]}}
"""
    with RobotManager(loads(text)) as manager, manager.request("frames") as first:
        both = [["a0", "b0"], ["a1", "b1"]]
        assert frames([first.get(patience()) for _ in range(2)]) == both
        with manager.request("frames") as second:
            assert frames([second.get(patience()) for _ in range(2)]) == both
        peers[0].kill()

        def stands() -> bool:
            with manager.request("frames") as third:
                came = [third.get(patience())]
                try:
                    came.append(third.get(0.2 * slowness()))
                except TimeoutError:
                    return frames(came) == both[1:]
                return False

        wait(stands, "what a node latched stands though it is gone")
    for peer in peers:
        peer.kill()


def test_we_latch_for_those_who_come_later(master: Master, lasting: Peer) -> None:
    with bridge_to(master) as bridge:
        at = input_("/ours", "std_msgs/String", peer="optional", wait=0, latch=True)
        bridge.open_sink(at, ANY).send({"data": "kept"})
        lasting.do("subscribe", topic="/ours", type="std_msgs/String")
        lasting.wait_for("came", lambda came: came == [{"data": "kept"}], topic="/ours")


def test_several_sources_of_one_topic_each_get_all(master: Master, lasting: Peer) -> None:
    lasting.do("advertise", topic="/shared", type=INT)
    with bridge_to(master) as bridge:
        collectors = [opened(bridge, output("/shared"))[1] for _ in range(3)]
        bridge.describe(output("/shared"))  # asks as one more subscriber, and takes none away
        lasting.publish("/shared", type=INT, values={"data": 1}, count=5)
        for collector in collectors:
            assert len(collector.wait(5)) == 5


def test_one_node_of_several_can_be_meant(master: Master) -> None:
    peers = [master.peer(f"camera{number}") for number in range(2)]
    for peer in peers:
        peer.do("advertise", topic="/cameras", type=INT)
    with bridge_to(master) as bridge:
        reports = Inbox(bridge)
        _, collector = opened(bridge, output("/cameras", node="/camera1"))
        peers[0].do("publish", topic="/cameras", type=INT, values={"data": 0})
        peers[1].publish("/cameras", type=INT, values={"data": 1})
        assert collector.wait(1) == [{"data": 1}]
        peers[0].kill()
        peers[1].do("publish", topic="/cameras", type=INT, values={"data": 2})
        assert collector.wait(2) == [{"data": 1}, {"data": 2}]
        assert not [event for event in reports.messages if event.health is Health.LOST]
        peers[1].kill()
        assert "/camera1" in reports.event(Health.LOST).cause
        with pytest.raises(BridgeError, match="node /absent does not publish"):
            bridge.describe(output("/cameras", node="/absent"))


def test_a_node_that_is_killed_is_lost_at_once_and_found_on_another_port(master: Master) -> None:
    first = master.peer("mortal")
    first.do("advertise", topic="/mortal", type=INT)
    at = output("/mortal", component="mortal component")
    with bridge_to(master) as bridge:
        reports = Inbox(bridge)
        source, _ = opened(bridge, at)
        first.kill()
        lost = reports.event(Health.LOST, "/mortal")
        assert lost.channel is source
        source.close()
        with pytest.raises(BridgeError) as caught:  # it stays registered at the master
            bridge.describe(at)
        assert caught.value.reason is FailureReason.UNAVAILABLE
        assert master.host in str(caught.value)
        second = master.peer("mortal")
        second.do("advertise", topic="/mortal", type=INT)
        assert reports.event(Health.OK, "/mortal").component == "mortal component"
        _, collector = opened(bridge, at)
        second.publish("/mortal", type=INT, values={"data": 3})
        assert collector.wait(1) == [{"data": 3}]
        second.kill()


def test_a_publisher_that_comes_later_is_connected(master: Master) -> None:
    with bridge_to(master) as bridge:
        collector = Collector()
        at = output("/later", INT, peer="optional")
        bridge.open_source(at, ANY, collector.deliver)
        peer = master.peer("late")
        peer.do("advertise", topic="/later", type=INT)
        peer.publish("/later", type=INT, values={"data": 4})
        assert collector.wait(1) == [{"data": 4}]
        peer.kill()


def test_a_killed_node_beside_one_that_lives_is_said_once(
    master: Master, lasting: Peer, monkeypatch: pytest.MonkeyPatch
) -> None:
    """It stays registered, and is tried again and again: the topic is well all the same."""
    dying = master.peer("half")
    for peer in (dying, lasting):
        peer.do("advertise", topic="/half", type=INT)
    with bridge_to(master) as bridge:
        reports = Inbox(bridge)
        _, collector = opened(bridge, output("/half"))
        dying.kill()
        reports.event(Health.DEGRADED)
        tries = Counted(_subscription._subscribe)
        monkeypatch.setattr(_subscription, "_subscribe", tries)
        for number in range(3):
            wait(partial(tries.is_beyond, number), "it is not tried again")
            lasting.publish("/half", type=INT, values={"data": number})
            collector.wait(number + 1)
        assert [event.health for event in reports.messages] == [Health.DEGRADED, Health.OK]


class Counted:
    """A function, and how often it was called."""

    def __init__(self, function: Any) -> None:
        self.function, self.count = function, 0

    def __call__(self, *given: Any, **named: Any) -> Any:
        self.count += 1
        return self.function(*given, **named)

    def is_beyond(self, count: int) -> bool:
        return self.count > count


@pytest.mark.usefixtures("short")
def test_a_node_that_hangs_is_asked_and_lost(master: Master) -> None:
    peer = master.peer("hanging")
    peer.do("advertise", topic="/hanging", type=INT)
    with bridge_to(master, silence=0.2) as bridge:
        reports = Inbox(bridge)
        opened(bridge, output("/hanging"))
        peer.freeze()
        assert "no answer in time" in reports.event(Health.LOST).cause
        peer.thaw()
        reports.event(Health.OK, "/hanging")
    peer.kill()


def test_a_silent_publisher_that_answers_is_well(master: Master, lasting: Peer) -> None:
    lasting.do("advertise", topic="/quiet", type=INT)
    with bridge_to(master, silence=0.05) as bridge:
        reports = Inbox(bridge)
        source, collector = opened(bridge, output("/quiet"))
        asked = threading.Event()
        asked.wait(0.5)  # several times as long as until it is asked
        lasting.publish("/quiet", type=INT, values={"data": 1})
        collector.wait(1)
        assert source.facts()["interruptions"] == 0
        assert not reports.messages


def test_a_topic_without_messages_is_lost_by_its_rate(master: Master, lasting: Peer) -> None:
    lasting.do("advertise", topic="/stale", type=INT)
    with bridge_to(master) as bridge:
        reports = Inbox(bridge)
        opened(bridge, output("/stale", stale_after=0.2))
        assert "no message for 0.2 s" in reports.event(Health.LOST).cause


def test_simulated_time_stands_still_until_it_is_said(master: Master) -> None:
    peer = master.peer("simulator")
    peer.do("advertise", topic="/clock", type="rosgraph_msgs/Clock", latch=True)
    peer.do("advertise", topic="/simulated", type=INT)

    def say(seconds: int) -> None:
        values = {"clock": {"secs": seconds, "nsecs": 0}}
        peer.do("publish", topic="/clock", type="rosgraph_msgs/Clock", values=values)

    def has_said(seconds: int) -> bool:
        return bool(clock._clock.stamp()["secs"] == seconds)

    with bridge_to(master, use_sim_time=True) as bridge:
        reports = Inbox(bridge)
        clock: Any = bridge
        source: Any = opened(bridge, output("/simulated", stale_after=10))[0]
        for seconds, counted in ((1_000, 0), (1_009, 9), (5, 9)):  # at last another run
            say(seconds)
            wait(partial(has_said, seconds), "the clock is not taken")
            assert clock._clock.now() == counted
            source.tick(None)
            assert not reports.messages
        say(7)
        assert "no message for 10 s" in reports.event(Health.LOST).cause
    peer.kill()


def test_another_definition_of_a_type_is_refused_with_both_sums(
    master: Master, lasting: Peer
) -> None:
    lasting.do("subscribe", topic="/other", type="std_msgs/String")
    with bridge_to(master) as bridge:
        reports = Inbox(bridge)
        at = input_("/other", "std_msgs/String", definition="int32 data", wait=slowness())
        with pytest.raises(BridgeError, match="build both of one definition"):
            bridge.open_sink(at, ANY)
        refused = reports.event(Health.DEGRADED, "/lasting wants topic /other")
        assert "992ce8a1687cec8c8bd883ec73ca41d1" in refused.cause
        assert "da5909fbe378aeaf85e547e830cc1bb7" in refused.cause
    lasting.do("advertise", topic="/another", type="std_msgs/String")
    with bridge_to(master) as bridge, pytest.raises(BridgeError, match="da5909fbe378aeaf"):
        bridge.describe(output("/another", "std_msgs/String", definition="int32 data"))


def test_a_topic_is_well_again_once_whom_it_refused_is_gone(master: Master, lasting: Peer) -> None:
    other = master.peer("other")
    lasting.do("subscribe", topic="/mixed", type=INT)
    with bridge_to(master) as bridge:
        reports = Inbox(bridge)
        sink = bridge.open_sink(input_("/mixed", INT, wait=patience()), ANY)
        other.do("subscribe", topic="/mixed", type="std_msgs/String")
        refused = reports.event(Health.DEGRADED, "/other wants topic /mixed")
        sink.send({"data": 1})
        assert not [event for event in reports.messages if event.health is Health.OK]
        other.do("subscribe_no_more", topic="/mixed")
        assert refused.channel is reports.event(Health.OK, "/other is connected, or subs").channel
    other.kill()


def test_a_topic_is_well_again_once_the_publisher_that_it_refused_is_gone(
    master: Master, lasting: Peer
) -> None:
    other = master.peer("another")
    lasting.do("advertise", topic="/mingled", type=INT)
    with bridge_to(master) as bridge:
        reports, came = Inbox(bridge), Inbox()
        place = output("/mingled", INT, wait=patience(), peer="optional")
        source = bridge.open_source(place, ANY, came)
        other.do("advertise", topic="/mingled", type="std_msgs/String")
        refused = reports.event(Health.DEGRADED, "std_msgs/String")
        lasting.publish("/mingled", type=INT, values={"data": 1})
        came.wait_for(1)
        assert not [event for event in reports.messages if event.health is Health.OK]
        lasting.do("advertise_no_more", topic="/mingled")
        wait(lambda: source.facts()["publishers"] == [])
        lasting.do("advertise", topic="/mingled", type=INT)
        wait(lambda: source.facts()["publishers"] == ["/lasting"])
        assert not [event for event in reports.messages if event.health is Health.OK]
        other.do("advertise_no_more", topic="/mingled")
        assert refused.channel is reports.event(Health.OK, "connected, or publishes no").channel
    other.kill()


def test_a_subscriber_that_replaces_its_connection_is_no_loss_and_one_that_goes_is(
    master: Master, lasting: Peer, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(_channels, "_RETURN_SECONDS", patience())
    lasting.do("subscribe", topic="/replaced", type=INT)
    with bridge_to(master) as bridge:
        reports = Inbox(bridge)
        sink = bridge.open_sink(input_("/replaced", INT, wait=patience()), ANY)
        lasting.do("connect_again", topic="/replaced")
        reports.event(Health.DEGRADED, "disconnected: subscriber of /replaced: subscriber /lasting")
        reports.event(Health.OK, "subscriber of /replaced: a peer is connected")
        sink.send({"data": 1})
        lasting.wait_for("count", lambda count: count == 1, topic="/replaced")
        assert [event.health for event in reports.messages] == [Health.DEGRADED, Health.OK]
        sink.close()
    monkeypatch.setattr(_channels, "_RETURN_SECONDS", 0.05)
    with bridge_to(master) as bridge:
        reports = Inbox(bridge)
        sink = bridge.open_sink(input_("/replaced", INT, wait=patience()), ANY)
        lasting.do("subscribe_no_more", topic="/replaced")
        assert reports.event(Health.LOST, "no peer for 0.05 s: subscriber /las").channel is sink


def test_a_sink_for_a_node_is_lost_with_it_though_another_subscribes(
    master: Master, lasting: Peer
) -> None:
    peer = master.peer("meant")
    for node in (peer, lasting):
        node.do("subscribe", topic="/meant", type=INT)
    with bridge_to(master) as bridge:
        reports = Inbox(bridge)
        sink = bridge.open_sink(input_("/meant", INT, node="/meant", wait=patience()), ANY)
        wait(lambda: sink.facts()["subscribers"] == ["/lasting", "/meant"])
        peer.kill()
        assert reports.event(Health.LOST, "/meant").channel is sink
        assert sink.facts()["subscribers"] == ["/lasting"]


def test_a_subscriber_that_is_refused_still_is_reported_beside_one_that_comes(
    master: Master, lasting: Peer
) -> None:
    other = master.peer("still_other")
    with bridge_to(master) as bridge:
        reports = Inbox(bridge)
        sink = bridge.open_sink(input_("/mixed/still", INT, peer="optional"), ANY)
        other.do("subscribe", topic="/mixed/still", type="std_msgs/String")
        reports.event(Health.DEGRADED, "/still_other wants topic /mixed/still")
        lasting.do("subscribe", topic="/mixed/still", type=INT)
        wait(lambda: sink.facts()["subscribers"] == ["/lasting"])
        other.do("subscribe_no_more", topic="/mixed/still")
        reports.event(Health.OK, "/still_other is connected, or subscribes no more")
        assert [event.health for event in reports.messages] == [Health.DEGRADED, Health.OK]
    other.kill()


def test_a_subscriber_that_takes_no_tcpros_is_named(master: Master) -> None:
    with bridge_to(master) as bridge:
        reports = Inbox(bridge)
        at = input_("/hurried", "std_msgs/String", peer="optional", wait=0)
        bridge.open_sink(at, ANY)
        known: Any
        node: Any
        with ServerProxy(master.uri) as known:
            (name,) = dict(known.getSystemState("/rviz")[2][0])["/hurried"]
            address = known.lookupNode("/rviz", name)[2]
        with ServerProxy(address) as node:
            asked = [["UDPROS", "", "here", 1, 1500]]
            assert node.requestTopic("/rviz", "/hurried", asked)[0] == 0
        reports.event(Health.DEGRADED, "/rviz wants /hurried over UDPROS alone")


def test_a_type_that_is_not_published_is_refused_with_what_to_do(master: Master) -> None:
    with bridge_to(master) as bridge:
        with pytest.raises(BridgeError, match="its type is in no address"):
            bridge.describe(input_("/untyped", peer="optional"))
        with pytest.raises(BridgeError, match=r"my_msgs/msg/Own\.msg in the bridge's option"):
            bridge.describe(input_("/unknown", "my_msgs/Own", peer="optional"))


def test_definitions_of_folders_and_of_endpoints_are_used(master: Master, tmp_path: Any) -> None:
    folder = tmp_path / "my_msgs" / "msg"
    folder.mkdir(parents=True)
    (folder / "Own.msg").write_text("Header header\nPart[] parts\n")
    (folder / "Part.msg").write_text("geometry_msgs/Point at\n")
    with bridge_to(master, definitions=[str(tmp_path)]) as bridge:
        at = input_("/own", "my_msgs/Own", peer="optional")
        message: Any = bridge.describe(at).message
        part = message.schema["properties"]["parts"]["items"]["properties"]["at"]
        assert part["properties"]["x"]["x-unit"] == "m"
        bridge.open_sink(at, ANY).send(
            {"header": zero("std_msgs/Header"), "parts": [{"at": {"x": 1, "y": 2, "z": 3}}]}
        )
        written = input_("/written", "my_msgs/New", definition="int8 a", peer="optional")
        message = bridge.describe(written).message
        assert message.schema["required"] == ["a"]


def test_a_host_that_cannot_be_resolved_or_reached_is_named_with_what_to_set(
    master: Master, lasting: Peer
) -> None:
    lasting.do("advertise", topic="/elsewhere", type=INT)
    with bridge_to(master) as bridge:
        node: Node = bridge._node  # type: ignore[attr-defined]  # of this bridge
        real = node.master.node_uri
        for uri, words in (
            ("http://no-such-host.invalid:41213/", ("no-such-host.invalid:41213", "ROS_HOSTNAME")),
            (f"http://{master.host}:1/", (f"{master.host}:1", "ROS_IP")),
        ):
            node.master.node_uri = lambda name, uri=uri: uri  # type: ignore[method-assign, misc]
            with pytest.raises(BridgeError) as caught:
                bridge.describe(output("/elsewhere"))
            assert all(word in str(caught.value) for word in words), str(caught.value)
        node.master.node_uri = real  # type: ignore[method-assign]


def test_a_master_that_is_not_there_is_named_with_what_to_set(master: Master) -> None:
    nowhere = f"http://{master.host}:1"
    with bridge_to(master, master=nowhere) as bridge:
        with pytest.raises(BridgeError) as caught:
            bridge.describe(output("/image"))
        assert caught.value.reason is FailureReason.UNAVAILABLE
        assert f"{master.host}:1" in str(caught.value)
        assert "ROS_MASTER_URI" in str(caught.value)


def test_what_is_wrong_is_said_on_rosout(master: Master, lasting: Peer) -> None:
    peer = master.peer("dying")
    peer.do("advertise", topic="/dying", type=INT)
    lasting.do("subscribe", topic="/rosout", type="rosgraph_msgs/Log")
    with bridge_to(master) as bridge:
        opened(bridge, output("/dying"))
        node: Any = bridge
        rosout = node._rosout
        wait(
            lambda: rosout._publication is not None and "/lasting" in rosout._publication.callers,
            "/rosout is not subscribed to",
        )
        peer.kill()
        lasting.wait_for(
            "came",
            lambda came: any("/dying" in log["msg"] and log["level"] == 8 for log in came),
            topic="/rosout",
        )


def test_a_node_of_the_same_name_ends_the_bridge(master: Master) -> None:
    with bridge_to(master, node="twin") as first:
        reports = Inbox(first)
        first.open_sink(input_("/twin", INT, peer="optional"), ANY)
        with bridge_to(master, node="twin") as second:
            second.open_sink(input_("/twin", INT, peer="optional"), ANY)
            lost = reports.event(Health.LOST, "ends node /twin")
            assert lost.channel is None


def test_a_subscription_of_our_own_is_waited_for_until_it_takes_messages(
    master: Master, monkeypatch: pytest.MonkeyPatch
) -> None:
    """On a busy machine its first connection may be given up after the publisher took it in."""
    given_up, is_open = threading.Event(), threading.Event()

    def receive(connection: socket.socket, *given: Any) -> Any:
        answered = receive_header(connection, *given)
        if not given_up.is_set():
            is_open.wait(0.5)
            given_up.set()
            raise TimeoutError
        return answered

    receive_header = _subscription._receive_header
    monkeypatch.setattr(_subscription, "_receive_header", receive)
    with bridge_to(master) as bridge:
        collector = Collector()
        at = ("/given_up", INT)
        bridge.open_source(output(*at, peer="optional"), ANY, collector.deliver)
        sink = bridge.open_sink(input_(*at, peer="optional"), ANY)
        is_open.set()
        sink.send({"data": 1})
        assert collector.wait(1) == [{"data": 1}]


def test_a_subscriber_that_reads_nothing_holds_up_no_other(master: Master, lasting: Peer) -> None:
    stuck = master.peer("stuck")
    for peer in (stuck, lasting):
        peer.do("subscribe", topic="/much", type="std_msgs/String")
    with bridge_to(master, max_octets=1 << 18) as bridge:
        sink = bridge.open_sink(input_("/much", queue=10, wait=patience()), ANY)
        wait(lambda: len(sink.facts()["subscribers"]) == 2)  # type: ignore[arg-type]  # a list
        stuck.freeze()
        for number in range(200):
            sink.send({"data": str(number) + "x" * 200_000})
            lasting.wait_for("count", partial(lt, number), topic="/much")
        facts: Any = sink.facts()
        assert facts["lost_on_link"] > 0
        assert facts["under_way"] <= 6, "four times `max_octets`, and what is half sent"
        stuck.kill()
        sink.send({"data": "last"})
        lasting.wait_for("count", lambda count: count == 201, topic="/much")


def test_a_thousand_connections_and_kills_leave_nothing_behind(master: Master) -> None:
    with bridge_to(master, rosout=False) as bridge:
        sink = bridge.open_sink(input_("/kills", INT, peer="optional", latch=True), ANY)
        sink.send({"data": 1})
        node: Node = bridge._node  # type: ignore[attr-defined]  # of this bridge
        snapshot = ResourceSnapshot()
        for number in range(1000):
            host, port = node._api.host, node._api.port
            with socket.create_connection((host, port)) as connection:
                if number % 2:
                    connection.sendall(b"\5\0\0")
                else:
                    from uoarm_ros1._tcpros import encode_header, subscriber_header

                    header = subscriber_header(f"/killed{number}", "/kills")
                    connection.sendall(encode_header(header))
                    connection.recv(10)
                # Ended by a reset, as by a process that is killed with octets unread.
                connection.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, b"\1\0\0\0\0\0\0\0")
        wait(lambda: not sink.facts()["subscribers"], "connections are left")
        snapshot.check(patience())


def test_a_link_moves_octets_without_reading_them(master: Master, lasting: Peer) -> None:
    peer = master.peer("linking")
    peer.do("advertise", topic="/link/from", type="std_msgs/String")
    lasting.do("subscribe", topic="/link/to", type="std_msgs/String")
    with bridge_to(master) as bridge:
        link = bridge.link(
            output("/link/from", wait=patience()), input_("/link/to", wait=patience())
        )
        assert link is not None
        values = {"data": "Kia ora"}
        peer.publish("/link/from", type="std_msgs/String", values=values, count=3)
        lasting.wait_for("count", lambda count: count == 3, topic="/link/to")
        wait(lambda: link.facts()["moved"] == 3)  # counted after they were written
        lasting.do("advertise", topic="/link/other", type=INT)
        assert bridge.link(output("/link/other"), input_("/link/to")) is None
        reports = Inbox(bridge)
        peer.kill()
        assert reports.event(Health.LOST).channel is link


def test_a_link_is_lost_by_its_rate_and_not_while_messages_come(
    master: Master, lasting: Peer
) -> None:
    lasting.do("advertise", topic="/rate/from", type=INT)
    lasting.do("subscribe", topic="/rate/to", type=INT)
    stale_after = 0.5 * slowness()
    with bridge_to(master) as bridge:
        reports = Inbox(bridge)
        link = bridge.link(
            output("/rate/from", wait=patience(), stale_after=stale_after),
            input_("/rate/to", wait=patience()),
        )
        assert link is not None
        for count in range(30):
            lasting.publish("/rate/from", type=INT, values={"data": count})
            time.sleep(stale_after / 10)
        assert not reports.messages
        assert "no message for" in reports.event(Health.LOST).cause


def test_two_nodes_on_one_topic_are_connected_already(master: Master, lasting: Peer) -> None:
    peer = master.peer("publishing")
    peer.do("advertise", topic="/one", type=INT)
    lasting.do("subscribe", topic="/one", type=INT)
    with bridge_to(master) as bridge:
        reports = Inbox(bridge)
        link = bridge.link(output("/one"), input_("/one"))
        assert link is not None
        peer.publish("/one", type=INT, values={"data": 1})
        lasting.wait_for("count", lambda count: count == 1, topic="/one")
        peer.kill()
        assert reports.event(Health.LOST).channel is link


def test_what_is_there_with_another_type_or_as_another_kind_is_named(
    master: Master, lasting: Peer
) -> None:
    lasting.do("advertise", topic="/spoken", type=INT)
    lasting.do("subscribe", topic="/taken", type=INT)
    lasting.do("serve", service="/served", type="std_srvs/SetBool")
    text = "std_msgs/String"
    known = f"; it is known as {INT}, not {text}"
    with bridge_to(master) as bridge:
        for at, words in (
            (output("/taken", text), f"no node publishes /taken{known}"),
            (input_("/spoken", text), f"no node subscribes to /spoken{known}"),
            (output("/served", text), "/served; there is a service of that name"),
            (service("/spoken"), f"; there is a topic of that name, of type {INT}"),
        ):
            with pytest.raises(BridgeError, match=words):
                bridge.describe(at)


def test_a_name_that_is_nearly_right_is_proposed(master: Master, lasting: Peer) -> None:
    lasting.do("advertise", topic="/uttered", type=INT)
    lasting.do("subscribe", topic="/heeded", type=INT)
    lasting.do("serve", service="/swivel", type="std_srvs/SetBool")
    lasting.do("set_param", name="/velocity", value=1)
    with bridge_to(master) as bridge:
        for at, words in (
            (output("/utered", INT), "/utered; did you mean '/uttered'"),
            (input_("/heded", INT), "/heded; did you mean '/heeded'"),
            (service("/swivl"), "; did you mean '/swivel'"),
            (output("/velocty", "parameter"), "not set; did you mean '/velocity'"),
            (output("/uttered", INT, node="/lastin"), "/uttered; did you mean '/lasting'"),
        ):
            with pytest.raises(BridgeError, match=words):
                bridge.describe(at)


def test_a_bridge_off_loopback_says_where_it_is_reached(master: Master) -> None:
    with bridge_to(master, host="127.0.0.1") as bridge:
        node: Node = bridge._node  # type: ignore[attr-defined]  # of this bridge
        assert node.uri.startswith("http://127.0.0.1:")
    assert os.environ.get("ROS_IP") is None  # nothing of it is inherited
