"""Random schemas that speak of several kinds of value at once, or of one in every way.

Keywords of one kind say nothing of the others, so their negations meet in one choice: what holds
for an array stands beside what holds for a text, a list of values and a number of members.
"""

from __future__ import annotations

from collections.abc import Sequence

from tests.schema._hand_schemas import KINDS, WRITERS, Schema, logic
from tests.schema._rewrites import negated

from uoarm.testing._instances import Choices, chance

Body = bool | dict[str, object]


def mixed_schema(choices: Choices, depth: int, kinds: Sequence[str] = KINDS) -> Schema | bool:
    """One schema without references; its keywords are about these kinds."""
    if depth == 0 and chance(choices, 30):
        return choices.item((True, False))

    def inner() -> Schema | bool:
        return mixed_schema(choices, depth - 1, kinds) if depth > 0 else choices.item((True, False))

    schema: Schema = {}
    for _ in range(choices.integer(1, 4)):
        if chance(choices, 35):
            schema.update(logic(choices, inner))
        else:
            written = WRITERS[choices.item(kinds)](choices, inner)
            schema.update([choices.item(tuple(written.items()))] if written else [])
    if chance(choices, 25):
        schema["type"] = choices.item(KINDS)
    return schema


def mixed_pair(choices: Choices) -> tuple[Body, Body]:
    """Two of them, of which the second may refuse what the first one refuses."""
    kinds = choices.item((KINDS, ("object",), ("array",)))
    producer, consumer = (mixed_schema(choices, choices.integer(0, 2), kinds) for _ in range(2))
    kind = choices.integer(0, 3)
    if kind == 0:
        return producer, {"anyOf": [consumer, producer]}
    if kind == 1:
        return producer, negated(consumer)
    return producer, consumer
