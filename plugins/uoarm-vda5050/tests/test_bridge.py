"""Transport orders, health and discovery, against a real Mosquitto and real vehicles."""

from __future__ import annotations

import json
import socket
import threading
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import pytest
from attrs import evolve
from brokers import Broker, Peer, running
from tests.inbox import health_events, until  # type: ignore[import-not-found]
from uoarm_mqtt.connection import BrokerConnection
from uoarm_vda5050.vehicle import Vehicle

from fleet import MAKER, bridge_to, driven, endpoint, goal
from uoarm import RobotManager
from uoarm.config import loads
from uoarm.errors import BridgeError
from uoarm.model import Health, MessageStructure
from uoarm.testing import Background, Collector, patience, wait

ANYTHING = MessageStructure(True)
RELEASES = ("2.0", "2.1", "3.0")


@pytest.mark.parametrize("release", RELEASES)
def test_a_transport_order_is_a_call(broker: Broker, release: str) -> None:
    serial = f"call{release}"
    with (
        driven(broker, serial, release=release) as driver,
        bridge_to(broker, release=release) as bridge,
    ):
        result = bridge.call(endpoint(serial, "transport"), goal("a", "b", "c", b="pick", c="drop"))
        wait(lambda: driver.done == ["b", "pick", "c", "drop"])  # noted after the report
        assert isinstance(result, dict)
        assert result["lastNodeId"] == "c"
        assert [action["actionStatus"] for action in result["actions"]] == ["FINISHED", "FINISHED"]


def test_streams_report_what_becomes_of_a_goal(broker: Broker) -> None:
    with driven(broker, "streams", "b") as driver, bridge_to(broker) as bridge:
        reports = {part: Collector() for part in ("status", "feedback", "result")}
        for part, collector in reports.items():
            place = endpoint("streams", "transport", part)
            bridge.open_source(place, ANYTHING, collector.deliver)
        sink = bridge.open_sink(endpoint("streams", "transport", "goal"), ANYTHING)
        sink.send(goal("a", "b", order="one"))
        assert reports["status"].wait(1) == [{"goal_id": "one", "status": "accepted"}]
        driver.let("b")
        (ended,) = reports["result"].wait(1)
        assert ended["status"] == "succeeded"
        assert reports["status"].wait(2)[1] == {"goal_id": "one", "status": "succeeded"}
        assert reports["feedback"].wait(1)[0]["feedback"]["lastNodeId"] == "a"


def test_instant_actions_of_2_0_have_either_name(broker: Broker) -> None:
    """The document calls the type `actionType`, and the published schema `actionName`."""
    topic, peer, states = "uagv/v2/uoa/names", Peer(broker), list[Any]()
    peer.subscribe(f"{topic}/state", lambda item: states.append(json.loads(item.payload)))
    with Vehicle(broker.url, "uoa", "names", release="2.0"):
        for number, name in enumerate(
            ({"actionName": "startPause"}, {"actionType": "stopPause"}, {})
        ):
            action = {**name, "actionId": str(number), "blockingType": "NONE"}
            peer.publish(f"{topic}/instantActions", json.dumps({"actions": [action]}))

        def became() -> list[str]:
            return [action["actionStatus"] for action in states[-1]["actionStates"]]

        expected = ["FINISHED", "FINISHED", "FAILED"]
        wait(lambda: states and became() == expected, lambda: f"{states[-1:]}")
    peer.close()


def test_a_vehicle_that_cannot_connect_does_not_come_later() -> None:
    vehicle = Vehicle("mqtt://127.0.0.1:1", "uoa", "away")
    with pytest.raises(BridgeError, match="refused"), vehicle:
        pass
    assert vehicle._broker._client._thread is None


def test_a_goal_is_cancelled(broker: Broker) -> None:
    with driven(broker, "cancelled", "b") as driver, bridge_to(broker) as bridge:
        status = Collector()
        bridge.open_source(endpoint("cancelled", "transport", "status"), ANYTHING, status.deliver)
        sink = bridge.open_sink(endpoint("cancelled", "transport", "goal"), ANYTHING)
        cancel = bridge.open_sink(endpoint("cancelled", "transport", "cancel"), ANYTHING)
        sink.send(goal("a", "b", "c", order="long"))
        status.wait(1)
        cancel.send({"goal_id": "long"})
        assert status.wait(2)[1] == {"goal_id": "long", "status": "canceled"}
        assert driver.vehicle.is_idle
        assert driver.done == []


def test_a_call_that_an_emergency_stop_ends_is_cancelled(broker: Broker) -> None:
    with (
        driven(broker, "stopped", "b") as driver,
        bridge_to(broker) as bridge,
        ThreadPoolExecutor() as pool,
    ):
        place, order = endpoint("stopped", "transport"), goal("a", "b")
        called = pool.submit(bridge.call, place, order, timeout=patience(), number=5)
        wait(lambda: not driver.vehicle.is_idle, "the vehicle has no order")
        assert bridge.cancel_call(5)
        with pytest.raises(BridgeError, match="canceled"):
            called.result(patience())
        assert driver.vehicle.is_idle
        assert driver.done == []


def test_what_the_vehicle_refuses_is_reported(broker: Broker) -> None:
    place, order = endpoint("refusing", "transport"), goal("a", "b", b="dance")
    refusal = pytest.raises(BridgeError, match=r"rejected: .*orderError.*no such actions: dance")
    with driven(broker, "refusing"), bridge_to(broker) as bridge, refusal:
        bridge.call(place, order)


def test_a_vehicle_that_dies_is_lost_at_once(broker: Broker) -> None:
    with driven(broker, "dying", "b") as driver, bridge_to(broker) as bridge:
        events, status = health_events(bridge), Collector()
        bridge.open_source(endpoint("dying", "transport", "status"), ANYTHING, status.deliver)
        sink = bridge.open_sink(endpoint("dying", "transport", "goal"), ANYTHING)
        sink.send(goal("a", "b", order="half"))
        status.wait(1)
        _die(driver.vehicle)
        assert status.wait(2)[1] == {"goal_id": "half", "status": "lost"}
        lost = until(events, Health.LOST)
        assert lost.component == "dying"
        assert "CONNECTIONBROKEN" in lost.cause


def test_a_fatal_error_is_reported_and_its_end(broker: Broker) -> None:
    with driven(broker, "ailing") as driver, bridge_to(broker) as bridge:
        events = health_events(bridge)
        bridge.open_sink(endpoint("ailing", "transport", "goal"), ANYTHING)
        driver.vehicle.raise_error("wheelBroken", "the left one", fatal=True)
        degraded = until(events, Health.DEGRADED)
        assert degraded.component == "ailing"
        assert degraded.cause.startswith("peer: vehicle ")
        assert degraded.cause.endswith("/ailing: fatal: wheelBroken: the left one")
        driver.vehicle.clear_error("wheelBroken")
        assert until(events, Health.OK).component == "ailing"


def test_a_vehicle_that_is_well_when_its_broker_is_back_is_reported_to_be(tmp_path: Path) -> None:
    with (
        running(tmp_path / "broker") as broker,
        driven(broker, "ailing") as driver,
        bridge_to(broker) as bridge,
    ):
        events = health_events(bridge)
        bridge.open_sink(endpoint("ailing", "transport", "goal"), ANYTHING)
        driver.vehicle.raise_error("wheelBroken", "the left one", fatal=True)
        wait(lambda: [event.health for event in events if event.component] == [Health.DEGRADED])
        broker.kill()
        driver.vehicle.clear_error("wheelBroken")
        broker.start()  # no last will: the vehicle says once more that it is there
        wait(lambda: [event.health for event in events if event.component][1:] == [Health.OK])


def test_a_vehicle_that_is_gone_with_its_broker_is_lost(tmp_path: Path) -> None:
    with running(tmp_path / "broker") as broker, bridge_to(broker, grace=3600) as bridge:
        events, link = health_events(bridge), vars(bridge)["_broker"]
        with driven(broker, "gone") as driver:
            bridge.open_sink(endpoint("gone", "transport", "goal"), ANYTHING)
            broker.kill()  # which publishes no last will, and keeps nothing
            driver.vehicle.close()
        broker.start()
        wait(lambda: link._lapse_at is not None and link.breaks)
        link._lapse_at = 0.0
        assert until(events, Health.LOST).component == "gone"


def test_a_component_that_opens_learns_that_its_vehicle_is_not_well(broker: Broker) -> None:
    with driven(broker, "unwell") as driver, bridge_to(broker) as bridge:
        events = health_events(bridge)
        place = endpoint("unwell", "transport", "goal")
        bridge.open_sink(place, ANYTHING).close()
        driver.vehicle.raise_error("wheelBroken", "the left one", fatal=True)
        degraded = until(events, Health.DEGRADED)
        for component in ("unwell", "another"):  # opened anew, and for the first time
            del events[:]
            bridge.open_sink(evolve(place, component=component), ANYTHING)
            report = until(events, Health.DEGRADED)
            assert (report.component, report.cause) == (component, degraded.cause)
        driver.vehicle.clear_error("wheelBroken")
        wait(lambda: len([event for event in events if event.health is Health.OK]) == 2)


def test_a_component_that_has_another_vehicle_since_is_not_that_of_the_former(
    broker: Broker,
) -> None:
    with (
        driven(broker, "before") as before,
        driven(broker, "since"),
        bridge_to(broker) as bridge,
    ):
        events = health_events(bridge)
        bridge.open_sink(endpoint("before", "transport", "goal"), ANYTHING)
        for serial in ("before", "since"):
            place = evolve(endpoint(serial, "transport", "goal"), component="z")
            bridge.open_sink(place, ANYTHING).close()
        before.vehicle.raise_error("wheelBroken", "the left one", fatal=True)
        assert until(events, Health.DEGRADED).component == "before"
        before.vehicle.clear_error("wheelBroken")
        until(events, Health.OK)
        assert {event.component for event in events} == {"before"}


def test_a_user_sees_how_a_vehicle_is_that_is_called(broker: Broker) -> None:
    text = "version: 1\nbridges: {fleet: {plugin: vda5050}}\nfunctions:\n" + "".join(
        f"  {name}: {{components: [{{name: {name}, bridge: fleet, "
        f"service: {{endpoint: [{MAKER}, called, transport]}}}}]}}\n"
        for name in ("first", "second")
    )
    with (
        bridge_to(broker) as bridge,
        RobotManager(loads(text), bridges={"fleet": bridge}) as robot,
        driven(broker, "called") as driver,
    ):

        def shown() -> list[tuple[str, Health]]:
            return [(item.name, item.health) for item in robot.status().components]

        robot.call("first", goal("a", "b"), timeout=patience())
        assert shown() == []
        driver.vehicle.raise_error("wheelBroken", "the left one", fatal=True)
        wait(lambda: shown() == [("first", Health.DEGRADED)])
        robot.call("second", goal("b", "c"), timeout=patience())
        wait(lambda: shown() == [(name, Health.DEGRADED) for name in ("first", "second")])
        driver.vehicle.clear_error("wheelBroken")
        wait(lambda: not shown())
        driver.vehicle.close()
        wait(lambda: shown() == [(name, Health.FINISHED) for name in ("first", "second")])


def test_vehicles_are_discovered_with_what_they_are(broker: Broker) -> None:
    sheet = {"typeSpecification": {"seriesName": "mouse", "maxLoadMass": 12.5}}
    heavy = {"typeSpecification": {"maxLoadMass": 10**400}}  # more than a float has room for
    with (
        driven(broker, "found", interface="other", factsheet=sheet),
        driven(broker, "heavy", interface="other", factsheet=heavy),
        driven(broker, "no$address", interface="other"),
        bridge_to(broker, interface="other") as bridge,
    ):
        found, unsaid = bridge.discover()
        assert (found.name, found.detail) == ("uoa/found", "mouse, 12.5 kg")
        assert (unsaid.name, unsaid.detail) == ("uoa/heavy", "")
        for place, description in found.endpoints:
            assert bridge.describe(place) == description


def test_vehicles_that_have_gone_make_room_for_others(broker: Broker) -> None:
    with driven(broker, "stranger", interface="room"):
        pass
    with bridge_to(broker, interface="room", max_vehicles=1) as bridge:
        assert bridge.discover() == ()
        with driven(broker, "found", interface="room"):
            wait(lambda: [found.name for found in bridge.discover()] == ["uoa/found"])


def _die(vehicle: Vehicle) -> None:
    """End its connection without a word, so that the broker publishes its last will."""
    client: Any = vehicle._broker._client
    report = client.on_disconnect

    def stay_away(client: Any, *more: Any) -> None:
        client.disconnect()
        report(client, *more)  # its link is down: closing waits for no goodbye

    client.on_disconnect = stay_away
    client.socket().shutdown(socket.SHUT_RDWR)


def test_a_vehicle_that_is_slow_to_be_followed_holds_up_no_other(
    broker: Broker, monkeypatch: pytest.MonkeyPatch
) -> None:
    reached, gate, subscribe = threading.Event(), threading.Event(), BrokerConnection.subscribe

    def late(link: BrokerConnection, receiver: Any, **more: Any) -> None:
        if receiver.topic.endswith("/slow/state"):
            reached.set()
            assert gate.wait(patience())
        subscribe(link, receiver, **more)

    def follow(serial: str) -> Any:
        place = endpoint(serial, "transport", "status")
        return bridge.open_source(place, ANYTHING, lambda _: None)

    monkeypatch.setattr(BrokerConnection, "subscribe", late)
    with driven(broker, "slow"), driven(broker, "quick"), bridge_to(broker) as bridge:
        slow = [Background(lambda: follow("slow")) for _ in range(2)]
        try:
            assert reached.wait(patience())
            follow("quick")
        finally:
            gate.set()
        first, second = (opening.result() for opening in slow)
        assert first._follower is second._follower
