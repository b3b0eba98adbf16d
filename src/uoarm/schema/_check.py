"""The check: is `producer and not consumer` empty?"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, TypeAlias

from uoarm.schema._document import Document, Pool
from uoarm.schema._errors import OutOfScopeError
from uoarm.schema._evaluate import accepts
from uoarm.schema._explain import explain, find_losses
from uoarm.schema._results import Found, Result, Unknown
from uoarm.schema._solve import BudgetError, Solver
from uoarm.schema._verdict import Budget, Verdict

__all__ = ["check"]

Schema: TypeAlias = Mapping[str, Any] | bool
_STANDARD = Budget()


def check(
    producer: Schema,
    consumer: Schema,
    *,
    budget: Budget | None = None,
) -> Verdict:
    """Decide whether every message that the producer can emit is accepted by the consumer.

    Args:
        producer: JSON Schema of draft 2020-12, or an older one that `$schema` names.
        consumer: likewise. Both may be hostile; the answer comes within the budget.
        budget: None for the standard one.

    Raises:
        SchemaError: a schema is malformed; the text says where.
    """
    limits = budget or _STANDARD
    pool = Pool()
    try:
        made, taken = Document(producer, pool), Document(consumer, pool)
    except OutOfScopeError as error:
        return Verdict(compatible=False, undecided=str(error))
    solver = Solver(pool, limits.steps, limits.seconds)
    result: Result
    try:
        result = solver.solve(((made.root, True), (taken.root, False)))
    except (BudgetError, OutOfScopeError) as error:
        result = Unknown(str(error))
    if isinstance(result, Unknown):
        return Verdict(compatible=False, undecided=result.cause)
    if not isinstance(result, Found):
        return Verdict(compatible=True, losses=find_losses(made.root, taken.root))
    message = result.value
    try:
        proven = accepts(made.root, message) and not accepts(taken.root, message)
    except OutOfScopeError as error:
        return Verdict(compatible=False, undecided=str(error))
    if not proven:
        return Verdict(compatible=False, undecided="internal: a counterexample did not hold")
    reasons, excerpt = explain(made.root, taken.root, message)
    return Verdict(compatible=False, reasons=reasons, counterexample=message, excerpt=excerpt)
