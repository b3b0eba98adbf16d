"""Older drafts: schemas that name theirs, and old forms in schemas that name none."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING, Any

import pytest
from hypothesis import given
from jsonschema import Draft202012Validator
from jsonschema.validators import validator_for
from tests.schema._judge import Body, answer, shown
from tests.schema._official import NEWEST, OLDER, groups
from tests.schema._strategies import schemas
from tests.schema._suite_pairs import const_pairs

from uoarm.schema import SchemaError, check, newest

if TYPE_CHECKING:
    from collections.abc import Mapping

DRAFT_4, DRAFT_6, DRAFT_7 = OLDER["draft4"], OLDER["draft6"], OLDER["draft7"]
DRAFT_2019 = OLDER["draft2019-09"]
TEXT, WHOLE = {"type": "string"}, {"type": "integer"}


@pytest.mark.parametrize("draft", OLDER)
def test_a_const_is_contained_exactly_where_it_is_valid(draft: str) -> None:
    wrong, undecided, count = [], 0, 0
    for pair in const_pairs(groups(draft)):
        given = answer(check(pair.producer, pair.consumer))
        undecided += given == "undecided"
        count += 1
        if given not in {"undecided", "yes" if pair.contained else "no"}:
            wrong.append((given, pair))
    assert not wrong, wrong[:5]
    assert undecided <= 0.025 * count, (undecided, count)


MEANINGS: dict[str, tuple[dict[str, Any], dict[str, Any]]] = {
    "items as a list": ({"items": [TEXT, WHOLE]}, {"prefixItems": [TEXT, WHOLE]}),
    "what follows a list": (
        {"items": [TEXT], "additionalItems": WHOLE},
        {"prefixItems": [TEXT], "items": WHOLE},
    ),
    "an empty list": ({"items": [], "additionalItems": WHOLE}, {"items": WHOLE}),
    "additionalItems beside one schema": (
        {"items": TEXT, "additionalItems": False},
        {"items": TEXT},
    ),
    "names that depend": ({"dependencies": {"a": ["b"]}}, {"dependentRequired": {"a": ["b"]}}),
    "schemas that depend": (
        {"dependencies": {"a": {"required": ["b"]}, "c": ["d"]}},
        {"dependentSchemas": {"a": {"required": ["b"]}}, "dependentRequired": {"c": ["d"]}},
    ),
    "exclusive by true": ({"minimum": 3, "exclusiveMinimum": True}, {"exclusiveMinimum": 3}),
    "exclusive by false": ({"maximum": 3, "exclusiveMaximum": False}, {"maximum": 3}),
    "a pointer into a list": (
        {"items": [TEXT, {"$ref": "#/items/0"}]},
        {"prefixItems": [TEXT, TEXT]},
    ),
    "a pointer into dependencies": (
        {"dependencies": {"a": {"required": ["b"]}}, "not": {"$ref": "#/dependencies/a"}},
        {"dependentRequired": {"a": ["b"]}, "not": {"required": ["b"]}},
    ),
    "draft 07: what stands beside a reference": (
        {
            "$schema": DRAFT_7,
            "$ref": "#/definitions/a",
            "type": "object",
            "definitions": {"a": TEXT},
        },
        TEXT,
    ),
    "draft 07: an identifier beside a reference, within": (
        {
            "$ref": "#/$defs/a",
            "$defs": {
                "a": {
                    "$schema": DRAFT_7,
                    "$id": "http://robots.example/a",
                    "$ref": "#/$defs/b",
                    "$defs": {"b": WHOLE},
                },
                "b": TEXT,
            },
        },
        TEXT,
    ),
    "draft 07: an anchor": (
        {"$schema": DRAFT_7, "items": {"$ref": "#a"}, "definitions": {"b": {"$id": "#a", **TEXT}}},
        {"items": TEXT},
    ),
    "draft 07: a later keyword": ({"$schema": DRAFT_7, "dependentRequired": {"a": ["b"]}}, {}),
    "draft 06: a later keyword": ({"$schema": DRAFT_6, "if": TEXT, "then": {"maxLength": 1}}, {}),
    "draft 04: a later keyword": ({"$schema": DRAFT_4, "const": 3}, {}),
    "draft 04: an identifier": (
        {
            "$schema": DRAFT_4,
            "id": "http://robots.example/a",
            "items": {"$ref": "b#/definitions/c"},
            "definitions": {"b": {"id": "b", "definitions": {"c": TEXT}}},
        },
        {"items": TEXT},
    ),
    "draft 2019-09: a later keyword": ({"$schema": DRAFT_2019, "prefixItems": [TEXT]}, {}),
    "an older schema within, where the drafts agree": (
        {"properties": {"a": {"$schema": DRAFT_4, **TEXT}}},
        {"properties": {"a": TEXT}},
    ),
}


@pytest.mark.parametrize(("old", "new"), MEANINGS.values(), ids=MEANINGS)
def test_an_old_form_keeps_its_meaning(old: dict[str, Any], new: dict[str, Any]) -> None:
    assert answer(check(old, new)) == "yes"
    assert answer(check(new, old)) == "yes"


@pytest.mark.parametrize(("old", "new"), MEANINGS.values(), ids=MEANINGS)
def test_an_old_form_is_written_in_the_newest_draft(
    old: dict[str, Any], new: dict[str, Any]
) -> None:
    if "robots.example" in str(old) or "$schema" in str(old.get("properties")):
        with pytest.raises(SchemaError, match=r"an address of its own|another draft"):
            newest(old)
        return
    made = newest(old)
    Draft202012Validator.check_schema(made)
    assert "$schema" not in str(made)
    assert newest(made) is made
    assert answer(check(made, new)) == "yes"
    assert answer(check(new, made)) == "yes"


@pytest.mark.parametrize("draft", [*OLDER, NEWEST])
def test_what_is_written_in_the_newest_draft_accepts_what_it_did(draft: str) -> None:
    wrong, refused, count = [], 0, 0
    for group in groups(draft):
        count += 1
        before = json.dumps(group.schema)
        try:
            made = newest(group.schema)
        except SchemaError:
            refused += 1
            continue
        assert json.dumps(group.schema) == before
        old = validator_for(group.schema, Draft202012Validator)
        for instance, _ in group.cases:
            found = [is_valid(old, group.schema, instance)]
            found.append(is_valid(Draft202012Validator, made, instance))
            if found[0] != found[1]:
                wrong.append((group, made, instance, found))
    assert not wrong, wrong[:3]
    assert refused <= 0.1 * count, (refused, count)


def is_valid(kind: Any, schema: Any, instance: object) -> object:
    """Whether an instance is valid, or what is raised: by patterns of ECMA-262, far references."""
    try:
        return kind(schema).is_valid(instance)
    except Exception as error:  # noqa: BLE001 - compared with the other one's
        return type(error)


WRITTEN: dict[str, tuple[Any, Any]] = {
    "a name that is a pointer, as tools write it": (
        {"$schema": DRAFT_7, "properties": {"a": {"$id": "#/properties/a", **TEXT}},
         "not": {"$ref": "#/properties/a"}},
        {"properties": {"a": TEXT}, "not": {"$ref": "#/properties/a"}},
    ),
    "addresses that nothing refers to": (
        {"$schema": DRAFT_7, "$id": "http://h/a", "properties": {"a": {"$id": "/b", **TEXT}}},
        {"properties": {"a": TEXT}},
    ),
    "references to true and false": (
        {"$schema": DRAFT_7, "definitions": {"a": True, "b": False},
         "properties": {"a": {"$ref": "#/definitions/a"}, "b": {"$ref": "#/definitions/b"}}},
        {"$defs": {"a": True, "b": False},
         "properties": {"a": {"allOf": [True]}, "b": {"allOf": [False]}}},
    ),
    "the address of the whole": (
        {"$schema": DRAFT_7, "$id": "http://h/a#",
         "items": [{"$ref": "http://h/a#/items/1"}, TEXT]},
        {"$id": "http://h/a#", "prefixItems": [{"$ref": "#/prefixItems/1"}, TEXT]},
    ),
    "a name with marks": (
        {"$schema": DRAFT_4, "definitions": {"a/b~": TEXT},
         "items": {"$ref": "#/definitions/a~1b~0"}},
        {"$defs": {"a/b~": TEXT}, "items": {"$ref": "#/$defs/a~1b~0"}},
    ),
    "both references of 2019-09": (
        {"$schema": DRAFT_2019, "properties": {"a": {"$ref": "#/$defs/n", "$recursiveRef": "#"}},
         "$recursiveAnchor": True, "$defs": {"n": TEXT}},
        {"properties": {"a": {"$ref": "#/$defs/n", "allOf": [{"$ref": "#"}]}},
         "$defs": {"n": TEXT}},
    ),
    "what is no schema": ({"$schema": DRAFT_7, "const": {"items": [TEXT]}},
                          {"const": {"items": [TEXT]}}),
    "what is malformed": ({"$schema": DRAFT_7, "properties": 3, "anyOf": {"a": 3}, "not": 3},
                          {"properties": 3, "anyOf": {"a": 3}, "not": 3}),
    "true": (True, True),
}  # fmt: skip


@pytest.mark.parametrize(("old", "new"), WRITTEN.values(), ids=WRITTEN)
def test_the_newest_draft_is_written_so(old: Any, new: Any) -> None:
    assert newest(old) == new


@pytest.mark.parametrize(
    ("schema", "place"),
    [
        ({"$schema": "http://json-schema.org/draft-03/schema#"}, r"#/\$schema: expected draft 04"),
        ({"$schema": 3}, r"#/\$schema: expected draft 04, .* got 3"),
        ({"$schema": DRAFT_7, "items": {"$ref": "#/x-parts/0"}}, r"#/items/\$ref: expected a ref"),
        ({"$schema": DRAFT_7, "definitions": {"a": {"$id": "b", "items": {"$ref": "c"}}}},
         "#/definitions/a: .* an address of its own"),
        ({"properties": {"a": {"$schema": DRAFT_4}}}, "#/properties/a: .* another draft"),
        ({"$schema": DRAFT_2019, "contains": TEXT, "unevaluatedItems": False},
         "#: .*unevaluatedItems"),
    ],
)  # fmt: skip
def test_what_the_newest_draft_cannot_say_is_refused_with_its_place(
    schema: Any, place: str
) -> None:
    with pytest.raises(SchemaError, match=place):
        newest(schema)


def test_a_schema_that_is_nested_too_deeply_is_refused() -> None:
    schema: Any = {}
    for _ in range(5000):
        schema = {"items": [schema]}
    with pytest.raises(SchemaError, match="nested less deeply"):
        newest(schema)


UNDECIDED = {
    "an older schema within, where the drafts differ": {
        "properties": {"a": {"$schema": DRAFT_4, "const": 3}}
    },
    "a draft before 04": {"$schema": "http://json-schema.org/draft-03/schema#"},
    "old and new dependencies": {
        "dependencies": {"a": ["b"]},
        "dependentRequired": {"c": ["d"]},
    },
    "what 2019-09 does not count": {
        "$schema": DRAFT_2019, "contains": TEXT, "unevaluatedItems": False
    },
}  # fmt: skip


@pytest.mark.parametrize("schema", UNDECIDED.values(), ids=UNDECIDED)
def test_what_could_mean_two_things_is_undecided(schema: dict[str, Any]) -> None:
    assert answer(check(True, schema)) == "undecided"


MALFORMED = {
    "#/items/0": {"items": [5]},
    "#/additionalItems": {"items": [TEXT], "additionalItems": 5},
    "#/dependencies/a": {"dependencies": {"a": "b"}},
    "#/dependencies": {"dependencies": 5},
    "#/definitions": {"$schema": DRAFT_7, "definitions": 5},
}


@pytest.mark.parametrize(("place", "schema"), MALFORMED.items(), ids=MALFORMED)
def test_an_error_names_the_place_as_it_was_written(place: str, schema: dict[str, Any]) -> None:
    with pytest.raises(SchemaError) as caught:
        check(schema, True)
    assert caught.value.pointer == place


@given(schemas)
def test_a_schema_written_the_old_way_means_the_same(schema: Body) -> None:
    old = _old(schema)
    assert answer(check(old, schema)) == "yes", shown(old, schema)
    assert answer(check(schema, old)) == "yes", shown(schema, old)


def _old(schema: Any) -> Any:
    """Write a schema with the older forms, wherever they can stand."""
    if isinstance(schema, list):
        return [_old(item) for item in schema]
    if not isinstance(schema, dict):
        return schema
    found = {name: _inside(name, value) for name, value in schema.items()}
    if "prefixItems" in found:
        more = {"additionalItems": found.pop("items")} if "items" in found else {}
        found |= {"items": found.pop("prefixItems"), **more}
    named, whole = found.pop("dependentRequired", {}), found.pop("dependentSchemas", {})
    if named.keys() & whole.keys():
        return found | {"dependentRequired": named, "dependentSchemas": whole}
    return found | ({"dependencies": named | whole} if named or whole else {})


def _inside(keyword: str, value: Any) -> Any:
    if keyword in {"enum", "const", "required", "type", "dependentRequired"}:
        return value
    if keyword in {"properties", "patternProperties", "dependentSchemas", "$defs"}:
        members: Mapping[str, Any] = value
        return {name: _old(member) for name, member in members.items()}
    return _old(value) if isinstance(value, dict | list) else value
