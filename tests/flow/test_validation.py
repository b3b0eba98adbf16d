"""Live messages against their structure: octets and numeric buffers count as arrays."""

from __future__ import annotations

import json
import math
import re
import time
from array import array
from collections import UserDict
from collections.abc import Callable
from decimal import Decimal
from fractions import Fraction
from functools import partial
from typing import Any

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st
from jsonschema import Draft202012Validator
from tests.calls import calls_of
from tests.structures import Quits

from uoarm._dataplane import Route, make_check
from uoarm.bridge._compiled_check import judged
from uoarm.bridge._full_validator import _key
from uoarm.errors import MessageError
from uoarm.model import Message, MessageStructure, ValidationMode
from uoarm.schema import check as verdict_of
from uoarm.testing import Background

OCTETS = {"type": "array", "items": {"type": "integer", "minimum": 0, "maximum": 255}}
IMAGE = MessageStructure(
    {
        "type": "object",
        "properties": {
            "width": {"type": "integer", "minimum": 0},
            "data": OCTETS | {"maxItems": 1000},
            "ranges": {"type": "array", "items": {"type": "number", "minimum": 0}},
        },
        "required": ["width", "data"],
        "additionalProperties": False,
    }
)


def check(message: Message) -> None:
    checker = make_check(IMAGE, ValidationMode.ALWAYS, "camera.default")
    assert checker is not None
    checker(message)


@pytest.mark.parametrize(
    "data", [b"", b"\x00\xff", bytearray(b"ab"), memoryview(b"ab"), [0, 255], array("B", [1])]
)
def test_every_form_of_octets_is_an_array(data: object) -> None:
    check({"width": 1, "data": data})


@pytest.mark.parametrize(
    ("schema", "message"),
    [
        ({"enum": [1, "a"]}, np.zeros((2, 2))),
        ({"const": [0, 1]}, np.zeros(2)),
        (False, memoryview(b"abcd").cast("B", (2, 2))),
        ({"enum": [1, "a"]}, {b"a": 1}),
    ],
)
def test_a_value_that_is_none_of_json_is_refused_as_a_message(schema: Any, message: Any) -> None:
    checker = make_check(MessageStructure(schema), ValidationMode.ALWAYS, "camera.default")
    assert checker is not None
    with pytest.raises(MessageError, match=r"camera\.default: "):
        checker(message)


@pytest.mark.parametrize("kind", [SystemExit, KeyboardInterrupt, ValueError])
@pytest.mark.parametrize("schema", [IMAGE.schema, {"type": "integer"}, {"minProperties": 1}])
def test_a_value_that_raises_as_it_is_checked_is_refused_as_a_message(
    kind: type[BaseException], schema: Any
) -> None:
    checker = make_check(MessageStructure(schema), ValidationMode.ALWAYS, "camera.default")
    assert checker is not None
    checks = Background(lambda: checker(Quits(kind)))
    with pytest.raises(MessageError, match=r"camera\.default: "):
        checks.result()


@pytest.mark.parametrize(
    "schema",
    [{"const": [0, 0]}, {"anyOf": [{"enum": [7]}, {"type": "array", "items": {"type": "number"}}]}],
)
def test_a_numeric_buffer_is_compared_as_an_array_is(schema: Any) -> None:
    checker = make_check(MessageStructure(schema), ValidationMode.ALWAYS, "here")
    assert checker is not None
    checker(np.zeros(2))


@pytest.mark.parametrize("ranges", [np.array([0.0, 2.5]), array("d", [0.5]), [1, 2.5], np.empty(0)])
def test_numeric_buffers_are_arrays(ranges: object) -> None:
    check({"width": 1, "data": b"", "ranges": ranges})


@pytest.mark.parametrize(
    ("message", "path"),
    [
        ({"width": -1, "data": b""}, "width"),
        ({"width": 1, "data": "text"}, "data"),
        ({"width": 1, "data": [256]}, r"data\.0"),
        ({"width": 1, "data": array("i", [7, -1])}, "data"),
        ({"width": 1, "data": b"x" * 1001}, "data"),
        ({"width": 1, "data": b"", "ranges": np.array([1.0, -0.5])}, "ranges"),
        ({"data": b""}, "the message"),
        ({"width": 1, "data": b"", "more": 1}, "more"),
        ("text", "the message"),
    ],
)
def test_a_mismatch_names_port_and_field(message: Message, path: str) -> None:
    with pytest.raises(MessageError, match=rf"camera\.default: {path}"):
        check(message)


HALVES = {
    "type": "object",
    "properties": {
        "plain": {"type": "string"},
        "bounded": {"type": "string", "minLength": 1, "maxLength": 9},
        "counted": {"type": "string", "x-max-utf8": 9},
        "perhaps": {"type": ["string", "null"]},
        "either": {"anyOf": [{"type": "string"}, {"type": "integer"}]},
        "several": {"type": "array", "items": {"type": "string"}},
        "named": {"type": "object", "additionalProperties": {"type": "integer"}},
        "matched": {"type": "object", "patternProperties": {"^a": {"type": "integer"}}},
    },
    "additionalProperties": False,
}


@pytest.mark.parametrize(
    ("message", "place"),
    [
        ({"plain": "é\ud800"}, "plain"),
        ({"bounded": "\udfff"}, "bounded"),
        ({"counted": "\udc00"}, "counted"),
        ({"perhaps": "\ud800"}, "perhaps"),
        ({"either": "\ud800"}, "either"),
        ({"several": ["a", "\ud800"]}, "several.1"),
        ({"named": {"\ud800": 1}}, "named.\\ud800"),
        ({"matched": {"a\ud800": 1}}, "matched.a\\ud800"),
    ],
)
def test_half_of_a_surrogate_pair_fits_no_text(message: Message, place: str) -> None:
    checker = make_check(MessageStructure(HALVES), ValidationMode.ALWAYS, "camera.default")
    assert checker is not None
    with pytest.raises(MessageError) as caught:
        checker(message)
    text = str(caught.value)
    assert text.startswith(f"camera.default: {place}: ")
    assert "without half of a surrogate pair" in text
    assert text.encode()
    pair = json.loads(json.dumps(message).replace("\\ud800", "\\ud83d\\ude00"))
    if pair != message:
        checker(pair)


@pytest.mark.parametrize(
    ("message", "text"),
    [
        ({"width": -(10**5000), "data": b""}, "width: expected at least 0, got a whole number of "),
        ({"width": "w" * 10**6, "data": b""}, 'width: expected a whole number, got "wwww'),
        ({"width": [0] * 10**6, "data": b""}, "width: expected a whole number, got [0, 0, 0"),
        ({"width": 1, "data": np.ones((4, 3))}, "data.0: expected a whole number, got an array of"),
        ({"width": b"12", "data": b""}, "width: expected a whole number, got 2 octets"),
        ({"width": None, "data": b""}, "width: expected a whole number, got nothing"),
        ({"width": 1, "data": b"x" * 1001}, "data: expected at most 1000 entries, got 1001"),
        ({"width": 1, "daat": b"", "data": b""}, 'daat: unknown field (did you mean "data"?)'),
    ],
)
def test_what_was_expected_and_what_came_is_said_in_few_words(message: Message, text: str) -> None:
    with pytest.raises(MessageError, match=re.escape(text)) as caught:
        check(message)
    assert len(str(caught.value)) < 150


NAMED = {"type": "object", "additionalProperties": {"type": "integer"}}
NUMBERS = {"type": "array", "items": {"type": "number", "minimum": 0}}


@pytest.mark.parametrize(
    ("schema", "message", "text"),
    [
        (NAMED, {1: 2}, "1: expected a name that is text, got 1"),
        (NAMED, {b"a": 2}, "b'a': expected a name that is text, got 1 octets"),
        ({"patternProperties": {"a": {}}}, {None: 2}, "None: expected a name that is text, got "),
        (IMAGE.schema, {"width": 1, "data": b"", 5: 2}, "5: expected a name that is text, got 5"),
        (NAMED, UserDict(a=1), "expected a mapping, got {'a': 1} of the class UserDict"),
        (NUMBERS, {1}, "expected a list, got {1} of the class set"),
        ({"type": "number"}, 1j, "expected a number, got 1j of the class complex"),
        ({"type": "number", "minimum": 0}, Decimal("NaN"), "a number, got Decimal('NaN')"),
        ({"type": "number"}, Fraction(1, 2), "expected a number, got Fraction(1, 2)"),
        (NUMBERS, np.array([1j]), "expected a number, got 1j"),
        (NUMBERS, np.array(["a"]), 'expected a number, got "a"'),
        (NUMBERS, np.array([1, "a"], object), '1: expected a number, got "a"'),
        (NUMBERS, np.array([True]), "expected a number, got true"),
        (NUMBERS, np.array([(1, 2.0)], "i4,f8"), "expected a number, got (1, 2.0)"),
        (NUMBERS, np.array(["2020"], "M8[Y]"), "a number, got datetime.date(2020, 1, 1)"),
        (NUMBERS, memoryview(b"abcd").cast("B", (2, 2)), "a list, got octets in 2 dimensions"),
        (
            NUMBERS,
            np.ma.array([1, 99], mask=[False, True]),
            "a list, got an array of 2 int64 with masked",
        ),
        ({"const": [1]}, np.ma.array([1], mask=True), "got an array of 1 int64 with masked items"),
        ({"type": "string"}, memoryview(b"ab"), "expected text, got 2 octets"),
        ({"enum": []}, 1, "expected nothing, got 1"),
        ({"enum": [1, "a"]}, {1}, "expected 1 or a, got {1} of the class set"),
    ],
)
def test_what_only_looks_like_a_value_of_json_is_refused_in_words(
    schema: Any, message: Any, text: str
) -> None:
    checker = make_check(MessageStructure(schema), ValidationMode.ALWAYS, "camera.default")
    assert checker is not None
    with pytest.raises(MessageError, match=re.escape(text)):
        checker(message)


@pytest.mark.parametrize(
    "message",
    [
        np.ma.array([1, 2]),
        np.arange(6)[::2],
        np.array([1, 2], ">i4"),
        np.ones(2, "e"),
        np.ones(2, "g"),
        [0],
    ],
)
def test_numbers_of_every_layout_and_size_are_numbers(message: Any) -> None:
    checker = make_check(MessageStructure(NUMBERS), ValidationMode.ALWAYS, "camera.default")
    assert checker is not None
    checker(message)
    checker([message[0]])


def test_every_missing_field_is_named() -> None:
    with pytest.raises(MessageError, match="the fields 'width' and 'data' are missing"):
        check({})
    with pytest.raises(MessageError, match="the field 'data' is missing"):
        check({"width": 1})


@pytest.mark.parametrize(
    ("message", "mistakes"),
    [
        (
            {"width": -1, "dta": b""},
            [
                "width: expected at least 0, got -1",
                "the message: the field 'data' is missing",
                'dta: unknown field (did you mean "data"?)',
            ],
        ),
        (
            {"width": 1, "data": [256, "a", 300, 300]},
            [
                "data.0: expected at most 255, got 256",
                'data.1: expected a whole number, got "a"',
                "data.2: expected at most 255, got 300",
            ],
        ),
        ({"width": 1, "data": [-1] * 1000}, ["data.0: expected at least 0, got -1"]),
    ],
)
def test_all_mistakes_are_said_at_once(message: Message, mistakes: list[str]) -> None:
    with pytest.raises(MessageError) as caught:
        check(message)
    said = str(caught.value).removeprefix("camera.default: ").split("; ")
    assert sorted(said) == sorted(mistakes)


def test_where_a_field_is_missing_those_that_nothing_says_anything_of_are_named() -> None:
    structure = MessageStructure(
        {"type": "object", "properties": {"data": {"type": "boolean"}}, "required": ["data"]}
    )
    checker = make_check(structure, ValidationMode.ALWAYS, "light")
    assert checker is not None
    with pytest.raises(MessageError) as caught:
        checker({"dta": True, "who": "me"})
    assert str(caught.value) == (
        "light: the message: the field 'data' is missing; "
        'the field "dta" is unknown (did you mean "data"?); the field "who" is unknown'
    )
    checker({"data": True, "who": "me"})


def test_a_message_with_a_thousand_mistakes_is_refused_in_few_words() -> None:
    with pytest.raises(MessageError) as caught:
        check({"width": 1, "data": b"", **{f"more{number}": 1 for number in range(1000)}})
    assert str(caught.value).count("unknown field") == 10
    assert str(caught.value).endswith("; ...")


def test_off_makes_no_check() -> None:
    assert make_check(IMAGE, ValidationMode.OFF, "x") is None


def test_sampled_checks_the_first_every_128th_and_those_after_one_that_does_not_match() -> None:
    checker = make_check(IMAGE, ValidationMode.SAMPLED, "x")
    assert checker is not None

    route = Route("a", "b", lambda _: None, clock=time.monotonic, check=checker)

    def is_found() -> bool:
        return isinstance(route.deliver("wrong"), MessageError)

    def pass_by(count: int) -> None:
        for _ in range(count):
            assert route.deliver({"width": 1, "data": b""}) is None

    pass_by(1)
    assert not any(is_found() for _ in range(127)), "between two samples"
    assert all(is_found() for _ in range(5)), "the 129th, and then all"
    pass_by(127)
    assert is_found(), "within 128 of the last"
    pass_by(128)
    assert [is_found() for _ in range(128)] == [False] * 127 + [True], "128 after the last"


TEXTS = MessageStructure(
    {
        "type": "object",
        "properties": {
            "digits": {"type": "string", "pattern": r"^\d+$"},
            "behind": {"type": "string", "pattern": "(?<=a)b"},
            "slow": {"type": "string", "pattern": "^(a|a)*$"},
        },
        "patternProperties": {r"^\w$": {"type": "integer"}},
        "additionalProperties": False,
    }
)


@pytest.mark.parametrize(
    ("message", "path"),
    [
        ({"digits": "12", "x": 1, "behind": "ab", "slow": "aaa"}, None),
        ({"digits": "\u0663"}, "digits"),  # a digit to Python's re, and none to what was proven
        ({"digits": "1\n"}, "digits"),
        ({"behind": "b"}, "behind"),
        ({"x": "1"}, "x"),
        ({"\u00e9": 1}, "\u00e9: unknown field"),
        ({"x\n": 1}, "x\n: unknown field"),
        ({"slow": "a" * 200 + "b"}, "slow"),  # for ever to an engine that goes back
    ],
)
def test_patterns_are_read_as_the_proof_reads_them(message: Message, path: str | None) -> None:
    checker = make_check(TEXTS, ValidationMode.ALWAYS, "p")
    assert checker is not None
    if path is None:
        checker(message)
    else:
        with pytest.raises(MessageError, match=f"p: {path}"):
            checker(message)


def tree(union: str, *order: str) -> MessageStructure:
    """Return the structure of a tree of two kinds of nodes, and of leaves."""

    def node(kind: str) -> dict[str, Any]:
        members = {"children": {"type": "array", "items": {"$ref": "#/$defs/node"}}}
        members["kind"] = {"const": kind}
        properties = {name: members[name] for name in order}
        return {"type": "object", "properties": properties, "required": [*order]}

    leaf = {"type": "object", "properties": {"kind": {"const": "leaf"}}, "required": ["kind"]}
    forms = {union: [node("sequence"), node("selector"), leaf]}
    return MessageStructure({"$defs": {"node": forms}, "$ref": "#/$defs/node"})


@pytest.mark.parametrize("rule", [["b"], {"required": ["b"]}])
@pytest.mark.parametrize("more", [{}, {"type": "object", "properties": {"a": True, "b": True}}])
def test_dependencies_of_older_drafts_hold_as_the_proof_has_them(
    rule: Any, more: dict[str, Any]
) -> None:
    schema = {"dependencies": {"a": rule}, **more}
    assert verdict_of({"const": {"a": 1}}, schema).incompatible
    checker = make_check(MessageStructure(schema), ValidationMode.ALWAYS, "old")
    assert checker is not None
    checker({"a": 1, "b": 2})
    checker({"b": 2})
    with pytest.raises(MessageError, match=r"old: .*b"):
        checker({"a": 1})


CENTS = {"type": "number", "multipleOf": 0.01}


def test_multiples_are_of_the_decimal_numbers_that_are_written() -> None:
    """As the proof reads them, which has 19.99 a multiple of 0.01."""
    prices = [number / 100 for number in range(-2000, 10_000)]
    assert verdict_of({"enum": prices}, CENTS).compatible
    checker = make_check(MessageStructure(CENTS), ValidationMode.ALWAYS, "price")
    assert checker is not None
    for price in (*prices, 1e308, 10**400, np.float64(19.99)):
        checker(price)
    for other in (0.015, 5e-324, math.nan, math.inf):
        with pytest.raises(MessageError, match=r"multipleOf: expected 0\.01"):
            checker(other)


@pytest.mark.parametrize("union", ["anyOf", "oneOf"])
@pytest.mark.parametrize("leaf", ["leaf", "loaf"])
def test_a_tree_of_nodes_of_several_kinds_costs_what_it_holds(union: str, leaf: str) -> None:
    """Each level was held against each kind, with all that is below it: twice as much for each."""
    checker = make_check(tree(union, "children", "kind"), ValidationMode.ALWAYS, "p")
    assert checker is not None
    message: dict[str, Any] = {"kind": leaf}
    for _ in range(40):
        message = {"kind": "selector", "children": [message]}
    if leaf == "leaf":
        checker(message)
    else:
        with pytest.raises(MessageError, match="is none of the 3 forms allowed"):
            checker(message)
    assert judged.parts is None


@pytest.mark.parametrize("union", ["anyOf", "oneOf"])
def test_parts_that_are_the_same_object_are_judged_by_each_reference(union: str) -> None:
    number, text = {"type": "integer"}, {"type": "array", "items": {"$ref": "#/$defs/text"}}
    schema = {
        "$defs": {"text": {union: [{"type": "string"}, text]}, "number": {union: [number]}},
        "properties": {"a": {"$ref": "#/$defs/text"}, "b": {"$ref": "#/$defs/number"}},
    }
    checker = make_check(MessageStructure(schema), ValidationMode.ALWAYS, "p")
    assert checker is not None
    same = ["x", ["y"]]
    checker({"a": same, "b": 1})
    with pytest.raises(MessageError, match=r"p: b: "):
        checker({"a": same, "b": same})
    with pytest.raises(MessageError, match=r"p: a"):
        checker({"a": [*same, [1]], "b": 1})


UNIQUE = MessageStructure({"type": "array", "uniqueItems": True})


@pytest.mark.parametrize(
    ("items", "are_unique"),
    [
        ([1, True, "1", [1], [True], {"a": 1}, {"a": True}, None, False, 0, 1.5, {}, []], True),
        ([1, 1.0], False),
        ([10**300, 1e300], True),
        ([2**60, float(2**60)], False),
        ([{"a": [1, {"b": 2}], "c": 3}, {"c": 3, "a": [1.0, {"b": 2}]}], False),
        ([b"ab", [97, 98]], False),
        ([None, None], False),
        ([math.nan, math.inf, -math.inf], True),
        (array("d", [1, 2, 1]), False),
    ],
)
def test_items_are_unique_as_json_values_are(items: Any, are_unique: bool) -> None:
    checker = make_check(UNIQUE, ValidationMode.ALWAYS, "p")
    assert checker is not None
    if are_unique:
        checker(items)
    else:
        with pytest.raises(MessageError, match="stands here twice"):
            checker(items)


@pytest.mark.parametrize("wrap", [lambda number: {"a": number}, lambda number: [number, "a"]])
def test_whether_items_are_unique_costs_as_much_as_there_are(wrap: Callable[[int], Any]) -> None:
    checker = make_check(UNIQUE, ValidationMode.ALWAYS, "p")
    assert checker is not None
    spent = []
    for count in (10, 100, 200):
        items = [*map(wrap, range(count - 1)), "mixed"]
        spent.append(calls_of(partial(checker, items)))
    assert spent[2] < 2.2 * spent[1]
    alike = [_key(wrap(number * (2**61 - 1))) for number in range(1000)]
    assert len(set(map(hash, alike))) > 900  # to Python all these numbers have one hash


numbers = st.one_of(
    st.integers(-5, 5),
    st.integers(),
    st.floats(),
    st.booleans(),
    st.sampled_from([0.0, 1.0, -1.5, math.inf, -math.inf, math.nan, 2**2000, "1", None]),
)
ranges = st.fixed_dictionaries(
    {"type": st.sampled_from(["integer", "number"])},
    optional={
        name: st.integers(-5, 5)
        for name in ("minimum", "maximum", "exclusiveMinimum", "exclusiveMaximum")
    },
)


@given(st.lists(numbers, max_size=8), ranges)
@example([1, 1.5, 2], {"type": "integer"})
@example([1, math.nan, 9, 2], {"type": "number", "maximum": 5})
@example([True, 1], {"type": "integer"})
def test_long_lists_of_numbers_are_judged_as_each_number_would_be(
    items: list[object], schema: dict[str, object]
) -> None:
    structure = MessageStructure({"type": "array", "items": schema})
    check = make_check(structure, ValidationMode.ALWAYS, "here")
    assert check is not None
    try:
        check(items)
    except MessageError:
        fits = False
    else:
        fits = True
    bounded = schema.keys() != {"type"}
    in_no_range = bounded and any(isinstance(item, float) and math.isnan(item) for item in items)
    assert fits == (Draft202012Validator(structure.schema).is_valid(items) and not in_no_range)


ROWS = {"type": "array", "items": {"type": "array", "items": {"type": "number", "minimum": 0}}}


def test_arrays_of_several_dimensions_are_arrays_of_rows() -> None:
    check = make_check(MessageStructure(ROWS), ValidationMode.ALWAYS, "grid")
    assert check is not None
    check(np.ones((2, 3)))
    check([np.ones(3), [1.0]])
    with pytest.raises(MessageError, match=r"grid: 0: expected at least 0, got -1.0"):
        check(-np.ones((2, 3)))
    with pytest.raises(MessageError, match=r"grid: 0: expected a list, got 1.0"):
        check(np.ones(3))
    with pytest.raises(MessageError, match=r"0.0: expected a number, got an array of 4 float64"):
        check(np.ones((2, 3, 4)))


def test_each_number_of_a_buffer_of_floats_is_an_integer_where_integers_are_due() -> None:
    structure = MessageStructure({"type": "array", "items": {"type": "integer", "maximum": 9}})
    check = make_check(structure, ValidationMode.ALWAYS, "counts")
    assert check is not None
    check(np.array([1.0, 2.0]))
    for numbers in (np.array([1.0, 1.5, 2.0]), array("d", [1.0, 1.5, 2.0])):
        with pytest.raises(MessageError, match=r"counts: 1: expected a whole number, got 1.5"):
            check(numbers)


def test_a_message_nested_without_end_is_refused() -> None:
    tree: dict[str, object] = {"type": "array", "items": {"$ref": "#"}}
    message: list[object] = []
    message.append(message)
    check = make_check(MessageStructure(tree), ValidationMode.ALWAYS, "tree")
    assert check is not None
    with pytest.raises(MessageError, match="tree: the message is nested too deep"):
        check(message)


@pytest.mark.parametrize(
    ("rules", "good", "bad", "sentence"),
    [
        ({"x-max-utf8": 4}, ["abcd", "éé", "\U0001f600", ""], "ééa", r"4 octets \(UTF-8\), got 5"),
        ({"x-max-utf16": 2}, ["ab", "éé", "\U0001f600"], "\U0001f600a", r"2 code units .*, got 3"),
        ({"x-nul": False}, ["ab", "é"], "a\0", "without the character NUL"),
        ({"x-nul": False, "minLength": 2, "x-max-utf8": 3}, ["ab", "aé"], "a\0", "without"),
    ],
)
def test_texts_are_counted_as_they_are_written(
    rules: dict[str, object], good: list[str], bad: str, sentence: str
) -> None:
    structure = MessageStructure({"type": "string", **rules})
    checker = make_check(structure, ValidationMode.ALWAYS, "note.default")
    assert checker is not None
    for text in good:
        checker(text)
    with pytest.raises(MessageError, match=sentence):
        checker(bad)
    with pytest.raises(MessageError, match="expected text"):
        checker(7)
