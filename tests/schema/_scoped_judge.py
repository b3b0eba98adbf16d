"""Holds a verdict on documents of several documents to the exact truth in a finite world."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from tests.schema._judge import WrongVerdictError, answer, shown
from tests.schema._scoped_schemas import (
    BESIDE,
    FAR,
    ROOT,
    dynamic_pair,
    far_document,
    far_pair,
    recursive_pair,
)  # fmt: skip
from tests.schema._worlds import InPlaceError, Meaning, World, world

from uoarm.schema import SchemaError, Verdict, check
from uoarm.testing._instances import chance

if TYPE_CHECKING:
    from collections.abc import Mapping

    from tests.schema._scoped_schemas import Body, Pair, Schema

    from uoarm.testing._instances import Choices

GENERATORS = {"dynamic": dynamic_pair, "recursive": recursive_pair, "far": far_pair}
_WORLDS_OUTSIDE = 3


def judge_scoped(kind: str, choices: Choices) -> str:
    """The answer for a pair of a kind of generator, after trying to disprove it.

    "malformed" and "in place" are no answers: the pair has no meaning. The producer is bounded by a
    small world, so that the truth is known; what lies outside is filled in in several ways.

    Raises:
        WrongVerdictError: the answer is not true.
    """
    producer, consumer = GENERATORS[kind](choices)
    over = world(2 if chance(choices, 25) else 1)
    producer = {**producer, "allOf": [*producer["allOf"], over.bound]}
    try:
        verdict = check(producer, consumer)
    except SchemaError:
        return "malformed"
    try:
        for _ in range(_WORLDS_OUTSIDE if kind == "far" else 1):
            _verify(verdict, (producer, consumer), over, _outside(choices, producer, consumer))
    except InPlaceError:
        return "in place"
    return answer(verdict)


def _outside(
    choices: Choices, producer: Schema, consumer: Schema
) -> tuple[Mapping[str, Body], Mapping[str, Body]]:
    """What lies behind the far references of either side: one world, but for what is relative."""
    shared = {uri: far_document(choices) for uri in (*FAR, BESIDE)}
    sides = []
    for item in (producer, consumer):
        if "$id" in item:
            sides.append(shared)
        else:
            sides.append({**shared, ROOT: True, "other.json": far_document(choices)})
    return sides[0], sides[1]


def _verify(
    verdict: Verdict,
    pair: Pair,
    over: World,
    outside: tuple[Mapping[str, Any], Mapping[str, Any]],
) -> None:
    given = answer(verdict)
    takes, wants = (Meaning(item, over, far) for item, far in zip(pair, outside, strict=True))
    where = f"{outside}{shown(*pair)}"
    refused = takes.bits & ~wants.bits
    if given == "yes" and refused:
        value = over.values[refused.bit_length() - 1]
        raise WrongVerdictError(f"yes, but {value!r}, with {where}")
    if given == "no" and not (
        takes.allows(verdict.counterexample) and not wants.allows(verdict.counterexample)
    ):
        raise WrongVerdictError(f"no for {verdict.counterexample!r}, with {where}")
