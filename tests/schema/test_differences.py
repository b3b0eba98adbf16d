"""Schemas of one shape are compared place by place: what that says is what a search says."""

from __future__ import annotations

from typing import Any

import pytest
from tests.schema._judge import answer, verify_counterexample
from tests.schema._random_choices import RandomChoices
from tests.schema._robot_schemas import closed, integer_type, robot_schema
from tests.sweeps import for_all

from uoarm.schema import check
from uoarm.schema._errors import Meter
from uoarm.schema.read import Pool, SchemaDocument
from uoarm.schema.solve import Solver, Unsatisfiable, differences
from uoarm.schema.solve import answer as search

BYTE, WORD = integer_type(8, signed=False), integer_type(16, signed=False)
NUMBER: dict[str, object] = {"type": "number"}


def pool() -> Pool:
    return Pool(Meter(10**7, 1_000.0, 10**9))


def places(one: Any, other: Any) -> list[tuple[str | int, ...]]:
    shared = pool()
    roots = [SchemaDocument(body, shared).root for body in (one, other)]
    return [found.path for found in differences(roots[0], roots[1], shared.meter)]


def sequence(items: object, **more: object) -> dict[str, object]:
    return {"type": "array", "items": items, **more}


@pytest.mark.parametrize(
    ("one", "other", "path"),
    [
        (closed({"a": WORD, "b": WORD}), closed({"a": WORD, "b": BYTE}), ("b",)),
        (closed({"a": sequence(WORD)}), closed({"a": sequence(BYTE)}), ("a", 0)),
        (closed({"a": WORD}), closed({"b": WORD}), ()),
        (closed({"a": WORD}, optional=("a",)), closed({"a": BYTE}), ()),
        (closed({"a": WORD}), closed({"a": BYTE}, optional=("a",)), ("a",)),
        (sequence(WORD, maxItems=3), sequence(BYTE, maxItems=2), ()),
        (sequence(WORD, maxItems=2), sequence(BYTE, maxItems=3), (0,)),
        (WORD, BYTE, ()),
        (sequence(WORD, prefixItems=[WORD]), sequence(BYTE, prefixItems=[WORD]), (1,)),
        (sequence(WORD, prefixItems=[WORD]), sequence(WORD, prefixItems=[BYTE]), ()),
        (
            {"properties": {"a": WORD}, "unevaluatedProperties": False},
            {"properties": {"a": BYTE}, "unevaluatedProperties": False},
            (),
        ),
        (
            {"$defs": {"n": WORD}, "properties": {"a": WORD}, "$ref": "#/$defs/n"},
            {"$defs": {"n": WORD}, "properties": {"a": BYTE}, "$ref": "#/$defs/n"},
            (),
        ),
        ({"properties": {"a": WORD}, "enum": [1]}, {"properties": {"a": BYTE}, "enum": [2]}, ()),
    ],
)
def test_the_places_of_differences(one: Any, other: Any, path: tuple[str | int, ...]) -> None:
    assert places(one, other) == [path]
    assert places(one, one) == []


@pytest.mark.parametrize(
    ("producer", "consumer", "fits"),
    [
        (sequence(NUMBER, maxItems=0), sequence(BYTE, maxItems=0), True),
        ({"properties": {"a": NUMBER}, "propertyNames": {"const": "b"}},
         {"properties": {"a": BYTE}, "propertyNames": {"const": "b"}}, True),
        ({"properties": {"a": NUMBER}, "maxProperties": 0},
         {"properties": {"a": BYTE}, "maxProperties": 0}, True),
        (sequence(NUMBER, minItems=3, uniqueItems=True),
         sequence(BYTE, minItems=3, uniqueItems=True), False),
        (closed({"a": NUMBER, "b": {"pattern": "^x+$", "type": "string"}}),
         closed({"a": BYTE, "b": {"pattern": "^x+$", "type": "string"}}), False),
        (closed({"a": False, "b": NUMBER}), closed({"a": False, "b": BYTE}), True),
        ({"properties": {"a": NUMBER}, "enum": [{"a": 1}]},
         {"properties": {"a": BYTE}, "enum": [{"a": 1}]}, True),
        (sequence(NUMBER, minItems=10**30), sequence(BYTE, minItems=10**30), False),
    ],
)  # fmt: skip
def test_a_place_that_no_message_reaches_is_no_difference(
    producer: Any, consumer: Any, fits: bool
) -> None:
    verdict = check(producer, consumer)
    if "000000000" not in str(producer):  # as long as none can be built
        assert (verdict.compatible, verdict.undecided) == (fits, None)
    assert verdict.compatible <= fits
    if verdict.counterexample is not None:
        verify_counterexample(verdict, producer, consumer)


def test_what_stands_before_the_items_is_made_even_if_no_message_needs_it() -> None:
    """To put an item at place 1 one stands at place 0, which `minItems` does not ask for."""
    narrower = {"allOf": [{"pattern": "^a"}, {"required": ["a"]}]}
    producer: Any = {"prefixItems": [{}], "items": {"pattern": "^a"}}
    consumer: Any = {"prefixItems": [{}], "items": narrower}
    verify_counterexample(check(producer, consumer), producer, consumer)


def changed(choices: RandomChoices, schema: Any) -> Any:
    """Return a schema with one schema in it, of a member or of items, widened or narrowed."""
    if isinstance(schema, dict) and isinstance(members := schema.get("properties"), dict):
        name = choices.item(list(members))
        return {**schema, "properties": {**members, name: changed(choices, members[name])}}
    if isinstance(schema, dict) and "items" in schema:
        return {**schema, "items": changed(choices, schema["items"])}
    return choices.item([NUMBER, BYTE, {"type": "integer"}, {"type": ["string", "null"]}, True])


@for_all("seed", range(150))
def test_it_says_what_a_search_of_the_whole_says(seed: int) -> None:
    choices = RandomChoices(seed)
    one = robot_schema(choices)
    other = changed(choices, one)
    for producer, consumer in ((one, other), (other, one)):
        shared = pool()
        goal = (
            (SchemaDocument(producer, shared).root, True),
            (SchemaDocument(consumer, shared).root, False),
        )
        whole = Solver(shared, search).solve(goal)
        verdict = check(producer, consumer)
        assert verdict.compatible is isinstance(whole, Unsatisfiable), verdict
        if answer(verdict) == "no":
            verify_counterexample(verdict, producer, consumer)
