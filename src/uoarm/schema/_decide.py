"""Deciding a pair: the search, why a message is refused, and what is accepted, not kept whole."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from json.encoder import encode_basestring
from typing import Any, TypeAlias

from attrs import frozen

from uoarm._encodable import shown
from uoarm.schema._errors import BudgetError, Meter, OutOfScopeError
from uoarm.schema._values import (
    SCALARS,
    Repeated,
    build,
    describe,
    exact,
    is_small,
    kind_of,
    runs_of,
)
from uoarm.schema._verdict import Loss, MismatchReason, Verdict
from uoarm.schema.read import Pool, SchemaNode
from uoarm.schema.regex import CodeUnits
from uoarm.schema.solve import (
    UNSATISFIABLE,
    Judgements,
    Messages,
    Result,
    Solver,
    Unknown,
    Unsatisfiable,
    Witness,
    answer,
    differences,
    item_rules,
    kinds_of_position,
    member_rules,
    named_rules,
)

_WRITTEN = 20_000
"""Parts and characters up to which a counterexample is written out unasked."""


_MAX_VISITS = 10_000


def failures(
    node: SchemaNode, value: object, judgements: Judgements, most: int
) -> list[tuple[SchemaNode, Any, tuple[str | int, ...], str]]:
    """Return some of the innermost failing schemas: node, value there, path, keyword."""
    found: list[tuple[SchemaNode, Any, tuple[str | int, ...], str]] = []
    waiting: list[tuple[SchemaNode, Any, tuple[str | int, ...]]] = [(node, value, ())]
    visits = 0
    while waiting and visits < _MAX_VISITS and len(found) < most:
        visits += 1
        subschema, part, path = waiting.pop()
        keyword = _failing_keyword(subschema, part, judgements)
        deeper = []
        if keyword == "rules":
            deeper = [
                (child, item, (*path, *step))
                for child, item, step in _direct_parts(subschema, part, judgements)
                if not child.never and not judgements.accepts(child, item)
            ]
        if deeper:
            waiting.extend(deeper[:3])
        else:
            found.append((subschema, part, path, keyword))
    return found


def _direct_parts(
    node: SchemaNode, value: Any, judgements: Judgements
) -> list[tuple[SchemaNode, Any, tuple[str | int, ...]]]:
    parts: list[tuple[SchemaNode, Any, tuple[str | int, ...]]] = [
        (subschema, value, ()) for subschema in node.all_of
    ]
    if node.reference is not None:
        parts.append((node.target(), value, ()))
    if kind_of(value) == "array":
        for start, item, count in runs_of(value):
            judgements.spend(1)
            for n in kinds_of_position(node, start, count):
                parts += [(rule, item, (n,)) for rule in item_rules(node, n)]
    elif isinstance(value, Mapping):
        for name, item in value.items():
            judgements.spend(1 + len(node.patterns))
            parts += [(rule, item, (name,)) for rule in member_rules(node, name)]
    return parts


def _failing_keyword(node: SchemaNode, value: Any, judgements: Judgements) -> str:
    kind = kind_of(value)
    if node.kinds is not None and kind not in node.kinds:
        return "type"
    if node.integer_only and kind == "number" and exact(value).denominator != 1:
        return "type"
    if node.values is not None and judgements.key_of(value) not in node.values:
        return "enum"
    if kind == "array" and not _within(len(value), node.min_items, node.max_items):
        return "size"
    if isinstance(value, str):
        if node.no_nul and "\0" in value:
            return "nul"
        if not all(units.holds(value) for units in _units(node)):
            return "units"
    if isinstance(value, Mapping):
        if not _within(len(value), node.min_properties, node.max_properties):
            return "size"
        if any(name not in value for name in node.required):
            return "required"
        if node.additional is not None and node.additional.never:
            extra = [k for k in value if not named_rules(node, k)]
            if extra:
                return "additionalProperties"
    return "rules"


def _within(size: int, least: int, most: int | None) -> bool:
    return least <= size and (most is None or size <= most)


Path: TypeAlias = "tuple[str | int, ...]"

_JSON = json.JSONEncoder(ensure_ascii=False, default=str)
_SHOWN = 160
_MAX_BITS = 4_000
_MAX_REASONS = 5
_MAX_NAMES = 20
_MAX_PAIRS = 5_000
_EXACT_INTEGERS = 2**53
_NONFINITE = "the producer may emit NaN or infinity, the consumer does not expect them"
_OF_PAIR, _OF_LOSS = 200, 300
"""About the octets of two schemas that wait to be compared, and of a loss without its texts."""


def explain(
    producer: SchemaNode, consumer: SchemaNode, message: Any, judgements: Judgements
) -> tuple[tuple[MismatchReason, ...], Any]:
    """Return why the consumer refuses a message, and the part of it that matters.

    What the budget does not reach for is left out: the verdict stands without it.
    """
    try:
        found = failures(consumer, message, judgements, _MAX_REASONS)
    except (OutOfScopeError, BudgetError):
        found = [(consumer, message, (), "rules")]
    reasons: list[MismatchReason] = []
    for node, value, path, keyword in found:
        there = _along(producer, path)
        reasons.append(
            MismatchReason(
                write_path(path),
                _show(there.raw) if there is not None else "",
                _show(node.raw),
                _sentence(keyword, node, value),
            )
        )
    return tuple(reasons), found[0][1] if found else message


def find_losses(producer: SchemaNode, consumer: SchemaNode, meter: Meter) -> tuple[Loss, ...]:
    """Return what is accepted but not kept whole, field by field where fields are plain.

    What the budget does not reach for is left out: the verdict stands without it.
    """
    losses: list[Loss] = []
    with meter.part("what is not kept whole"), suppress(BudgetError):
        _gather_losses(producer, consumer, losses, meter)
        if isinstance(consumer.raw, Mapping) and consumer.raw.get("x-nonfinite") is False:
            _keep(losses, _nonfinite(producer, losses, meter), meter)
    return tuple(sorted(losses, key=lambda loss: (loss.path, loss.kind)))


def _nonfinite(producer: SchemaNode, known: Sequence[Loss], meter: Meter) -> list[Loss]:
    """Return where else a producer may emit what is not finite, said once of all such places."""
    waiting: list[tuple[SchemaNode, Path]] = [(producer, ())]
    places: set[str] = set()
    for _ in range(_MAX_PAIRS):
        if not waiting:
            break
        node, path = waiting.pop()
        if isinstance(node.raw, Mapping) and node.raw.get("x-nonfinite") is True:
            places.add(write_path(path))
        meter.spend()
        meter.hold(_OF_PAIR)
        waiting.extend((child, path) for child in node.applied() if child is not node.negated)
        waiting.extend((child, (*path, name)) for name, child in node.properties.items())
        waiting.extend((child, (*path, number)) for number, child in enumerate(node.prefix))
        if node.items is not None:
            waiting.append((node.items, (*path, "*")))
    others = sorted(places - {loss.path for loss in known if loss.kind == "nonfinite"})
    if not others:
        return []
    more = f", here and in {len(others) - 1:,} more places" if others[1:] else ""
    return [Loss(others[0], "nonfinite", f"{_NONFINITE}{more}")]


def _gather_losses(
    producer: SchemaNode, consumer: SchemaNode, losses: list[Loss], meter: Meter
) -> None:
    waiting: list[tuple[SchemaNode, SchemaNode, Path]] = [(producer, consumer, ())]
    seen: set[tuple[int, int]] = set()
    while waiting and len(seen) < _MAX_PAIRS:
        first, second, path = waiting.pop()
        if (first.number, second.number) in seen:
            continue
        seen.add((first.number, second.number))
        meter.spend()
        meter.hold(_OF_PAIR)
        if first.reference is not None:
            waiting.append((first.target(), second, path))
        if second.reference is not None:
            waiting.append((first, second.target(), path))
        _keep(losses, _losses_here(first, second, path), meter)
        for name, child in first.properties.items():
            meter.spend(1 + len(second.patterns))
            try:
                rules = member_rules(second, name)
            except OutOfScopeError:
                continue
            waiting.extend((child, rule, (*path, name)) for rule in rules)
            if not rules and second.properties:
                sentence = f"the consumer does not know the field {name!r} and ignores it"
                _keep(losses, [Loss(write_path((*path, name)), "ignored", sentence)], meter)
        if first.items is not None and second.items is not None:
            waiting.append((first.items, second.items, (*path, "*")))


def _keep(losses: list[Loss], more: list[Loss], meter: Meter) -> None:
    for loss in more:
        meter.hold(_OF_LOSS + len(loss.path) + len(loss.sentence))
        losses.append(loss)


def write_path(path: Path) -> str:
    """Write a path as `pose.points[3].x`; every item of an array as `points[]`."""
    text = ""
    for part in path:
        if isinstance(part, int):
            text += f"[{part}]"
        elif part == "*":
            text += "[]"
        else:
            text += f".{part}" if text else part
    return text


def _losses_here(first: SchemaNode, second: SchemaNode, path: Path) -> list[Loss]:
    where = write_path(path)
    found: list[Loss] = []
    whole_to_real = first.integer_only and not second.integer_only and second.kinds is not None
    if whole_to_real and "number" in second.kinds:  # type: ignore[operator] # checked above
        bounds = [first.minimum, first.maximum]
        if any(bound is None or abs(bound) > _EXACT_INTEGERS for bound in bounds):
            sentence = "whole numbers beyond 2**53 lose digits as floating-point numbers"
            found.append(Loss(where, "precision", sentence))
    mine = first.raw if isinstance(first.raw, Mapping) else {}
    theirs = second.raw if isinstance(second.raw, Mapping) else {}
    if mine.get("x-nonfinite") and not theirs.get("x-nonfinite"):
        found.append(Loss(where, "nonfinite", _NONFINITE))
    for keyword in ("format", "contentEncoding", "contentMediaType"):
        if keyword in theirs and mine.get(keyword) != theirs[keyword]:
            mine_says, they_say = shown(mine.get(keyword)), shown(theirs[keyword])
            sentence = f"the consumer says {keyword} {they_say}, the producer {mine_says}"
            found.append(Loss(where, "annotation", sentence))
    return found


def _along(node: SchemaNode, path: Path) -> SchemaNode | None:
    """Follow a path through a schema as far as it is plain."""
    for part in path:
        for _ in range(20):
            if node.reference is None:
                break
            node = node.target()
        if isinstance(part, int):
            inner = node.prefix[part] if part < len(node.prefix) else node.items
        else:
            rules = member_rules(node, part)
            inner = rules[0] if rules else None
        if inner is None:
            return node
        node = inner
    return node


def _sentence(keyword: str, node: SchemaNode, value: Any) -> str:
    text = _show(value)
    if keyword == "required":
        missing = [name for name in node.required if name not in value]
        if len(missing) == 1:
            return f"the field {missing[0]!r} is required and may be missing"
        return f"the fields {_several(missing)} are required and may be missing"
    if keyword == "additionalProperties":
        return f"a field may come that the consumer does not allow: {text}"
    if keyword == "type":
        return f"{text} is not of a type that the consumer takes"
    if keyword == "enum":
        return f"{text} is none of the values that the consumer takes"
    if keyword == "nul":
        return f"the text has the character NUL, which the consumer does not take: {text}"
    if keyword == "units":
        units = next(units for units in _units(node) if not units.holds(value))
        return f"{units.count(value):,} {units} are more than {units.most:,}: {text}"
    if keyword == "size":
        return f"{len(value):,} parts are more or fewer than the consumer takes: {text}"
    return f"{text} does not meet what the consumer demands"


def _units(node: SchemaNode) -> list[CodeUnits]:
    return [pattern for pattern in node.texts if isinstance(pattern, CodeUnits)]


def _several(names: list[str]) -> str:
    """Write two names or more, the first of them where there are many."""
    words = [repr(name) for name in names[:_MAX_NAMES]]
    if len(names) > _MAX_NAMES:
        return f"{', '.join(words)} and {len(names) - _MAX_NAMES:,} more"
    return f"{', '.join(words[:-1])} and {words[-1]}"


def _show(value: Any) -> str:
    """Return a value as JSON text, cut where it is long; what is cut off is never written."""
    text = ""
    waiting = [_pieces(value)]
    while waiting and len(text) <= _SHOWN:
        piece = next(waiting[-1], None)
        if piece is None:
            waiting.pop()
        elif isinstance(piece, _Part):
            waiting.append(_pieces(piece.value))
        else:
            text += piece
    return text if len(text) <= _SHOWN else f"{text[: _SHOWN - 3]}..."


@frozen
class _Part:
    """A part of a value that is still to be written."""

    value: Any


def _pieces(value: Any) -> Iterator[str | _Part]:
    if value.__class__ in SCALARS:
        yield _scalar(value)
    elif isinstance(value, Mapping):
        before = "{"
        for name, part in value.items():
            yield f"{before}{_scalar(name)}: "
            yield _scalar(part) if part.__class__ in SCALARS else _Part(part)
            before = ", "
        yield "}" if value else "{}"
    elif isinstance(value, list | tuple | Repeated):
        yield "["
        items = (item for _, item, count in runs_of(value) for _ in range(count))
        for number, part in enumerate(items):
            yield ", " if number else ""
            yield _scalar(part) if part.__class__ in SCALARS else _Part(part)
        yield "]"
    else:
        yield _scalar(value)


def _scalar(value: Any) -> str:
    if value.__class__ is str:
        return encode_basestring(value[: _SHOWN + 1])
    if isinstance(value, int) and value.bit_length() > _MAX_BITS:
        return f"a number of {value.bit_length():,} bits"
    return _JSON.encode(value[: _SHOWN + 1] if isinstance(value, str) else value)


def decide(producer: SchemaNode, consumer: SchemaNode, pool: Pool) -> Verdict:
    """Come to a verdict, or raise what keeps it from being one."""
    judgements = Judgements(pool.meter.spend)
    with pool.meter.part("the search"):
        result = _search(producer, consumer, pool, judgements)
    if isinstance(result, Witness):
        return _refusal(producer, consumer, result.value, pool.meter, judgements)
    if isinstance(result, Unknown):
        return Verdict(compatible=False, undecided=result.cause)
    return Verdict(compatible=True, losses=find_losses(producer, consumer, pool.meter))


def _search(
    producer: SchemaNode, consumer: SchemaNode, pool: Pool, judgements: Judgements
) -> Result:
    """Look for a message of the producer that the consumer refuses, first where they differ."""
    solver, messages = Solver(pool, answer), Messages(pool.meter)

    def refused(first: SchemaNode, second: SchemaNode, found: Witness) -> bool:
        accepts = judgements.accepts
        return accepts(first, found.value) and not accepts(second, found.value)

    for path, node, second in differences(producer, consumer, pool.meter):
        likely = messages.likely(node, second)
        found = next((value for value in likely if refused(node, second, value)), None)
        result = found or solver.solve(((node, True), (second, False)))
        if not path:
            return result
        if isinstance(result, Witness):
            message = messages.place(producer, path, result.value)
            if message is not None and refused(producer, consumer, message):
                return message
        if not isinstance(result, Unsatisfiable):
            return solver.solve(((producer, True), (consumer, False)))
    return UNSATISFIABLE


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
