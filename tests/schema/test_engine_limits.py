"""Where the engine stops counting it says so; it neither guesses nor runs away."""

from __future__ import annotations

from typing import Any

import pytest

from uoarm.schema import CheckBudget, check

OBJECT = {"type": "object"}
ARRAY = {"type": "array"}

BEYOND: dict[str, tuple[Any, Any, str]] = {
    "patterns that may be evaluated": (
        OBJECT,
        {
            "anyOf": [{"patternProperties": {f"^{n}": True}} for n in range(7)],
            "unevaluatedProperties": {"type": "integer"},
        },
        "patterns of names",
    ),
    "contains that may be evaluated": (
        {**ARRAY, "minItems": 1, "items": {"enum": [0, "x"]}},
        {
            "anyOf": [{"contains": {"const": n}} for n in range(7)],
            "unevaluatedItems": {"type": "integer"},
        },
        "contains",
    ),
    "schemas beside an unevaluated keyword": (
        OBJECT,
        {"allOf": [{"title": "x"}] * 2_000, "unevaluatedProperties": {"type": "integer"}},
        "stand beside",
    ),
    "contains in one array": (
        {"allOf": [ARRAY, *({"contains": {"const": n}} for n in range(9))]},
        {"contains": {"const": "x"}},
        "contains meet",
    ),
    "overlapping alternatives": (
        {"type": "string"},
        {"oneOf": [{"minLength": n} for n in range(700)]},
        "oneOf",
    ),
    "distinct items": (
        {"type": "array", "uniqueItems": True, "minItems": 5_000},
        False,
        "distinct items",
    ),
    "distinct and counted items": (
        {"type": "array", "uniqueItems": True, "contains": {"type": "integer"}, "minContains": 999},
        False,
        "distinct items",
    ),
    "counted items": (
        {"type": "array", "contains": {"type": "integer"}, "minContains": 9_999},
        False,
        "counted through",
    ),
    "names by many patterns": (
        {"patternProperties": {f"^{n}": True for n in range(9)}, "minProperties": 1, **OBJECT},
        False,
        "patterns of names",
    ),
    "a longer text than is of use": (
        {"type": "string", "minLength": 2**31},
        False,
        "characters",
    ),
    "a longer array than is of use": ({"type": "array", "minItems": 2**31}, False, "items"),
    "a wider object than is of use": (
        {"type": "object", "minProperties": 2**31},
        False,
        "members",
    ),
}


@pytest.mark.parametrize(("producer", "consumer", "cause"), BEYOND.values(), ids=BEYOND.keys())
def test_what_is_beyond_is_undecided_and_says_why(producer: Any, consumer: Any, cause: str) -> None:
    verdict = check(producer, consumer)
    assert not verdict.compatible
    assert verdict.undecided is not None
    assert cause in verdict.undecided


@pytest.mark.parametrize(("steps", "seconds", "cause"), [(0, 100.0, "steps"), (10**9, 0.0, "time")])
def test_a_spent_budget_says_of_what(steps: int, seconds: float, cause: str) -> None:
    fields = {f"f{n}": {"type": ["integer", "string"], "minLength": n} for n in range(200)}
    message = {"type": "object", "properties": fields, "required": list(fields)}
    verdict = check(message, message | {"x": 1}, budget=CheckBudget(steps=steps, seconds=seconds))
    assert verdict.undecided is not None
    assert cause in verdict.undecided


def test_more_steps_of_numbers_than_are_taken_apart_at_once_are_still_decided() -> None:
    primes = (2, 3, 5, 7, 11)
    producer = {"type": "integer", "multipleOf": 2310}
    assert check(producer, {"allOf": [{"multipleOf": number} for number in primes]}).compatible
    verdict = check({"type": "integer"}, {"anyOf": [{"multipleOf": number} for number in primes]})
    assert all(verdict.counterexample % number for number in primes)
