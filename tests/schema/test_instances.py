"""The generator of instances: what it hands out is valid, and it reaches the edges."""

from __future__ import annotations

import pytest
from hypothesis import find, given, settings
from hypothesis.errors import Unsatisfiable
from hypothesis.strategies import DataObject, data
from tests.schema._random_choices import RandomChoices
from tests.schema._reference import Reference
from tests.schema._strategies import Body, schemas

from uoarm.testing._instances import DrawnChoices, find_instance, instances

MESSAGE: Body = {
    "type": "object",
    "properties": {
        "id": {"type": "integer", "minimum": 0, "maximum": 2**64 - 1},
        "mode": {"enum": ["idle", "run"]},
        "ranges": {"type": "array", "items": {"type": "number"}, "minItems": 1, "maxItems": 3},
        "cause": {"anyOf": [{"type": "null"}, {"type": "string", "maxLength": 4}]},
    },
    "required": ["id"],
    "additionalProperties": False,
}
RECURSIVE: Body = {
    "type": "object",
    "properties": {"next": {"$ref": "#"}, "v": {"type": "integer"}},
    "required": ["v"],
    "additionalProperties": False,
}


@given(schemas, data())
def test_what_is_found_is_valid(schema: Body, more: DataObject) -> None:
    accepts = Reference(schema).accepts
    value, found = find_instance(schema, DrawnChoices(more.draw), accepts)
    assert accepts(value) or not found


@given(instances(MESSAGE))
def test_instances_are_valid_by_default(value: object) -> None:
    assert Reference(MESSAGE).accepts(value)


@pytest.mark.parametrize(
    ("schema", "wanted"),
    [
        ({"type": "integer", "maximum": 2**64 - 1}, 2**64 - 1),
        ({"type": "integer", "minimum": -(2**63)}, -(2**63)),
        ({"type": "number", "exclusiveMinimum": 0, "maximum": 1}, 1),
        ({"type": "string", "minLength": 2, "maxLength": 5}, 5),
        ({"type": "array", "items": {"type": "null"}, "minItems": 2, "maxItems": 7}, 7),
        ({"type": "array", "minItems": 2, "maxItems": 7, "items": {"const": 1}}, 2),
        ({"anyOf": [{"const": "left"}, {"const": "right"}]}, "right"),
        ({"enum": [1, "two", [3]]}, [3]),
        ({"$ref": "#there", "$defs": {"a": {"$anchor": "there", "const": "found"}}}, "found"),
        ({"type": "object", "properties": {"a": {"const": 1}}}, {"a": 1}),
        ({"type": "object", "properties": {"a": {"const": 1}}}, {}),
        ({"type": "integer", "multipleOf": 7, "minimum": 1}, 7),
    ],
)
def test_edges_are_reached(schema: Body, wanted: object) -> None:
    def is_wanted(value: object) -> bool:
        if isinstance(value, (str, list)) and isinstance(wanted, int):
            return len(value) == wanted
        return value == wanted

    find(instances(schema), is_wanted, settings=settings(max_examples=2_000, database=None))


def test_recursion_ends() -> None:
    accepts = Reference(RECURSIVE).accepts
    depths = set()
    for seed in range(200):
        value, found = find_instance(RECURSIVE, RandomChoices(seed), accepts)
        assert found
        depths.add(str(value).count("{"))
    assert {1, 2} <= depths


def test_an_empty_schema_has_none() -> None:
    with pytest.raises(Unsatisfiable):
        find(instances({"type": "integer", "minimum": 1, "maximum": 0}), lambda _: True)


class CountedChoices(RandomChoices):
    """Says how many numbers were chosen."""

    made = 0

    def integer(self, low: int, high: int) -> int:
        self.made += 1
        return super().integer(low, high)


def test_a_schema_whose_instances_are_too_large_is_given_up_soon() -> None:
    branch = {"$ref": "#"}
    tree = {"type": "object", "properties": {"l": branch, "r": branch}, "required": ["l", "r"]}
    choices = CountedChoices(0)
    assert find_instance(tree, choices, Reference(tree).accepts) == (None, False)
    assert 4_000 < choices.made < 12_000
