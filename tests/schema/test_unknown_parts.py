"""The law of the unknown: what is decided beside an unknown schema holds whatever that one is."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import pytest
from tests.schema._judge import answer, shown
from tests.schema._random_choices import RandomChoices
from tests.schema._unknown_parts import PAIRS, UNKNOWN, fillings, places, replaced

from uoarm.schema import check
from uoarm.testing._instances import chance

if TYPE_CHECKING:
    from collections.abc import Callable

    from tests.schema._judge import Body

    from uoarm.testing._instances import Choices


@pytest.mark.parametrize(
    "block", [*range(3), *(pytest.param(block, marks=pytest.mark.long) for block in range(3, 30))]
)
@pytest.mark.parametrize("draw", PAIRS)
def test_a_verdict_beside_an_unknown_schema_holds_for_any_schema(
    draw: Callable[[Choices], tuple[Body, Body]], block: int
) -> None:
    decided = 0
    for seed in range(40 * block, 40 * block + 40):
        choices = RandomChoices(seed)
        pair = draw(choices)
        side = choices.integer(0, 1)
        where = list(places(pair[side]))
        if not where:
            continue
        path = choices.item(where)
        both = chance(choices, 40) and path in set(places(pair[1 - side]))

        def with_part(part: Body) -> tuple[Body, Body]:
            sides: list[Any] = list(pair)  # noqa: B023 - called in this round
            for n in {side, 1 - side} if both else {side}:  # noqa: B023 - called in this round
                sides[n] = replaced(sides[n], path, part)  # noqa: B023 - called in this round
            return sides[0], sides[1]

        unknown = with_part(UNKNOWN)
        given = answer(check(*unknown))
        if given == "undecided":
            continue
        decided += 1
        known = [with_part(filling) for filling in fillings(choices)]
        for item in [*known, *([] if both else [pair])]:
            other = answer(check(*item))
            assert other in {given, "undecided"}, (seed, given, shown(*unknown), shown(*item))
    assert decided, "nothing was decided, so nothing was tried"
