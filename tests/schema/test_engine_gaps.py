"""What is not decided stays undecided wherever it stands, and is never taken for absent."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import pytest

from uoarm.schema import check

GAP: dict[str, Any] = {"$ref": "tag:nowhere,2026:other"}
OBJECT: dict[str, Any] = {"type": "object"}


@pytest.mark.parametrize(
    "consumer",
    [
        GAP,
        {"allOf": [GAP]},
        {"properties": {"a": {"type": "string"}}, "$ref": "#/$defs/gap", "$defs": {"gap": GAP}},
        {"unevaluatedProperties": GAP},
        {"allOf": [GAP], "unevaluatedProperties": {"type": "object"}},
        {"anyOf": [GAP, {"properties": {"a": True}}], "unevaluatedProperties": False},
        {"required": [], "allOf": [GAP, {"maxProperties": 9}]},
        {"anyOf": [GAP, {"type": "null"}]},
        {"not": {"not": GAP}},
        {"oneOf": [GAP, {"type": "null"}]},
        {"if": True, "then": GAP},
        {"$schema": "tag:nowhere,2026:other", "type": "object"},
        {"allOf": [{"$dynamicRef": "tag:nowhere,2026:other#x"}, {"minProperties": 0}]},
    ],
)
def test_a_gap_is_never_a_yes(consumer: dict[str, Any]) -> None:
    assert not check(OBJECT, consumer).compatible


def test_a_gap_about_texts_does_not_concern_numbers() -> None:
    refers_back = {"type": ["string", "number"], "pattern": r"(a)\1"}
    assert check({"type": "integer"}, refers_back).compatible
    assert check({"type": "string"}, refers_back).undecided is not None


def test_a_gap_in_one_way_does_not_hide_another() -> None:
    verdict = check({"anyOf": [GAP, {"const": 1}]}, {"type": "string"})
    assert verdict.counterexample == 1


def test_a_gap_beside_a_contradiction_does_not_matter() -> None:
    producer = {"allOf": [GAP, {"type": "integer"}, {"type": "string"}]}
    assert check(producer, False).compatible


PLACES: dict[str, Callable[[Any], dict[str, Any]]] = {
    "member": lambda part: {"type": "object", "properties": {"a": part}},
    "member by pattern": lambda part: {"type": "object", "patternProperties": {"^a": part}},
    "other member": lambda part: {"type": "object", "additionalProperties": part},
    "name": lambda part: {"type": "object", "propertyNames": part},
    "dependent": lambda part: {"type": "object", "dependentSchemas": {"a": part}},
    "item": lambda part: {"type": "array", "items": part},
    "first item": lambda part: {"type": "array", "prefixItems": [part]},
    "some item": lambda part: {"type": "array", "contains": part},
    "no item": lambda part: {"type": "array", "contains": part, "minContains": 0, "maxContains": 0},
    "all of": lambda part: {"allOf": [part]},
    "any of": lambda part: {"anyOf": [part, {"type": "null"}]},
    "one of": lambda part: {"oneOf": [part, {"type": "null"}]},
    "not": lambda part: {"not": part},
    "if": lambda part: {"if": part, "then": {"type": "null"}, "else": {"type": "boolean"}},
    "unevaluated member": lambda part: {"type": "object", "unevaluatedProperties": part},
    "unevaluated item": lambda part: {"type": "array", "unevaluatedItems": part},
}


@pytest.mark.parametrize("place", PLACES.values(), ids=PLACES)
def test_a_gap_in_any_place_is_never_taken_for_nothing(
    place: Callable[[Any], dict[str, Any]],
) -> None:
    loose = {"type": place(GAP).get("type", "string")}
    assert not check(loose, place(GAP)).compatible
    assert check(place({"$ref": "tag:nowhere,2026:one"}), place(GAP)).undecided


def test_numbers_that_cannot_be_written_are_no_yes_among_hundreds_of_ranges() -> None:
    """Between neighbours of doubles there are numbers; that none was found proves nothing."""
    ranges = [{"minimum": n + 0.25, "maximum": n + 0.5} for n in range(2, 400)]
    between = {"exclusiveMinimum": 1, "exclusiveMaximum": math.nextafter(1, 2)}
    producer = {"type": "number", "anyOf": [between, *ranges]}
    assert check(producer, {"anyOf": ranges}).undecided is not None
    assert check({"type": "number", "anyOf": ranges}, {"anyOf": ranges[::-1]}).compatible
