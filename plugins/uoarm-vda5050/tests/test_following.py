"""What a fleet makes of a vehicle's states: whose error it is, who is busy, what was missed."""

from __future__ import annotations

import json
from contextlib import nullcontext
from threading import Event
from types import SimpleNamespace
from typing import Any

import pytest
from brokers import Broker
from uoarm_mqtt.connection import PayloadCodec
from uoarm_vda5050._channels import VehicleFollower, call
from uoarm_vda5050._health import Presence
from uoarm_vda5050._messages import check_of
from uoarm_vda5050._options import place_of
from uoarm_vda5050._orders import Order
from uoarm_vda5050._releases import HEADER, RELEASES, body_of
from uoarm_vda5050._transport_state import Action, GoalEnded, Phase, Send, TransportState
from uoarm_vda5050._vehicle_state import VehicleState

from fleet import MAKER, bridge_to, driven, endpoint, goal
from uoarm.errors import BridgeError, BridgeTimeoutError, MessageError
from uoarm.model import Budget, Health, MessageStructure
from uoarm.testing import Collector, patience, wait

ANYTHING = MessageStructure(True)
BUDGET = Budget()
BOTH = pytest.mark.parametrize("release", ["2.1", "3.0"])


def state(vehicle: VehicleState, **more: Any) -> dict[str, Any]:
    second, charge = vehicle.release.battery
    return {**vehicle.body(), second: {charge: 50.0, "charging": False}, **more}


def error(vehicle: VehicleState, **references: str) -> dict[str, Any]:
    named = [
        {"referenceKey": key, "referenceValue": reference} for key, reference in references.items()
    ]
    kind = vehicle.release.errors.action
    return {"errorType": kind, "errorLevel": "WARNING", "errorReferences": named}


def ends(actions: list[Action]) -> list[tuple[str, Any]]:
    return [
        (action.status, action.result["reason"])
        for action in actions
        if isinstance(action, GoalEnded)
    ]


@BOTH
@pytest.mark.parametrize(
    ("references", "is_refused"),
    [
        ({"orderId": "one"}, True),
        ({"orderId": "one", "orderUpdateId": "0"}, True),
        ({"orderId": "one", "orderUpdateId": "1"}, False),
        ({"orderId": "another"}, False),
        ({}, True),
        ({"topic": "order"}, True),
        ({"topic": "instantActions"}, False),
    ],
    ids=str,
)
def test_an_error_refuses_the_order_that_it_names(
    release: str, references: dict[str, str], is_refused: bool
) -> None:
    vehicle, fleet = VehicleState(RELEASES[release], frozenset()), TransportState(RELEASES[release])
    fleet.goal(goal("a", "b", order="one"), 0.0)
    fleet.state(state(vehicle), 0.0)
    assert fleet.phase is Phase.SENT
    reports = fleet.state(state(vehicle, errors=[error(vehicle, **references)]), 0.0)
    assert [status for status, _ in ends(reports)] == ["rejected"] * is_refused


@BOTH
def test_an_error_from_before_the_order_does_not_refuse_it(release: str) -> None:
    vehicle, fleet = VehicleState(RELEASES[release], frozenset()), TransportState(RELEASES[release])
    before = state(vehicle, errors=[error(vehicle)])
    fleet.goal(goal("a", "b", order="one"), 0.0)
    fleet.state(before, 0.0)
    assert not ends(fleet.state(before, 0.0))
    named = state(vehicle, errors=[error(vehicle), error(vehicle, orderId="one")])
    assert ends(fleet.state(named, 0.0))


@BOTH
@pytest.mark.parametrize("is_known", [True, False])
def test_a_vehicle_with_another_order_is_busy(release: str, is_known: bool) -> None:
    vehicle, fleet = VehicleState(RELEASES[release], frozenset()), TransportState(RELEASES[release])
    vehicle.order(Order.of(goal("a", "b"), "another", RELEASES[release], 10).body)
    reports: list[Action] = []
    if is_known:
        fleet.state(state(vehicle), 0.0)
    reports += fleet.goal(goal("a", "b", order="one"), 0.0)[1]
    reports += fleet.state(state(vehicle), 0.0)
    assert ends(reports) == [("rejected", "order 'another' is under way")]


@pytest.mark.parametrize("release", ["2.0", "2.1"])
@pytest.mark.parametrize("is_done", [False, True])
def test_a_running_instant_action_keeps_no_order_away(release: str, is_done: bool) -> None:
    vehicle, fleet = VehicleState(RELEASES[release], frozenset()), TransportState(RELEASES[release])
    fleet.state(state(vehicle), 0.0)
    if is_done:
        (order,) = fleet.goal(goal("a", "b", order="zero"), 0.0)[1]
        assert isinstance(order, Send)
        vehicle.order(order.body)
        assert vehicle.task is not None
        vehicle.reached(vehicle.task)
        assert ends(fleet.state(state(vehicle), 0.0)) == [("succeeded", "")]
    charging = {"actionId": "i", "actionType": "startCharging", "actionStatus": "RUNNING"}
    fleet.state(state(vehicle, actionStates=[charging]), 0.0)
    (order,) = fleet.goal(goal("b", "c", order="one"), 0.0)[1]
    assert isinstance(order, Send)
    assert order.topic == "order"


@BOTH
def test_an_order_of_before_with_this_name_has_not_reached_other_nodes(release: str) -> None:
    vehicle, fleet = VehicleState(RELEASES[release], frozenset()), TransportState(RELEASES[release])
    vehicle.order(Order.of(goal("a", "b"), "box", RELEASES[release], 10).body)
    assert vehicle.task is not None
    vehicle.reached(vehicle.task)
    fleet.state(state(vehicle), 0.0)
    assert [status for status, _ in ends(fleet.goal(goal("a", "b", order="box"), 0.0)[1])] == [
        "succeeded"
    ]
    assert ends(fleet.goal(goal("a", "c", order="box"), 0.0)[1]) == [
        ("aborted", "it ended at node 'b', before its last one")
    ]


@BOTH
def test_a_vehicle_that_drops_its_order_is_said_to_have_none(release: str) -> None:
    vehicle, fleet = VehicleState(RELEASES[release], frozenset()), TransportState(RELEASES[release])
    vehicle.order(Order.of(goal("a", "b"), "one", RELEASES[release], 10).body)
    fleet.state(state(vehicle), 0.0)
    fleet.goal(goal("a", "b", order="one"), 0.0)
    assert ends(fleet.state(state(vehicle, orderId=""), 0.0)) == [
        ("aborted", "the vehicle now has no order any more")
    ]


@BOTH
def test_an_order_that_is_not_cancelled_yet_keeps_others_away_and_says_why(release: str) -> None:
    vehicle, fleet = VehicleState(RELEASES[release], frozenset()), TransportState(RELEASES[release])
    fleet.goal(goal("a", "b", order="one"), 0.0)
    fleet.state(state(vehicle), 0.0)
    assert fleet.cancel("one", 0.0)
    fleet.unreadable("no number")
    assert ends(fleet.goal(goal("a", "b", order="two"), 0.0)[1]) == [
        ("rejected", "order 'one' is being cancelled; a state came that cannot be read: no number")
    ]


def cancels(actions: list[Action]) -> list[dict[str, Any]]:
    sent = [action.body for action in actions if isinstance(action, Send)]
    instants = [action for body in sent for action in body.get("actions", ())]
    return [action for action in instants if action["actionType"] == "cancelOrder"]


@BOTH
def test_an_order_that_comes_behind_its_cancellation_is_cancelled_again(release: str) -> None:
    vehicle, fleet = VehicleState(RELEASES[release], frozenset()), TransportState(RELEASES[release])
    fleet.goal(goal("a", "b", order="one"), 0.0)
    (order,) = fleet.state(state(vehicle), 0.0)
    for action in cancels(fleet.cancel("one", 0.0)):
        vehicle.instant(action)
    assert ends(fleet.state(state(vehicle), 0.0)) == [
        ("canceled", "cancelled before the vehicle took it")
    ]
    assert isinstance(order, Send)
    assert vehicle.order(order.body)
    for action in cancels(fleet.state(state(vehicle), 9.0)):
        vehicle.instant(action)
    assert vehicle.is_idle


@BOTH
def test_an_abandoned_order_stays_so_where_its_goal_is_cancelled_before_it_is_sent(
    release: str,
) -> None:
    vehicle, fleet = VehicleState(RELEASES[release], frozenset()), TransportState(RELEASES[release])
    fleet.goal(goal("a", "b", order="one"), 0.0)
    (order,) = fleet.state(state(vehicle), 0.0)
    assert isinstance(order, Send)
    assert vehicle.order(order.body)
    assert ends(fleet.connection(False, "it is gone")) == [("lost", "it is gone")]
    fleet.connection(True, "")
    fleet.goal(goal("a", "b", order="one"), 1.0)
    assert ends(fleet.cancel("one", 1.0)) == [("canceled", "cancelled before it was sent")]
    assert cancels(fleet.state(state(vehicle), 9.0))


@BOTH
def test_a_cancellation_that_failed_is_sent_again_as_another_action(release: str) -> None:
    vehicle, fleet = VehicleState(RELEASES[release], frozenset()), TransportState(RELEASES[release])
    fleet.goal(goal("a", "b", order="one"), 0.0)
    (order,) = fleet.state(state(vehicle), 0.0)
    assert isinstance(order, Send)
    assert vehicle.order(order.body)
    fleet.connection(False, "it is gone")
    fleet.connection(True, "")
    (first,) = cancels(fleet.state(state(vehicle), 9.0))
    (lost,) = cancels(fleet.state(state(vehicle), 19.0))
    assert lost == first, "no state shows it: the vehicle may not have got it"
    vehicle.instant({**first, "actionType": "unknown"})  # which fails
    for action in cancels(fleet.state(state(vehicle), 29.0)):
        vehicle.instant(action)
    assert vehicle.is_idle


def test_a_cancellation_is_finished_however_many_actions_follow_it() -> None:
    vehicle = VehicleState(RELEASES["3.0"], frozenset())
    vehicle.order(Order.of(goal("a", "b"), "one", RELEASES["3.0"], 10).body)
    vehicle.driving = True
    vehicle.instant({"actionId": "cancel", "actionType": "cancelOrder"})
    for n in range(200):
        vehicle.instant({"actionId": str(n), "actionType": "stateRequest"})
    assert vehicle.stands()
    assert vehicle.is_idle


def test_a_vehicle_that_falls_silent_while_it_cancels_is_followed_when_it_speaks_again() -> None:
    release = RELEASES["2.1"]
    vehicle, transport = VehicleState(release, frozenset()), TransportState(release)
    codec: Any = SimpleNamespace(split=lambda payload: ({}, json.loads(payload)), encode=json.dumps)
    sent: list[tuple[str, Any]] = []
    link: Any = SimpleNamespace(
        require_up=lambda: None,
        unsubscribe=lambda _: None,
        publish=lambda topic, payload, *_, **__: sent.append((topic, json.loads(payload))),
    )
    reports: list[str] = []
    codecs = dict.fromkeys(("order", "instantActions", "state"), codec)
    follower = VehicleFollower(
        link, "v2/m/s", transport, 0.05, codecs, lambda _, cause, __: reports.append(cause)
    )
    news: list[Any] = []
    follower.join(news.append)

    def says() -> None:
        event: Any = SimpleNamespace(payload=json.dumps(state(vehicle)).encode())
        follower._inbox.put(event)

    try:
        says()
        wait(lambda: transport._known is not None)
        goal_id = follower.goal(goal("a", "b"))
        vehicle.order(sent[-1][1])
        vehicle.driving = True
        says()
        wait(lambda: transport.phase is Phase.UNDER_WAY)
        follower.cancel(goal_id)
        for action in sent[-1][1]["actions"]:
            vehicle.instant(action)
        reports.clear()
        says()
        wait(lambda: any("silent" in cause for cause in reports), lambda: f"{reports}")
        vehicle.driving = False
        vehicle.stands()
        says()
        wait(lambda: ends(news) == [("canceled", "cancelled")], lambda: f"{news}")
    finally:
        follower.close()


def test_a_flood_of_states_is_bounded_and_hides_no_end_of_the_vehicle() -> None:
    release = RELEASES["2.1"]
    whole = state(VehicleState(release, frozenset()))
    codec: Any = SimpleNamespace(split=lambda _: ({}, whole), encode=json.dumps)
    link: Any = SimpleNamespace(
        require_up=lambda: None, unsubscribe=lambda _: None, publish=lambda *_, **__: None
    )
    codecs = dict.fromkeys(("order", "instantActions", "state"), codec)
    follower = VehicleFollower(
        link, "v2/m/s", TransportState(release), patience(), codecs, lambda *_: None, 1000
    )  # fmt: skip
    came: Any = SimpleNamespace(payload=b" " * 100)
    news: list[Any] = []
    stuck, free = Event(), Event()

    def listen(said: Any) -> None:
        news.append(said)
        stuck.set()
        assert free.wait(patience())

    try:
        follower.goal(goal("a", "b", order="one"))
        follower.join(listen)
        follower._inbox.put(came)
        assert stuck.wait(patience())
        follower.connection(False, "it is gone")
        for _ in range(100):
            follower._inbox.put(came)
        assert len(follower._inbox) <= 10
        free.set()
        wait(lambda: ends(news) == [("lost", "it is gone")], lambda: f"{news}")
    finally:
        free.set()
        follower.close()


def test_what_waits_for_a_slow_receiver_is_bounded_in_octets(broker: Broker) -> None:
    got = Collector()
    with (
        driven(broker, "wordy", "b", state_seconds=0.01) as driver,
        bridge_to(broker, max_octets=20_000) as bridge,
    ):
        feedback = endpoint("wordy", "transport", "feedback")
        source = bridge.open_source(feedback, ANYTHING, got)
        into = bridge.open_sink(endpoint("wordy", "transport", "goal"), ANYTHING)
        driver.vehicle.raise_error("wordy", "w" * 15_000)
        with got.held():
            into.send(goal("a", "b"))
            wait(lambda: source.facts()["lost_on_link"], lambda: str(source.facts()))
            waiting: Any = source.facts()["under_way"]
            assert waiting <= 8 * 20_000 // 15_000


def test_states_that_were_not_followed_are_in_the_facts(broker: Broker) -> None:
    with driven(broker, "missed", "b", state_seconds=0.05) as driver, bridge_to(broker) as bridge:
        status = Collector()
        place = endpoint("missed", "transport", "status")
        source = bridge.open_source(place, ANYTHING, status.deliver)

        def counted(name: str) -> int:
            return int(str(source.facts()[name]))

        bridge.open_sink(endpoint("missed", "transport", "goal"), ANYTHING).send(goal("a", "b"))
        status.wait(1)  # a state was seen, from which the next ones are counted
        for _ in range(3):
            driver.vehicle._headers.next("state")
        wait(lambda: counted("states_missed") >= 3, lambda: str(source.facts()))
        topic = f"{driver.vehicle._topic}/state"
        driver.vehicle._broker.publish(topic, b"{", lambda _: None, qos=0)
        wait(lambda: counted("states_unreadable") == 1, lambda: str(source.facts()))


@pytest.mark.parametrize("lacking", ["errors", "driving", "nodeStates"])
def test_a_state_that_lacks_what_the_rules_need_is_unreadable_and_the_next_is_taken(
    lacking: str,
) -> None:
    """As a schema of the user's may allow it."""
    release = RELEASES["2.1"]
    whole = state(VehicleState(release, frozenset()))
    codec: Any = SimpleNamespace(split=lambda payload: ({}, json.loads(payload)))
    link: Any = SimpleNamespace(subscribe=lambda _: None, unsubscribe=lambda _: None)
    reports: list[tuple[Health, str]] = []
    follower = VehicleFollower(
        link, "v2/m/s", TransportState(release), patience(), {"state": codec},
        lambda *one: reports.append(one),
    )  # fmt: skip
    try:
        for body in ({key: whole[key] for key in whole if key != lacking}, whole):
            event: Any = SimpleNamespace(payload=json.dumps(body))
            follower._inbox.put(event)
        wait(lambda: reports and reports[-1][0] is Health.OK, lambda: str(reports))
    finally:
        follower.close()
    assert reports[0][0] is Health.DEGRADED
    assert lacking in reports[0][1]
    assert follower.facts()["states_unreadable"] == 1


def test_a_call_that_is_given_up_says_which_states_came_and_could_not_be_read() -> None:
    release = RELEASES["2.1"]
    codec: Any = SimpleNamespace(split=lambda payload: ({}, json.loads(payload)))
    link: Any = SimpleNamespace(
        subscribe=lambda _: None,
        unsubscribe=lambda _: None,
        require_up=lambda: None,
        publish=lambda *_, **__: None,
    )
    codecs = {
        "state": codec,
        "order": PayloadCodec("json", BUDGET),
        "instantActions": PayloadCodec("json", BUDGET),
    }
    follower = VehicleFollower(
        link, "v2/m/s", TransportState(release), patience(), codecs, lambda *_: None
    )  # fmt: skip
    try:
        follower.connection(True, "")
        event: Any = SimpleNamespace(payload=b"{")
        follower._inbox.put(event)
        wait(follower.unread_states, lambda: str(follower.facts()))
        why = r"did not end in 0\.01 s; a state came that cannot be read: .*Expecting property name"
        with pytest.raises(BridgeTimeoutError, match=why):
            call(
                endpoint("m", "transport"), follower, goal("a", "b"), 0.01, lambda _: nullcontext()
            )
    finally:
        follower.close()


@pytest.mark.parametrize("asked", [True, False])
def test_a_goal_that_ends_for_want_of_states_says_which_came_and_could_not_be_read(
    asked: bool,
) -> None:
    release = RELEASES["2.1"]
    transport = TransportState(release)
    if not asked:
        transport.state(state(VehicleState(release, frozenset())), 0.0)
    transport.goal(goal("a", "b", order="one"), 0.0)
    for _ in range(8):
        transport.unreadable("state: 'errors' is a required property")
    [(status, reason)] = ends(transport.tick(1000.0))
    what = "sent no state that can be read" if asked else "did not take it"
    why = "8 states came that cannot be read: state: 'errors' is a required property"
    assert (status, reason) == ("aborted", f"the vehicle {what} within 15 s; {why}")


def test_silence_is_distinguished_from_states_that_cannot_be_read() -> None:
    codec: Any = SimpleNamespace(split=lambda payload: ({}, json.loads(payload)))
    link: Any = SimpleNamespace(unsubscribe=lambda _: None)
    reports: list[tuple[Health, str]] = []
    follower = VehicleFollower(
        link, "v2/m/s", TransportState(RELEASES["2.1"]), 0.2, {"state": codec},
        lambda *report: reports.append(report[:2]),
    )  # fmt: skip
    unreadable = "peer: vehicle m/s: its state cannot be read: "
    silent = "silent: vehicle m/s: no message for 0.2 s that can be read"
    try:
        event: Any = SimpleNamespace(payload=b"{")
        follower._inbox.put(event)
        wait(lambda: reports and unreadable in reports[-1][1], lambda: str(reports))
        wait(lambda: reports[-1][1].startswith(f"{silent}; {unreadable}"), lambda: str(reports))
        follower.connection(False, "")
        follower._inbox.put(event)
        wait(lambda: follower.facts()["states_unreadable"] == 2)
    finally:
        follower.close()
    assert {health for health, _ in reports} == {Health.DEGRADED}
    assert len(reports) == 2, "that a vehicle has gone is reported by what watches its connection"


def test_an_order_that_the_client_fails_to_send_is_rejected_and_the_next_state_is_taken() -> None:
    release = RELEASES["2.1"]
    whole = state(VehicleState(release, frozenset()))

    def publish(topic: str, *_: object, **__: object) -> None:
        if topic.endswith("/order"):  # which is sent in the follower's thread, after a state
            raise RuntimeError(f"no {topic}")

    link: Any = SimpleNamespace(publish=publish, require_up=lambda: None, unsubscribe=print)
    taken: list[bytes] = []

    def split(payload: bytes) -> tuple[dict[str, Any], dict[str, Any]]:
        taken.append(payload)
        return {}, whole

    codec: Any = SimpleNamespace(split=split, encode=lambda _: b"")
    codecs = dict.fromkeys(("order", "instantActions", "state"), codec)
    follower = VehicleFollower(
        link, "v2/m/s", TransportState(release), patience(), codecs, lambda *_: None
    )
    received: list[Any] = []
    follower.join(received.append)
    came: Any = SimpleNamespace(payload=b"")
    try:
        follower.goal(goal("a", "b", order="one"))
        follower._inbox.put(came)  # from which on the order can be sent
        wait(
            lambda: ends(received) == [("rejected", "RuntimeError('no v2/m/s/order')")],
            lambda: str(received),
        )
        follower._inbox.put(came)
        wait(lambda: len(taken) == 2)
    finally:
        follower.close()
    assert follower.facts()["states_unreadable"] == 0


def test_a_schema_that_cannot_be_applied_is_said_to_be() -> None:
    schema = {"type": "object", "properties": {"headerId": {"$ref": "#/$defs/none"}}}
    check = check_of(schema, "order")
    check({})
    with pytest.raises(MessageError, match="order: the message cannot be held against its struc"):
        check({"headerId": 1})


def test_a_message_is_held_against_any_schema_in_time_that_grows_with_it() -> None:
    """In the validator of `jsonschema` each of these takes years."""
    pattern = {"type": "object", "properties": {"name": {"pattern": "^(a+)+$"}}}
    with pytest.raises(MessageError, match="order: name: "):
        check_of(pattern, "order")({"name": "a" * 60 + "!"})
    unique = {"type": "object", "properties": {"nodes": {"uniqueItems": True}}}
    nodes = [{"nodeId": "n", "at": [number]} for number in range(100_000)]
    check_of(unique, "order")({"nodes": nodes})
    with pytest.raises(MessageError, match="order: nodes: "):
        check_of(unique, "order")({"nodes": [*nodes, nodes[0]]})


def test_a_vehicle_that_goes_before_it_is_followed_is_reported() -> None:
    def nothing(*_: object, **__: object) -> None:
        pass

    link: Any = SimpleNamespace(require_up=nothing, subscribe=nothing)
    release, reports = RELEASES["2.1"], list[tuple[str, Health, str]]()
    watch = Presence(link, "uagv/v2", release, 0.0, 1, lambda *one: reports.append(one))

    def say(serial: str, state: str) -> None:
        payload = b'{"connectionState": "%s"}' % state.encode()
        topic = f"uagv/v2/{MAKER}/{serial}/connection"
        watch._take(SimpleNamespace(topic=topic, payload=payload))  # type: ignore[arg-type]

    say("agv", "ONLINE")
    watch.require((MAKER, "agv"), "carrier")
    say("agv", "OFFLINE")
    received: list[tuple[bool, str]] = []
    watch.follow((MAKER, "agv"), lambda online, why: received.append((online, why)))
    assert received == [(False, "its connection state is OFFLINE")]
    assert ("carrier", Health.FINISHED, f"peer: vehicle {MAKER}/agv: {received[0][1]}") in reports
    with pytest.raises(BridgeError, match="too many"):
        watch.require((MAKER, "second"), "other")


def test_states_that_cannot_be_read_count_against_what_is_read_from_them(broker: Broker) -> None:
    with driven(broker, "torn", "b", state_seconds=0.05) as driver, bridge_to(broker) as bridge:
        got = Collector()
        place = endpoint("torn", "transport", "result")
        source = bridge.open_source(place, ANYTHING, got)
        topic = f"{driver.vehicle._topic}/state"
        driver.vehicle._broker.publish(topic, b"{", lambda _: None, qos=0)
        # The states that follow can be read, and nothing of them is a result.
        wait(lambda: source.unreadable == 1 and "" in got.unread, lambda: str(got.unread))
        assert "Expecting property name" in next(filter(None, got.unread))
        assert got.messages == []


@pytest.mark.parametrize("serial", ["", "a/b", "a\n", "a\x7f", "a\0", "#"])
def test_a_serial_number_that_no_topic_has_is_refused(serial: str) -> None:
    with pytest.raises(ValueError, match="manufacturer or serial number is no level of a topic"):
        place_of((MAKER, serial, "state"), {})


def test_what_is_missing_is_named_without_the_header_as_unknown() -> None:
    check = check_of(body_of("instantActions", "3.0").schema, "instantActions")
    with pytest.raises(MessageError) as refused:
        check(dict.fromkeys(HEADER, "") | {"instantAction": []})
    text = "instantActions: the message: the field 'actions' is missing"
    assert str(refused.value).startswith(f'{text}; the field "instantAction" is unknown')
    assert "headerId" not in str(refused.value)
