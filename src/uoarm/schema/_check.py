"""The check: is `producer and not consumer` empty?

Schemas of one text, which most are that meet in a robot, are compatible: the prover is not loaded
for them.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, TypeAlias

from attrs import evolve

from uoarm.schema._errors import BudgetError, Meter, OutOfScopeError
from uoarm.schema._verdict import CheckBudget, Verdict

Schema: TypeAlias = Mapping[str, Any] | bool
_STANDARD = CheckBudget()


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
    from uoarm.schema.read import Pool, SchemaDocument  # noqa: PLC0415 - when first needed

    limits = budget or _STANDARD
    pool = Pool(Meter(limits.steps, limits.seconds, limits.octets))
    try:
        document, other = SchemaDocument(producer, pool), SchemaDocument(consumer, pool)
        if document.has_text_of(other):
            return Verdict(compatible=True, disputed_patterns=tuple(document.disputed))
        from uoarm.schema._decide import decide  # noqa: PLC0415 - when first needed

        made, taken = document.root, other.root
        disputed = tuple(document.disputed | other.disputed)  # as far as the two are read by now
        verdict = decide(made, taken, pool)
        return verdict if verdict.undecided else evolve(verdict, disputed_patterns=disputed)
    except (BudgetError, OutOfScopeError) as error:
        return Verdict(compatible=False, undecided=str(error))
    finally:
        pool.close()
