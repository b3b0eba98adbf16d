"""What another set of structures does to the plans of a lock; no bridge is asked."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from enum import Enum
from typing import Any

from attrs import frozen

from uoarm._adapt import EdgeVerdict, check_edge
from uoarm._lock._record import Lock, LockedEdge, LockedFunction, meaning_of
from uoarm._meaning import name_of_type
from uoarm.model import MessageStructure

__all__ = ["LockFinding", "LockOutcome", "compare"]

_UNDECIDED = "it cannot be decided"


class LockOutcome(Enum):
    """What becomes of one edge, or of one port of a function."""

    FITS = "fits"
    FITS_WITH_MAP = "fits with a map"
    BREAKS = "breaks"
    UNDECIDED = "undecided"


@frozen
class LockFinding:
    """What becomes of one edge, or of what applications get from a function or send to it.

    Attributes:
        function: whose plan it is of.
        subject: `camera.default -> finder.default`, or `output.default` of the function itself.
        outcome: what becomes of it.
        changed: whether its structures are others at all.
        path: field path, where it does not fit.
        sentence: why not.
        suggestion: lines that would mend it.
    """

    function: str
    subject: str
    outcome: LockOutcome
    changed: bool
    path: str = ""
    sentence: str = ""
    suggestion: str = ""


Port = tuple[str, str]
Find = Callable[[Port, MessageStructure], "MessageStructure | None"]


def compare(lock: Lock, other: Lock | Mapping[str, Any]) -> Iterator[LockFinding]:
    """Yield what becomes of every edge and of every function that applications may ask for.

    Args:
        lock: whose plans they are.
        other: another lock, or JSON Schemas by the names of their types; a structure whose type is
            not among those stays as it is.
    """
    find = _in_lock(other) if isinstance(other, Lock) else _in_schemas(other)
    known = {
        (part.component, port): lock.structure(fingerprint)
        for part in lock.parts()
        for port, fingerprint in part.ports.items()
    }
    for name, offer in lock.offers.items():
        for edge in offer.edges:
            yield _edge(f"offer {name}", edge, known, find)
    for name, function in lock.functions.items():
        for edge in function.edges:
            yield _edge(name, edge, known, find)
        yield from _offered(name, function, known, find)


def _in_lock(other: Lock) -> Find:
    found = {
        (part.component, port): other.structure(fingerprint)
        for part in other.parts()
        for port, fingerprint in part.ports.items()
    }
    return lambda port, _: found.get(port)


def _in_schemas(schemas: Mapping[str, Any]) -> Find:
    def find(_: Port, before: MessageStructure) -> MessageStructure:
        schema = before.schema
        declared = name_of_type(schema.get("x-type")) if isinstance(schema, Mapping) else ""
        for name in (before.native_type, declared):
            if name in schemas:
                after = schemas[name]
                if declared and name_of_type(after.get("x-type")) == "":
                    after = {**after, "x-type": schema["x-type"]}  # type: ignore[index] # told
                return MessageStructure(after, native_type=before.native_type)
        return before

    return find


def _edge(
    function: str, edge: LockedEdge, ports: Mapping[Port, MessageStructure], find: Find
) -> LockFinding:
    producer, consumer = (edge.producer, f"output.{edge.output}"), (
        edge.consumer, f"input.{edge.input}",
    )  # fmt: skip
    subject = f"{edge.producer}.{edge.output} -> {edge.consumer}.{edge.input}"
    sent, taken = find(producer, ports[producer]), find(consumer, ports[consumer])
    for port, now in ((producer, sent), (consumer, taken)):
        if now is None:
            return _gone(function, subject, port)
    assert sent is not None
    assert taken is not None
    if sent == ports[producer] and taken == ports[consumer]:
        return LockFinding(function, subject, LockOutcome.FITS, changed=False)
    verdict = check_edge(sent, taken, edge.map, edge.allow_loss, meaning_of(edge))
    return _judged(function, subject, verdict)


def _offered(
    name: str, function: LockedFunction, ports: Mapping[Port, MessageStructure], find: Find
) -> Iterator[LockFinding]:
    """Yield what applications notice: outputs may narrow, inputs may widen."""
    if not function.parts:
        return
    provider = function.parts[-1]
    fed = {edge.input for edge in function.edges if edge.consumer == provider.component}
    for port in provider.ports:
        kind, _, own = port.partition(".")
        if kind == "input" and own in fed:
            continue
        key = provider.component, port
        before, after = ports[key], find(key, ports[key])
        if after is None:
            yield _gone(name, port, key)
        elif after == before:
            yield LockFinding(name, port, LockOutcome.FITS, changed=False)
        elif kind in {"output", "reply"}:
            yield _judged(name, port, check_edge(after, before, suggest_seconds=0))
        else:
            yield _judged(name, port, check_edge(before, after, suggest_seconds=0))


def _gone(function: str, subject: str, port: Port) -> LockFinding:
    sentence = f"the other lock has no {port[1]} of a component {port[0]!r}"
    return LockFinding(function, subject, LockOutcome.BREAKS, changed=True, sentence=sentence)


def _judged(function: str, subject: str, verdict: EdgeVerdict) -> LockFinding:
    if verdict.compatible:
        return LockFinding(function, subject, LockOutcome.FITS, changed=True)
    first = verdict.reasons[0]
    outcome = LockOutcome.FITS_WITH_MAP if first.suggestion else LockOutcome.BREAKS
    if first.sentence.startswith(_UNDECIDED):
        outcome = LockOutcome.UNDECIDED
    return LockFinding(
        function, subject, outcome, changed=True,
        path=first.path, sentence=first.sentence, suggestion=first.suggestion,
    )  # fmt: skip
