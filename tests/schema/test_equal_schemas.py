"""Equal schemas are read once; only those that mean the same are equal."""

from __future__ import annotations

from types import MappingProxyType
from typing import Any

import pytest

from uoarm.schema import Budget, check

ALIKE_IN_PYTHON: list[tuple[Any, Any]] = [
    ({"const": 1}, {"const": True}),
    ({"enum": [0]}, {"enum": [False]}),
    ({"const": [1]}, {"const": [True]}),
    ({"const": {"a": 1}}, {"const": {"a": True}}),
    ({"const": (1,)}, {"const": (True,)}),
    (MappingProxyType({"const": 1}), MappingProxyType({"const": True})),
    ({"const": MappingProxyType({"a": 1})}, {"const": MappingProxyType({"a": True})}),
]


@pytest.mark.parametrize(("producer", "consumer"), ALIKE_IN_PYTHON)
def test_what_is_equal_to_python_alone_is_not_equal(producer: Any, consumer: Any) -> None:
    assert producer == consumer
    assert check(producer, consumer).incompatible


@pytest.mark.parametrize("keyword", ["$ref", "$dynamicRef"])
def test_equal_texts_with_references_that_lead_out_stay_two(keyword: str) -> None:
    verdicts = [check({keyword: "other.json"}, {keyword: "other.json"}) for _ in range(2)]
    assert all(verdict.undecided is not None for verdict in verdicts)


def test_equal_schemas_are_read_once() -> None:
    one, other = ({"type": "object", "required": [f"f{n}" for n in range(9)],
                   "properties": {f"f{n}": {"type": "number"} for n in range(9)}}
                  for _ in range(2))  # fmt: skip
    budget = Budget(steps=_steps(one, {}) + 20)
    assert check(one, other, budget=budget).compatible


def _steps(producer: Any, consumer: Any) -> int:
    """The fewest steps that the check of a pair needs."""
    most = 1
    while check(producer, consumer, budget=Budget(steps=most)).undecided is not None:
        most += 1
    return most
