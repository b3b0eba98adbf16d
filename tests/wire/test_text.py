"""Messages as JSON text and back: nothing loses digits, octets are base64."""

from __future__ import annotations

import base64
import json
import math
import tracemalloc
from array import array
from collections.abc import Callable
from dataclasses import dataclass
from datetime import date, datetime, time, timezone
from enum import Enum
from functools import partial
from typing import Any
from uuid import UUID

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from jsonschema import Draft202012Validator
from tests.hostile import misbehaviour
from tests.structures import Quits, closed

from uoarm._wire import LARGEST, TEXT_FORM, read_binary, write_binary
from uoarm._wire._text import read_text, write_text
from uoarm._wire._text_schema import make_reader, text_schema, viewer_schema
from uoarm.errors import ControlMessageError, MessageError
from uoarm.local import Range
from uoarm.model import Budget, BudgetUse
from uoarm.testing import Background

OCTETS = {
    "type": "array",
    "items": {"type": "integer", "minimum": 0, "maximum": 255},
    "x-octets": True,
}
EVERYTHING: dict[str, Any] = {
    "type": "object",
    "properties": {
        "data": OCTETS,
        "wide": {"type": "integer"},
        "small": {"type": "integer", "minimum": 0, "maximum": 255},
        "angle": {"type": "number", "x-nonfinite": True},
        "name": {"type": "string"},
        "list": {"type": "array", "items": {"$ref": "#/$defs/angle"}},
    },
    "$defs": {"angle": {"type": "number", "x-nonfinite": True}},
}
messages = st.fixed_dictionaries(
    {},
    optional={
        "data": st.binary(max_size=50),
        "wide": st.integers(-(2**70), 2**70),
        "small": st.integers(0, 255),
        "angle": st.floats(),
        "name": st.text(max_size=20) | st.sampled_from(["NaN", "null", "12"]),
        "list": st.lists(st.floats(), max_size=5),
    },
)


# What orjson and Python's reader of JSON disagree on, or nearly so.
numbers = (
    st.integers(-(2**70), 2**70)
    | st.integers(2**63 - 3, 2**64 + 3)
    | st.integers(-(2**63) - 3, -(2**63) + 3)
    | st.floats(allow_nan=False, allow_infinity=False)
    | st.sampled_from([0.00012345678901234567, 1e-300, -(10**18), 10**19, 10**300, 2**64 - 1])
)
anything = st.recursive(
    st.none() | st.booleans() | numbers | st.text(max_size=5) | st.sampled_from([":", '":{', "\\"]),
    lambda inner: (
        st.lists(inner, max_size=4)
        | st.dictionaries(
            st.text(max_size=3) | st.sampled_from([":", '"', "\\"]), inner, max_size=4
        )
    ),
    max_leaves=12,
)


@given(anything, st.booleans())
def test_json_is_read_exactly(value: object, spaced: bool) -> None:
    text = json.dumps(value, ensure_ascii=False, separators=(" , ", " : ") if spaced else None)
    read = read_text(text, BudgetUse(Budget()))
    assert repr(read) == repr(json.loads(text))


@given(anything, st.text(max_size=3), st.booleans())
def test_a_name_that_is_given_twice_is_refused(value: object, name: str, deep: bool) -> None:
    inner, key = json.dumps(value), json.dumps(name)
    text = f'{{{key}: {inner}, "other : ": ":", {key} :{inner}}}'
    text = f'[1, {{"a": [{text}]}}]' if deep else text
    with pytest.raises(ControlMessageError, match="is given twice in one object"):
        read_text(text, BudgetUse(Budget()))


@pytest.mark.parametrize(
    ("text", "why"),
    [
        ("1e400", "infinity|beyond"),
        (f"[{2**64}, 1e400]", "beyond what a number of 64 bits"),
        (f"[{2**64}, NaN]", "NaN is no number"),
        ("NaN", "not JSON"),
        (r'"\ud800"', "surrogate"),
        (rf'[{2**64}, "\ud800"]', "surrogate"),
        (f"{10**1000}", "1,001 digits|infinity"),
    ],
)
def test_what_no_form_has_is_refused_beside_a_wide_number_too(text: str, why: str) -> None:
    with pytest.raises(ControlMessageError, match=why):
        read_text(text, BudgetUse(Budget()))


@pytest.mark.parametrize("kind", [SystemExit, RuntimeError])
def test_what_raises_as_it_is_written_is_refused(kind: type[BaseException]) -> None:
    writes = Background(lambda: write_text({"x": math.nan, "y": Quits(kind)}))
    with pytest.raises(MessageError, match=kind.__name__):
        writes.result()


def same(left: object, right: object) -> bool:
    if isinstance(left, float) and isinstance(right, float) and math.isnan(left):
        return math.isnan(right)
    if isinstance(left, dict) and isinstance(right, dict):
        return left.keys() == right.keys() and all(same(left[key], right[key]) for key in left)
    if isinstance(left, list) and isinstance(right, list):
        return len(left) == len(right) and all(map(same, left, right))
    return left == right


@given(messages)
def test_what_is_written_is_read_back_exactly(message: dict[str, Any]) -> None:
    reader = make_reader(EVERYTHING)
    assert reader is not None
    parsed = json.loads(write_text(message))
    assert same(reader(parsed), message)
    Draft202012Validator(text_schema(EVERYTHING)).validate(parsed)


@pytest.mark.parametrize(
    ("value", "text"),
    [
        (float("nan"), '"NaN"'),
        ([1.5, float("-inf"), None], '[1.5,"-Infinity",null]'),
        (2**53, '"9007199254740992"'),
        (2**53 - 1, "9007199254740991"),
        (b"\x00\xff", '"AP8="'),
        (memoryview(b"\x00\xff"), '"AP8="'),
        (memoryview(b"\x00?\xff?")[::2], '"AP8="'),
        (np.array([0, 9, 255, 9], dtype=np.uint8)[::2], '"AP8="'),
        ({"a\0": b"\x00", "b": "\0", "c": b""}, '{"a\\u0000":"AA==","b":"\\u0000","c":""}'),
        (array("d", [1.0, float("nan")]), '[1.0,"NaN"]'),
        (np.array([1.0, float("inf")]), '[1.0,"Infinity"]'),
        (np.array([2**60, 1]), '["1152921504606846976",1]'),
        (np.array([[1, 2], [3, 4]], dtype=">i4"), "[[1,2],[3,4]]"),
        (np.array([1, 2], dtype=np.uint8), '"AQI="'),
        (np.float32(0.5), "0.5"),
        (("a", True), '["a",true]'),
    ],
)
def test_values_without_an_exact_json_number_are_strings(value: object, text: str) -> None:
    assert write_text(value) == text.encode()


class Kind(Enum):
    A = "a"


@dataclass
class Point:
    x: int


@pytest.mark.parametrize(
    ("value", "text"),
    [
        (datetime(2026, 1, 2, 3, tzinfo=timezone.utc), "2026-01-02T03:00:00+00:00"),
        (datetime(2026, 1, 2, 3), "2026-01-02T03:00:00"),  # noqa: DTZ001 - without one
        (date(2026, 1, 2), "2026-01-02"),
        (time(3, 4), "03:04:00"),
        (UUID(int=1), "00000000-0000-0000-0000-000000000001"),
        (np.array(["2026-01-02"], "M8[ns]"), ["2026-01-02T00:00:00"]),
        (Kind.A, "a"),
        (Point(1), {"x": 1}),
    ],
)
@pytest.mark.parametrize("beside", ["", b"a" * 5_000], ids=["small", "large"])
def test_both_forms_have_the_same_of_what_messages_are_not_made_of(
    value: object, text: object, beside: object
) -> None:
    message = {"value": {"value": value}, "beside": beside}
    assert json.loads(write_text(message))["value"] == {"value": text}
    assert read_binary(write_binary(message), BudgetUse(Budget()))["value"] == {"value": text}


@pytest.mark.parametrize(
    ("make", "why"),
    [
        (lambda: list(range(2_000_000)), "values"),  # made as it is needed, not by each worker
        (lambda: [{"a": 1}] * 700_000, "values"),
        (lambda: np.zeros((2_000_000, 2), np.uint8), "values"),
        (lambda: bytes(LARGEST.octets // 4 * 3), "bytes"),
    ],
    ids=["numbers", "objects", "array", "octets"],
)
def test_what_is_too_much_for_a_client_is_not_written(make: Callable[[], object], why: str) -> None:
    value = make()
    for write in (TEXT_FORM.write, partial(TEXT_FORM.write_data, "c1", 1)):
        with pytest.raises(MessageError, match=why):
            write({"value": value})
    assert write_text({"value": value})  # into a file


def test_what_a_client_takes_is_written() -> None:
    for value in (list(range(1_900_000)), ",:[" * 1_000_000, bytes(9_000_000)):
        text = TEXT_FORM.write_data("c1", 1, {"value": value}).decode()
        assert TEXT_FORM.read(text, BudgetUse(LARGEST))


def test_what_has_no_json_form_is_refused_by_name() -> None:
    with pytest.raises(MessageError, match="Range"):
        write_text({"x": Range(1, 2)})


@pytest.mark.parametrize(
    ("message", "said"),
    [
        ({"data": "no base64!"}, r"\$\.data: expected octets .*: character 3 is ' ', expected A-Z"),
        ({"data": "YQ-_"}, r"\$\.data: expected octets .*: character 3 is '-'"),
        ({"data": "YWFhY"}, r"\$\.data: expected octets .*: 5 characters make no whole number"),
        ({"data": "YQ="}, r"\$\.data: expected octets .*: 3 characters make no whole number"),
        ({"wide": "1e5"}, r"\$\.wide: expected an integer"),
        ({"wide": 1.8446744073709552e19}, r"\$\.wide: .* lost digits"),
        ({"list": [1, "nan"]}, r"\$\.list\[1\]: expected a number"),
    ],
)
def test_text_that_its_place_cannot_carry_is_refused_with_the_path(
    message: object, said: str
) -> None:
    reader = make_reader(EVERYTHING)
    assert reader is not None
    with pytest.raises(MessageError, match=said):
        reader(message)


@pytest.mark.parametrize("octets", [b"", b"a", b"ab", b"abc", b"abcd", bytes(range(256))])
def test_base64_without_its_padding_is_read(octets: bytes) -> None:
    reader = make_reader(EVERYTHING)
    assert reader is not None
    text = base64.b64encode(octets).decode().rstrip("=")
    assert reader({"data": text}) == {"data": octets}


def test_a_structure_of_strings_needs_no_reader() -> None:
    assert make_reader({"type": "object", "properties": {"text": {"type": "string"}}}) is None


NUMBER = {"type": "number", "x-nonfinite": True}


def test_viewers_get_each_field_that_has_one_type() -> None:
    given = {
        **EVERYTHING["properties"],
        "perhaps": {"anyOf": [NUMBER, {"type": "null"}]},
        "kind": {"enum": ["a", "b"]},
        "places": {"type": "array", "items": closed(x=NUMBER, odd={"const": 1})},
        "either": {"anyOf": [NUMBER, {"type": "string"}]},
        "pair": {"type": "array", "prefixItems": [NUMBER, {"type": "string"}], "items": False},
        "rows": {"type": "array", "items": {"type": "array", "items": NUMBER}},
        "blobs": {"type": "array", "items": OCTETS},
        "all": True,
        "by_name": {"type": "object", "additionalProperties": NUMBER},
    }
    number, text = {"type": "number"}, {"type": "string"}
    assert json.loads(viewer_schema(closed(**given)))["properties"] == {
        "data": {"type": "string", "contentEncoding": "base64"},
        "wide": {"type": "integer"},
        "small": {"type": "integer"},
        "angle": number,
        "name": text,
        "perhaps": number,
        "kind": text,
        "places": {"type": "array", "items": {"type": "object", "properties": {"x": number}}},
        "by_name": {"type": "object", "properties": {}},
    }


def test_viewers_get_what_references_lead_to() -> None:
    place, node = {"$ref": "#/$defs/place"}, {"$ref": "#/$defs/node"}
    definitions = {
        "place": closed(x=NUMBER),
        "node": closed(at=place, inner=node, nodes={"type": "array", "items": {"$ref": "#"}}),
    }
    other = {"$id": "other", "$ref": "#/$defs/place", "$defs": {"place": {"type": "string"}}}
    whole = closed(first=place, tree=node, other=other, lost={"$ref": "#/no"})
    schema = {"$ref": "#/$defs/whole", "$defs": {"whole": whole, **definitions}}
    shown = {"type": "object", "properties": {"x": {"type": "number"}}}
    assert json.loads(viewer_schema(schema))["properties"] == {
        "first": shown,
        "tree": {"type": "object", "properties": {"at": shown}},
        "other": {"type": "string"},
    }


def test_viewers_get_no_more_of_many_references_than_they_can_read() -> None:
    names = [f"#/$defs/{number}" for number in range(60)]
    doubled = {
        str(number): closed(a={"$ref": name}, b={"$ref": name})
        for number, name in enumerate(names[1:])
    }
    schema = {"$ref": names[0], "$defs": {**doubled, "59": closed(x=NUMBER)}}
    assert len(viewer_schema(schema)) < 1_000_000


@pytest.mark.parametrize("schema", [True, NUMBER, OCTETS, {"type": "array", "items": NUMBER}, {}])
def test_viewers_get_no_schema_where_messages_are_no_objects(schema: Any) -> None:
    assert viewer_schema(schema) == ""


def test_a_recursive_structure_has_an_end() -> None:
    branches = {"left": {"$ref": "#"}, "next": {"$ref": "#"}, "right": {"$ref": "#"}}
    tree = {"type": "object", "properties": {**branches, "data": OCTETS}}
    reader = make_reader(tree)
    assert reader is not None
    data = base64.b64encode(b"x").decode()
    assert reader({"next": {"data": data}}) == {"next": {"data": b"x"}}


@pytest.mark.parametrize(
    "rest",
    [
        {"items": {"$ref": "#/$defs/a%20b"}, "$defs": {"a b": OCTETS}},
        {"items": {"$ref": "#/prefixItems/0"}, "prefixItems": [OCTETS]},
        {"items": {"$ref": "#data"}, "$defs": {"a": {**OCTETS, "$anchor": "data"}}},
        {"items": {"$ref": "http://here/a#/$defs/a"}, "$defs": {"a": OCTETS}},
        {"items": {"$id": "http://here/b", "$ref": "#/$defs/a", "$defs": {"a": OCTETS}}},
    ],
)
def test_octets_are_read_wherever_a_reference_leads_to(rest: dict[str, Any]) -> None:
    reader = make_reader({"$id": "http://here/a", "type": "array", **rest})
    assert reader is not None
    assert reader(["YQ==", "YQ=="]) == [b"a", b"a"]


def test_a_long_name_in_a_path_is_shown_in_short() -> None:
    reader = make_reader({"additionalProperties": {"additionalProperties": {"type": "integer"}}})
    assert reader is not None
    with pytest.raises(MessageError, match="expected an integer") as caught:
        reader({"x" * 1_000_000: {"y" * 1_000_000: "z" * 1_000_000}})
    assert len(str(caught.value)) < 400


def test_reading_makes_no_path_for_what_is_right() -> None:
    """A path for each value under a long name cost as much as the name, each time."""
    reader = make_reader({"additionalProperties": {"items": {"type": "integer"}}})
    assert reader is not None
    name = "x" * 5_000_000
    tracemalloc.start()
    try:
        reader({name: [1] * 10})
        assert tracemalloc.get_traced_memory()[1] < 1_000_000
    finally:
        tracemalloc.stop()


@pytest.mark.parametrize(
    "schema",
    [
        {"$ref": "#/$defs/a", "properties": {"own": OCTETS}},
        {"allOf": [{"properties": {"own": OCTETS}}, {"$ref": "#/$defs/a"}]},
        {"anyOf": [{"$ref": "#/$defs/a"}, {"type": "null"}], "properties": {"own": OCTETS}},
        {"$ref": "#/$defs/turning", "properties": {"own": OCTETS}},
    ],
)
def test_what_stands_beside_a_reference_or_a_choice_is_read_too(schema: dict[str, Any]) -> None:
    other: dict[str, Any] = {"properties": {"other": OCTETS}}
    turning = {"$ref": "#/$defs/turning", **other}
    reader = make_reader({**schema, "$defs": {"a": other, "turning": turning}})
    assert reader is not None
    assert reader({"own": "AQ==", "other": "Ag=="}) == {"own": b"\x01", "other": b"\x02"}


def tagged(kind: str, **fields: Any) -> dict[str, Any]:
    return closed(kind={"const": kind}, **fields)


TEXT: dict[str, Any] = {"type": "string"}
WIDE: dict[str, Any] = {"type": "integer"}
CHOICES: list[tuple[dict[str, Any], list[Any]]] = [
    (
        {"anyOf": [tagged("a", x=OCTETS), tagged("b", y=OCTETS), tagged("c", x=TEXT), TEXT]},
        [
            {"kind": "a", "x": b"abc"},
            {"kind": "b", "y": b"abc"},
            {"kind": "c", "x": "auto"},
            "auto",
        ],
    ),
    (
        {"oneOf": [{"$ref": "#/$defs/a"}, {"allOf": [{"$ref": "#/$defs/b"}]}],
         "$defs": {"a": closed(x=OCTETS), "b": closed(x=OCTETS, y=WIDE)}},
        [{"x": b"abc"}, {"x": b"abc", "y": 2**60}],
    ),
    ({"anyOf": [WIDE, NUMBER]}, [2**60, 1e300, math.inf, 2.0**53, 0.5]),
    ({"anyOf": [WIDE, OCTETS]}, [b"", b"auto", 2**60, 7]),
    ({"anyOf": [OCTETS, {"enum": ["auto"]}, {"type": "array", "items": TEXT}]},
     [b"abc", "auto", ["auto"]]),
    ({"anyOf": [{"type": "array", "items": OCTETS}, {"items": tagged("a", x=WIDE)}]},
     [[b"a"], [{"kind": "a", "x": 2**60}]]),
    ({"type": ["integer", "null"]}, [2**60, -5, None]),
    ({**NUMBER, "type": ["number", "array"], "items": WIDE}, [math.inf, 0.5, [2**60]]),
    ({"enum": [2**60, -(2**60), "12", None, 10**5000]}, [2**60, -(2**60), "12", None]),
    ({"anyOf": [{"const": 2**60}, OCTETS]}, [2**60, b"ab"]),
]  # fmt: skip


@pytest.mark.parametrize(("schema", "values"), CHOICES)
def test_a_choice_is_read_as_what_was_written(schema: Any, values: list[Any]) -> None:
    reader = make_reader(closed(v=schema) | {"$defs": schema.get("$defs", {})})
    assert reader is not None
    for value in values:
        parsed = json.loads(write_text({"v": value}))
        assert same(reader(parsed), {"v": value})
        if schema.get("enum", [])[-1:] != [10**5000]:
            Draft202012Validator(text_schema(schema)).validate(parsed["v"])


def test_a_choice_whose_references_go_in_a_circle_has_an_end() -> None:
    around = {"anyOf": [{"$ref": "#/$defs/a"}, {"$ref": "#/$defs/b"}, OCTETS], "required": ["c"]}
    reader = make_reader({**around, "$defs": {"a": around, "b": around}})
    assert reader is not None
    assert reader({"a": 1}) == {"a": 1}


@pytest.mark.parametrize("write", [write_text, write_binary])
def test_what_a_value_does_itself_is_a_refusal(write: Any) -> None:
    assert not misbehaviour(write)
    assert not misbehaviour(lambda value: write({"x": [value], "y": value}))


def test_arrays_that_repeat_are_bounded_together() -> None:
    mask = np.broadcast_to(np.uint8(0), (2**27,))
    with pytest.raises(MessageError, match="13,421,772,800 bytes; 268,400,000 are"):
        write_binary({f"x{number}": mask for number in range(100)})
