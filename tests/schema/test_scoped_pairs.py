"""Documents with dynamic scopes, recursive and far references, against a second procedure."""

from __future__ import annotations

from collections import Counter

import jsonschema_rs
import pytest
from tests.schema._random_choices import RandomChoices
from tests.schema._scoped_judge import GENERATORS, judge_scoped
from tests.schema._scoped_schemas import dynamic_pair, recursive_pair
from tests.schema._worlds import Meaning, world


@pytest.mark.parametrize("block", range(6))
@pytest.mark.parametrize("kind", ["dynamic", "recursive", "far"])
def test_no_answer_is_wrong_in_a_small_world(kind: str, block: int) -> None:
    answers = Counter(
        judge_scoped(kind, RandomChoices(seed)) for seed in range(25 * block, 25 * block + 25)
    )
    assert answers["yes"], answers
    if kind != "far":
        assert answers["undecided"] <= 5, answers


@pytest.mark.long
@pytest.mark.parametrize("block", range(40))
@pytest.mark.parametrize("kind", GENERATORS)
def test_no_answer_is_wrong_for_two_thousand_pairs_of_a_kind(kind: str, block: int) -> None:
    for seed in range(10_000 + 50 * block, 10_050 + 50 * block):
        judge_scoped(kind, RandomChoices(seed))


@pytest.mark.parametrize("draw", [dynamic_pair, recursive_pair])
def test_a_public_validator_means_the_same(draw: object) -> None:
    """The second procedure reads dynamic scopes as Rust's validator does, where that is settled."""
    over = world(1)
    different = 0
    for seed in range(150):
        schema = draw(RandomChoices(seed))[0]  # type: ignore[operator] # a generator
        validator = jsonschema_rs.validator_for(schema)
        bits = sum(1 << n for n, value in enumerate(over.values) if validator.is_valid(value))
        different += bits != Meaning(schema, over).bits
    assert different <= 8, different
