"""References whose target depends on the way to them, or lies outside of the document."""

from __future__ import annotations

from typing import Any

import pytest
from tests.schema._judge import answer

from uoarm.schema import check

HERE = "http://robots.example/root"
TEXT = {"type": "string"}
WHOLE = {"type": "integer"}
DRAFT_2019 = "https://json-schema.org/draft/2019-09/schema"
DRAFT_7 = "http://json-schema.org/draft-07/schema#"


def _list_of(name: str, rule: dict[str, Any]) -> dict[str, Any]:
    anchor = {"$dynamicAnchor": "T", **rule}
    return {"$id": name, "$ref": "list", "$defs": {"n": anchor}}


LISTS: dict[str, Any] = {
    "list": {
        "$id": "list",
        "type": "array",
        "items": {"$dynamicRef": "#T"},
        "$defs": {"n": {"$dynamicAnchor": "T"}},
    },
    "int": _list_of("int", WHOLE),
    "string": _list_of("string", TEXT),
}


def _with_lists(schema: dict[str, Any]) -> dict[str, Any]:
    return {"$id": HERE, **schema, "$defs": LISTS}


DYNAMIC = {
    "one schema in two scopes is two schemas": (
        _with_lists({"oneOf": [{"$ref": "int"}, {"$ref": "string"}]}), False, "no"
    ),
    "a negation in one scope is no negation in the other": (
        {"const": [1]}, _with_lists({"anyOf": [{"not": {"$ref": "int"}}, {"$ref": "string"}]}), "no"
    ),
    "a list of whole numbers": (_with_lists({"$ref": "int"}), {"items": WHOLE}, "yes"),
    "and no narrower one": (_with_lists({"$ref": "int"}), {"items": {"minimum": 0}}, "no"),
    "the scope of the first one is kept": (
        _with_lists({"$ref": "int", "prefixItems": [{"$ref": "string"}]}), {"maxItems": 0}, "yes"
    ),
    "within the list itself anything may come": (
        _with_lists({"$ref": "list"}), {"items": {}}, "yes"
    ),
    "the same document twice": (
        _with_lists({"$ref": "int"}), _with_lists({"$ref": "int"}), "yes"
    ),
    "one content in two documents that set different anchors": (
        _with_lists({"$ref": "int"}), _with_lists({"$ref": "string"}), "no"
    ),
}  # fmt: skip


@pytest.mark.parametrize(("producer", "consumer", "truth"), DYNAMIC.values(), ids=DYNAMIC)
def test_the_way_decides_where_a_dynamic_reference_leads(
    producer: Any, consumer: Any, truth: str
) -> None:
    assert answer(check(producer, consumer)) == truth


def test_equal_parts_of_two_documents_are_not_equal() -> None:
    """The same `$ref`, spelled alike, where the dynamic anchor has two meanings."""

    def document(rule: dict[str, Any]) -> dict[str, Any]:
        anchors = {"n": {"$dynamicAnchor": "T", **rule}, "list": LISTS["list"]}
        return {"$id": HERE, "$ref": "list", "$defs": anchors}

    assert answer(check(document(WHOLE), document(TEXT))) == "no"
    assert answer(check(document(WHOLE), document({"type": ["integer", "string"]}))) == "yes"


def _tree(kind: dict[str, Any], *, keyword: str = "not") -> dict[str, Any]:
    inner: Any = {"$recursiveRef": "#"}
    child = {"not": inner} if keyword == "not" else {keyword: [inner, True]}
    if keyword == "if":
        child = {"if": inner, "then": False}
    return {"$schema": DRAFT_2019, **kind, "properties": {"k": child}}


@pytest.mark.parametrize("keyword", ["not", "oneOf", "if"])
def test_a_recursive_reference_is_of_its_document(keyword: str) -> None:
    typed, untyped = _tree({"type": "object"}, keyword=keyword), _tree({}, keyword=keyword)
    for pair in ((typed, untyped), (untyped, typed)):
        assert answer(check(*pair)) == "no", pair


def test_a_recursive_reference_follows_the_outermost_anchor() -> None:
    def document(outer: dict[str, Any]) -> dict[str, Any]:
        inner = {"$id": "inner", "$recursiveAnchor": True, "items": {"$recursiveRef": "#"}}
        return {"$schema": DRAFT_2019, "$id": HERE, **outer, "$defs": {"i": inner}, "$ref": "inner"}

    strict = document({"$recursiveAnchor": True, "type": "array"})
    loose = document({"type": "array"})
    assert answer(check(strict, {"items": {"type": "array"}})) == "yes"
    assert answer(check(loose, {"items": {"type": "array"}})) == "no"
    assert answer(check({"const": [1]}, loose)) == "yes"


FAR = {"$ref": "other.json"}
ELSEWHERE = {"$ref": "http://robots.example/other"}
UNDECIDED = {
    "two nameless documents, a relative reference": (FAR, FAR),
    "below a reference of equal documents": (
        {"$ref": "#/$defs/x", "$defs": {"x": FAR}}, {"$ref": "#/$defs/x", "$defs": {"x": FAR}}
    ),
    "two names, one far reference, different anchors": (
        {"$id": "http://a/1", **ELSEWHERE, "$defs": {"n": {"$dynamicAnchor": "T", **TEXT}}},
        {"$id": "http://b/1", **ELSEWHERE, "$defs": {"n": {"$dynamicAnchor": "T", **WHOLE}}},
    ),
    "two names, to which the far schema may refer back": (
        {"$id": "http://a/1", "items": ELSEWHERE}, {"$id": "http://b/1", "items": ELSEWHERE}
    ),
    "a file, which is another one elsewhere": (
        {"$ref": "file:///a.json"}, {"$ref": "file:///a.json"}
    ),
    "another draft around the reference": (ELSEWHERE, {"$schema": DRAFT_2019, **ELSEWHERE}),
    "one far reference in two scopes": (
        {
            "$id": HERE,
            "allOf": [{"$ref": "one"}, {"not": {"$ref": "two"}}],
            "$defs": {
                "o": {"$id": "one", "$ref": "#x", "$defs": {
                    "n": {"$dynamicAnchor": "T", **TEXT}, "x": {"$anchor": "x", "$ref": "l"}}},
                "t": {"$id": "two", "$ref": "#x", "$defs": {
                    "n": {"$dynamicAnchor": "T", **WHOLE}, "x": {"$anchor": "x", "$ref": "l"}}},
                "l": {"$id": "l", **ELSEWHERE},
            },
        },
        False,
    ),
    "a reference to a dynamic anchor that another document sets first": (
        {
            "$id": HERE,
            "$ref": "list",
            "$defs": {
                "n": {"$dynamicAnchor": "T", **WHOLE},
                "list": {
                    "$id": "list",
                    "items": {"$ref": "#T"},
                    "$defs": {"n": {"$dynamicAnchor": "T", **TEXT}, "d": {"$dynamicRef": "#T"}},
                },
            },
        },
        {"items": TEXT},
    ),
    "a dynamic anchor of a document without a name": (
        {
            "$ref": "http://robots.example/list",
            "$defs": {
                "n": {"$dynamicAnchor": "T", **WHOLE},
                "list": {
                    "$id": "http://robots.example/list",
                    "items": {"$dynamicRef": "#T"},
                    "$defs": {"n": {"$dynamicAnchor": "T", **TEXT}},
                },
            },
        },
        {"items": WHOLE},
    ),
    "an anchored document beyond one that is not": (
        {
            "$schema": DRAFT_2019,
            "$id": HERE,
            "$recursiveAnchor": True,
            "type": ["array", "integer"],
            "anyOf": [{"$ref": "middle"}],
            "$defs": {
                "m": {"$id": "middle", "anyOf": [{"$ref": "inner"}]},
                "i": {"$id": "inner", "$recursiveAnchor": True, "items": {"$recursiveRef": "#"}},
            },
        },
        {"items": {"type": ["array", "integer"]}},
    ),
    "a recursive anchor within a document": (
        {
            "$schema": DRAFT_2019,
            "items": {"$recursiveAnchor": True, "items": {"$recursiveRef": "#"}},
        },
        {"items": {"items": {"type": "null"}}},
    ),
    "a reference into an embedded document of another draft": (
        {
            "$id": HERE,
            "$ref": "old#/definitions/a",
            "$defs": {
                "o": {
                    "$id": "old",
                    "$schema": DRAFT_7,
                    "definitions": {"a": {"$ref": "#/definitions/b", "type": "integer"}, "b": {}},
                }
            },
        },
        WHOLE,
    ),
    "a list of values that the other draft does not read": (
        {
            "oneOf": [
                {"$schema": DRAFT_7, "$ref": "#/$defs/any", "enum": [1]},
                {"$schema": DRAFT_7, "$ref": "#/$defs/any", "enum": [2]},
            ],
            "$defs": {"any": True},
        },
        {"enum": [1, 2]},
    ),
    "a pointer into another document among dynamic anchors": (
        _with_lists({"$ref": "#/$defs/int/$defs/n"}), WHOLE
    ),
    "two anchors of one name": (
        {"$ref": "#x", "$defs": {"a": {"$anchor": "x", **TEXT}, "b": {"$anchor": "x", **WHOLE}}}, {}
    ),
    "a draft that is not known, below": (
        {
            "$id": HERE,
            "$ref": "own#/$defs/a",
            "$defs": {
                "o": {"$id": "own", "$schema": "http://robots.example/draft", "$defs": {"a": WHOLE}}
            },
        },
        WHOLE,
    ),
}  # fmt: skip


@pytest.mark.parametrize(("producer", "consumer"), UNDECIDED.values(), ids=UNDECIDED)
def test_what_may_mean_two_things_is_undecided(producer: Any, consumer: Any) -> None:
    assert answer(check(producer, consumer)) == "undecided"


SAME = {
    "one absolute reference": (ELSEWHERE, ELSEWHERE),
    "beside what makes it narrower": ({"items": {**ELSEWHERE, **WHOLE}}, {"items": ELSEWHERE}),
    "equal documents with a name": (
        {"$id": HERE, "items": FAR}, {"$id": HERE, "items": FAR}
    ),
    "the other draft reads it alike": (
        {
            "$id": HERE,
            "$ref": "old#/definitions/a",
            "$defs": {"o": {"$id": "old", "$schema": DRAFT_7, "definitions": {"a": WHOLE}}},
        },
        WHOLE,
    ),
}  # fmt: skip


@pytest.mark.parametrize(("producer", "consumer"), SAME.values(), ids=SAME)
def test_what_certainly_is_one_schema_is_one(producer: Any, consumer: Any) -> None:
    assert answer(check(producer, consumer)) == "yes"


def test_scopes_without_end_are_undecided() -> None:
    """Each document may be the first to set each of many names, so that scopes multiply."""
    count = 16
    documents: dict[str, object] = {}
    for n in range(count):
        ways = {f"to{m}": {"$ref": f"d{m}"} for m in range(count) if m != n}
        anchors = [{"$dynamicAnchor": f"T{m % count}"} for m in (n, n + 1)]
        parts = {**ways, "item": {"$dynamicRef": f"#T{n}"}}
        named = {
            "$id": f"d{n}",
            "properties": parts,
            "$defs": dict(zip("ab", anchors, strict=True)),
        }
        documents[f"d{n}"] = named
    schema = {"$id": HERE, "$ref": "d0", "$defs": documents}
    assert answer(check(schema, {"type": "object"})) == "undecided"
