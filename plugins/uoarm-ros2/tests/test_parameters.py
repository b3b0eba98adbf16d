"""Parameters as the configuration writes them, and what nodes say of them; no node is there."""

from __future__ import annotations

from typing import Any

import pytest
from uoarm_ros2._parameters import flattened, holds, mistakes, value_for

BOOL, INTEGER, DOUBLE, STRING, BYTES, BOOLS, INTEGERS, DOUBLES, STRINGS = range(1, 10)


def descriptor(kind: int, *, dynamic: bool = False) -> dict[str, Any]:
    return {
        "type": kind,
        "dynamic_typing": dynamic,
        "integer_range": [],
        "floating_point_range": [],
    }


def test_names_are_joined_and_lists_stay_whole() -> None:
    given = {"gain": 1, "camera": {"fps": 30, "names": ("left", "right")}, "a.b": True}
    assert flattened(given) == {
        "gain": 1,
        "camera.fps": 30,
        "camera.names": ["left", "right"],
        "a.b": True,
    }


@pytest.mark.parametrize("value", [None, [1, "a"], [[1]], 2**63, [None], "a\0b", {"x": None}])
def test_a_value_that_no_parameter_holds_is_reported_before_a_call(
    value: object,
) -> None:
    assert list(mistakes({"good": 1, "bad": value})) == ["bad"]


@pytest.mark.parametrize(
    ("kind", "value", "field", "sent"),
    [
        (BOOL, True, "bool_value", True),
        (INTEGER, -(2**63), "integer_value", -(2**63)),
        (DOUBLE, 3, "double_value", 3.0),
        (STRING, "", "string_value", ""),
        (BYTES, [0, 255], "byte_array_value", [0, 255]),
        (BOOLS, [], "bool_array_value", []),
        (INTEGERS, [1], "integer_array_value", [1]),
        (DOUBLES, (1, 0.5), "double_array_value", [1.0, 0.5]),
        (STRINGS, ["a"], "string_array_value", ["a"]),
    ],
)
def test_a_value_is_sent_as_its_type(kind: int, value: object, field: str, sent: object) -> None:
    made: Any = value_for(value, descriptor(kind))
    assert (made["type"], made[field]) == (kind, sent)
    assert type(made[field]) is type(sent)
    assert holds(made, made)
    assert not holds({**made, "type": 0}, made)


@pytest.mark.parametrize(
    ("kind", "value"),
    [(BOOL, 1), (INTEGER, True), (INTEGER, 1.0), (DOUBLE, "1"), (STRING, 1), (BYTES, [256])],
)
def test_a_value_of_another_type_is_refused(kind: int, value: object) -> None:
    with pytest.raises(ValueError, match="expected a"):
        value_for(value, descriptor(kind))


def test_where_any_type_may_be_the_value_says_it() -> None:
    made: Any = value_for(1.5, descriptor(STRING, dynamic=True))
    assert made["type"] == DOUBLE
    with pytest.raises(ValueError, match="does not say what it would hold"):
        value_for([], descriptor(0))


@pytest.mark.parametrize("value", ["seven", ["a"], True, 0.5])
def test_a_range_of_integers_says_nothing_of_other_values(value: object) -> None:
    stated = {"integer_range": [{"from_value": 5, "to_value": 10, "step": 1}]}
    assert value_for(value, {**descriptor(INTEGER, dynamic=True), **stated})


def test_a_number_at_the_end_of_its_range_is_left_to_the_node() -> None:
    stated = {"floating_point_range": [{"from_value": 0.0, "to_value": 0.3, "step": 0.1}]}
    assert value_for(3 * 0.1, {**descriptor(DOUBLE), **stated})
    with pytest.raises(ValueError, match=r"expected 0 to 0\.3, got 0\.31"):
        value_for(0.31, {**descriptor(DOUBLE), **stated})
