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
    assert len(check({**row, "minItems": 2**bits}, False).counterexample) == 2**bits
