"""The hand-written pairs: the checker decides each, and decides it rightly."""

from __future__ import annotations

import sys
from contextlib import contextmanager
from typing import TYPE_CHECKING

import pytest
from tests.schema import _hard_arrays, _hard_logic, _hard_objects, _hard_scalars, _hard_sizes
from tests.schema._judge import answer, verify_counterexample
from tests.schema._random_choices import RandomChoices
from tests.schema._reference import Reference

from uoarm.schema import CheckBudget, check
from uoarm.testing._instances import find_instance

if TYPE_CHECKING:
    from collections.abc import Iterator

    from tests.schema._hard import Hard

TABLES = {
    "scalars": _hard_scalars.PAIRS,
    "arrays": _hard_arrays.PAIRS,
    "objects": _hard_objects.PAIRS,
    "logic": _hard_logic.PAIRS,
    "sizes": _hard_sizes.PAIRS,
}
PAIRS = [
    pytest.param(pair, id=f"{t}: {pair.name}") for t, pairs in TABLES.items() for pair in pairs
]
PATIENT = CheckBudget(seconds=1_000)
FEW_STEPS = CheckBudget(steps=30_000, seconds=1_000)
HOSTILE = [pytest.param(pair, id=pair.name) for pair in _hard_sizes.HOSTILE]


@contextmanager
def deep_stack() -> Iterator[None]:
    """The reference validator recurses; the checker must not need this."""
    limit = sys.getrecursionlimit()
    sys.setrecursionlimit(20_000)
    try:
        yield
    finally:
        sys.setrecursionlimit(limit)


def hold_true(pair: Hard) -> None:
    """Hold that the table says the truth of a pair, as far as a validator finds out."""
    takes, wants = Reference(pair.producer), Reference(pair.consumer)
    with deep_stack():
        if not pair.contained:
            assert takes.accepts(pair.witness)
            assert not wants.accepts(pair.witness)
            return
        for seed in range(2):  # the checker, which looks by other means, is to say the same
            value, found = find_instance(pair.producer, RandomChoices(seed), takes.accepts)
            assert not found or wants.accepts(value), value


@pytest.mark.parametrize("pair", PAIRS)
def test_the_checker_decides_as_the_table_says_and_its_counterexample_is_one(pair: Hard) -> None:
    hold_true(pair)
    verdict = check(pair.producer, pair.consumer, budget=PATIENT)
    assert answer(verdict) == ("yes" if pair.contained else "no"), verdict.undecided
    if not pair.contained:
        with deep_stack():
            verify_counterexample(verdict, pair.producer, pair.consumer)


@pytest.mark.parametrize("pair", HOSTILE)
def test_hostile_input_ends_without_a_wrong_answer(pair: Hard) -> None:
    hold_true(pair)
    verdict = check(pair.producer, pair.consumer, budget=FEW_STEPS)
    assert answer(verdict) in {"yes", "undecided"}
