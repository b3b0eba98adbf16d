"""The check: is `producer and not consumer` empty?"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, TypeAlias

from attrs import evolve

from uoarm.schema._errors import BudgetError, Meter, OutOfScopeError
from uoarm.schema._explain import CheckBudget, Verdict, explain, find_losses
from uoarm.schema._values import build, describe, is_small
from uoarm.schema.read import Pool, SchemaDocument, SchemaNode
from uoarm.schema.solve import (
    EMPTY,
    Empty,
    Found,
    Judgements,
    Messages,
    Result,
    Solver,
    Unknown,
    answer,
    differences,
)

__all__ = ["check"]

Schema: TypeAlias = Mapping[str, Any] | bool
_STANDARD = CheckBudget()
_WRITTEN = 20_000
"""Parts and characters up to which a counterexample is written out unasked."""


def check(
    producer: Schema,
    consumer: Schema,
    *,
    budget: CheckBudget | None = None,
) -> Verdict:
    """Decide whether every message that the producer can emit is accepted by the consumer.

    Args:
        producer: JSON Schema of draft 2020-12, or an older one that `$schema` names.
        consumer: likewise. Both may be hostile; the answer comes within the budget.
        budget: None for the standard one. What it does not suffice for is undecided.

    Raises:
        SchemaError: a schema is malformed; the text says where.
    """
    limits = budget or _STANDARD
    pool = Pool(Meter(limits.steps, limits.seconds, limits.octets))
    try:
        return _check(producer, consumer, pool)
    except (BudgetError, OutOfScopeError) as error:
        return Verdict(compatible=False, undecided=str(error))
    finally:
        pool.close()


def _check(producer: Schema, consumer: Schema, pool: Pool) -> Verdict:
    """Come to a verdict, or raise what keeps it from being one."""
    document, other = SchemaDocument(producer, pool), SchemaDocument(consumer, pool)
    if document.has_text_of(other):
        return Verdict(compatible=True, disputed_patterns=tuple(document.disputed))
    made, taken = document.root, other.root
    disputed = tuple(document.disputed | other.disputed)
    judgements = Judgements(pool.meter.spend)
    with pool.meter.part("the search"):
        result = _search(made, taken, pool, judgements)
    if isinstance(result, Found):
        refusal = _refusal(made, taken, result.value, pool.meter, judgements)
        return evolve(refusal, disputed_patterns=disputed)
    if isinstance(result, Unknown):
        return Verdict(compatible=False, undecided=result.cause)
    losses = find_losses(made, taken, pool.meter)
    return Verdict(compatible=True, losses=losses, disputed_patterns=disputed)


def _search(
    producer: SchemaNode, consumer: SchemaNode, pool: Pool, judgements: Judgements
) -> Result:
    """Look for a message of the producer that the consumer refuses, first where they differ."""
    solver, messages = Solver(pool, answer), Messages(pool.meter)

    def refused(one: SchemaNode, other: SchemaNode, found: Found) -> bool:
        accepts = judgements.accepts
        return accepts(one, found.value) and not accepts(other, found.value)

    for path, node, other in differences(producer, consumer, pool.meter):
        likely = messages.likely(node, other)
        found = next((value for value in likely if refused(node, other, value)), None)
        result = found or solver.solve(((node, True), (other, False)))
        if not path:
            return result
        if isinstance(result, Found):
            message = messages.place(producer, path, result.value)
            if message is not None and refused(producer, consumer, message):
                return message
        if not isinstance(result, Empty):
            return solver.solve(((producer, True), (consumer, False)))
    return EMPTY


def _refusal(
    producer: SchemaNode, consumer: SchemaNode, message: Any, meter: Meter, judgements: Judgements
) -> Verdict:
    """Return the verdict that a message comes to which the search has found.

    Raises:
        OutOfScopeError: whether the message is valid is not decided.
        BudgetError: nor within the budget.
    """
    with meter.part("the check of the counterexample"):
        if not judgements.accepts(producer, message) or judgements.accepts(consumer, message):
            return Verdict(compatible=False, undecided="internal: a counterexample did not hold")
    reasons, excerpt = explain(producer, consumer, message, judgements)
    short = is_small(message, _WRITTEN)
    return Verdict(
        compatible=False,
        reasons=reasons,
        counterexample=build(message) if short else None,
        excerpt=build(excerpt) if is_small(excerpt, _WRITTEN) else describe(excerpt),
        abridged=not short,
        message=message,
    )
