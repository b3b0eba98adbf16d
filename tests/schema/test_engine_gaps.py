"""What is not decided stays undecided wherever it stands, and is never taken for absent."""

from __future__ import annotations

from typing import Any

import pytest

from uoarm.schema import check

GAP: dict[str, Any] = {"unevaluatedProperties": False}
OBJECT: dict[str, Any] = {"type": "object"}


@pytest.mark.parametrize(
    "consumer",
    [
        GAP,
        {"allOf": [GAP]},
        {"properties": {"a": {"type": "string"}}, "$ref": "#/$defs/gap", "$defs": {"gap": GAP}},
        {"required": [], "allOf": [GAP, {"maxProperties": 9}]},
        {"anyOf": [GAP, {"type": "null"}]},
        {"not": {"not": GAP}},
        {"oneOf": [GAP, {"type": "null"}]},
        {"if": True, "then": GAP},
        {"$schema": "tag:nowhere,2026:other", "type": "object"},
        {"allOf": [{"$dynamicRef": "#x"}, {"minProperties": 0}]},
    ],
)
def test_a_gap_is_never_a_yes(consumer: dict[str, Any]) -> None:
    assert not check(OBJECT, consumer).compatible


def test_a_gap_about_objects_does_not_concern_numbers() -> None:
    assert check({"type": "integer"}, {"type": ["object", "number"], **GAP}).compatible
