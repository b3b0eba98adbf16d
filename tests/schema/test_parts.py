"""Parts of schemas: found by references; changed, put within others, taken out: same meaning."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING, Any

import pytest
from jsonschema import Draft202012Validator
from tests.schema._ecma import UnsupportedPatternError
from tests.schema._mixed_schemas import mixed_schema
from tests.schema._random_choices import RandomChoices
from tests.schema._reference import Reference, UnsupportedSchemaError
from tests.sweeps import for_all

from uoarm.schema import change_parts, document_of, enclose, follow, property_of

if TYPE_CHECKING:
    from collections.abc import Mapping

    from tests.schema._official import Group


def around(inner: Any) -> Mapping[str, Any]:
    return {
        "type": "object",
        "properties": {"beside": {"$ref": "#/$defs/own"}, "message": inner},
        "$defs": {"own": {"type": "integer"}},
    }


def accepts(schema: Any, value: object) -> bool:
    return Draft202012Validator(schema).is_valid(value)


@pytest.mark.parametrize(
    ("schema", "good", "bad"),
    [
        ({"$ref": "#/$defs/n", "$defs": {"n": {"type": "integer"}}}, 1, "1"),
        ({"$ref": "#/definitions/n", "definitions": {"n": {"type": "integer"}}}, 1, "1"),
        (
            {"properties": {"a": {"type": "integer"}, "b": {"$ref": "#/properties/a"}}},
            {"b": 1},
            {"b": ""},
        ),
        ({"type": "array", "items": {"$ref": "#"}}, [[[]]], [[1]]),
        ({"type": "array", "items": {"$dynamicRef": "#"}}, [[[]]], [[1]]),
        ({"not": {"$ref": "#/$defs/x~1y%20z"}, "$defs": {"x/y z": {"type": "null"}}}, 1, None),
        ({"if": {"$ref": "#/then"}, "then": {"type": "integer"}, "else": {"const": "#"}}, "#", ""),
        (
            {
                "$id": "http://here/x",
                "$ref": "http://here/x#/$defs/n",
                "$defs": {"n": {"const": 1}},
            },
            1,
            2,
        ),
        ({"$ref": "#own", "$defs": {"n": {"$anchor": "own", "const": 1}}}, 1, 2),
        (
            {"properties": {"$ref": {"const": "#"}, "x": {"$ref": "#/properties/$ref"}}},
            {"x": "#"},
            {"x": 1},
        ),
        ({"const": {"$ref": "#"}}, {"$ref": "#"}, {"$ref": "#/$defs/message"}),
        (True, 1, None),
        (False, None, 1),
    ],
    ids=json.dumps,
)
def test_references_within_another_schema_mean_what_they_did(
    schema: Any, good: object, bad: object
) -> None:
    before = json.dumps(schema)
    made = enclose(schema, around)
    assert json.dumps(schema) == before
    assert accepts(made, {"message": good}) or schema is False
    assert not accepts(made, {"message": bad}) or schema is True
    assert accepts(made, {"beside": 1})
    assert not accepts(made, {"beside": ""})


def test_the_official_suite_holds_within_another_schema(official_groups: tuple[Group, ...]) -> None:
    seen = 0
    for group in official_groups:
        if group.keyword == "vocabulary":
            continue  # what keywords mean there, `$schema` says
        try:
            Reference(group.schema)
        except UnsupportedSchemaError:
            continue  # documents within it, and references that change with the way there
        made = enclose(group.schema, around)
        for value, is_valid in group.cases:
            try:
                alone = Reference(group.schema).accepts(value)
            except (UnsupportedSchemaError, UnsupportedPatternError):
                continue
            assert alone is is_valid, group
            assert Reference(made).accepts({"message": value}) is is_valid, (group, value, made)
            seen += 1
    assert seen > 1000


@for_all("seed", range(20))
def test_parts_that_are_changed_into_themselves_change_nothing(seed: int) -> None:
    choices = RandomChoices(seed)
    for _ in range(50):
        schema = mixed_schema(choices, 3)

        def same(part: Any) -> Any:
            return part if isinstance(part, bool) else change_parts(part, same)

        assert same(schema) == schema


def test_every_part_is_changed_and_no_data() -> None:
    keywords = {
        "items": True, "contains": True, "not": True, "if": True, "then": True, "else": True,
        "additionalProperties": True, "propertyNames": True, "unevaluatedItems": True,
        "unevaluatedProperties": True, "contentSchema": True, "additionalItems": True,
        "prefixItems": [True], "allOf": [True], "anyOf": [True], "oneOf": [True],
        "properties": {"items": True}, "patternProperties": {"a": True}, "$defs": {"a": True},
        "definitions": {"a": True}, "dependentSchemas": {"a": True},
        "dependencies": {"a": True, "b": ["c"]},
    }  # fmt: skip
    data = {"const": {"not": True}, "enum": [{"items": True}], "default": {"properties": True}}
    made = change_parts({**keywords, **data}, lambda part: not part)
    assert json.dumps(made).count("false") == len(keywords)
    assert {name: made[name] for name in data} == data
    assert change_parts(keywords, lambda part: not part, but=frozenset(keywords)) == keywords
    assert change_parts({"items": [True, True]}, lambda _: False) == {"items": [False, False]}


INTEGER = {"type": "integer"}
BOOK = {"$id": "http://here/book", "$anchor": "other", "$defs": {"n": {"type": "null"}}}
DOCUMENT: dict[str, Any] = {
    "$id": "http://here/x#",
    "$defs": {"x/y z~": INTEGER, "named": {"$anchor": "own"}, "last": {"$dynamicAnchor": "top"}},
    "definitions": {"never": False},
    "prefixItems": [True, INTEGER],
    "properties": {"$id": {"not": INTEGER}, "book": BOOK},
    "const": {"$anchor": "data"},
    "title": "#",
}


@pytest.mark.parametrize(
    ("reference", "found"),
    [
        ("#", DOCUMENT),
        ("", DOCUMENT),
        ("http://here/x", DOCUMENT),
        ("http://here/x#/prefixItems/1", INTEGER),
        ("#/$defs/x~1y%20z~0", INTEGER),
        ("#/definitions/never", False),
        ("#/prefixItems/0", True),
        ("#/properties/$id/not", INTEGER),
        ("#own", {"$anchor": "own"}),
        ("#top", {"$dynamicAnchor": "top"}),
        # What follows leads to no schema of this document.
        ("#/prefixItems/2", None),
        ("#/prefixItems/-1", None),
        (f"#/prefixItems/{'1' * 5000}", None),
        ("#/prefixItems/\u0661", None),
        ("#/prefixItems", None),
        ("#/title", None),
        ("#/title/0", None),
        ("#/$defs/none", None),
        ("#data", None),
        ("#other", None),
        ("#/properties/book", None),
        ("#/properties/book/$defs/n", None),
        ("http://there/x#/prefixItems/1", None),
        (7, None),
    ],
)
def test_a_reference_leads_to_a_schema_of_the_document(reference: object, found: Any) -> None:
    assert follow(DOCUMENT, reference) == found


def test_a_document_within_another_has_its_own_references() -> None:
    assert document_of(BOOK, DOCUMENT) is BOOK
    assert document_of(DOCUMENT["properties"], DOCUMENT) is DOCUMENT
    assert document_of(True, DOCUMENT) is DOCUMENT


@pytest.mark.parametrize(
    ("schema", "good", "bad"),
    [
        ({"properties": {"a": {"$ref": "#/$defs/n"}}, "$defs": {"n": INTEGER}}, 1, "1"),
        ({"properties": {"a": {"$ref": "#/definitions/n"}}, "definitions": {"n": INTEGER}}, 1, ""),
        ({"properties": {"a": {"$ref": "#/properties/b"}, "b": INTEGER}}, 1, "1"),
        ({"properties": {"a": {"items": {"$ref": "#/properties/a"}}}}, [[]], None),
        ({"properties": {"a": {"$dynamicRef": "#n"}}, "$dynamicAnchor": "n", "maxProperties": 1},
         {}, {"a": {}, "b": 1}),
        ({"properties": {"a": {"$ref": "#/properties/a/$defs/n", "$defs": {"n": INTEGER}}}}, 1, ""),
        ({"properties": {"a": {"$ref": "#n", "$defs": {"n": {"$anchor": "n", **INTEGER}}}}}, 1, ""),
        ({"properties": {"a": {"$id": "http://h/a", "$ref": "#/not/not", "not": {"not": INTEGER}}}},
         1, ""),
        ({"$ref": "#/$defs/o", "$defs": {"o": {"properties": {"a": INTEGER}}}}, 1, "1"),
        ({"$id": "http://here/o", "$ref": "http://here/o#/not/not",
          "not": {"not": {"properties": {"a": INTEGER}}}}, 1, "1"),
        ({"properties": {"a": False}}, None, 1),
        ({"properties": {"b": INTEGER}}, "1", None),
        ({"$ref": "#"}, 1, None),
        (True, 1, None),
    ],
    ids=json.dumps,
)  # fmt: skip
def test_a_property_alone_accepts_what_it_did(schema: Any, good: object, bad: object) -> None:
    made = property_of(schema, "a")
    assert accepts(made, good) or made is False
    assert made is True or not accepts(made, bad) or bad is None
