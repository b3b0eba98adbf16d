"""Adapters: what they emit is what their schema says, and losses are allowed by name."""

from __future__ import annotations

import itertools
import time
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import yaml
from hypothesis import given
from hypothesis import strategies as st
from jsonschema import Draft202012Validator
from tests.calls import calls_of
from tests.processes import run_python
from tests.schema._hostile import HOSTILE
from tests.structures import closed

from uoarm._adapt import MappingError, _edge, adapt, check_edge, parse
from uoarm._adapt._suggest import flow, suggest
from uoarm._support.yaml import read
from uoarm.errors import MessageError
from uoarm.model import Meaning, MessageStructure
from uoarm.schema import CheckBudget, check

INT = {"type": "integer", "minimum": -100, "maximum": 100}
SOURCE: dict[str, Any] = {
    "type": "object",
    "properties": {
        "data": {"type": "array", "items": INT},
        "range": {"type": "number", "minimum": 0, "maximum": 10},
        "state": {"enum": ["IDLE", "RUN"]},
        "pose": {
            "type": "object",
            "properties": {"x": INT, "y": INT},
            "required": ["x"],
            "additionalProperties": False,
        },
        "boxes": {
            "type": "array",
            "items": {"$ref": "#/$defs/box"},
            "maxItems": 4,
        },
    },
    "required": ["data", "range", "state", "pose", "boxes"],
    "additionalProperties": False,
    "$defs": {"box": closed(left=INT, score={"type": "number"})},
}
# The same with the items elsewhere: what a map takes still means what it did.
_BOXES = SOURCE["properties"]["boxes"]
_REST = {keyword: value for keyword, value in SOURCE.items() if keyword != "$defs"}
FORMS: list[dict[str, Any]] = [
    SOURCE,
    {
        **_REST,
        "properties": {
            **_REST["properties"],
            "boxes": {**_BOXES, "items": {"$ref": "#/definitions/box"}},
        },
        "definitions": SOURCE["$defs"],
    },
    {
        **_REST,
        "x-unit": "m",
        "properties": {
            **_REST["properties"],
            "pose": {**_REST["properties"]["pose"], "$anchor": "pose"},
            "boxes": {**_BOXES, "items": {"$ref": "#/patternProperties/%5Ebox%24"}},
        },
        "patternProperties": {"^box$": SOURCE["$defs"]["box"]},
    },
]
ANY: dict[str, Any] = {}
small = st.integers(-100, 100)
messages = st.fixed_dictionaries(
    {
        "data": st.lists(small, max_size=5),
        "range": st.floats(0, 10),
        "state": st.sampled_from(["IDLE", "RUN"]),
        "pose": st.fixed_dictionaries({"x": small}, optional={"y": small}),
        "boxes": st.lists(
            st.fixed_dictionaries({"left": small, "score": st.floats(allow_nan=False)}), max_size=4
        ),
    }
)
numbers = st.one_of(st.integers(-50, 50), st.sampled_from([0.001, -2.5, 0.1]))
entries = st.one_of(
    st.sampled_from(["data", "range", "state", "pose", "pose.x", "pose.y", "boxes", "."]),
    st.builds(lambda item: {"const": item}, st.sampled_from([1, "a", None, [1], {"b": 2}])),
    st.builds(
        lambda path, scale, offset: {"from": path, "scale": scale, "offset": offset},
        st.sampled_from(["range", "pose.x", "data", "pose.y"]),
        numbers,
        numbers,
    ),
    st.builds(
        lambda path, low, more: {"from": path, "clamp": [low, low + more]},
        st.sampled_from(["pose.x", "data", "pose.y"]),
        st.integers(-150, 150),
        st.integers(0, 50),
    ),
    st.just({"from": "state", "enum": {"IDLE": 0, "RUN": 1}}),
    st.just({"from": "pose.y", "default": 7}),
    st.just({"each": "boxes", "map": {"x": "left", "kind": {"const": "box"}}}),
)
mappings = st.dictionaries(
    st.sampled_from(["a", "b", "c", "d.x", "d.y", "e.f.g"]), entries, min_size=1, max_size=4
)


@given(mappings, messages, st.sampled_from(FORMS))
def test_what_an_adapter_emits_is_what_its_schema_says(
    mapping: Any, message: Any, form: dict[str, Any]
) -> None:
    adapted = adapt(parse(mapping), form, ANY)
    Draft202012Validator(adapted.schema).validate(adapted.make(message))


@pytest.mark.parametrize("form", FORMS[1:])
def test_an_adapter_takes_a_structure_whatever_its_references_lead_to(form: dict[str, Any]) -> None:
    mapping = {"lefts": {"each": "boxes", "map": {"x": "left"}}, "boxes": "boxes", "at": "pose"}
    made = [adapt(parse(mapping), schema, ANY) for schema in (SOURCE, form)]
    assert made[0].losses == tuple(loss for loss in made[1].losses if loss != "*")
    for adapted in made:
        wanted = {"properties": {"boxes": {"items": {"properties": {"left": INT}}}}}
        assert check(adapted.schema, wanted).compatible
        assert not check(adapted.schema, {"properties": {"boxes": {"maxItems": 0}}}).compatible


def structure(**fields: Any) -> MessageStructure:
    return MessageStructure(
        {
            "type": "object",
            "properties": fields,
            "required": list(fields),
            "additionalProperties": False,
        }
    )


NUMBER = {"type": "number"}
PRODUCER = structure(data=INT, header=NUMBER)


def test_a_dropped_field_must_be_allowed_by_name() -> None:
    consumer = structure(pixels=INT)
    refused = check_edge(PRODUCER, consumer, {"pixels": "data"})
    assert not refused.compatible
    assert "header" in refused.reasons[0].sentence
    assert refused.reasons[0].suggestion == "allow_loss: [header]"
    allowed = check_edge(PRODUCER, consumer, {"pixels": "data"}, ("header",))
    assert allowed.compatible
    assert allowed.losses == ("header",)


def test_lines_that_allow_losses_read_back_as_these() -> None:
    boxes = {"type": "array", "items": closed(left=NUMBER, right=NUMBER)}
    producer = structure(boxes=boxes, **{"a, b": NUMBER, "null": NUMBER})
    consumer = structure(boxes={"type": "array", "items": closed(x=NUMBER)})
    mapping = {"boxes": {"each": "boxes", "map": {"x": "left"}}}
    (first, *_) = check_edge(producer, consumer, mapping).reasons
    losses = yaml.safe_load(first.suggestion)["allow_loss"]
    assert losses == ["a, b", "null", "boxes[].right"]
    assert check_edge(producer, consumer, mapping, tuple(losses)).compatible


@pytest.mark.parametrize(
    "named", [{"additionalProperties": NUMBER}, {"patternProperties": {"^j": NUMBER}}]
)
def test_fields_whose_names_are_not_known_are_a_loss(named: dict[str, Any]) -> None:
    joints = {**closed(n=NUMBER), **named}
    producer, consumer = structure(at=joints), structure(n=NUMBER)
    assert check_edge(producer, consumer, {"n": "at.n"}).reasons[0].path == "at.*"
    assert check_edge(producer, consumer, {"n": "at.n"}, ("at.*",)).compatible
    whole = structure(at={"type": "object"})
    assert check_edge(producer, whole, {"at": "at"}).compatible


def test_fields_beside_a_reference_are_not_lost() -> None:
    named = {"$ref": "#/$defs/n", "properties": {"more": NUMBER}}
    producer = MessageStructure({**closed(at=named), "$defs": {"n": closed(n=NUMBER)}})
    verdict = check_edge(producer, structure(n=NUMBER), {"n": "at.n"})
    assert "fields stand beside a reference" in verdict.reasons[0].sentence


def test_a_loss_that_is_none_is_remarked() -> None:
    verdict = check_edge(PRODUCER, PRODUCER, None, ("nothing",))
    assert verdict.compatible
    assert "nothing" in verdict.warnings[0]


def test_a_suggestion_mends_the_edge_that_it_is_for() -> None:
    consumer = structure(pixels=INT, format={"const": "rgb8"})
    verdict = check_edge(structure(pixel=INT, header=NUMBER), consumer)
    expected = "map: {pixels: pixel, format: {const: rgb8}}\nallow_loss: [header]"
    assert verdict.reasons[0].suggestion == expected
    mapping = {"pixels": "pixel", "format": {"const": "rgb8"}}
    assert check_edge(
        structure(pixel=INT, header=NUMBER), consumer, mapping, ("header",)
    ).compatible


def ros(name: str, /, **fields: Any) -> dict[str, Any]:
    return {**closed(**fields), "x-type": name}


def whole(least: int, most: int, unit: str = "") -> dict[str, Any]:
    limits = {"type": "integer", "minimum": least, "maximum": most}
    return {**limits, "x-unit": unit} if unit else limits


WORD, TEXT = whole(0, 2**32 - 1), {"type": "string"}
SECS, NSECS = whole(0, 2**32 - 1, "s"), whole(0, 2**32 - 1, "ns")
HEADERS = (
    ros(
        "std_msgs/Header",
        seq=WORD,
        stamp=ros("time", secs=SECS, nsecs=NSECS),
        frame_id=TEXT,
    ),
    ros(
        "std_msgs/msg/Header",
        stamp=ros(
            "builtin_interfaces/msg/Time", sec=whole(-(2**31), 2**31 - 1, "s"), nanosec=NSECS
        ),
        frame_id=TEXT,
    ),
)
CLOUDS = tuple(
    ros(
        f"sensor_msgs/{infix}Cloud",
        header=header,
        fields={
            "type": "array",
            "items": ros(f"sensor_msgs/{infix}Field", name=TEXT, offset=WORD),
        },
        **{gain: {"type": "number"}},
    )
    for header, infix, gain in zip(HEADERS, ("", "msg/"), ("K", "k"), strict=True)
)
CLAMP = {"clamp": [0, 2**31 - 1]}


def of_header(*, is_to_two: bool, at: str = "") -> dict[str, Any]:
    own, others = (("secs", "nsecs"), ("sec", "nanosec"))[:: -1 if is_to_two else 1]
    times = dict(zip(own, others, strict=True))
    (seconds, other), (rest, other_rest) = times.items()
    return {
        **({} if is_to_two else {f"{at}seq": {"const": 0}}),
        f"{at}stamp.{seconds}": {"from": f"{at}stamp.{other}", **CLAMP},
        f"{at}stamp.{rest}": f"{at}stamp.{other_rest}",
        f"{at}frame_id": f"{at}frame_id",
    }


PARTS = {"each": "fields", "map": {"name": "name", "offset": "offset"}}


@pytest.mark.parametrize(
    ("producer", "consumer", "mapping", "losses"),
    [
        (HEADERS[0], HEADERS[1], of_header(is_to_two=True), ["seq"]),
        (HEADERS[1], HEADERS[0], of_header(is_to_two=False), []),
        (
            CLOUDS[0],
            CLOUDS[1],
            {**of_header(is_to_two=True, at="header."), "fields": PARTS, "k": "K"},
            ["header.seq"],
        ),
        (
            CLOUDS[1],
            CLOUDS[0],
            {**of_header(is_to_two=False, at="header."), "fields": PARTS, "K": "k"},
            [],
        ),
    ],
)
def test_a_message_of_the_other_ros_is_offered_a_map(
    producer: Any, consumer: Any, mapping: Any, losses: list[str]
) -> None:
    """It is refused until that is pasted: the types have different names, and members."""
    ends = MessageStructure(producer), MessageStructure(consumer)
    refused = check_edge(*ends)
    assert not refused.compatible
    lines = yaml.safe_load(refused.reasons[0].suggestion)
    assert (lines["map"], lines.get("allow_loss", [])) == (mapping, losses)
    assert check_edge(*ends, mapping, tuple(losses)).compatible


@pytest.mark.parametrize(
    ("producer", "consumer"),
    [
        (HEADERS[0], ros("std_msgs/msg/Header", frame_id=TEXT, more=TEXT)),
        (ros("a/B", x=WORD), ros("a/C", x=WORD)),
    ],
)
def test_no_map_is_offered_between_messages_of_different_names_or_fields(
    producer: Any, consumer: Any
) -> None:
    refused = check_edge(MessageStructure(producer), MessageStructure(consumer))
    assert not refused.reasons[0].suggestion


WORDS = st.text(max_size=4) | st.sampled_from(
    ["<<", "yes", "null", "~", "1e5", "\U0001f600", "\x85"]
)
VALUES = st.recursive(
    WORDS
    | st.integers()
    | st.booleans()
    | st.none()
    | st.floats(allow_nan=False, allow_infinity=False),
    lambda inner: st.lists(inner, max_size=2) | st.dictionaries(WORDS, inner, max_size=2),
    max_leaves=4,
)


@given(st.dictionaries(WORDS, VALUES, min_size=1))
def test_the_lines_of_a_map_read_back_as_what_was_tried(mapping: dict[str, Any]) -> None:
    found = read(f"map: {flow(mapping)}")
    assert not found.problems
    assert found.value == {"map": mapping}


@pytest.mark.parametrize(
    ("made", "taken", "suggestion"),
    [
        ("celsius", "fahrenheit", "{fahrenheit: {from: celsius, scale: 1.8, offset: 32}}"),
        (
            "fahrenheit",
            "kelvin",
            "{kelvin: {from: fahrenheit, scale: 0.5555555555555556, offset: ",
        ),
        ("angle_deg", "angleRad", "{angleRad: {from: angle_deg, scale: 0.017453292519943295}}"),
        ("range_mm", "range_m", "{range_m: {from: range_mm, scale: 0.001}}"),
        ("metres", "meters", "{meters: metres}"),
        ("metres", "seconds", ""),
        ("degrees", "celsius", ""),
        ("celsius", "speed", ""),  # nothing says in which unit
        ("temperature", "temperatur", "{temperatur: temperature}"),
    ],
)
def test_a_suggestion_never_equates_other_units(made: str, taken: str, suggestion: str) -> None:
    producer, consumer = structure(**{made: NUMBER}), structure(**{taken: NUMBER})
    found = check_edge(producer, consumer).reasons[0].suggestion
    assert found.startswith(f"map: {suggestion}" if suggestion else "")
    assert bool(found) is bool(suggestion)
    if found:
        assert check_edge(producer, consumer, yaml.safe_load(found)["map"]).compatible


def test_what_a_structure_says_of_its_unit_comes_before_the_name() -> None:
    degrees, radians = NUMBER | {"x-unit": "deg"}, NUMBER | {"x-unit": "rad"}
    producer = structure(pitch=radians, yaw=degrees, more=INT)
    found = check_edge(producer, structure(yaw=radians, pitch=radians)).reasons[0].suggestion
    assert "yaw: {from: yaw, scale: 0.017453292519943295}" in found


def test_a_machine_that_has_other_work_takes_nothing_from_a_suggestion(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """A minute passes between any two looks at the clock, as where a hundred others work."""
    minutes = itertools.count(step=60)
    busy = SimpleNamespace(monotonic=lambda: next(minutes), thread_time=time.thread_time)
    monkeypatch.setattr(_edge, "time", busy)
    found = check_edge(structure(celsius=NUMBER), structure(fahrenheit=NUMBER)).reasons[0]
    assert "{from: celsius, scale: 1.8, offset: 32}" in found.suggestion


def test_a_field_that_is_not_required_may_stay_without_a_source() -> None:
    text = {
        "type": "object",
        "properties": {"b": {"type": "string"}},
        "additionalProperties": False,
    }
    (reason,) = check_edge(structure(a=NUMBER), MessageStructure(text)).reasons
    assert reason.suggestion == "map: {}\nallow_loss: [a]"


def test_nothing_is_suggested_where_nothing_fits() -> None:
    verdict = check_edge(structure(a={"type": "string"}), structure(b=INT))
    assert verdict.reasons[0].suggestion == ""


def test_suggestions_for_hostile_structures_are_given_up() -> None:
    """Each of nine pairs of fields would take some seconds to compare: the first ends the time."""
    inner = HOSTILE["500 open choices"]()
    producer = MessageStructure(structure(**{f"a{n}": inner[0] for n in range(3)}).schema)
    consumer = MessageStructure(structure(**{f"b{n}": inner[1] for n in range(3)}).schema)
    left = iter(
        [CheckBudget(steps=1000, seconds=1000.0), CheckBudget(seconds=0.0)]
    )  # a third is an error
    assert suggest(producer, consumer, lambda *_: True, lambda: next(left), Meaning()) == ""
    assert list(left) == []


@pytest.mark.parametrize("malformed", [[[]], True, "x", {"a": 1}])
def test_what_is_no_schema_is_refused_as_that(malformed: object) -> None:
    taken = MessageStructure({"type": "object", "properties": malformed, "required": ["a"]})
    verdict = check_edge(MessageStructure(SOURCE), taken)
    assert [reason.error_code for reason in verdict.reasons] == ["UOA-226"]


def test_an_example_stands_at_the_reason_that_it_shows() -> None:
    refused = check_edge(
        structure(step=INT, data=NUMBER),
        structure(step={"type": "boolean"}, data={"type": "string"}),
    )
    assert len(refused.reasons) > 1
    first, *others = refused.reasons
    assert repr(first.example) in first.sentence
    assert [other.example for other in others] == [None] * len(others)


def test_a_hostile_structure_ends_with_a_clear_reason() -> None:
    producer, consumer = map(MessageStructure, HOSTILE["500 open choices"]())
    verdict = check_edge(producer, consumer, seconds=0.2)
    assert not verdict.compatible
    assert "the budget of time ran out" in verdict.reasons[0].sentence


def test_a_long_map_is_read_in_linear_time() -> None:
    def calls(count: int) -> int:
        return calls_of(lambda: parse({f"f{n}.x": "a" for n in range(count)}))

    once, few, many = map(calls, (1, 200, 400))
    assert many < 2.3 * few
    assert once < few


@given(
    st.lists(
        st.lists(st.sampled_from("ab"), min_size=1, max_size=3).map(".".join), unique=True,
        max_size=6,
    )
)  # fmt: skip
def test_no_two_entries_fill_the_same_field(targets: list[str]) -> None:
    parts = [target.split(".") for target in targets]
    overlap = any(
        part is not other and other[: len(part)] == part for part in parts for other in parts
    )
    try:
        parse(dict.fromkeys(targets, "x"))
    except MappingError as error:
        assert overlap
        assert "fill the same field" in str(error)
    else:
        assert not overlap


def test_an_optional_source_does_not_fill_a_required_field() -> None:
    producer = MessageStructure({**SOURCE})
    consumer = structure(y=INT)
    losses = ("data", "range", "state", "boxes", "pose.x")
    assert not check_edge(producer, consumer, {"y": "pose.y"}, losses).compatible
    filled = check_edge(producer, consumer, {"y": {"from": "pose.y", "default": 0}}, losses)
    assert filled.compatible, filled.reasons


def test_an_enum_map_must_name_every_value() -> None:
    verdict = check_edge(MessageStructure(SOURCE), MessageStructure({}),
                         {"a": {"from": "state", "enum": {"IDLE": 0}}})  # fmt: skip
    assert "'RUN'" in verdict.reasons[0].sentence


@pytest.mark.parametrize(
    ("rule", "path", "said"),
    [
        ("data.x", "data.x", "there is no field 'x'; there is none"),
        ("all.x", "all.x", "a choice of structures"),
        ({"each": "pair", "map": {"x": "."}}, "pair", "all of one structure"),
        ({"each": "pose", "map": {"x": "."}}, "pose", "all of one structure"),
        ({"from": "pose.x", "enum": {"1": 2}}, "pose.x", "a known set of values"),
        ({"from": "same", "enum": {"1": 2, "true": 3}}, "same", "True from its equal"),
        ({"from": "any", "scale": 2}, "any", "says nothing of this field"),
        ({"from": "all", "scale": 2}, "all", "need a number"),
    ],
)
def test_what_a_map_cannot_take_is_refused_at_its_place(rule: Any, path: str, said: str) -> None:
    pair = {"type": "array", "prefixItems": [INT], "items": INT}
    both = {"type": "object", "properties": {"x": INT}, "required": ["x"], "allOf": [{}]}
    more = {"pair": pair, "all": both, "same": {"enum": [1, True]}, "any": True}
    producer = MessageStructure({**SOURCE, "properties": {**SOURCE["properties"], **more}})
    (reason,) = check_edge(producer, MessageStructure(ANY), {"a": rule}).reasons
    assert (reason.path, said in reason.sentence) == (path, True)


def test_a_field_within_a_field_is_filled_there() -> None:
    made = adapt(parse({"at.x": "range", "b.c.d": {"const": 1}}), SOURCE, ANY)
    assert made.make({"range": 0.5}) == {"at": {"x": 0.5}, "b": {"c": {"d": 1}}}


def test_every_mistake_of_a_mapping_is_reported() -> None:
    with pytest.raises(MappingError) as caught:
        parse({"a": {"form": "x"}, "b": {"const": 1, "scale": 2}, "c": 7, "d": "x", "d.e": "y"})
    for part in ("'form'", "const stands alone", "map.c", "fill the same field"):
        assert part in str(caught.value)
    for rule in ({"each": "x", "map": 7}, {"each": "x", "map": {}, "scale": 2}):
        with pytest.raises(MappingError, match="each needs map"):
            parse({"a": rule})


def test_buffers_are_not_copied_and_scale_as_buffers() -> None:
    make = adapt(parse({"a": "data", "b": {"from": "data", "scale": 2}}), SOURCE, ANY).make
    data = np.arange(4)
    made = make({"data": data})
    assert made["a"] is data
    assert made["b"].tolist() == [0, 2, 4, 6]


def test_a_message_that_lacks_a_field_is_named() -> None:
    make = adapt(parse({"a": "range"}), SOURCE, ANY).make
    with pytest.raises(MessageError, match="'a'"):
        make({})


WIDE = structure(width={"type": "integer", "minimum": 0, "maximum": 2**32 - 1})
NARROW = structure(width={"type": "integer", "minimum": 0, "maximum": 2**16 - 1})


@pytest.mark.parametrize("mapping", [None, {}, {"width": "width"}])
def test_no_permission_narrows_a_range(mapping: dict[str, Any] | None) -> None:
    refused = check_edge(WIDE, NARROW, mapping, ("width",))
    assert not refused.compatible
    assert refused.reasons[0].path == "width"


def test_a_clamp_narrows_a_range_because_it_is_named() -> None:
    mapping = {"width": {"from": "width", "clamp": [0, 65535]}}
    verdict = check_edge(WIDE, NARROW, mapping)
    assert verdict.compatible, verdict.reasons
    assert not verdict.losses
    make = adapt(parse(mapping), WIDE.schema, NARROW.schema).make
    assert [make({"width": number})["width"] for number in (0, 65535, 65536, 2**32 - 1)] == [
        0,
        65535,
        65535,
        65535,
    ]
    wider = {"width": {"from": "width", "clamp": [0, 65536]}}
    assert not check_edge(WIDE, NARROW, wider).compatible


def test_a_clamp_works_on_arrays_of_every_kind_and_leaves_nan() -> None:
    octets = {"type": "array", "items": {"type": "integer", "minimum": 0, "maximum": 255}}
    make = adapt(parse({"a": {"from": "a", "clamp": [-5, 100]}}), structure(a=octets).schema, ANY)
    assert make.make({"a": bytes([0, 100, 255])}) == {"a": [0, 100, 100]}
    array = np.array([0, 100, 255], dtype=np.uint8)
    assert make.make({"a": array})["a"].tolist() == [0, 100, 100]
    maybe = {"type": "number", "x-nonfinite": True}
    made = adapt(parse({"a": {"from": "a", "clamp": [0, 1]}}), structure(a=maybe).schema, ANY)
    assert made.schema["properties"]["a"]["x-nonfinite"]
    assert np.isnan(made.make({"a": float("nan")})["a"])
    assert made.make({"a": float("-inf")}) == {"a": 0}


@pytest.mark.parametrize(
    ("rule", "expected"),
    [
        ({"from": "range", "clamp": [2, 1]}, "the lower one first"),
        ({"from": "range", "clamp": [True, 1]}, "two numbers"),
        ({"from": "pose.x", "clamp": [0.5, 1]}, "needs integers here"),
        ({"from": "state", "clamp": [0, 1]}, "needs a number"),
    ],
)
def test_a_clamp_that_cannot_be_is_refused(rule: dict[str, Any], expected: str) -> None:
    verdict = check_edge(MessageStructure(SOURCE), MessageStructure(ANY), {"a": rule})
    assert expected in verdict.reasons[0].sentence


WITHOUT_PINT = """
import sys
sys.modules["pint"] = None
from uoarm._adapt import check_edge
from uoarm.model import MessageStructure
def structure(**fields):
    return MessageStructure({"type": "object", "properties": fields, "required": [*fields]})
def said(producer, consumer):
    print([one.sentence for one in check_edge(producer, consumer).reasons])
number = {"type": "number"}
said(structure(fahrenheit=number), structure(celsius=number))
said(structure(fahrenheit=number), structure(temperature={**number, "x-unit": "Cel"}))
said(structure(angle={**number, "x-unit": "deg"}), structure(angle={**number, "x-unit": "rad"}))
said(structure(fahrenheit=number), structure(colour={"type": "string"}))
said(structure(celsius=number), structure(celsius={"type": "string"}))
"""


def test_where_a_conversion_was_not_tried_a_refusal_says_what_it_needs() -> None:
    done = run_python("-c", WITHOUT_PINT, check=True)
    by_name, by_unit, meant, no_unit, one_unit = done.stdout.splitlines()
    said = "whether fahrenheit can be converted to {} is not known: to compare and convert units "
    for text, unit in ((by_name, "celsius"), (by_unit, "Cel")):
        assert f"{said.format(unit)}this needs: pip install" in text
        assert "[units]" in text
    assert meant.count("[units]") == 1
    assert "units" not in no_unit + one_unit
