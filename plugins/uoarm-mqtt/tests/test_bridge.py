"""Options and faults, each against a real Mosquitto and peers that know nothing of uoarm."""

from __future__ import annotations

import json
import signal
import socket
import threading
from collections.abc import Iterator
from contextlib import closing, contextmanager
from pathlib import Path
from typing import Any

import pytest
import trustme
from brokers import Broker, Peer, running
from tests.inbox import health_events, until  # type: ignore[import-not-found]
from tests.processes import ForkedProgram  # type: ignore[import-not-found]
from uoarm_mqtt import _channels, _link
from uoarm_mqtt._channels import _Call
from uoarm_mqtt._link import PacketOutcome

from uoarm.bridge import Bridge, Registry, Sink, Source
from uoarm.errors import (
    BridgeError,
    BridgeTimeoutError,
    ConfigurationError,
    FailureReason,
    MessageError,
)
from uoarm.model import BridgeSpec, Endpoint, Health, MessageStructure, Role
from uoarm.testing import Background, Collector, Proxy, patience, wait

ANYTHING = MessageStructure(True)


def endpoint(topic: str, role: Role = Role.OUTPUT, **options: Any) -> Endpoint:
    return Endpoint("mqtt", f"component of {topic}", role, (topic,), options=options)


@contextmanager
def bridge_to(broker: Broker, **options: Any) -> Iterator[Bridge]:
    spec = BridgeSpec("mqtt", "mqtt", {"url": broker.url, "retained_wait": 0, **options})
    made = Registry().create(spec)
    try:
        yield made
    finally:
        made.close(timeout=patience())


@contextmanager
def cut_off(broker: Broker) -> Iterator[tuple[Proxy, Bridge]]:
    """A bridge, and what its connection to a broker can be cut with; its session stays there."""
    with (
        Proxy(broker.port, broker.host) as proxy,
        bridge_to(broker, url=f"mqtt://127.0.0.1:{proxy.port}", grace=patience()) as bridge,
    ):
        yield proxy, bridge


@pytest.fixture
def bridge(broker: Broker) -> Iterator[Bridge]:
    with bridge_to(broker) as made:
        yield made


@pytest.fixture
def peer(broker: Broker) -> Iterator[Peer]:
    made = Peer(broker)
    yield made
    made.close()


def listen(
    bridge: Bridge, topic: str, structure: MessageStructure = ANYTHING, **options: Any
) -> tuple[Collector, Source]:
    collector = Collector()
    return collector, bridge.open_source(endpoint(topic, **options), structure, collector)


def speak(bridge: Bridge, topic: str, **options: Any) -> Sink:
    return bridge.open_sink(endpoint(topic, Role.INPUT, **options), ANYTHING)


class Quits(dict[str, int]):
    """What ends whatever thread writes it."""

    def items(self) -> Any:
        raise SystemExit


class TestTopics:
    """Wildcards, retained messages, shared subscriptions, contents."""

    def test_a_wildcard_receives_all_and_says_where(self, bridge: Bridge, peer: Peer) -> None:
        collector, source = listen(bridge, "wild/+/temperature", with_topic=True)
        assert not source.latched
        peer.publish("wild/a/temperature", "1")
        peer.publish("wild/a/humidity", "2")
        peer.publish("wild/b/temperature", "3")
        assert collector.wait(2) == [
            {"topic": "wild/a/temperature", "message": 1},
            {"topic": "wild/b/temperature", "message": 3},
        ]

    def test_overlapping_filters_get_each_message_once(self, bridge: Bridge, peer: Peer) -> None:
        listeners = [listen(bridge, name)[0] for name in ("over/#", "over/+", "over/x", "over/x")]
        for number in range(5):
            peer.publish("over/x", str(number))
        for listener in listeners:
            assert listener.wait(5) == [0, 1, 2, 3, 4]

    def test_each_new_consumer_gets_what_is_retained_and_none_twice(
        self, bridge: Bridge, peer: Peer
    ) -> None:
        peer.publish("kept/map", "1", retain=True)
        first, _ = listen(bridge, "kept/map", retain=True)
        assert first.wait(1) == [1]
        second, leaving = listen(bridge, "kept/map", retain=True)
        fresh, _ = listen(bridge, "kept/map")
        assert second.wait(1) == [1]
        peer.publish("kept/map", "2", retain=True)
        assert first.wait(2) == [1, 2]
        assert second.wait(2) == [1, 2]
        assert fresh.wait(1) == [2], "a port without `retain` gets what is new"
        leaving.close()
        peer.publish("kept/map", "3", retain=True)
        assert first.wait(3) == [1, 2, 3]
        assert fresh.wait(2) == [2, 3]

    def test_what_is_sent_with_retain_stands(self, bridge: Bridge, peer: Peer) -> None:
        sink = speak(bridge, "kept/by/us", retain=True)
        sink.send({"a": 1})
        with pytest.raises(MessageError, match="delete"):
            speak(bridge, "kept/octets", retain=True, content="octets").send(b"")
        assert sink.drain(patience())
        came = peer.collect("kept/by/us")
        wait(lambda: came, "it was not retained")
        assert (came[0].payload, came[0].retain) == (b'{"a":1}', True)
        assert came[0].properties.ContentType == "application/json"

    def test_shared_subscriptions_divide_the_messages(self, bridge: Bridge, peer: Peer) -> None:
        with bridge_to_same(bridge) as other:
            first, _ = listen(bridge, "work/items", share="workers")
            second, _ = listen(other, "work/items", share="workers")
            for number in range(10):
                peer.publish("work/items", str(number))
            both = (first, second)
            wait(lambda: sum(len(collector.messages) for collector in both) == 10, "lost")
            assert sorted([*first.messages, *second.messages]) == list(range(10))
            assert first.messages, "the other got everything"
            assert second.messages, "the other got everything"

    def test_a_message_expires_with_its_option(self, bridge: Bridge, peer: Peer) -> None:
        came = peer.collect("expiring")
        speak(bridge, "expiring", expiry=60, qos=2).send(1)
        wait(lambda: came, "it did not come")
        assert came[0].properties.MessageExpiryInterval == 60

    @pytest.mark.parametrize("qos", [0, 1, 2])
    def test_every_qos_arrives_and_drains(self, bridge: Bridge, qos: int) -> None:
        collector, _ = listen(bridge, f"qos/{qos}", qos=qos)
        sink = speak(bridge, f"qos/{qos}", qos=qos)
        for number in range(100):
            sink.send(number)
        assert sink.drain(patience())
        assert sink.facts()["under_way"] == 0
        assert collector.wait(100) == list(range(100))

    def test_the_broker_says_when_no_client_listens(self, bridge: Bridge) -> None:
        sink = speak(bridge, "no/listener")
        sink.send(1)
        assert sink.drain(patience())
        assert sink.facts()["undelivered"] == 1


def paho_of(bridge: Bridge) -> Any:
    return vars(bridge)["_broker"]._client


@contextmanager
def bridge_to_same(bridge: Bridge) -> Iterator[Bridge]:
    made = Registry().create(BridgeSpec("other", "mqtt", {"url": vars(bridge)["_options"].url}))
    try:
        yield made
    finally:
        made.close(timeout=patience())


class TestBudget:
    """What enters is measured before it is decoded."""

    @pytest.mark.parametrize(
        ("payload", "why"),
        [
            (b"[" * 40 + b"]" * 40, "deep"),
            (b"[" + b"1," * 500 + b"1]", "values"),
            (b'"' + b"x" * 2000 + b'"', "bytes"),
            (b"NaN", "NaN"),
            (b"\xff", "utf-8"),
        ],
    )
    def test_what_is_too_much_is_counted_and_the_next_arrives(
        self, broker: Broker, peer: Peer, payload: bytes, why: str
    ) -> None:
        with bridge_to(broker, max_octets=1500, max_values=400, max_depth=20) as bridge:
            events = health_events(bridge)
            collector, source = listen(bridge, "budget")
            peer.publish("budget", payload)
            peer.publish("budget", b"7")
            assert collector.wait(1) == [7]
            assert (source.unreadable, events) == (1, [])
            [said] = collector.unread
            assert said.startswith("budget: a payload of ")
            assert why in said

    def test_what_is_sent_is_measured_too(self, broker: Broker) -> None:
        with bridge_to(broker, max_octets=100) as bridge:
            sink = speak(bridge, "budget")
            with pytest.raises(MessageError, match="max_octets"):
                sink.send("x" * 200)

    def test_another_content_type_is_not_read_as_json(self, bridge: Bridge, peer: Peer) -> None:
        collector, source = listen(bridge, "typed")
        peer.publish("typed", b"1", ContentType="image/png")
        peer.publish("typed", b"2", ContentType="Application/vnd.mine+JSON")
        assert collector.wait(1) == [2]
        assert source.unreadable == 1

    def test_a_receiver_that_is_stuck_costs_a_bounded_backlog(
        self, broker: Broker, peer: Peer
    ) -> None:
        with bridge_to(broker, backlog=3) as bridge:
            collector, source = listen(bridge, "stuck")
            with collector.held():
                peer.publish("stuck", "0")
                collector.wait_begun(1, patience())
                for number in range(1, 9):
                    peer.publish("stuck", str(number))
                wait(lambda: source.facts()["lost_on_link"] == 5, lambda: str(source.facts()))
            assert collector.wait(4) == [0, 6, 7, 8]


class TestStructures:
    """From the options, from a retained schema, from the configuration."""

    def test_a_retained_schema_describes_and_reads(self, broker: Broker, peer: Peer) -> None:
        schema = {"type": "object", "properties": {"n": {"type": "integer"}}}
        peer.publish("schemas/lab/counter", json.dumps(schema), retain=True)
        with bridge_to(broker, schemas="schemas/{topic}") as bridge:
            found = bridge.describe(endpoint("lab/counter")).message
            assert found == MessageStructure(schema)
            wide = bridge.describe(endpoint("lab/counter", with_topic=True)).message
            assert wide is not None
            collector, _ = listen(bridge, "lab/counter", wide, with_topic=True)
            peer.publish("lab/counter", '{"n": 7.0}')
            (came,) = collector.wait(1)
            assert came == {"topic": "lab/counter", "message": {"n": 7}}
            assert type(came["message"]["n"]) is int
            (only,) = [
                component for component in bridge.discover() if component.name == "lab/counter"
            ]
            assert only.endpoints[0][1].message == MessageStructure(schema)

    def test_a_retained_schema_may_be_of_an_older_draft(self, broker: Broker, peer: Peer) -> None:
        schema = {
            "$schema": "http://json-schema.org/draft-07/schema#",
            "dependencies": {"a": ["b"]},
        }
        peer.publish("schemas/lab/old", json.dumps(schema), retain=True)
        peer.publish("schemas/lab/ask", json.dumps({"request": schema, "reply": {}}), retain=True)
        made = MessageStructure({"dependentRequired": {"a": ["b"]}})
        with bridge_to(broker, schemas="schemas/{topic}") as bridge:
            assert bridge.describe(endpoint("lab/old")).message == made
            assert bridge.describe(endpoint("lab/ask", Role.SERVICE)).request == made

    def test_a_schema_that_is_none_is_named(self, broker: Broker, peer: Peer) -> None:
        peer.publish("schemas/lab/odd", '{"type": "byte"}', retain=True)
        peer.publish("schemas/lab/no", "{", retain=True)
        peer.publish("schemas/lab/draft", '{"$schema": "http://elsewhere"}', retain=True)
        with bridge_to(broker, schemas="schemas/{topic}", max_octets=500) as bridge:
            for topic in ("lab/odd", "lab/no", "lab/draft"):
                with pytest.raises(BridgeError, match=f"schemas/{topic} is no JSON Schema"):
                    bridge.describe(endpoint(topic))
            with pytest.raises(BridgeError) as caught:
                bridge.describe(endpoint("lab/nothing"))
            assert caught.value.reason is FailureReason.NOT_FOUND

    def test_without_any_the_configuration_has_to_say(self, bridge: Bridge) -> None:
        assert bridge.describe(endpoint("some/topic")).message is None

    def test_discovery_is_bounded(self, broker: Broker, peer: Peer) -> None:
        for number in range(20):
            peer.publish(f"many/{number}", "1", retain=True)
        wanted = {"topics": ["many/#"], "seconds": 600, "most": 5}
        with bridge_to(broker, discover=wanted) as bridge:
            assert len(bridge.discover()) == 5


class TestPresence:
    """A component's word that it is there, kept by its last will."""

    def test_a_vehicle_that_ends_in_order_is_finished_and_comes_back(
        self, broker: Broker, peer: Peer
    ) -> None:
        says = {"topic": "v/1/connection", "member": "state", "online": "ON", "finished": "OFF"}
        with bridge_to(broker) as bridge:
            events, place = health_events(bridge), endpoint("v/1/state", presence=says)
            with pytest.raises(BridgeError, match="v/1/connection says nothing") as caught:
                bridge.describe(place)
            assert caught.value.reason is FailureReason.UNAVAILABLE
            for said, health in (("ON", Health.OK), ("OFF", Health.FINISHED)):
                peer.publish("v/1/connection", json.dumps({"state": said}), retain=True)
                assert until(events, health).component == place.component
            with pytest.raises(BridgeError, match='says "OFF"'):
                bridge.open_source(place, ANYTHING, lambda _: None)
            peer.publish("v/1/connection", json.dumps({"state": "ON"}), retain=True)
            wait(lambda: len(events) == 3, lambda: f"{events}")
            bridge.describe(place)

    def test_two_with_one_name_on_two_topics_are_two(self, broker: Broker) -> None:
        peers = [Peer(broker, will=(f"two/{name}", "gone")) for name in "ab"]
        with bridge_to(broker) as bridge:
            events = health_events(bridge)
            for name, item in zip("ab", peers, strict=True):
                item.publish(f"two/{name}", "online", retain=True)
                bridge.describe(endpoint(f"two/{name}/x", presence={"topic": f"two/{name}"}))
            peers[0].die()
            event = until(events, Health.LOST)
            assert event.component == "component of two/a/x"
            assert "gone" in event.cause
        for item in peers:
            item.close()

    def test_one_that_a_broker_has_forgotten_and_does_not_come_back_is_lost(
        self, tmp_path: Path
    ) -> None:
        with running(tmp_path / "broker") as broker, bridge_to(broker, grace=3600) as bridge:
            events, link = health_events(bridge), vars(bridge)["_broker"]
            with closing(Peer(broker)) as peer:
                for name in ("alive", "dead"):
                    peer.publish(f"{name}/there", "online", retain=True)
                    bridge.describe(endpoint(name, presence={"topic": f"{name}/there"}))
            broker.kill()
            broker.start()  # which keeps nothing
            wait(lambda: link._lapse_at is not None and link.breaks)
            with closing(Peer(broker)) as peer:
                peer.publish("alive/there", "online", retain=True)
            link.barrier(patience())  # so this has come
            link._lapse_at = 0.0
            event = until(events, Health.LOST)
            assert (event.component, event.cause) == (
                "component of dead",
                "dead/there says nothing",
            )
            bridge.describe(endpoint("alive", presence={"topic": "alive/there"}))
            with pytest.raises(BridgeError, match="dead/there says nothing"):
                bridge.describe(endpoint("dead", presence={"topic": "dead/there"}))

    def test_one_that_is_slow_to_be_read_holds_up_no_other(
        self, broker: Broker, peer: Peer, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        reached, gate = threading.Event(), threading.Event()
        subscribe = _link.BrokerConnection.subscribe

        def late(link: Any, receiver: Any, **more: Any) -> None:
            if receiver.topic == "slow/there":
                reached.set()
                assert gate.wait(patience())
            subscribe(link, receiver, **more)

        def describe(bridge: Bridge, name: str) -> None:
            place = endpoint(name, presence={"topic": f"{name}/there"})
            bridge.describe(place)

        monkeypatch.setattr(_link.BrokerConnection, "subscribe", late)
        for name in ("slow", "quick"):
            peer.publish(f"{name}/there", "online", retain=True)
        with bridge_to(broker) as bridge:
            slow = [Background(lambda: describe(bridge, "slow")) for _ in range(2)]
            try:
                assert reached.wait(patience())
                describe(bridge, "quick")
            finally:
                gate.set()
            for description in slow:
                description.result()

    def test_ours_is_announced_and_withdrawn(self, broker: Broker, peer: Peer) -> None:
        came = peer.collect("robots/ours")
        with bridge_to(broker, presence={"topic": "robots/ours"}) as bridge:
            bridge.describe(endpoint("anything"))
            wait(lambda: came, "no birth")
        wait(lambda: len(came) == 2, "no goodbye")
        assert [item.payload for item in came] == [b"online", b"offline"]


class TestServices:
    """Response topic and correlation data, with peers on the other side."""

    def test_a_client_may_have_any_name(self, broker: Broker, peer: Peer) -> None:
        peer.serve("any/name", lambda request: request)
        with bridge_to(broker, client_id="lab+arm #1/é") as bridge:
            assert bridge.discover() is not None
            place = endpoint("any/name", Role.SERVICE)
            assert bridge.call(place, 7) == 7

    def test_filters_may_have_every_form(self, broker: Broker) -> None:
        topics = ["#", "+", "+/+", "a/+/b", "/a", "a//b", "/", "a/#", "+/#", "$SYS/#", "é ☃/+"]
        structures = dict.fromkeys(topics, True)
        with bridge_to(broker, discover={"topics": topics, "seconds": 0.1}, structures=structures):
            pass

    def test_an_absent_service_is_reported_at_once(self, bridge: Bridge) -> None:
        place = endpoint("no/service", Role.SERVICE)
        with pytest.raises(BridgeError, match="no client is subscribed") as caught:
            bridge.call(place, {})
        assert not isinstance(caught.value, BridgeTimeoutError)

    def test_a_reply_that_answers_no_call_is_named_where_one_is_waited_for(
        self, broker: Broker, peer: Peer, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        came, take = threading.Event(), _channels.ServiceCalls._take

        class LateEvent(threading.Event):
            """Its wait is over once the reply came, and not before."""

            def wait(self, timeout: float | None = None) -> bool:
                assert came.wait(patience())
                return super().wait(timeout)

        def take_first(calls: _channels.ServiceCalls, incoming: Any) -> None:
            take(calls, incoming)
            came.set()

        monkeypatch.setattr(_channels.ServiceCalls, "_take", take_first)
        monkeypatch.setattr(_channels, "_Call", lambda: _Call(ended=LateEvent()))
        monkeypatch.setattr("uoarm.bridge._bridge._GRACE_SECONDS", patience())

        def answer(request: Any) -> None:
            peer.publish_soon(request.properties.ResponseTopic, b"42", CorrelationData=b"mine")

        peer.subscribe("odd/service", answer)
        expected = r"no reply within .*; what came instead answers no call: 2 octets with .*b'mine'"
        place = endpoint("odd/service", Role.SERVICE)
        with bridge_to(broker) as bridge, pytest.raises(BridgeTimeoutError, match=expected):
            bridge.call(place, {}, timeout=0.1)

    def test_a_function_serves_peers_and_failures_are_reported(
        self, bridge: Bridge, peer: Peer
    ) -> None:
        def answer(request: Any) -> Any:
            if request < 0:
                raise ArithmeticError("of no negative number")
            return request * 2 if request else Quits(a=1)

        channel = bridge.serve(endpoint("served/double", Role.SERVICE, share="pool"), answer)
        came = peer.collect("answers/mine")
        for payload in (b"21", b"-1", b"{", b"0"):
            peer.publish(
                "served/double", payload, ResponseTopic="answers/mine", CorrelationData=payload
            )
        peer.publish("served/double", b"1")
        wait(lambda: len(came) == 4, "not answered")
        assert [item.properties.CorrelationData for item in came] == [b"21", b"-1", b"{", b"0"]
        assert came[0].payload == b"42"
        assert "of no negative number" in dict(came[1].properties.UserProperty)["error"]
        assert "MessageError" in dict(came[2].properties.UserProperty)["error"]
        assert "SystemExit" in dict(came[3].properties.UserProperty)["error"]
        wait(lambda: channel.facts()["unanswerable"] == 1, lambda: f"{channel.facts()}")

    @pytest.mark.parametrize("said", ["two\nlines", "nul\0", "del\x7f", "none\ufdd0", "\U0001ffff"])
    def test_a_failure_in_any_words_is_reported_and_breaks_no_connection(
        self, bridge: Bridge, said: str
    ) -> None:
        events = health_events(bridge)

        def answer(request: Any) -> Any:
            raise ValueError(f"{request}: {said} \U0001f600")

        place = endpoint("served/words", Role.SERVICE)
        bridge.serve(place, answer)
        with pytest.raises(BridgeError, match=r"the service failed: ValueError: 1: .* \U0001f600"):
            bridge.call(place, 1)
        assert not events

    def test_a_service_that_the_broker_takes_no_more_after_a_break_is_lost(
        self, broker: Broker, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        refusing = PacketOutcome("the broker refuses: Not authorized")
        with cut_off(broker) as (proxy, bridge):
            events = health_events(bridge)
            served = bridge.serve(endpoint("served/no/more", Role.SERVICE), lambda _: 1)
            calls = bridge._calls  # type: ignore[attr-defined]
            place = endpoint("served/elsewhere", Role.SERVICE)
            with pytest.raises(BridgeError):
                bridge.call(place, 1)
            note = _link.BrokerConnection._note

            def refused(self: Any, key: Any, pending: Any, *more: Any) -> None:
                if key[0] == "s":
                    pending.done(refusing)
                else:
                    note(self, key, pending, *more)

            monkeypatch.setattr(_link.BrokerConnection, "_note", refused)
            proxy.cut()
            lost = until(events, Health.LOST)
            assert lost.channel is served
            assert "Not authorized" in lost.cause
            assert not calls._is_open, "the next call says why no reply can come"


FORKED = """
import sys
from uoarm.bridge import Registry
from uoarm.model import BridgeSpec, Endpoint, MessageStructure, Role
from uoarm.testing import patience

presence = {"topic": "forked/there"}
options = {"url": sys.argv[1], "presence": presence, "keepalive": 65535}
bridge = Registry().create(BridgeSpec("mqtt", "mqtt", options))
said = Endpoint("mqtt", "said", Role.INPUT, ("forked/said",))
sink = bridge.open_sink(said, MessageStructure(True), timeout=patience())
"""


class TestBroker:
    """The broker killed, silent, hostile, and what a bridge may not do."""

    def test_a_child_that_is_forked_keeps_back_no_last_will(
        self, broker: Broker, peer: Peer
    ) -> None:
        came = peer.collect("forked/there")
        with ForkedProgram(FORKED, broker.url) as forked:
            assert forked.read() == "forked"
            forked.kill_parent()
            wait(lambda: [item.payload for item in came] == [b"online", b"offline"], "no will")

    def test_killed_and_back_counts_and_resumes(self, tmp_path: Path) -> None:
        lines = f"allow_anonymous true\npersistence true\npersistence_location {tmp_path}/\n"
        with running(tmp_path / "broker", lines) as broker, bridge_to(broker) as bridge:
            events = health_events(bridge)
            collector, source = listen(bridge, "resumed", retain=True)
            sink = speak(bridge, "resumed")
            sink.send(0)
            collector.wait(1)
            # Else it may be sent again: a subscriber has it before the sender its acknowledgement.
            assert sink.drain(patience())
            broker.kill()
            cause = until(events, Health.DEGRADED).cause
            assert f"the broker at {broker.host}:{broker.port}: the connection broke" in cause
            with pytest.raises(BridgeError, match="no connection to the broker"):
                sink.send("lost")
            with pytest.raises(BridgeError, match="no connection to the broker"):
                bridge.describe(endpoint("resumed"))
            broker.start()
            until(events, Health.OK)
            sink.send(1)
            assert collector.wait(2) == [0, 1]
            assert source.facts()["interruptions"] == 1
            assert [event.health for event in events] == [Health.DEGRADED, Health.OK]

    def test_killed_as_much_is_under_way_each_message_is_counted_once(self, tmp_path: Path) -> None:
        with running(tmp_path / "broker") as broker, bridge_to(broker) as bridge:
            events = health_events(bridge)
            sink = speak(bridge, "counted")
            for number in range(300):
                sink.send(number)
            broker.kill()
            until(events, Health.DEGRADED)
            assert sink.facts()["under_way"]
            broker.start()
            until(events, Health.OK)
            sink.send(300)
            assert sink.drain(patience())
            # The broker takes each, and says that no client is subscribed.
            facts = sink.facts()
            counts = {name: facts[name] for name in ("under_way", "lost_on_link", "refused")}
            assert (counts, facts["undelivered"]) == (dict.fromkeys(counts, 0), 301)

    def test_what_is_retained_with_qos_0_in_a_break_is_not_missed(
        self, broker: Broker, peer: Peer
    ) -> None:
        kept, there = "break/state", {"topic": "break/there"}
        peer.publish(kept, "1", retain=True)
        peer.publish("break/same", "1", retain=True)
        peer.publish("break/there", "online", retain=True)
        with cut_off(broker) as (proxy, bridge):
            events = health_events(bridge)
            collector, _ = listen(bridge, kept, retain=True, presence=there)
            same, _ = listen(bridge, "break/same", retain=True)
            assert collector.wait(1) == same.wait(1) == [1]
            proxy.cut(admit=False)
            until(events, Health.DEGRADED)
            peer.publish(kept, "2", qos=0, retain=True)
            peer.publish("break/there", "gone", qos=0, retain=True)
            peer.publish("break/meanwhile", "")  # once this is answered the broker has both
            proxy.admit()
            assert collector.wait(2) == [1, 2]
            assert until(events, Health.LOST).component == f"component of {kept}"
            peer.publish("break/same", "2")
            assert same.wait(2) == [1, 2], "what stands came twice"

    def test_a_shared_subscription_closed_in_a_break_takes_nothing_more(
        self, broker: Broker, peer: Peer
    ) -> None:
        with cut_off(broker) as (proxy, bridge), bridge_to(broker) as other:
            events = health_events(bridge)
            _, leaving = listen(bridge, "break/work", share="break")
            staying, _ = listen(other, "break/work", share="break")
            proxy.cut(admit=False)
            until(events, Health.DEGRADED)
            leaving.close(timeout=patience())
            proxy.admit()
            until(events, Health.OK)
            for number in range(6):
                peer.publish("break/work", str(number))
            assert staying.wait(6) == [*range(6)]

    def test_away_for_longer_than_its_grace_it_is_lost_once(self, tmp_path: Path) -> None:
        with running(tmp_path / "broker") as broker, bridge_to(broker, grace=0.5) as bridge:
            events = health_events(bridge)
            listen(bridge, "lost")
            broker.kill()
            event = until(events, Health.LOST)
            assert (event.channel, event.component) == (None, None)
            assert [health_event.health for health_event in events] == [
                Health.DEGRADED,
                Health.LOST,
            ]

    def test_one_that_appears_late_is_reported(self, tmp_path: Path) -> None:
        broker = Broker(tmp_path / "broker")
        with bridge_to(broker) as bridge:
            events = health_events(bridge)
            with pytest.raises(BridgeError, match="no connection to the broker at") as caught:
                bridge.describe(endpoint("late"))
            assert caught.value.reason is FailureReason.UNAVAILABLE
            assert str(caught.value).endswith((": Connection refused", ": no answer yet"))
            broker.start()
            try:
                until(events, Health.OK)
                bridge.describe(endpoint("late"))
            finally:
                broker.stop()

    def test_one_that_says_nothing_is_noticed_and_closing_ends(self, tmp_path: Path) -> None:
        with running(tmp_path / "broker") as broker, bridge_to(broker, keepalive=1) as bridge:
            events = health_events(bridge)
            listen(bridge, "silent")
            broker.send_signal(signal.SIGSTOP)
            try:
                # Before that the broker may have ended the connection of one that was late itself.
                wait(
                    lambda: any("Keep alive" in event.cause for event in events),
                    lambda: f"{events}",
                )
                bridge.close(timeout=patience())
            finally:
                broker.send_signal(signal.SIGCONT)

    def test_a_drain_of_one_that_says_nothing_ends_with_its_own_time(
        self, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        with running(tmp_path / "broker") as broker, bridge_to(broker, keepalive=1) as bridge:
            sink = speak(bridge, "silent", qos=0)
            broker.send_signal(signal.SIGSTOP)
            try:
                monkeypatch.setattr(_link, "_STEP_SECONDS", 100 * patience())
                sink.send(1)
                assert not sink.drain(0.1)
            finally:
                broker.send_signal(signal.SIGCONT)

    def test_what_waits_for_one_that_says_nothing_is_bounded(self, tmp_path: Path) -> None:
        with (
            running(tmp_path / "broker") as broker,
            bridge_to(broker, max_octets=1000, keepalive=65535) as bridge,
        ):
            sink = speak(bridge, "silent", qos=1, content="octets")
            broker.send_signal(signal.SIGSTOP)
            try:
                for _ in range(8):
                    sink.send(bytes(1000))
                with pytest.raises(BridgeError, match=r"8 messages of 8,000 octets wait .*backlog"):
                    sink.send(b"1")
            finally:
                broker.send_signal(signal.SIGCONT)
            assert sink.drain(patience())
            sink.send(bytes(1000))
            assert sink.drain(patience())

    def test_its_limits_hold_and_its_reason_codes_are_reported(self, tmp_path: Path) -> None:
        lines = "allow_anonymous true\nmax_packet_size 3000\nmax_inflight_messages 3\n"
        with running(tmp_path / "broker", lines) as broker, bridge_to(broker) as bridge:
            events = health_events(bridge)
            collector, _ = listen(bridge, "limited", qos=2)
            sink = speak(bridge, "limited", qos=2)
            with pytest.raises(MessageError, match="3,000 at most"):
                sink.send("x" * 3000)
            for number in range(50):
                sink.send(number)
            assert collector.wait(50) == list(range(50))
            assert not events
            # What is sent as the broker closes takes its last word away.
            wait(lambda: not paho_of(bridge)._in_messages)
            paho_of(bridge).publish("limited", "x" * 3000)  # past what holds the limit
            assert "Packet too large (reason code 0x95)" in until(events, Health.DEGRADED).cause
            until(events, Health.OK)

    @pytest.mark.parametrize("qos", [1, 2])
    def test_a_reason_that_the_standard_does_not_give_is_a_refusal(
        self, tmp_path: Path, qos: int
    ) -> None:
        lines = "allow_anonymous true\nmessage_size_limit 100\n"
        with running(tmp_path / "broker", lines) as broker, bridge_to(broker) as bridge:
            events = health_events(bridge)
            sink = speak(bridge, "limited", qos=qos)
            sink.send("x" * 200)
            assert "Packet too large (reason code 0x95)" in until(events, Health.DEGRADED).cause
            assert sink.facts()["refused"] == 1
            sink.send("x")
            assert sink.drain(patience())
            assert [event.channel for event in events] == [sink, sink], "the connection broke"

    def test_a_refusal_ends_with_the_connection_although_nothing_is_sent(
        self, tmp_path: Path
    ) -> None:
        lines = "allow_anonymous true\nmessage_size_limit 100\n"
        with running(tmp_path / "broker", lines) as broker, bridge_to(broker) as bridge:
            events = health_events(bridge)
            sink = speak(bridge, "limited")
            sink.send("x" * 200)
            assert until(events, Health.DEGRADED).channel is sink
            broker.kill()
            broker.start()
            wait(
                lambda: (
                    [event.health for event in events if event.channel is sink][1:] == [Health.OK]
                ),
                str(events),
            )

    @pytest.mark.parametrize(
        ("limit", "most", "beyond", "why"),
        [
            ("max_qos 1", {"qos": 1}, {"qos": 2}, r"QoS 1 at most \(qos\)"),
            ("max_qos 0", {"qos": 0}, {"qos": 1}, r"QoS 0 at most \(qos\)"),
            ("retain_available false", {}, {"retain": True}, r"nothing to be retained \(retain\)"),
        ],
    )
    def test_what_a_broker_takes_of_no_client_does_not_open(
        self, tmp_path: Path, limit: str, most: Any, beyond: Any, why: str
    ) -> None:
        lines = f"{limit}\nallow_anonymous true\n"
        with running(tmp_path / "broker", lines) as broker, bridge_to(broker) as bridge:
            events = health_events(bridge)
            with pytest.raises(BridgeError, match=f"the broker at .* takes {why}") as caught:
                speak(bridge, "limited", **beyond)
            assert caught.value.reason is FailureReason.REFUSED
            sink = speak(bridge, "limited", **most)
            sink.send(1)
            assert sink.drain(patience())
            assert not events

    def test_rights_and_passwords(
        self, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
    ) -> None:
        secret = tmp_path / "secret"
        secret.write_text("open sesame\n")
        (tmp_path / "acl").write_text("user ours\ntopic readwrite ours/#\n")
        # What mosquitto_passwd makes of "open sesame", with 101 rounds of PBKDF2.
        (tmp_path / "passwords").write_text(f"ours:{hashed('open sesame')}\n")
        for name in ("acl", "passwords"):
            (tmp_path / name).chmod(0o644)
        lines = f"password_file {tmp_path}/passwords\nacl_file {tmp_path}/acl\n"
        monkeypatch.setenv("MQTT_SECRET", "wrong secret")
        caplog.set_level("DEBUG")
        with running(tmp_path / "broker", lines) as broker:
            with bridge_to(broker, user="ours", password_env="MQTT_SECRET") as refused:
                with pytest.raises(BridgeError, match=r"Not authorized.*0x87") as caught:
                    refused.describe(endpoint("ours/a"))
                assert "secret" not in f"{caught.value}{caplog.text}{vars(refused)}"
            with bridge_to(broker, user="ours", password_file=str(secret)) as bridge:
                events = health_events(bridge)
                collector, _ = listen(bridge, "ours/a")
                speak(bridge, "ours/a").send(1)
                assert collector.wait(1) == [1]
                for qos in (1, 2):
                    sink = speak(bridge, "theirs/a", qos=qos)
                    sink.send(1)
                    assert "0x87" in until(events, Health.DEGRADED).cause
                    assert sink.facts()["refused"] == 1
                    events.clear()
                assert "sesame" not in f"{caplog.text}{vars(bridge)}"

    # paho leaves the socket of a failed handshake to the garbage collector.
    @pytest.mark.filterwarnings("ignore::ResourceWarning")
    @pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning")
    def test_tls_with_a_certificate_of_ours_and_without(self, tmp_path: Path) -> None:
        broker = Broker(tmp_path / "broker", "allow_anonymous true\n" + TLS.format(tmp_path))
        certify(broker, tmp_path)
        trustme.CA().cert_pem.write_to_path(tmp_path / "stranger.pem")
        broker.start()
        url = f"mqtts://{broker.host}:{broker.port}"
        ours = {"ca": f"{tmp_path}/ca.pem", "certificate": f"{tmp_path}/us.pem"}
        try:
            with bridge_to(broker, url=url, tls=ours) as bridge:
                collector, _ = listen(bridge, "encrypted")
                speak(bridge, "encrypted").send({"a": "x" * 100_000})
                collector.wait(1)
            for tls, why in (
                (
                    {**ours, "ca": f"{tmp_path}/stranger.pem"},
                    "not trusted: .*; give its authority as `ca`",
                ),
                (
                    {"ca": ours["ca"]},
                    "(?i)this side's certificate: .*alert|ask for a certificate of the client",
                ),
                (None, "ended before the broker answered: does it ask for TLS"),
            ):
                options = {"url": broker.url} if tls is None else {"url": url, "tls": tls}
                refused = bridge_to(broker, **options)
                with refused as bad, pytest.raises(BridgeError, match=why):
                    bad.describe(endpoint("x"))
        finally:
            broker.stop()

    @pytest.mark.filterwarnings("ignore::ResourceWarning")
    @pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning")
    def test_a_broker_without_tls_has_a_hint(self, broker: Broker) -> None:
        url = broker.url.replace("mqtt:", "mqtts:")
        why = r"before TLS was spoken: is that spoken there .*\? Connection reset|no TLS is spoken"
        with bridge_to(broker, url=url) as bridge, pytest.raises(BridgeError, match=why):
            bridge.describe(endpoint("x"))

    def test_a_connection_that_is_closed_before_the_answer_has_a_hint(self, broker: Broker) -> None:
        def close(server: socket.socket) -> None:
            connection, _ = server.accept()
            with connection:
                assert connection.recv(1000)

        with socket.create_server(("127.0.0.1", 0)) as server:
            closing = Background(lambda: close(server))
            url = f"mqtt://127.0.0.1:{server.getsockname()[1]}"
            why = r"does it ask for TLS \(`mqtts://`\)\? the broker closed it and did not say why"
            with bridge_to(broker, url=url) as bridge, pytest.raises(BridgeError, match=why):
                bridge.describe(endpoint("x"))
            closing.result()

    @pytest.mark.filterwarnings("ignore::ResourceWarning")
    @pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning")
    def test_files_that_were_renewed_count_from_the_next_connection_on(
        self, tmp_path: Path, caplog: pytest.LogCaptureFixture
    ) -> None:
        secret, passwords = tmp_path / "secret", tmp_path / "passwords"
        broker = Broker(tmp_path / "broker", f"password_file {passwords}\n" + TLS.format(tmp_path))

        def renew(password: str) -> None:
            certify(broker, tmp_path)
            secret.write_text(password)
            passwords.write_text(f"ours:{hashed(password)}\n")
            passwords.chmod(0o644)

        renew("open sesame")
        broker.start()
        options = {
            "url": f"mqtts://{broker.host}:{broker.port}",
            "tls": {"ca": f"{tmp_path}/ca.pem", "certificate": f"{tmp_path}/us.pem"},
            "user": "ours",
            "password_file": str(secret),
            "grace": patience(),
        }
        try:
            with bridge_to(broker, **options) as bridge:
                events = health_events(bridge)
                collector, _ = listen(bridge, "a")
                speak(bridge, "a").send(1)
                assert collector.wait(1) == [1]
                broker.stop()
                until(events, Health.DEGRADED)
                ours = (tmp_path / "us.pem").read_bytes()
                (tmp_path / "us.pem").write_text("half of it")
                wait(lambda: "what was read before is used" in caplog.text, caplog.text)
                (tmp_path / "us.pem").write_bytes(ours)
                renew("open barley")
                broker.start()
                until(events, Health.OK)
                speak(bridge, "a").send(2)
                assert collector.wait(2) == [1, 2]
                assert "barley" not in f"{caplog.text}{vars(bridge)}"
        finally:
            broker.stop()


TLS = "cafile {0}/ca.pem\ncertfile {0}/broker.pem\nkeyfile {0}/broker.pem\nrequire_certificate true"


def certify(broker: Broker, folder: Path) -> None:
    """Write the certificates of an authority, of a broker and of a client."""
    authority = trustme.CA()
    authority.cert_pem.write_to_path(folder / "ca.pem")
    for file, name in (("broker.pem", broker.host), ("us.pem", "client")):
        authority.issue_cert(name).private_key_and_cert_chain_pem.write_to_path(folder / file)
    for path in folder.glob("*.pem"):
        path.chmod(0o644)


def hashed(password: str) -> str:
    import base64
    import hashlib
    import os

    salt = os.urandom(12)
    key = hashlib.pbkdf2_hmac("sha512", password.encode(), salt, 101)
    return f"$7$101${base64.b64encode(salt).decode()}${base64.b64encode(key).decode()}"


class TestRefusals:
    """Mistakes of a configuration, before anything is opened."""

    @pytest.mark.parametrize(
        ("options", "why"),
        [
            ({"url": "http://broker"}, "url"),
            ({"url": "mqtt://user:secret@broker"}, "url"),
            ({"url": "mqtt://broker:99999"}, "ort"),
            ({"tls": {}}, "mqtts://"),
            ({"url": "mqtts://broker", "tls": {"ca": "/no/such/file"}}, "tls"),
            ({"url": "mqtts://broker", "tls": {"key": "k"}}, "certificate"),
            ({"user": "u", "password_env": "NO_SUCH_VARIABLE"}, "NO_SUCH_VARIABLE"),
            ({"user": "u", "password_file": "/no/such/file"}, "password_file"),
            ({"user": "u", "password_file": "/dev/zero"}, "not a regular file"),
            ({"password_env": "PATH"}, "user"),
            ({"user": "u", "password_env": "PATH", "password_file": "x"}, "not both"),
            ({"url": "mqtt://broker", "user": "u", "password_env": "PATH"}, "unencrypted"),
            ({"password": "secret"}, "password"),
            ({"schemas": "no place"}, "schemas"),
            ({"replies": "a/#"}, "replies"),
            ({"presence": {"topic": "a/+"}}, "presence"),
            ({"discover": {"topics": ["a#"]}}, "discover"),
            ({"discover": {"topics": ["a/#/b"]}}, "discover"),
            ({"structures": {"a+/b": True}}, "structures"),
            ({"services": {"a/#": {}}}, "services"),
        ],
    )
    def test_options_of_the_bridge(self, options: dict[str, object], why: str) -> None:
        spec = BridgeSpec("mqtt", "mqtt", {"url": "mqtt://127.0.0.1", **options})
        with pytest.raises(ConfigurationError, match=why):
            Registry().create(spec)

    @pytest.mark.parametrize(
        ("topic", "role", "options", "why"),
        [
            ("a/#/b", "output", {}, "last"),
            ("a/b+", "output", {}, "whole level"),
            ("a\n", "output", {}, "control characters"),
            ("a\uffff", "input", {}, "control characters"),
            ("$share/g/a", "output", {}, "`share`"),
            ("a/+", "input", {}, "wildcards"),
            ("a", "input", {"with_topic": True}, "with_topic"),
            ("a", "input", {"share": "g"}, "share"),
            ("a", "output", {"share": "g", "retain": True}, "retained"),
            ("a", "output", {"qos": 3}, "qos"),
            ("a", "output", {"Qos": 1}, "Qos"),
            ("a", "output", {"presence": {}}, "presence"),
            ("a", "output", {"presence": {"topic": "a/#"}}, "presence"),
        ],
    )
    def test_options_of_a_port(
        self, bridge: Bridge, topic: str, role: str, options: dict[str, object], why: str
    ) -> None:
        with pytest.raises(BridgeError, match=why) as caught:
            bridge.describe(endpoint(topic, Role(role), **options))
        assert caught.value.reason is FailureReason.BAD_ENDPOINT


def test_paths_begin_at_the_configuration() -> None:
    located = Registry().types["mqtt"].located
    assert located(
        {
            "url": "mqtts://b",
            "password_file": "p",
            "tls": {"ca": "c/ca.pem", "key": "/k"},
            "schemas": "s/{topic}",
        },
        "/robot",
    ) == {
        "url": "mqtts://b",
        "password_file": "/robot/p",
        "tls": {"ca": "/robot/c/ca.pem", "key": "/k"},
        "schemas": "s/{topic}",
    }
