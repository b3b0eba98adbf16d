"""Every model value survives the way to JSON text and back."""

from __future__ import annotations

import json
from enum import Enum
from typing import Any, TypeVar

import attrs
import pytest
from attrs import fields
from hypothesis import given
from hypothesis import strategies as st

from uoarm.model import (
    BridgeSpec,
    BridgeStatus,
    Component,
    ComponentStatus,
    ConnectionState,
    ConnectionStatus,
    ControlMessage,
    Edge,
    Endpoint,
    Function,
    Health,
    Input,
    MessageStructure,
    Op,
    Output,
    OverflowPolicy,
    Plan,
    PortRef,
    QueuePolicy,
    Reason,
    Rejection,
    Robot,
    Role,
    RouteStatus,
    Service,
    StatusEvent,
    StatusMap,
    Step,
    from_json,
    to_json,
)

T = TypeVar("T")

TEXT = st.text(max_size=5)
TEXTS = st.lists(TEXT, max_size=3).map(tuple)
NUMBER = st.integers(0, 2**63)
SECONDS = st.floats(0, 1e9)
JSON = st.recursive(
    st.none() | st.booleans() | st.integers() | TEXT,
    lambda inner: st.lists(inner, max_size=2) | st.dictionaries(TEXT, inner, max_size=2),
    max_leaves=5,
)
OPTIONS = st.dictionaries(TEXT, JSON, max_size=2)
STRUCTURES = st.builds(MessageStructure, st.booleans() | OPTIONS, native_type=TEXT)
ENDPOINTS = st.builds(Endpoint, TEXT, TEXT, st.sampled_from(Role), TEXTS, TEXT, OPTIONS, OPTIONS)
QUEUES = st.builds(
    QueuePolicy, st.integers(1, 99), st.sampled_from(OverflowPolicy), st.floats(0.1, 9)
)
COMPONENTS = st.builds(
    Component,
    TEXT,
    TEXT,
    TEXT,
    st.integers(-9, 9),
    st.lists(
        st.builds(
            Input,
            TEXT,
            ENDPOINTS,
            st.none() | st.builds(PortRef, TEXT, st.none() | TEXT),
            st.none() | OPTIONS,
            TEXTS,
            st.none() | STRUCTURES,
            st.none() | QUEUES,
        ),
        max_size=1,
    ).map(tuple),
    st.lists(st.builds(Output, TEXT, ENDPOINTS, st.none() | STRUCTURES), max_size=1).map(tuple),
    st.none() | st.builds(Service, ENDPOINTS, st.none() | STRUCTURES, st.none() | STRUCTURES),
    OPTIONS,
)
REASONS = st.lists(st.builds(Reason, TEXT, TEXT, TEXT, TEXT, JSON, TEXT), max_size=1).map(tuple)
REJECTIONS = st.recursive(
    st.builds(Rejection, TEXT, TEXT, st.integers(), REASONS),
    lambda inner: st.builds(
        Rejection, TEXT, TEXT, st.integers(), REASONS, st.lists(inner, max_size=2).map(tuple)
    ),
    max_leaves=4,
)
PLANS = st.builds(
    Plan,
    TEXT,
    st.lists(
        st.builds(Step, COMPONENTS, st.dictionaries(TEXT, STRUCTURES, max_size=1)), max_size=2
    ).map(tuple),
    st.lists(
        st.builds(
            Edge,
            TEXT,
            TEXT,
            TEXT,
            TEXT,
            STRUCTURES,
            STRUCTURES,
            st.none() | OPTIONS,
            TEXTS,
            TEXTS,
        ),
        max_size=1,
    ).map(tuple),
    st.lists(REJECTIONS, max_size=1).map(tuple),
    TEXTS,
)
ROBOTS = st.builds(
    Robot,
    st.dictionaries(
        TEXT, st.builds(BridgeSpec, TEXT, TEXT, OPTIONS, st.none() | OPTIONS), max_size=1
    ),
    st.dictionaries(
        TEXT,
        st.builds(Function, TEXT, st.lists(COMPONENTS, max_size=1).map(tuple), TEXT),
        max_size=1,
    ),
    TEXTS,
    TEXT,
)
HEALTH = st.sampled_from(Health)
STATUS_MAPS = st.builds(
    StatusMap,
    st.lists(st.builds(BridgeStatus, TEXT, TEXT, HEALTH, NUMBER, TEXT), max_size=1).map(tuple),
    st.lists(st.builds(ComponentStatus, TEXT, TEXT, TEXT, HEALTH, TEXTS, TEXT), max_size=1).map(
        tuple
    ),
    st.lists(
        st.builds(ConnectionStatus, TEXT, TEXT, st.sampled_from(ConnectionState), TEXTS, TEXT),
        max_size=1,
    ).map(tuple),
    st.lists(
        st.builds(
            RouteStatus,
            TEXT,
            TEXT,
            NUMBER,
            NUMBER,
            st.lists(st.tuples(TEXT, NUMBER), max_size=2).map(tuple),
            NUMBER,
            st.none() | SECONDS,
            st.none() | SECONDS,
            TEXT,
            st.booleans(),
        ),
        max_size=1,
    ).map(tuple),
)
EVENTS = st.builds(StatusEvent, NUMBER, SECONDS, TEXT, TEXT, TEXT)
CONTROL = st.builds(
    ControlMessage, st.sampled_from(Op), TEXT | TEXTS, JSON, st.none() | TEXT, OPTIONS
)


def there_and_back(value: T) -> T:
    return from_json(json.loads(json.dumps(to_json(value))), type(value))


@given(st.one_of(PLANS, ROBOTS, STATUS_MAPS, EVENTS, CONTROL))
def test_a_value_comes_back_the_same(value: Any) -> None:
    back = there_and_back(value)
    assert back == value
    assert to_json(back) == to_json(value)
    assert {field.name: type(getattr(back, field.name)) for field in fields(type(value))} == {
        field.name: type(getattr(value, field.name)) for field in fields(type(value))
    }


@given(PLANS)
def test_a_plan_that_came_back_still_finds_its_provider(plan: Plan) -> None:
    if plan.steps:
        assert there_and_back(plan).provider == plan.provider


def test_a_structure_is_written_with_its_two_parts() -> None:
    structure = MessageStructure({"type": "string"}, native_type="Text")
    assert to_json(structure) == {"schema": {"type": "string"}, "native_type": "Text"}


def test_a_tree_of_rejections_without_end_is_cut_with_a_note() -> None:
    tree = Rejection("f", "c", 0, ())
    for _ in range(5000):
        tree = Rejection("f", "c", 0, (), (tree,))
    back = there_and_back(tree)
    depth = 1
    while back.because_of:
        depth, back = depth + 1, back.because_of[0]
    assert depth == 50
    assert back.reasons == (Reason("its own causes lie too deep to be written down"),)


BAD: dict[str, tuple[type, object, str]] = {
    "unknown field": (PortRef, {"function": "f", "prt": 1}, "unknown fields prt"),
    "missing field": (PortRef, {}, "the field 'function' is missing"),
    "number for text": (PortRef, {"function": 1}, "expected str, got int"),
    "text for a number": (QueuePolicy, {"length": "3"}, "expected int, got str"),
    "boolean for a number": (QueuePolicy, {"length": True}, "expected int, got bool"),
    "number out of range": (QueuePolicy, {"length": 0}, "'length' must be >= 1"),
    "unknown choice": (QueuePolicy, {"policy": "newest"}, "newest.*policy"),
    "list for an object": (Plan, [], "expected the fields of Plan"),
    "nothing for an object": (Plan, None, "Plan: "),
    "structure": (MessageStructure, {"schema": True}, "expected schema and native_type"),
    "structure of text": (MessageStructure, {"schema": "x", "native_type": ""}, "mapping"),
    "options of text": (BridgeSpec, {"name": "a", "plugin": "b", "options": "c"}, "mapping"),
    "type of numbers": (ControlMessage, {"op": "Kill", "type": [1]}, "list of strings"),
}


@pytest.mark.parametrize(("kind", "data", "says"), BAD.values(), ids=BAD.keys())
def test_other_data_is_refused(kind: type, data: object, says: str) -> None:
    with pytest.raises(ValueError, match=says):
        from_json(data, kind)


def test_data_nested_without_end_is_refused() -> None:
    tree: dict[str, Any] = {"function": "f", "component": "c", "priority": 0, "reasons": []}
    for _ in range(5000):
        tree = {**tree, "because_of": [tree]}
    with pytest.raises(ValueError, match="more than 200 levels"):
        from_json(tree, Rejection)


class _Colour(str, Enum):
    RED = "red"


class _Named(dict[str, object]):
    pass


def test_what_is_derived_from_plain_values_is_written_as_one_of_them() -> None:
    written = to_json({"a": _Colour.RED, 1: _Named(b=(True, 2, None, _Named(c=_Colour.RED)))})
    assert written == {"a": "red", "1": {"b": [True, 2, None, {"c": "red"}]}}
    assert type(written["a"]) is str
    assert type(written["1"]) is dict


def test_what_is_no_model_value_is_left_as_it_is() -> None:
    thing = object()
    octets = b"\x00\xff"
    assert to_json({"thing": thing, "octets": octets}) == {"thing": thing, "octets": octets}


def test_a_host_is_given_every_field_of_a_bridge_but_those_of_the_manager() -> None:
    spec = BridgeSpec("arm", "net", {"rate": 1}, {"memory": "1GB"}, {"rate": 1}, "/robot", "m1")
    names = [attribute.name for attribute in attrs.fields(BridgeSpec)]
    plain = BridgeSpec("", "")
    assert all(getattr(spec, name) != getattr(plain, name) for name in names), "give it one here"
    given = json.loads(json.dumps({**spec.to_host(), "of a later version": 1}))
    hosted = BridgeSpec.in_host(given)
    assert attrs.asdict(hosted) == attrs.asdict(attrs.evolve(spec, host=None, assigned={}))
