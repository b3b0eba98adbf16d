"""Structures whose values may be of several types are no riddle to the kit."""

from __future__ import annotations

from typing import Any

import pytest

from uoarm.testing.conformance._world import find_other_type, with_integers, with_length

ANY_OF: Any = {"type": ["array", "boolean", "number", "string"]}
SCHEMA: Any = {
    "type": "object",
    "properties": {
        "value": ANY_OF,
        "values": {"type": "array", "items": ANY_OF},
        "n": {"type": "integer"},
    },
}


@pytest.mark.parametrize("value", [True, 1, 1.5, "text", [1]])
def test_a_value_of_several_types_is_taken_as_it_is(value: object) -> None:
    message = {"value": value, "values": [value]}
    assert find_other_type(SCHEMA, message) == ""
    assert with_integers(SCHEMA, message) == message
    assert with_length(SCHEMA, message)["values"] == [value]


def test_beside_it_a_wrong_type_is_still_found() -> None:
    assert "a float where the structure says integer" in find_other_type(SCHEMA, {"n": 1.0})
