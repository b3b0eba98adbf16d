"""Arrays in which several demands meet: equal items, counts, distinct items."""

from __future__ import annotations

from typing import Any

from uoarm.schema import check


def test_the_value_that_comes_twice_is_chosen_with_the_counts() -> None:
    words = {"type": "array", "items": {"enum": [0, "s"]}}
    twice_and_no_zero = {"not": {"anyOf": [{"uniqueItems": True}, {"contains": {"const": 0}}]}}
    producer: dict[str, Any] = {"allOf": [words, twice_and_no_zero]}
    verdict = check(producer, {"contains": True, "maxContains": 1})
    assert verdict.counterexample == ["s", "s"]
