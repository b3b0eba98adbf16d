"""Hypothesis strategies for schemas and for related pairs of them."""

from __future__ import annotations

from typing import TYPE_CHECKING, TypeVar

from hypothesis import strategies as st
from tests.schema._hand_schemas import hand_schema
from tests.schema._rewrites import equivalent, loosened, tightened
from tests.schema._robot_schemas import robot_schema

from uoarm.testing._instances import Choices, DrawnChoices

if TYPE_CHECKING:
    from collections.abc import Callable

    from hypothesis.strategies import DrawFn, SearchStrategy

Body = bool | dict[str, object]
Made = TypeVar("Made")
Pair = tuple[Body, Body]


def drawn(make: Callable[[Choices], Made]) -> SearchStrategy[Made]:
    """A strategy out of a generator over choices."""

    @st.composite
    def strategy(draw: DrawFn) -> Made:
        return make(DrawnChoices(draw))

    return strategy()


def any_schema(choices: Choices) -> Body:
    if choices.integer(0, 2) == 0:
        return robot_schema(choices, 2)
    return hand_schema(choices, choices.integer(1, 3))


def related_pair(choices: Choices) -> Pair:
    """Two schemas that have much in common, so that both answers occur."""
    schema = any_schema(choices)
    kind = choices.integer(0, 5)
    if kind == 0:
        return schema, any_schema(choices)
    if kind == 1:
        return tightened(choices, schema), schema
    if kind == 2:
        return schema, tightened(choices, schema)
    if kind == 3:
        return loosened(choices, schema), equivalent(choices, schema)
    if kind == 4:
        return equivalent(choices, schema), loosened(choices, schema)
    return tightened(choices, loosened(choices, schema)), equivalent(choices, schema)


schemas = drawn(any_schema)
pairs = drawn(related_pair)
