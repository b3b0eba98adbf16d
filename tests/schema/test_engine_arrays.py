"""Arrays in which several demands meet: equal items, counts, distinct items."""

from __future__ import annotations

from typing import Any

import pytest

from uoarm.schema import check


def test_the_value_that_comes_twice_is_chosen_with_the_counts() -> None:
    words = {"type": "array", "items": {"enum": [0, "s"]}}
    twice_and_no_zero = {"not": {"anyOf": [{"uniqueItems": True}, {"contains": {"const": 0}}]}}
    producer: dict[str, Any] = {"allOf": [words, twice_and_no_zero]}
    verdict = check(producer, {"contains": True, "maxContains": 1})
    assert verdict.counterexample == ["s", "s"]


@pytest.mark.parametrize("count", [2, 129, 200, 300])
def test_there_are_as_many_distinct_values_as_one_wants(count: int) -> None:
    """A number that floats cannot hold once came again instead of a new one: a wrong yes."""
    verdict = check({"type": "array", "uniqueItems": True, "minItems": count}, False)
    assert len({repr(item) for item in verdict.counterexample}) == count


@pytest.mark.parametrize("bits", [2, 5, 7])
def test_there_are_only_as_many_distinct_values_as_there_are(bits: int) -> None:
    digits = {"type": "integer", "minimum": 0, "maximum": 2**bits - 1}
    row = {"type": "array", "items": digits, "uniqueItems": True}
    assert check({**row, "minItems": 2**bits + 1}, False).compatible
    assert len(check({**row, "minItems": 2**bits}, False).build_counterexample()) == 2**bits


@pytest.mark.parametrize("short", [{"maxItems": 0}, {"items": False, "maxItems": 1}])
@pytest.mark.parametrize(
    "consumer",
    [
        {"const": 0, "maxItems": 1},
        {"const": None, "maxItems": 0},
        {"enum": [0, "a", [1]], "minItems": 0, "maxItems": 1},
        {"const": 0, "items": {"type": "number"}},
        {"const": 0, "uniqueItems": True, "maxItems": 1},
        {"anyOf": [{"const": 0, "maxItems": 1}, {"const": "a", "uniqueItems": True}]},
    ],
)
def test_a_list_of_values_is_no_matter_of_equal_items(
    short: dict[str, Any], consumer: dict[str, Any]
) -> None:
    """Beside a length, `const` of another kind was once judged as `two items are equal`."""
    assert check({"type": "array", **short}, consumer).counterexample == []


@pytest.mark.parametrize("length", [0, 1, 2])
def test_equal_and_distinct_items_beside_a_length(length: int) -> None:
    short = {"type": "array", "minItems": length, "maxItems": length}
    distinct = {"uniqueItems": True}
    assert check(short, {**distinct, "minItems": length}).compatible == (length < 2)
    assert check({**short, **distinct}, {"not": {**distinct, "minItems": 1}}).compatible == (
        length == 0
    )


@pytest.mark.parametrize("size", [0, 1, 3])
def test_an_array_that_is_excluded_excludes_none_that_begins_as_it_does(size: int) -> None:
    ones = {"type": "array", "items": {"const": 1}, "minItems": size, "maxItems": max(size, 2)}
    verdict = check({"allOf": [ones]}, {"const": [1, 1]})
    assert verdict.counterexample == [1] * size
