"""Pairs by seed, without hypothesis: quick enough to be run against every mutant of the checker."""

from __future__ import annotations

from typing import TYPE_CHECKING

import pytest
from tests.schema._judge import answer, judge, shown
from tests.schema._mixed_schemas import mixed_pair
from tests.schema._random_choices import RandomChoices
from tests.schema._strategies import related_pair
from tests.schema._unions import range_pair, row_pair, tagged_pair
from tests.schema._universe import universe
from tests.schema._watching import watching_pair

from uoarm.schema import check
from uoarm.testing._instances import chance

if TYPE_CHECKING:
    from collections.abc import Callable

    from tests.schema._judge import Body

    from uoarm.testing._instances import Choices

    Known = tuple[Body, Body, str]

EVERYTHING = tuple(universe())
SOME = EVERYTHING[::9]
SMALL = EVERYTHING[:40]


@pytest.mark.parametrize("block", range(4))
def test_pairs_of_a_block_of_seeds(block: int) -> None:
    for seed in range(100 * block, 100 * block + 100):
        choices = RandomChoices(seed)
        pair = related_pair(choices)
        judge(*pair, choices, universe=EVERYTHING if chance(choices, 20) else SOME)


@pytest.mark.parametrize("block", range(20))
def test_pairs_that_speak_of_several_kinds_at_once(block: int) -> None:
    for seed in range(100 * block, 100 * block + 100):
        choices = RandomChoices(seed)
        judge(*mixed_pair(choices), choices, universe=(*SMALL, *SOME))


@pytest.mark.parametrize("block", range(3))
@pytest.mark.parametrize("draw", [watching_pair, range_pair, row_pair, tagged_pair])
def test_pairs_of_known_truth(draw: Callable[[Choices], Known], block: int) -> None:
    for seed in range(50 * block, 50 * block + 50):
        producer, consumer, truth = draw(RandomChoices(seed))
        assert answer(check(producer, consumer)) == truth, (seed, shown(producer, consumer))
