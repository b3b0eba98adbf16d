"""The verdict on one edge: mapping applied, containment proven, losses allowed, meaning judged."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Mapping
from typing import Any

from attrs import evolve, frozen

from uoarm._adapt._adaptation import Adaptation, adapt
from uoarm._adapt._mapping import MappingError, UnfitError, parse
from uoarm._adapt._suggest import converting_map, flow, suggest, untried_conversion
from uoarm._meaning import (
    JSON_LIMIT,
    OCTETS_LIMIT,
    MeaningDifference,
    judge,
    sizes_of,
    write_places,
)
from uoarm.model import Edge, Meaning, MeaningLevel, Message, MessageStructure, Reason
from uoarm.schema import CheckBudget, SchemaError, Verdict, check

_CHECK_SECONDS = 10.0
_SUGGEST_SECONDS = 5.0
_MAX_LOSSES = 200
_STATED = Meaning()
_NO_SCHEMA = "UOA-226"


@frozen
class EdgeVerdict:
    """Whether every message of a producer is accepted by a consumer, and at what cost.

    Attributes:
        compatible: proven, and every loss is allowed.
        reasons: why not; the first carries configuration lines that would mend it, if any.
        losses: producer's fields that are dropped, all allowed by name.
        warnings: what a careful reader should know.
        unstated: paths of numbers and octets of whose meaning one side says nothing.
        differences: what both sides state of the meaning and do not agree on.
        is_undecided: whether it is refused only since it is not known, for want of time mostly.
    """

    compatible: bool
    reasons: tuple[Reason, ...] = ()
    losses: tuple[str, ...] = ()
    warnings: tuple[str, ...] = ()
    unstated: tuple[str, ...] = ()
    differences: tuple[MeaningDifference, ...] = ()
    is_undecided: bool = False


def check_edge(
    producer: MessageStructure,
    consumer: MessageStructure,
    mapping: Mapping[str, object] | None = None,
    allow_loss: tuple[str, ...] = (),
    meaning: Meaning = _STATED,
    *,
    seconds: float = _CHECK_SECONDS,
    suggest_seconds: float = _SUGGEST_SECONDS,
) -> EdgeVerdict:
    """Judge one edge. Raises nothing; works for some 15 s at most, whatever the structures are.

    Equal arguments give equal verdicts, but where the time did not suffice: then the reason says
    so, or it has no suggestion. A machine that has other work takes nothing from the time of a
    suggestion, which is that of this thread: a refusal has its lines there, too, only later.

    Args:
        producer: structure of what is emitted.
        consumer: structure of what is taken.
        mapping: the adapter, None to pass messages unchanged.
        allow_loss: fields that may be dropped.
        meaning: how the meaning of what fits in shape is judged.
        seconds: for the proof, about.
        suggest_seconds: of work for a suggestion of what would mend a refusal; 0: there is none.
    """
    verdict = _judge(producer, consumer, mapping, allow_loss, meaning, CheckBudget(seconds=seconds))
    is_explained = verdict.compatible or not verdict.reasons or bool(verdict.reasons[0].suggestion)
    # What looks for a map reads both structures, which have to be schemas for that.
    if is_explained or verdict.reasons[0].error_code == _NO_SCHEMA or not suggest_seconds:
        return verdict
    end = time.thread_time() + suggest_seconds

    def left() -> CheckBudget:
        return CheckBudget(seconds=max(0.0, end - time.thread_time()))

    def fits(mapping: Mapping[str, Any], losses: tuple[str, ...]) -> bool:
        return _judge(producer, consumer, mapping, losses, meaning, left()).compatible

    lines = ""
    if mapping is None and any(difference.conversion for difference in verdict.differences):
        lines = converting_map(producer, consumer, verdict.differences, fits)
    lines = lines or suggest(producer, consumer, fits, left, meaning)
    if not lines:
        said = "" if verdict.differences else untried_conversion(producer, consumer)
        return evolve(verdict, reasons=(*verdict.reasons, Reason(said))) if said else verdict
    first, *rest = verdict.reasons
    return evolve(verdict, reasons=(evolve(first, suggestion=lines), *rest))


def transfer(edge: Edge) -> Callable[[Message], Message] | None:
    """Return the compiled adapter of a checked edge, None when messages pass unchanged."""
    if edge.mapping is None:
        return None
    entries = parse(edge.mapping)
    return adapt(entries, edge.producer_structure.schema, edge.consumer_structure.schema).make


def _judge(
    producer: MessageStructure,
    consumer: MessageStructure,
    mapping: Mapping[str, Any] | None,
    allow_loss: tuple[str, ...],
    meaning: Meaning,
    budget: CheckBudget,
) -> EdgeVerdict:
    try:
        if mapping is None:
            emitted = producer.schema
            verdict = _verdict(check(emitted, consumer.schema, budget=budget), (), allow_loss)
        else:
            adapted = adapt(parse(mapping), producer.schema, consumer.schema)
            emitted = adapted.schema
            verdict = _with_losses(adapted, consumer, allow_loss, budget)
        verdict = _with_meaning(verdict, emitted, consumer.schema, meaning)
        return _within_limits(verdict, emitted, consumer.schema)
    except MappingError as error:
        sentence = f"the map cannot be understood: {error}"
        return EdgeVerdict(False, (Reason(sentence, error_code="UOA-221"),))
    except UnfitError as error:
        return EdgeVerdict(False, (Reason(str(error), path=error.path, error_code="UOA-221"),))
    except SchemaError as error:
        sentence = f"a structure is no JSON Schema: {error}"
        return EdgeVerdict(False, (Reason(sentence, error_code=_NO_SCHEMA),))


def _with_meaning(verdict: EdgeVerdict, emitted: Any, taken: Any, meaning: Meaning) -> EdgeVerdict:
    """Judge the meaning of what fits in shape."""
    if not verdict.compatible or meaning.level is MeaningLevel.OFF:
        return verdict
    found = judge(emitted, taken, meaning.alike)
    unstated = tuple(map(write_places, found.unstated))
    reasons = [
        Reason(
            difference.sentence,
            write_places(difference.path),
            difference.producer,
            difference.consumer,
            error_code="UOA-222",
        )
        for difference in found.differences
    ]
    if meaning.level is MeaningLevel.STRICT:
        sentence = (
            "not both sides say what it means, as `meaning: strict` demands, which is what inputs "
            "that move something have: state it (`x-unit`), or say `meaning: stated` there"
        )
        reasons += [Reason(sentence, path, error_code="UOA-222") for path in unstated]
    if reasons:
        return EdgeVerdict(False, tuple(reasons), unstated=unstated, differences=found.differences)
    if not found.notes and not unstated:
        return verdict
    return EdgeVerdict(
        True,
        losses=verdict.losses,
        warnings=(*verdict.warnings, *found.notes),
        unstated=unstated,
    )


def _within_limits(verdict: EdgeVerdict, emitted: Any, taken: Any) -> EdgeVerdict:
    """Refuse what may be larger than the consumer takes, as far as the producer says how large.

    A producer that says nothing of it may send all that is small enough: what is not is refused
    when it is sent.
    """
    if not verdict.compatible or not isinstance(taken, Mapping):
        return verdict
    for limit, form in ((JSON_LIMIT, " as JSON"), (OCTETS_LIMIT, "")):
        most: Any = taken.get(limit)
        if most is None:
            continue
        least, largest = sizes_of(emitted, limit)
        size, which = (
            (least, "every message has at least")
            if least > most
            else (largest, "a message may have about")
        )
        if most < size < math.inf:
            sentence = f"{which} {int(size):,} octets{form}, and {most:,} are taken"
            reason = Reason(sentence, consumer=f"{limit} {most}", error_code="UOA-223")
            return EdgeVerdict(False, (reason,))
    return verdict


def _with_losses(
    adapted: Adaptation,
    consumer: MessageStructure,
    allow_loss: tuple[str, ...],
    budget: CheckBudget,
) -> EdgeVerdict:
    refused = [loss for loss in adapted.losses if loss not in allow_loss]
    checked = check(adapted.schema, consumer.schema, budget=budget)
    verdict = _verdict(checked, adapted.losses, allow_loss)
    if not verdict.compatible or not refused:
        return verdict
    lines = f"allow_loss: {flow([*allow_loss, *refused])}"
    reasons = [Reason(f"the map drops the field {refused[0]!r}, which is not allowed",
                      path=refused[0], suggestion=lines, error_code="UOA-225")]  # fmt: skip
    reasons += [
        Reason(f"the map drops the field {loss!r} too", path=loss, error_code="UOA-225")
        for loss in refused[1:_MAX_LOSSES]
    ]
    return EdgeVerdict(False, tuple(reasons))


def _verdict(verdict: Verdict, losses: tuple[str, ...], allow_loss: tuple[str, ...]) -> EdgeVerdict:
    if verdict.undecided is not None:
        sentence = f"it cannot be decided whether every message fits: {verdict.undecided}"
        return EdgeVerdict(False, (Reason(sentence, error_code="UOA-224"),), is_undecided=True)
    if not verdict.compatible:
        reasons = tuple(
            Reason(
                reason.sentence,
                reason.path,
                reason.producer,
                reason.consumer,
                None if place else verdict.excerpt,  # it is of the first
            )
            for place, reason in enumerate(verdict.reasons)
        )
        return EdgeVerdict(False, reasons or (Reason("a message would be refused"),))
    warnings = [f"{loss.path}: {loss.sentence}" for loss in verdict.losses]
    idle = [name for name in allow_loss if name not in losses]
    warnings += [f"allow_loss names {name!r}, which is not lost" for name in idle]
    return EdgeVerdict(True, losses=losses, warnings=tuple(warnings))
