"""Decided without a connection: which receivers get a message."""

from __future__ import annotations

import threading
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from jsonschema import Draft202012Validator
from paho.mqtt.enums import CallbackAPIVersion, MQTTErrorCode
from tests.hostile import misbehaviour  # type: ignore[import-not-found]
from uoarm_mqtt._client import ThreadedClient
from uoarm_mqtt._codec import PayloadCodec, with_topic
from uoarm_mqtt._subscriptions import ReceivedMessage, Receiver, Subscriptions

from uoarm.bridge import Registry
from uoarm.errors import MessageError
from uoarm.model import Budget, Endpoint, MessageStructure, Role
from uoarm.schema import property_of


class Ending(ThreadedClient):
    """Its thread is gone as soon as it was looked at."""

    _looked = False

    @property
    def _thread(self) -> threading.Thread | None:
        thread = None if self._looked else threading.Thread(target=int)
        if thread is not None:
            thread.start()
        self._looked = True
        return thread

    @_thread.setter
    def _thread(self, _: threading.Thread | None) -> None:
        self._looked = False


def test_a_thread_that_ends_while_it_is_waited_for_is_no_error() -> None:
    assert Ending(CallbackAPIVersion.VERSION2).loop_stop() is MQTTErrorCode.MQTT_ERR_SUCCESS


def receiver(topic: str, *, retained: bool = False) -> Receiver:
    return Receiver(topic, lambda _: None, retained=retained)


def message(topic: str, *ids: int, retain: bool = False) -> ReceivedMessage:
    return ReceivedMessage(topic, b"", retain, SimpleNamespace(SubscriptionIdentifier=[*ids]))


def test_identifiers_are_bounded_and_the_last_one_serves_every_receiver() -> None:
    table, lasting = Subscriptions(), receiver("a")
    table.add(lasting)
    for _ in range(1000):
        passing = receiver("a")
        table.add(passing)
        assert not table.remove(passing)
    assert table.route(message("a", passing.id)) == [lasting]
    assert len(table._filters) < 20
    assert table.remove(lasting)
    assert table.route(message("a", passing.id)) == []


def test_a_filter_is_added_and_removed_without_a_look_at_the_others() -> None:
    """All are added again after each break, in the thread in which messages come."""
    looks = 0

    class Topic(str):
        __slots__ = ()

        def __eq__(self, other: object) -> bool:
            nonlocal looks
            looks += 1
            return str.__eq__(self, other)

        __hash__ = str.__hash__

    table, receivers = Subscriptions(), [receiver(Topic(number)) for number in range(300)]
    for item in (*receivers, *receivers):
        table.add(item)
    for item in receivers:
        assert table.remove(item)
    assert looks < 20 * len(receivers)
    assert not table._filters


def test_without_identifiers_filters_are_matched() -> None:
    table, receivers = Subscriptions(), [receiver(topic) for topic in ("a/+", "$share/g/a/#", "b")]
    for item in receivers:
        table.add(item)
    assert sorted(table.route(message("a/x")), key=lambda item: item.id) == receivers[:2]


def test_what_is_retained_goes_to_who_has_just_subscribed_and_wants_it() -> None:
    table = Subscriptions()
    old, new, other = (receiver("a", retained=wanted) for wanted in (True, True, False))
    for item in (old, new):
        table.add(item)
    assert table.route(message("a", new.id, retain=True)) == [new]
    table.add(other)
    assert table.route(message("a", other.id, retain=True)) == []
    assert table.route(message("a", other.id)) == [old, new, other]


@pytest.mark.parametrize("content", ["json", "octets", "text"])
def test_what_a_value_does_itself_is_a_refusal(content: str) -> None:
    assert not misbehaviour(PayloadCodec(content, Budget()).encode)
    if content == "json":
        assert not misbehaviour(lambda value: PayloadCodec(content, Budget()).encode([value]))


def test_octets_in_json_are_base64_with_its_padding_or_without() -> None:
    octets = {"type": "array", "items": {"type": "integer"}, "x-octets": True}
    codec = PayloadCodec.of("json", MessageStructure(octets), Budget())
    for text in (b'"YQ=="', b'"YQ"'):
        assert bytes(codec.decode(text)) == b"a"
    for text in (b'"Y"', b'"YQ="', b'"Y Q"'):
        with pytest.raises(MessageError):
            codec.decode(text)


@pytest.mark.parametrize("kind", ["u1", "i1", "<i8", ">u2"])
def test_octets_are_the_numbers_of_an_array_and_not_its_memory(kind: str) -> None:
    numbers: Any = np.array([1, 2, 127], kind)
    budget = Budget()
    assert PayloadCodec("octets", budget).encode(numbers) == b"\x01\x02\x7f"
    assert PayloadCodec("json", budget).encode(memoryview(numbers.astype("<i8"))) == b'"AQJ/"'
    for wrong in (np.array([-1], "i1"), np.array([256]), np.array([1.5])):
        with pytest.raises(MessageError):
            PayloadCodec("octets", budget).encode(wrong)


KNOWN: list[tuple[Role, dict[str, object], dict[str, object], bool]] = [
    (Role.OUTPUT, {}, {}, False),
    (Role.SERVICE, {}, {}, False),
    (Role.OUTPUT, {"content": "text"}, {}, True),
    (Role.OUTPUT, {}, {"structures": {"room/#": {"type": "number"}}}, True),
    (Role.OUTPUT, {}, {"schemas": "schemas/{topic}"}, True),
    (Role.SERVICE, {}, {"structures": {"room/#": {"type": "number"}}}, False),
    (Role.SERVICE, {}, {"services": {"room/temp": {"request": True, "reply": True}}}, True),
]


@pytest.mark.parametrize(("role", "port", "options", "is_known"), KNOWN)
def test_check_knows_without_a_broker_which_structures_must_be_written(
    role: Role, port: dict[str, object], options: dict[str, object], is_known: bool
) -> None:
    kind = Registry().types["mqtt"]
    assert kind.describe is not None
    endpoint = Endpoint("mqtt", "temp", role, ("room/temp",), options=port)
    given = kind.value_of({"url": "mqtt://127.0.0.1:1", **options}, "")
    description = kind.describe(endpoint, given)
    where = "services" if role is Role.SERVICE else "structures"
    assert bool(description.hint) is not is_known
    assert is_known or f"under `{where}` of the bridge's options" in description.hint


OCTETS = {"type": "array", "x-octets": True}
REFERRING: list[dict[str, Any]] = [
    {"properties": {"a": OCTETS, "kids": {"type": "array", "items": {"$ref": "#"}}}},
    {"properties": {"a": {"$ref": "#/properties/b"}, "b": OCTETS, "kids": True}},
    {"properties": {"a": {"$ref": "#/$defs/o~1p%20q"}, "kids": True}, "$defs": {"o/p q": OCTETS}},
    {"properties": {"a": {"$ref": "#/definitions/o"}, "kids": True}, "definitions": {"o": OCTETS}},
    {
        "$id": "x:y",
        "properties": {"a": {"$ref": "#/$defs/o"}, "$ref": True},
        "$defs": {"o": OCTETS},
    },
    {"properties": {"a": {"$ref": "#o"}, "kids": True}, "$defs": {"o": {"$anchor": "o", **OCTETS}}},
    {"properties": {"a": {"$ref": "#/prefixItems/0"}, "kids": True}, "prefixItems": [OCTETS]},
]


@pytest.mark.parametrize("schema", REFERRING)
def test_references_mean_the_same_where_the_topic_is_said(schema: dict[str, Any]) -> None:
    inner = {"type": "object", "required": ["a"], "additionalProperties": True, **schema}
    both = with_topic(MessageStructure(inner))
    said = {"a": [1, 2], "kids": [{"a": [3]}]}
    validator = Draft202012Validator(both.schema)
    assert validator.is_valid({"topic": "t", "message": said})
    assert not validator.is_valid({"topic": "t", "message": {"a": "ab"}})
    codec = PayloadCodec.of("json", MessageStructure(property_of(both.schema, "message")), Budget())
    read: Any = codec.decode(b'{"a": "AQI=", "kids": [{"a": "Aw=="}]}')
    assert read["a"] == b"\1\2"
    if "items" in str(schema):
        assert read["kids"] == [{"a": b"\3"}]
