"""Holds one verdict of the checker to what can be known without it."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING

import jsonschema_rs
from jsonschema import Draft202012Validator
from tests.schema._reference import Reference

from uoarm.schema import CheckBudget, Verdict, check
from uoarm.testing._instances import find_instance

if TYPE_CHECKING:
    from collections.abc import Iterable

    from uoarm.testing._instances import Choices

Body = bool | dict[str, object]


class WrongVerdictError(AssertionError):
    """The checker said something that an instance disproves."""


def shown(producer: object, consumer: object) -> str:
    return f"\nproducer = {json.dumps(producer)}\nconsumer = {json.dumps(consumer)}"


def answer(verdict: Verdict) -> str:
    """ "yes", "no" or "undecided"; raises when the verdict claims several or none."""
    claims = {
        "yes": verdict.compatible,
        "no": verdict.incompatible,
        "undecided": verdict.undecided is not None,
    }
    made = [name for name, claimed in claims.items() if claimed]
    if len(made) != 1:
        raise WrongVerdictError(f"claims {made}: {verdict!r}")
    return made[0]


def judge(
    producer: Body,
    consumer: Body,
    choices: Choices,
    *,
    samples: int = 5,
    universe: Iterable[object] = (),
    budget: CheckBudget | None = None,
) -> str:
    """The checker's answer, after trying to disprove it."""
    verdict = check(producer, consumer, budget=budget)
    given = answer(verdict)
    takes, wants = Reference(producer), Reference(consumer)
    if given == "yes":
        for _ in range(samples):
            value, found = find_instance(producer, choices, takes.accepts)
            if found and not wants.accepts(value):
                raise WrongVerdictError(f"yes, but {value!r}{shown(producer, consumer)}")
        for value in universe:
            if takes.accepts(value) and not wants.accepts(value):
                raise WrongVerdictError(f"yes, but {value!r}{shown(producer, consumer)}")
    if given == "no":
        verify_counterexample(verdict, producer, consumer)
    return given


def verify_counterexample(verdict: Verdict, producer: Body, consumer: Body) -> None:
    """The counterexample is a JSON value that the producer emits and the consumer refuses."""
    value = verdict.build_counterexample()
    where = f"{value!r}{shown(producer, consumer)}"
    if json.loads(json.dumps(value)) != value:
        raise WrongVerdictError(f"not a JSON value: {where}")
    if not Reference(producer).accepts(value):
        raise WrongVerdictError(f"the producer does not emit {where}")
    if Reference(consumer).accepts(value):
        raise WrongVerdictError(f"the consumer accepts {where}")
    if not verdict.reasons:
        raise WrongVerdictError(f"refused without a reason: {where}")


def other_validators_agree(value: object, producer: Body, consumer: Body) -> bool:
    """Whether two public validators see the counterexample as we do."""
    return (
        Draft202012Validator(producer).is_valid(value)
        and not Draft202012Validator(consumer).is_valid(value)
        and jsonschema_rs.Draft202012Validator(producer).is_valid(value)
        and not jsonschema_rs.Draft202012Validator(consumer).is_valid(value)
    )
