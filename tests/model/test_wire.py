"""Model values and control messages to JSON and back."""

from __future__ import annotations

import json

import pytest
from hypothesis import given
from hypothesis import strategies as st

from uoarm.errors import ControlMessageError
from uoarm.model import (
    ControlMessage,
    Op,
    RouteStatus,
    StatusMap,
    from_json,
    read_control,
    to_json,
    write_control,
)

values = st.recursive(
    st.none()
    | st.booleans()
    | st.integers()
    | st.floats(allow_nan=False, allow_infinity=False)
    | st.text(),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(), inner, max_size=3),
    max_leaves=8,
)
controls = st.builds(
    ControlMessage,
    op=st.sampled_from(Op),
    type=st.text() | st.lists(st.text(), min_size=1).map(tuple),
    jsonMessage=values,
    id=st.none() | st.text(),
    extensions=st.dictionaries(st.text().map(lambda one: f"x-{one}"), values, max_size=2),
)


@given(controls)
def test_control_messages_come_back_as_they_went(message: ControlMessage) -> None:
    assert read_control(json.dumps(write_control(message))) == message


def test_the_wire_spells_the_fields_as_they_are_published() -> None:
    message = ControlMessage(Op.REQUEST, "faceRecognition", {"a": 1}, "7")
    expected = {"op": "Request", "type": "faceRecognition", "jsonMessage": {"a": 1}, "id": "7"}
    assert write_control(message) == expected


@pytest.mark.parametrize(
    ("text", "part"),
    [
        ("{", "not JSON"),
        ("42", "expected an object"),
        ("{}", "op: expected one of"),
        ('{"op": "Reqest"}', "did you mean 'Request'"),
        ('{"op": "Kill", "typ": "x"}', "did you mean 'type'"),
        ('{"op": "Kill", "type": 7}', "type: expected a string"),
        ('{"op": "Kill", "id": 7}', "id: expected a string"),
        ('{"op": "Kill", "op": "Kill"}', "given twice"),
        ('{"op": "Data", "jsonMessage": NaN}', "NaN is not JSON"),
        ('{"op": "Data", "jsonMessage": 1e999}', "too large"),
        ('{"op": "Data", "jsonMessage": ' + "[" * 100 + "]" * 100 + "}", "levels deep"),
        ('"' + "x" * 1_048_576 + '"', "are allowed"),
    ],
)
def test_a_bad_control_message_is_one_clear_error(text: str, part: str) -> None:
    with pytest.raises(ControlMessageError, match=part):
        read_control(text)


@given(st.text(max_size=40) | st.binary(max_size=40))
def test_any_text_is_a_control_message_or_a_control_message_error(text: str | bytes) -> None:
    try:
        read_control(text)
    except ControlMessageError as error:
        assert str(error)


def test_a_status_map_comes_back_as_it_went() -> None:
    status = StatusMap(routes=(RouteStatus("a.x", "b.y", 3, 2, (("queue-full", 1),), rate=1.5),))
    assert from_json(json.loads(json.dumps(to_json(status))), StatusMap) == status
