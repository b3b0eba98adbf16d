"""Control messages: the wire's spelling, what is kept, and one clear error for what is not."""

from __future__ import annotations

import json
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from uoarm.errors import ControlMessageError
from uoarm.model import ControlMessage, Op, read_control, write_control

TEXT = st.text(st.characters(exclude_categories=["Cs"]), max_size=8)
JSON = st.recursive(
    st.none()
    | st.booleans()
    | st.integers()
    | st.floats(allow_nan=False, allow_infinity=False)
    | TEXT,
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(TEXT, inner, max_size=3),
    max_leaves=10,
)
MESSAGES = st.builds(
    ControlMessage,
    op=st.sampled_from(Op),
    type=TEXT | st.lists(TEXT, max_size=4).map(tuple),
    jsonMessage=JSON,
    id=st.none() | TEXT,
    extensions=st.dictionaries(TEXT.map("x-".__add__), JSON, max_size=2),
)


@given(MESSAGES)
def test_a_message_comes_back_from_its_text(message: ControlMessage) -> None:
    wire = write_control(message)
    assert read_control(json.dumps(wire)) == message
    assert read_control(json.dumps(wire, ensure_ascii=False).encode()) == message
    assert read_control(wire) == message
    back = read_control(json.dumps(wire))
    assert (back.jsonMessage, back.extensions) == (message.jsonMessage, message.extensions)


def test_the_paper_s_message_is_spelt_as_in_the_paper() -> None:
    wire = write_control(ControlMessage(Op.REQUEST, "faceRecognition", {"a": 1}, "7"))
    assert wire == {
        "op": "Request",
        "type": "faceRecognition",
        "jsonMessage": {"a": 1},
        "id": "7",
    }


def test_a_list_of_strings_is_a_tuple_in_the_model() -> None:
    text = '{"op": "Request", "type": ["/image", "Image"]}'
    message = read_control(text)
    assert message.type == ("/image", "Image")
    assert json.loads(text) == write_control(message)


def test_extensions_are_kept() -> None:
    wire = {"op": "Kill", "x-trace": [1], "x-": None}
    message = read_control(json.dumps(wire))
    assert message.extensions == {"x-trace": [1], "x-": None}
    assert write_control(message) == wire


def test_an_extension_cannot_take_the_place_of_a_field() -> None:
    with pytest.raises(ControlMessageError, match="begin with x-, got 'op'"):
        write_control(ControlMessage(Op.KILL, extensions={"op": "Request"}))


BAD: dict[str, tuple[Any, str]] = {
    "empty": ("", "not JSON"),
    "no object": ("[]", "expected an object, got a list"),
    "number": ("1", "expected an object, got 1"),
    "no op": ("{}", "op is missing"),
    "misspelt op": ('{"op": "request"}', "did you mean 'Request'"),
    "op of another type": ('{"op": ["Kill"]}', "op: expected one of .* got a list"),
    "misspelt field": ('{"op": "Kill", "jsonMesage": 1}', "did you mean 'jsonMessage'"),
    "extension without a dash": ('{"op": "Kill", "xtrace": 1}', "unknown field 'xtrace'"),
    "type is a number": ('{"op": "Kill", "type": 1}', "type: .* got 1"),
    "type is null": ('{"op": "Kill", "type": null}', "type: .* got None"),
    "type of numbers": ('{"op": "Kill", "type": ["a", 1]}', "type: expected a string or a list"),
    "id is a number": ('{"op": "Kill", "id": 7}', "id: expected a string, got 7"),
    "field twice": ('{"op": "Kill", "op": "Kill"}', "'op' is given twice"),
    "field twice, deep": ('{"op": "Data", "jsonMessage": [{"a": 1, "a": 2}]}', "'a' is given"),
    "nan": ('{"op": "Data", "jsonMessage": [NaN]}', "NaN is not a number"),
    "infinity": ('{"op": "Data", "jsonMessage": -Infinity}', "-Infinity is not a number"),
    "overflow": ('{"op": "Data", "jsonMessage": [{"a": 1e999}]}', "inf is not a number"),
    "long number": ('{"op": "Data", "jsonMessage": ' + "9" * 5000 + "}", "5,000 digits"),
    "surrogate": ('{"op": "Data", "jsonMessage": "\\ud800"}', "surrogate pair"),
    "surrogate in a name": ('{"op": "Data", "jsonMessage": {"\\udfff": 1}}', "surrogate pair"),
    "not UTF-8": (b'{"op": "Kill", "id": "\xff"}', "not UTF-8: byte 23"),
    "UTF-16": ('{"op": "Kill"}'.encode("utf-16"), "not UTF-8"),
    "after the end": ('{"op": "Kill"} x', "Extra data in line 1, column 16"),
    "deep": ("[" * 100_000, "more than 64 levels"),
    "deep in text": ('"' + "[" * 100 + '" ' + "[" * 65, "more than 64 levels"),
    "open string": ('"' + '\\"' * 300_000, "not JSON"),
    "large": ("x" * 1_048_577, "it has 1,048,577 bytes; 1,048,576 are allowed"),
    "large in UTF-8": ("\u00e9" * 524_289, "it has 1,048,578 bytes"),
    "mapping with nan": ({"op": "Data", "jsonMessage": float("nan")}, "nan is not a number"),
    "mapping with a number as name": ({"op": "Data", 1: 2}, "expected names to be strings"),
}


@pytest.mark.parametrize(("data", "says"), BAD.values(), ids=BAD.keys())
def test_what_cannot_be_read_gives_one_short_clear_error(data: Any, says: str) -> None:
    with pytest.raises(ControlMessageError, match=says) as caught:
        read_control(data)
    assert len(str(caught.value)) < 300


def test_brackets_within_strings_are_not_depth() -> None:
    message = read_control(json.dumps({"op": "Data", "jsonMessage": '\\"[' * 100}))
    assert message.jsonMessage == '\\"[' * 100


def test_sixty_four_levels_are_read() -> None:
    text = '{"op": "Data", "jsonMessage": ' + "[" * 63 + "]" * 63 + "}"
    assert read_control(text).op is Op.DATA


def test_a_mapping_that_holds_itself_is_refused() -> None:
    endless: list[Any] = []
    endless.append(endless)
    with pytest.raises(ControlMessageError, match="64 levels"):
        read_control({"op": "Data", "jsonMessage": endless})


def test_a_mapping_that_shares_without_end_is_refused() -> None:
    value: Any = [1]
    for _ in range(60):
        value = [value, value]
    with pytest.raises(ControlMessageError, match="more than 1,000,000 values"):
        read_control({"op": "Data", "jsonMessage": value})


def test_the_size_limit_can_be_chosen() -> None:
    with pytest.raises(ControlMessageError, match="10 are allowed"):
        read_control('{"op": "Kill"}', max_bytes=10)
    assert read_control('{"op": "Kill"}', max_bytes=14).op is Op.KILL


@given(st.binary(max_size=100) | st.text(max_size=100) | JSON.map(json.dumps))
def test_anything_is_read_or_refused(data: bytes | str) -> None:
    try:
        message = read_control(data)
    except ControlMessageError:
        return
    assert isinstance(message, ControlMessage)
