"""References within one document: embedded identifiers, anchors, pointers, dynamic references."""

from __future__ import annotations

from typing import Any

import pytest
from tests.schema._judge import answer

from uoarm.schema import SchemaError, check

TEXT = {"type": "string"}
WHOLE = {"type": "integer"}
HERE = "https://robots.example/msgs/root"

LEAD_TO_TEXT: dict[str, dict[str, Any]] = {
    "an embedded identifier": {"$ref": "item", "$defs": {"x": {"$id": "item", **TEXT}}},
    "relative to the one around it": {
        "$id": HERE,
        "$ref": "https://robots.example/msgs/item",
        "$defs": {"x": {"$id": "item", **TEXT}},
    },
    "relative to a folder": {
        "$id": HERE,
        "$defs": {"f": {"$id": "folder/", "$ref": "item", "$defs": {"x": {"$id": "item", **TEXT}}}},
        "$ref": "folder/",
    },
    "the pointer starts at the embedded document": {
        "$ref": "item",
        "$defs": {
            "x": {"$id": "item", "$ref": "#/$defs/y", "$defs": {"y": TEXT}},
            "y": WHOLE,
        },
    },
    "an anchor of an embedded document": {
        "$ref": "item#here",
        "$defs": {"x": {"$id": "item", "$defs": {"y": {"$anchor": "here", **TEXT}}}},
    },
    "a pointer through an embedded document": {
        "$ref": "#/$defs/x/$defs/y",
        "$defs": {
            "x": {"$id": "folder/x", "$defs": {"y": {"$ref": "z"}, "z": {"$id": "z", **TEXT}}}
        },
    },
    "a urn": {
        "$id": "urn:uuid:deadbeef",
        "$ref": "#/$defs/x",
        "$defs": {"x": {"$ref": "urn:uuid:deadbeef#/$defs/y"}, "y": TEXT},
    },
    "outside of the known keywords": {"$ref": "#/parts/x", "parts": {"x": TEXT}},
    "a dynamic reference with one target": {
        "$dynamicRef": "#x",
        "$defs": {"x": {"$dynamicAnchor": "x", **TEXT}},
    },
    "a dynamic reference to a plain anchor": {
        "$dynamicRef": "#x",
        "$defs": {
            "x": {"$anchor": "x", **TEXT},
            "o": {"$id": "o", "$dynamicAnchor": "x", **WHOLE},
        },
    },
    "both references at once": {
        "$ref": "#/$defs/any",
        "$dynamicRef": "#x",
        "$defs": {"any": {"minLength": 0}, "x": {"$dynamicAnchor": "x", **TEXT}},
    },
}


@pytest.mark.parametrize("schema", LEAD_TO_TEXT.values(), ids=LEAD_TO_TEXT.keys())
def test_a_reference_leads_to_text(schema: dict[str, Any]) -> None:
    assert check(schema, TEXT).compatible
    assert check(TEXT, schema).compatible


def test_the_way_decides() -> None:
    schema = {
        "$id": HERE,
        "$ref": "list",
        "$defs": {
            "item": {"$dynamicAnchor": "item", **WHOLE},
            "list": {
                "$id": "list",
                "items": {"$dynamicRef": "#item"},
                "$defs": {"item": {"$dynamicAnchor": "item", **TEXT}},
            },
        },
    }
    assert answer(check({"type": "array", "items": WHOLE}, schema)) == "yes"
    assert answer(check({"type": "array"}, schema)) == "no"


def test_an_anchor_found_late_still_counts() -> None:
    """The first dynamic anchor stands where only a reference makes it a schema."""
    schema = {
        "properties": {"plain": {"$ref": "#/parts/list"}, "other": {"$ref": "#/parts/more"}},
        "parts": {
            "list": {
                "$id": "list",
                "items": {"$dynamicRef": "#item"},
                "$defs": {"i": {"$dynamicAnchor": "item", **WHOLE}},
            },
            "more": {
                "$id": "more",
                "$ref": "list",
                "$defs": {"i": {"$dynamicAnchor": "item", **TEXT}},
            },
        },
    }
    lists = {"plain": {"items": WHOLE}, "other": {"items": TEXT}}
    for pair in ((schema, {"properties": lists}), ({"properties": lists}, schema)):
        assert answer(check(*pair)) == "yes"
    assert answer(check(schema, {"properties": {"other": {"items": WHOLE}}})) == "no"


def test_two_documents_of_one_name_are_undecided() -> None:
    schema = {"$defs": {"a": {"$id": "x", **TEXT}, "b": {"$id": "x", **WHOLE}}, "$ref": "x"}
    assert answer(check(True, schema)) == "undecided"


def test_one_object_in_two_documents_is_undecided_where_it_refers() -> None:
    part = {"$ref": "#/$defs/t"}
    inner = {"$id": "inner", "properties": {"a": part}, "$defs": {"t": TEXT}}
    schema = {"properties": {"a": part, "b": inner}, "$defs": {"t": WHOLE}}
    assert answer(check(True, schema)) == "undecided"


def test_one_object_in_two_documents_is_fine_where_it_does_not() -> None:
    inner = {"$id": "inner", "properties": {"a": TEXT}}
    assert check({"properties": {"a": TEXT, "b": inner}}, {"properties": {"a": TEXT}}).compatible


@pytest.mark.parametrize("reference", ["item#none", "item#/$defs/none", "#item"])
def test_a_part_that_is_not_there_is_an_error(reference: str) -> None:
    with pytest.raises(SchemaError):
        check(True, {"$ref": reference, "$defs": {"x": {"$id": "item", **TEXT}}})
