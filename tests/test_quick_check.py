"""What certainly matches a schema, against the whole validator; and that it knows real files."""

from __future__ import annotations

import difflib
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st
from jsonschema import Draft202012Validator

from uoarm._mistakes import certainly_matches
from uoarm._spelling import nearest
from uoarm._support.yaml import read_file
from uoarm.bridge import Registry, did_you_mean
from uoarm.config import published_schema

ROOT = Path(__file__).parents[1]
SCALARS = st.one_of(
    st.none(), st.booleans(), st.integers(-3, 3), st.sampled_from([0.0, 1.0, 2.5, float("nan")]),
    st.sampled_from(["", "a", "ab", "é", "a b"]),
)  # fmt: skip
VALUES = st.recursive(
    SCALARS,
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.sampled_from("abc"), inner),
    max_leaves=6,
)
NAMES = st.sampled_from(["object", "array", "string", "integer", "number", "boolean", "null"])
SMALL = st.integers(0, 2)


def schemas(inner: st.SearchStrategy[Any]) -> st.SearchStrategy[Any]:
    members = st.dictionaries(st.sampled_from("abc"), inner, max_size=2)
    keywords: dict[str, st.SearchStrategy[Any]] = {
        "type": NAMES | st.lists(NAMES, min_size=1, max_size=2, unique=True),
        "enum": st.lists(VALUES, min_size=1, max_size=3), "const": VALUES,
        "required": st.lists(st.sampled_from("abc"), max_size=2, unique=True),
        "pattern": st.sampled_from(["^a", "b$", "^$"]), "uniqueItems": st.booleans(),
        "minimum": SMALL, "maximum": SMALL, "exclusiveMinimum": SMALL, "exclusiveMaximum": SMALL,
        "minLength": SMALL, "maxLength": SMALL, "minItems": SMALL, "maxItems": SMALL,
        "minProperties": SMALL, "maxProperties": SMALL, "properties": members,
        "additionalProperties": inner, "patternProperties": st.just({"^a": False}),
        "propertyNames": inner, "items": inner, "prefixItems": st.just([False]),
        "anyOf": st.lists(inner, min_size=1, max_size=2), "not": inner,
        "$ref": st.just("#/$defs/part"), "x-unit": st.just("m"), "title": st.just("it"),
    }  # fmt: skip
    return st.fixed_dictionaries({}, optional=keywords)


SCHEMAS = st.recursive(st.booleans(), schemas, max_leaves=5)


@given(SCHEMAS, st.sampled_from([True, False, {"type": "string"}]), VALUES)
def test_what_certainly_matches_is_valid(schema: Any, part: Any, value: Any) -> None:
    whole = {**schema, "$defs": {"part": part}} if isinstance(schema, dict) else schema
    if certainly_matches(value, whole):
        assert Draft202012Validator(whole).is_valid(value)


FILES = [
    path
    for path in sorted((ROOT / "examples").rglob("*.yaml"))
    if "version: 1" in path.read_text(encoding="utf-8")
]


@pytest.mark.parametrize("path", FILES, ids=lambda path: str(path.relative_to(ROOT)))
def test_files_without_mistakes_need_no_validator(path: Path) -> None:
    value: Any = read_file(path).value
    is_valid = not any(Draft202012Validator(published_schema()).iter_errors(value))
    assert certainly_matches(value, published_schema()) is is_valid
    for bridge in (value.get("bridges") or {}).values():
        kind = Registry().types.get((bridge or {}).get("plugin", ""))
        options = (bridge or {}).get("options", {})
        if kind is not None and Draft202012Validator(kind.options_schema).is_valid(options):
            assert certainly_matches(options, kind.options_schema)


@pytest.mark.parametrize(
    ("value", "schema"),
    [
        (True, {"const": 1}),
        (1.0, {"type": "integer"}),
        ((1, 2), {"items": False}),
        ({"a": 1}, {"patternProperties": {"a": False}, "additionalProperties": False}),
        ([1], {"prefixItems": [False], "items": True}),
        ("a", {"minimum": "a"}),
        ("a", {"pattern": "("}),
        ("a", {"$ref": "other.json"}),
        ("a", {"format": "date"}),
        ([[1], [1]], {"uniqueItems": True}),
    ],
)
def test_what_is_not_certain_is_left_to_the_validator(value: Any, schema: Any) -> None:
    if "minimum" in schema:
        value = 1
    assert not certainly_matches(value, schema)


def test_the_nearest_of_many_words_is_found_among_few(monkeypatch: pytest.MonkeyPatch) -> None:
    compared: list[int] = []
    original = difflib.get_close_matches

    def count(word: str, known: list[str], n: int) -> list[str]:
        compared.append(len(known))
        return original(word, known, n=n)

    monkeypatch.setattr(difflib, "get_close_matches", count)
    many = [
        f"{part}Function{number}" for number in range(1000) for part in ("front", "rear", "arm")
    ]
    assert nearest("rearFuncton271", many) == "rearFunction271"
    assert nearest("quite other", many) == ""
    assert nearest("scann", ["scan", "map"]) == "scan"
    assert compared == [64, 64, 2]


def test_a_near_name_is_proposed_of_any_number_and_for_any_value() -> None:
    names = [f"/robot{number}/camera" for number in range(20_000)]
    assert did_you_mean("/robot77/camrea", names) == "; did you mean '/robot77/camera'?"
    assert did_you_mean("x" * 2**20, ["x" * (2**20 - 1)]) == ""
    assert did_you_mean("camera", ["camera"]) == "", "the name itself is no other one"
    values: tuple[object, ...] = (7, None, [], b"7")
    assert not any(did_you_mean(value, ["7", "None"]) for value in values)
