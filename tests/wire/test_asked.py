"""What clients ask is checked against the published schema, in both forms."""

from __future__ import annotations

import time
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st
from jsonschema import Draft202012Validator

from uoarm._wire._forms import (
    ASKED,
    BINARY_FORM,
    FORMS,
    TEXT_FORM,
    Form,
    check_asked,
    protocol_schema,
    salvage_id,
)
from uoarm.errors import ControlMessageError
from uoarm.model import Budget, BudgetUse


def test_the_protocol_schema_is_a_schema_and_has_every_operation() -> None:
    schema = protocol_schema()
    Draft202012Validator.check_schema(schema)
    assert {f"client.{op}" for op in ASKED} <= schema["$defs"].keys()


plain = st.none() | st.booleans() | st.integers(0, 9) | st.text(max_size=3)
fields = st.dictionaries(
    st.sampled_from(
        ["type", "id", "jsonMessage", "x-note", "x-timeout", "x-sent", "x-managers", "odd"]
    ),
    plain | st.fixed_dictionaries({}, optional={"every": plain, "receive": plain, "z": plain}),
)
# Those that are looked at quickly, with some that are wrong.
quick = st.fixed_dictionaries(
    {"type": st.text(max_size=3), "id": st.text(max_size=3), "jsonMessage": plain},
    optional={
        "x-timeout": st.integers(-1, 1) | st.floats() | st.booleans(),
        "x-sent": st.floats() | st.booleans() | st.text(max_size=3),
        "x-managers": st.lists(st.sampled_from(["a" * 32, "A" * 32, "a" * 33, 1]), max_size=3)
        | st.just(["b" * 32] * 65),
    },
)


@given(st.sampled_from(ASKED) | st.sampled_from(["Call", "Data"]), fields | quick)
def test_the_server_takes_exactly_what_the_schema_allows(op: str, rest: dict[str, Any]) -> None:
    message = {**rest, "op": op}
    schema = {**protocol_schema(), "$ref": f"#/$defs/client.{op}"}
    allowed = Draft202012Validator(schema).is_valid(message)
    try:
        check_asked(message)
    except ControlMessageError:
        assert not allowed
    else:
        assert allowed


@pytest.mark.parametrize(
    ("message", "said"),
    [
        ({}, "op is missing; expected one of Request"),
        ({"op": "request"}, "did you mean 'Request'"),
        (
            {"op": "subscribe", "topic": "/t"},
            "rosbridge, whose clients connect at /rosbridge; here",
        ),
        ({"op": "status"}, "did you mean 'Status'"),
        ({"op": ["x"]}, "got list"),
        ({"op": "Reply", "id": "1"}, "op: expected one of"),
        ({"op": "Request", "id": "1"}, "'type' is a required property"),
        ({"op": "Call", "type": "f"}, "'id' is a required property"),
        ({"op": "Request", "id": "1", "type": "f", "jsonMessage": {"every": -1}}, "every"),
        ({"op": "Kill", "id": "1", "type": [1] * 200_000}, "too much beside a message"),
        ({"op": "Data", "id": "1", "type": ["1"] * 200_000, "jsonMessage": 1}, "too much beside"),
        ({"op": "List", "id": "1", **{f"x-{index}": 1 for index in range(100)}}, "64 fields"),
        ({"op": "Resume", "id": "1", "jsonMessage": {"waiting": [1] * 5000}}, "waiting"),
    ],
)
def test_an_error_names_the_field(message: dict[str, Any], said: str) -> None:
    with pytest.raises(ControlMessageError, match=said):
        check_asked(message)


@pytest.mark.parametrize("identity", [None, 5, "", "x" * 129, ["1"]])
def test_only_an_id_that_can_be_sent_back_is_salvaged(identity: object) -> None:
    assert salvage_id({"id": identity}) is None
    assert salvage_id({"id": "7", "op": 5}) == "7"


@pytest.mark.parametrize("frame", ["", "{", "42", "[]", "null", "{{{", "NaN", b"{}", '{"a":1}x'])
def test_text_that_is_no_object_is_refused(frame: str | bytes) -> None:
    with pytest.raises(ControlMessageError):
        TEXT_FORM.read(frame, BudgetUse(Budget()))


@pytest.mark.parametrize("frame", ["{}", b"", b"\x01", b"\x80", b"\xff"])
def test_binary_that_is_no_map_is_refused(frame: str | bytes) -> None:
    with pytest.raises(ControlMessageError):
        BINARY_FORM.read(frame, BudgetUse(Budget()))


@pytest.mark.parametrize("frame", ["{" * 5000, "[" * 1_000_000, '{"a":' * 100_000, '"' + "\\" * 99])
def test_deep_nesting_costs_little_and_is_refused(frame: str) -> None:
    started = time.thread_time()
    with pytest.raises(ControlMessageError):
        TEXT_FORM.read(frame, BudgetUse(Budget()))
    assert time.thread_time() - started < 5  # rosbridge needs for ever; this some milliseconds


def test_nesting_is_allowed_up_to_the_limit_and_brackets_in_text_are_none() -> None:
    nested = '{"a":' + "[" * 63 + "]" * 63 + ',"b":"' + "[{" * 100 + '\\""}'
    assert "a" in TEXT_FORM.read(nested, BudgetUse(Budget()))
    with pytest.raises(ControlMessageError, match="64 levels"):
        TEXT_FORM.read(nested.replace("[]", "[[]]"), BudgetUse(Budget()))


@pytest.mark.parametrize("form", FORMS.values(), ids=lambda form: form.name)
def test_data_is_an_ordinary_control_message(form: Form) -> None:
    message = {"a": [1, 2.5], "b": None, "c": "x"}
    written = form.write_data("c1", 7, message)
    read = form.read(written.decode() if form.text else written, BudgetUse(Budget()))
    assert read == {"op": "Data", "type": "c1", "x-number": 7, "jsonMessage": message}
    schema = {**protocol_schema(), "$ref": "#/$defs/server.Data"}
    Draft202012Validator(schema).validate(read)


@pytest.mark.parametrize(
    ("text", "identity"),
    [
        ('{"op":"Call","jsonMessage":[[1]],"id":"12"}', "12"),
        ('{"op":"Call","jsonMessage":[[1] , "id" : "12" } ', "12"),
        ('{"jsonMessage":{"id":"12"}}', None),
        ('{"jsonMessage":"\\"id\\":\\"12"}', None),
        ('{"id":"12","op":"Call"}', None),
        ('{"id":12}', None),
        (f'{{"id":"{"x" * 300}"}}', None),
        ("", None),
    ],
)
def test_the_id_is_found_at_the_end_of_what_cannot_be_read(text: str, identity: str | None) -> None:
    assert TEXT_FORM.last_id(text) == identity
    assert BINARY_FORM.last_id(text) is None
    assert TEXT_FORM.last_id(text.encode()) is None


@pytest.mark.parametrize("identity", ["1", "x" * 24, "\u00e9" * 128, 12, ["1"], {"a": "1"}])
def test_the_id_is_found_at_the_end_of_cbor_that_cannot_be_read(identity: object) -> None:
    frame = BINARY_FORM.write({"op": "Call", "jsonMessage": {"id": "2"}, "id": identity})
    assert BINARY_FORM.last_id(frame) == (identity if isinstance(identity, str) else None)
    assert BINARY_FORM.last_id(frame[:-1]) is None
    assert BINARY_FORM.last_id(BINARY_FORM.write({"id": "2", "op": "Call"})) is None
