"""Names, and who connects: namespaces, remaps, private names, headers as real nodes send them."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import Any, cast

import pytest
from endpoints import bridge_to, input_, output, service
from peers import Master, Peer, RestartingMaster, running
from tests.inbox import Inbox  # type: ignore[import-not-found]
from uoarm_ros1._master import call_api
from uoarm_ros1._node import Rosout
from uoarm_ros1._options import NodeIdentity, Ros1BridgeOptions

from uoarm import RobotManager
from uoarm.bridge import Channel
from uoarm.config import loads
from uoarm.errors import BridgeError
from uoarm.model import Health, MessageStructure, OfferState
from uoarm.testing import Collector, patience, wait

INT = "std_msgs/Int64"
SET = "std_srvs/SetBool"
ADD = "actionlib/TwoIntsAction"
ANY = MessageStructure(True)


def test_relative_private_and_remapped_names_are_those_of_the_robot(
    master: Master, lasting: Peer
) -> None:
    lasting.do("advertise", topic="/lab/numbers", type=INT, latch=True)
    lasting.do("publish", topic="/lab/numbers", type=INT, values={"data": 1})
    lasting.do("advertise", topic="/robot7/camera", type=INT, latch=True)
    lasting.do("publish", topic="/robot7/camera", type=INT, values={"data": 2})
    lasting.do("serve", service="/lab/set", type=SET)
    lasting.do("set_param", name="/lab/cart/speed", value=3)
    lasting.do("subscribe", topic="/lab/cart/state", type=INT)
    remap = {"camera": "/robot7/camera", "/other/place": "numbers"}
    with bridge_to(master, namespace="/lab", node="cart", remap=remap) as bridge:
        for address, value in (("numbers", 1), ("camera", 2), ("/other/place", 1)):
            collector = Collector()
            bridge.open_source(output(address), ANY, collector.deliver)
            assert collector.wait(1) == [{"data": value}], address
        reply = bridge.call(service("set"), {"data": True})
        assert reply["success"]
        parameter = Collector()
        bridge.open_source(output("~speed", "parameter"), ANY, parameter.deliver)
        assert parameter.wait(1) == [3]
        sink = bridge.open_sink(input_("~state", INT), ANY)
        sink.send({"data": 4})
        lasting.wait_for("came", lambda came: {"data": 4} in came, topic="/lab/cart/state")
        bridge.serve(service("~lamp", SET), lambda ask: {"success": ask["data"], "message": "on"})
        bridge.serve(service("sum", ADD), lambda goal: {"sum": goal["a"] + goal["b"]})
        ask = {"service": "/lab/cart/lamp", "type": SET, "values": {"data": True}}
        assert lasting.do("call", **ask)["message"] == "on"
        goal = {"action": "/lab/sum", "type": ADD, "values": {"a": 1, "b": 2}}
        assert lasting.do("send_goal", **goal, timeout=patience())["result"] == {"sum": 3}
        found = {component.name for component in bridge.discover()}
        assert "/lasting" in found
        assert "/lab/cart" not in found  # it is this bridge's own


def test_the_name_of_a_host_goes_before_its_address() -> None:
    environment = {"ROS_IP": "10.0.0.5", "ROS_HOSTNAME": "cart.local"}
    assert NodeIdentity.of("b", Ros1BridgeOptions(), environment).host == "cart.local"
    assert NodeIdentity.of("b", Ros1BridgeOptions(host="10.0.0.9"), environment).host == "10.0.0.9"


def test_tools_that_take_any_type_are_given_type_sum_and_definition(
    master: Master, lasting: Peer
) -> None:
    with bridge_to(master) as bridge:
        at = input_("/any", "geometry_msgs/PointStamped", peer="optional", wait=0)
        sink = bridge.open_sink(at, ANY)
        lasting.do("subscribe_any", topic="/any")
        header = {"seq": 0, "stamp": {"secs": 1, "nsecs": 2}, "frame_id": "map"}
        message = {"header": header, "point": {"x": 1.0, "y": 2.0, "z": 3.0}}

        def has_come() -> bool:
            sink.send(message)
            return bool(lasting.do("count", topic="/any"))

        wait(has_come, "nothing comes")
        kind, md5, value = lasting.do("came", topic="/any")[0]
        assert (kind, md5) == ("geometry_msgs/PointStamped", "c63aecb41bfdfd6b7e1fac37c7cbe7bf")
        assert value["point"] == message["point"]


@pytest.mark.parametrize("nodelay", [True, False])
def test_small_messages_are_sent_as_the_endpoint_asks(
    master: Master, lasting: Peer, nodelay: bool
) -> None:
    topic = f"/delays{int(nodelay)}"
    lasting.do("advertise", topic=topic, type=INT)
    with bridge_to(master) as bridge:
        at = output(topic, nodelay=nodelay)
        bridge.open_source(at, ANY, Collector().deliver)
        lasting.wait_for("nodelays", lambda found: found == [nodelay], topic=topic)


def test_a_client_that_keeps_its_connection_calls_over_it(master: Master, lasting: Peer) -> None:
    """And one that asks for the type alone, as `rosservice` and `wait_for_service` do."""
    with bridge_to(master) as bridge:
        served = bridge.serve(
            service("/kept", SET), lambda ask: {"success": ask["data"], "message": "Kia ora"}
        )
        asked = [{"data": number % 2 == 0} for number in range(20)]
        replies = lasting.do("call_persistently", service="/kept", type=SET, requests=asked)
        assert [reply["success"] for reply in replies] == [ask["data"] for ask in asked]
        wait(lambda: served.facts()["clients"] == 0, "a connection is left")


@pytest.mark.parametrize(
    ("how", "words"), [("reject", "rejected: not today"), ("recall", "recalled: called back")]
)
def test_a_goal_that_is_refused_or_called_back_says_so(
    master: Master, lasting: Peer, how: str, words: str
) -> None:
    lasting.do("act_by_hand", action=f"/{how}", type=ADD, how=how)
    with bridge_to(master) as bridge, pytest.raises(BridgeError, match=f"the goal was {words}"):
        bridge.call(service(f"/{how}", ADD), {"a": 1, "b": 2})


def test_a_server_that_cannot_be_resolved_or_reached_is_named_with_what_to_set(
    master: Master, lasting: Peer
) -> None:
    lasting.do("serve", service="/far/set", type=SET)
    with bridge_to(master) as bridge:
        node: Any = bridge._node  # type: ignore[attr-defined]  # of this bridge
        for host, port, words in (
            ("no-such-host.invalid", 41213, "no-such-host.invalid:41213"),
            (master.host, 1, f"{master.host}:1"),
        ):
            node.master.service_address = lambda _, to=(host, port): to
            with pytest.raises(BridgeError) as caught:
                bridge.describe(service("/far/set"))
            assert words in str(caught.value)
            assert "ROS_HOSTNAME" in str(caught.value) or "ROS_IP" in str(caught.value)


@contextmanager
def watched_speed(folder: Path) -> Iterator[tuple[Master, Peer, Any, Collector]]:
    """A master, a node that sets its parameter /speed, 1 at first, and a bridge that watches it."""
    with running(folder / "master") as world:
        peer, collector = world.peer("setting"), Collector()
        peer.do("set_param", name="/speed", value=1)
        with bridge_to(world) as bridge:
            bridge.open_source(output("/speed", "parameter"), ANY, collector.deliver)
            assert collector.wait(1) == [1]
            yield world, peer, bridge, collector


def test_a_parameter_is_watched_over_the_death_of_its_master(tmp_path: Any) -> None:
    with watched_speed(tmp_path) as (world, peer, bridge, collector):
        reports = Inbox(bridge)
        wait(lambda: bridge._master_health.is_up, "the master was not asked")
        world.kill()
        reports.event(Health.DEGRADED, world.host)
        world.start()
        reports.event(Health.OK, "answers again")
        peer.do("set_param", name="/speed", value=2)
        assert collector.wait(2) == [1, 2]


def test_what_is_opened_before_the_look_at_a_new_master_hides_nothing_from_it(
    tmp_path: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    with running(tmp_path / "master") as world, bridge_to(world) as bridge:
        watching: Any = bridge
        bridge.open_source(output("/before", INT, peer="optional"), ANY, print)
        wait(lambda: watching._master_health.is_up, "the master was not asked")
        is_between = threading.Event()
        monkeypatch.setattr(bridge, "_look_at_master", is_between.set)
        assert is_between.wait(patience())
        world.kill()
        world.start()
        bridge.open_source(output("/since", INT, peer="optional"), ANY, print)
        assert watching._node.is_known()
        monkeypatch.undo()
        wait(lambda: "/before" in registered(watching._node), "it is not known")


def test_a_master_that_comes_back_with_its_process_is_another(
    tmp_path: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    with running(tmp_path / "master", RestartingMaster) as world, bridge_to(world) as bridge:
        watching: Any = bridge
        bridge.open_source(output("/before", INT, peer="optional"), ANY, print)
        wait(lambda: watching._master_health.is_up, "the master was not asked")
        world.kill()
        wait(lambda: not watching._master_health.is_up, "it is not missed")
        is_between = threading.Event()
        monkeypatch.setattr(bridge, "_look_at_master", is_between.set)
        assert is_between.wait(patience())
        world.start()
        bridge.open_source(output("/since", INT, peer="optional"), ANY, print)
        assert watching._node.is_known()
        monkeypatch.undo()
        wait(lambda: "/before" in registered(watching._node), "it is not known")


def test_a_parameter_that_is_not_set_any_more_is_degraded_until_it_is(tmp_path: Any) -> None:
    with watched_speed(tmp_path) as (world, peer, bridge, collector):
        wait(lambda: bridge._master_health.is_up, "the master was not asked")

        def start_again() -> None:
            world.kill()
            world.start()

        for number, go in enumerate(
            (lambda: peer.do("delete_param", name="/speed"), start_again), 2
        ):
            reports = Inbox(bridge)
            go()
            reports.event(Health.DEGRADED, "the parameter /speed is not set any more")
            peer.do("set_param", name="/speed", value=1)
            reports.event(Health.OK, "the parameter /speed is set again")
            assert collector.wait(number) == [1] * number


def test_a_change_of_a_parameter_that_is_more_than_a_call_may_hold_is_looked_at(
    master: Master, lasting: Peer
) -> None:
    """And where no answer may hold it, the parameter is degraded until it has another value."""
    for name in ("/table", "/speed"):
        lasting.do("set_param", name=name, value=[1])
    with bridge_to(master) as bridge:
        collectors = {name: Collector() for name in ("/table", "/speed")}
        for name, collector in collectors.items():
            bridge.open_source(output(name, "parameter"), ANY, collector.deliver)
            collector.wait(1)
        reports = Inbox(bridge)
        lasting.do("set_param", name="/table", value=[0] * 50_000)
        assert len(collectors["/table"].wait(2)[1]) == 50_000
        deep: list[object] = []
        for _ in range(100):
            deep = [deep]
        lasting.do("set_param", name="/table", value=deep)
        reports.event(Health.DEGRADED, "the parameter /table cannot be read: getParam: ")
        lasting.do("set_param", name="/table", value=[2])
        reports.event(Health.OK, "the parameter /table is set again")
        assert len(collectors["/table"].wait(3)[2]) == 1
        assert len(collectors["/speed"].messages) == 1


def test_a_change_of_a_parameter_in_one_that_is_watched_too_comes_once(
    master: Master, lasting: Peer
) -> None:
    lasting.do("set_param", name="/cart/speed", value=0)
    with bridge_to(master) as bridge:
        outer, inner = Collector(), Collector()
        bridge.open_source(output("/cart", "parameter"), ANY, outer.deliver)
        bridge.open_source(output("/cart/speed", "parameter"), ANY, inner.deliver)
        for count, value in enumerate((1, 2, 2, 3), 1):
            inner.wait(count)
            lasting.do("set_param", name="/cart/speed", value=value)
        assert inner.wait(5) == [0, 1, 2, 2, 3]
        wait(lambda: {"speed": 3} in outer.messages, "it has not come")


def test_a_look_that_fails_ends_no_other(master: Master, lasting: Peer) -> None:
    lasting.do("advertise", topic="/looked_at", type=INT)
    with bridge_to(master) as bridge:
        reports, failed = Inbox(bridge), threading.Event()

        def fail(_: object) -> None:
            failed.set()
            raise ZeroDivisionError

        sources: list[Any] = []
        for number in range(3):  # before it and behind it, in whatever order they are looked at
            looked_at = output("/looked_at", INT, component=f"c{number}", stale_after=0.1)
            sources.append(bridge.open_source(looked_at, ANY, print))
            if number == 1:
                sources[1].tick = fail
        assert failed.wait(patience())
        for source in (sources[0], sources[2]):
            wait(partial(is_lost, reports, source), "its silence is not seen")


def is_lost(reports: Inbox, channel: Channel) -> bool:
    events = tuple(reports.messages)
    return any(event.channel is channel and event.health is Health.LOST for event in events)


def test_a_master_whose_process_has_the_number_of_the_one_before_is_known_by_its_run(
    tmp_path: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As in a container, where a node opens something between two looks at the master."""
    with running(tmp_path / "master", RestartingMaster) as world:
        set_run = partial(call_api, world.uri, "setParam", "/roslaunch", "/run_id")
        set_run("first")
        with bridge_to(world) as bridge:
            watching: Any = bridge
            bridge.open_source(output("/before", INT, peer="optional"), ANY, print)
            wait(lambda: "first" in (watching._master_identity or ()), "the master was not asked")
            is_between = threading.Event()
            monkeypatch.setattr(bridge, "_look_at_master", is_between.set)
            assert is_between.wait(patience())
            world.kill()
            world.start()
            set_run("second")
            bridge.open_source(output("/since", INT, peer="optional"), ANY, print)
            assert "/before" not in registered(watching._node)
            monkeypatch.undo()
            wait(lambda: "/before" in registered(watching._node), "it is not known")


def test_a_parameter_that_is_found_twice_was_set_once(tmp_path: Any) -> None:
    """The look at the master finds a channel that is being opened, and registers it, too."""
    with watched_speed(tmp_path) as (_, peer, bridge, collector):
        bridge._node.register_again()
        peer.do("set_param", name="/speed", value=2)
        assert collector.wait(2) == [1, 2]


def test_a_parameter_that_is_set_as_a_new_master_is_found_without_it_was_set_once(
    tmp_path: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The master reports what is set after the registration, which found nothing."""
    with watched_speed(tmp_path) as (world, peer, bridge, collector):
        watch = bridge._node.master.watch_parameter

        def set_meanwhile(key: str) -> Any:
            found = watch(key)
            if found == {}:
                peer.do("set_param", name=key, value=2)
                collector.wait(2)
            return found

        monkeypatch.setattr(bridge._node.master, "watch_parameter", set_meanwhile)
        world.kill()
        world.start()
        assert collector.wait(2) == [1, 2]
        peer.do("set_param", name="/speed", value=3)
        assert collector.wait(3) == [1, 2, 3]


def test_what_is_being_registered_is_not_registered_again(
    tmp_path: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    """rospy that is announced a publisher twice replaces its connection to it."""
    with running(tmp_path / "master") as world, bridge_to(world, rosout=False) as bridge:
        node: Any = cast("Any", bridge)._node
        register, calls = node.master.register_publisher, []

        def look_before(*arguments: Any) -> Any:
            calls.append(arguments)
            if len(calls) == 1:
                cast("Any", bridge)._look_at_master()
            return register(*arguments)

        monkeypatch.setattr(node.master, "register_publisher", look_before)
        sink = bridge.open_sink(input_("/t", INT, peer="optional"), ANY)
        assert calls == [("/t", INT)]
        assert "/t" in registered(node)
        assert node.is_registered
        sink.close()
        assert not node.is_registered


def test_what_is_taken_back_while_it_is_registered_does_not_stay(
    tmp_path: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The look at the master registers /rosout as a brief application ends."""
    with running(tmp_path / "master") as world, bridge_to(world, rosout=False) as bridge:
        node: Any = cast("Any", bridge)._node
        register = node.master.register_publisher

        def late(*arguments: Any) -> Any:
            bridge.close()
            return register(*arguments)

        monkeypatch.setattr(node.master, "register_publisher", late)
        rosout = Rosout(node, cast("Any", bridge)._types)
        rosout.open()
        assert registered(node) == []
        with pytest.raises(BridgeError, match="is closed"):
            Rosout(node, cast("Any", bridge)._types).open()
        assert registered(node) == []


@pytest.mark.parametrize("kind", ["topic", "subscription", "service"])
def test_what_is_closed_while_it_is_registered_again_does_not_stay(
    tmp_path: Any, monkeypatch: pytest.MonkeyPatch, kind: str
) -> None:
    with running(tmp_path / "master") as world, bridge_to(world) as bridge:
        opened: Any
        if kind == "topic":
            opened, method = bridge.open_sink(input_("/t", INT, peer="optional"), ANY), "publisher"
        elif kind == "subscription":
            opened = bridge.open_source(output("/t", INT, peer="optional"), ANY, print)
            method = "subscriber"
        else:
            opened, method = bridge.serve(service("/t", SET), lambda _: {}), "service"
        node: Any = cast("Any", bridge)._node
        closed_during(monkeypatch, node.master, f"register_{method}", opened)
        node.register_again()
        assert "/t" not in registered(node)


def test_a_parameter_that_is_closed_while_it_is_watched_again_is_watched_no_more(
    tmp_path: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    with running(tmp_path / "master") as world, bridge_to(world) as bridge:
        peer = world.peer("setting")
        collector = Collector()
        for name in ("/speed", "/fence"):
            peer.do("set_param", name=name, value=1)
        opened = bridge.open_source(output("/speed", "parameter"), ANY, print)
        bridge.open_source(output("/fence", "parameter"), ANY, collector.deliver)
        node: Any = cast("Any", bridge)._node
        closed_during(monkeypatch, node.master, "watch_parameter", opened)
        node.register_again()
        keys: list[str] = []
        changed = node.parameter_changed

        def noted(key: str, value: Any, /) -> None:
            keys.append(key)
            changed(key, value)

        monkeypatch.setattr(node, "parameter_changed", noted)
        # The master reports to a node in order: the second comes after what the first would have.
        for name in ("/speed", "/fence"):
            peer.do("set_param", name=name, value=2)
        assert collector.wait(2) == [1, 2]
        assert keys == ["/fence"]


def registered(node: Any) -> list[str]:
    """Return what the master says that a node publishes, subscribes to or serves."""
    tables = node.master.call("getSystemState")
    return [name for table in tables for name, nodes in table if node.name in nodes]


def closed_during(monkeypatch: pytest.MonkeyPatch, master: Any, method: str, opened: Any) -> None:
    """Close a channel before the next call of a method gets to the master."""
    call = getattr(master, method)

    def late(*arguments: Any) -> Any:
        opened.close()
        return call(*arguments)

    monkeypatch.setattr(master, method, late)


def test_frames_that_stand_still_are_offered_back_to_who_comes_later(master: Master) -> None:
    """Of several publishers each keeps its own; the one here keeps what all of them have said."""
    peers = [master.peer(f"still{number}", "/tf_static:=/far/tf_static") for number in range(2)]
    for number, peer in enumerate(peers):
        peer.do("static_transforms", frames=[f"a{number}", f"b{number}"])
    text = f"""
version: 1
bridges: {{ros: {{plugin: ros1, options: {{master: "{master.uri}", wait: 60}}}}}}
functions:
  frames:
    components: [{{name: frames, bridge: ros, output: {{endpoint: [/far/tf_static]}}}}]
offer:
  ros:
    frames:
      output: {{endpoint: [/near/tf_static, tf2_msgs/TFMessage], options: {{latch: 100}}}}
"""
    remap = "/tf_static:=/near/tf_static"
    frames = ["a0", "a1", "b0", "b1"]
    with RobotManager(loads(text)) as manager:
        manager.offer()
        wait(lambda: {offer.state for offer in manager.status().offers} == {OfferState.OPEN})
        for name in ("early", "late"):
            listener = master.peer(f"{name}_listener", remap)
            assert listener.do("look_up", frames=frames, seconds=patience()) == frames
            listener.kill()
    for peer in peers:
        peer.kill()
