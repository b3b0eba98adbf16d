"""Proofs about structures that were discovered: each pair is judged once, within a time limit."""

from __future__ import annotations

import math
import time
from collections import OrderedDict
from collections.abc import Callable, Iterator, Mapping
from types import MappingProxyType
from typing import Any, Generic, TypeAlias, TypeVar

from attrs import field, frozen

from uoarm._adapt import MappingError, UnfitError, adapt, check_edge, number_problem, parse
from uoarm._resolve._catalogue import (
    EdgeCheck,
    Judgement,
    StructureCatalogue,
    Structures,
    Unavailable,
)
from uoarm.bridge import message_check
from uoarm.errors import MessageError
from uoarm.model import (
    CommandPolicy,
    Component,
    Edge,
    Input,
    Meaning,
    MeaningLevel,
    MessageStructure,
    Options,
    Output,
    Reason,
)

T = TypeVar("T")

_PAIR_SECONDS = 0.5
_SUGGEST_SECONDS = 2.0
_ROUND_SECONDS = 10.0
_MOST_FACTOR = 16
_PATIENCE = 20.0
_REMEMBERED = 50_000
_NO_RULES: Options = MappingProxyType({})
_NOT_COMPARED = "it was not compared yet, for want of time"


@frozen
class Adapted:
    """How messages of one structure become such of another: as they are, or through a map."""

    mapping: Mapping[str, Any] | None = None
    allow_loss: tuple[str, ...] = ()


@frozen
class _Answer(Generic[T]):
    """What is known of a pair, and from when on it is judged again.

    Attributes:
        factor: of the time that it was given.
        again: never, where it was decided.
    """

    result: T
    factor: int = 1
    again: float = math.inf


_Answers: TypeAlias = "OrderedDict[tuple[str, str], _Answer[T]]"


class Proofs:
    """Judges pairs and remembers them. For one thread at a time.

    In one round it takes some ten seconds at most; what it has not judged then does not fit yet,
    and is judged in a later one. So is what could not be decided in the time that a pair has, with
    twice the time each time, eight seconds for a proof at last, and a wait between that is some
    twenty times as long.

    Args:
        clock: a monotonic clock, in seconds.
    """

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        self._clock = clock
        self._refusals: _Answers[str] = OrderedDict()
        self._adapted: _Answers[Adapted | None] = OrderedDict()
        self._end = 0.0
        self.unjudged = 0

    def begin_round(self) -> None:
        """Have time again."""
        self._end = self._clock() + _ROUND_SECONDS
        self.unjudged = 0

    def refusal(self, producer: MessageStructure, consumer: MessageStructure) -> str:
        """Say why not every message of a producer is accepted; nothing: it is proven."""
        if producer.schema is consumer.schema:
            return ""
        key = producer.fingerprint, consumer.fingerprint
        if key[0] == key[1]:
            return ""

        def judge(factor: int) -> tuple[str, bool]:
            seconds = factor * _PAIR_SECONDS
            verdict = check_edge(producer, consumer, seconds=seconds, suggest_seconds=0)
            reasons = [
                f"{reason.path}: {reason.sentence}".removeprefix(": ") for reason in verdict.reasons
            ]
            refused = "" if verdict.compatible else "; ".join(reasons[:3]) or "refused"
            return refused, not verdict.is_undecided

        return self._answer(self._refusals, key, judge, _NOT_COMPARED)

    def adapted(
        self,
        producer: MessageStructure,
        consumer: MessageStructure,
        rules: Options = _NO_RULES,
    ) -> Adapted | None:
        """Return how messages fit: as they are, or through a map, proven to.

        The map is the one that is suggested. With rules it is these, for those of the fields that
        the consumer has at its top, and others come from the fields of their names.
        """
        if not self.refusal(producer, consumer):
            return Adapted()
        own = _rules_for(consumer, rules)
        if own:
            return self._through(own, producer, consumer)

        def judge(factor: int) -> tuple[Adapted | None, bool]:
            seconds, to_suggest = factor * _PAIR_SECONDS, factor * _SUGGEST_SECONDS
            begun = self._clock()
            verdict = check_edge(producer, consumer, seconds=seconds, suggest_seconds=to_suggest)
            is_over = self._clock() - begun < to_suggest  # the suggestion had the time it needed
            lines = verdict.reasons[0].suggestion if verdict.reasons else ""
            found = _read(lines, producer, consumer, seconds)
            return found, found is not None or (is_over and not verdict.is_undecided)

        key = producer.fingerprint, consumer.fingerprint
        return self._answer(self._adapted, key, judge, None)

    def _through(
        self, rules: Options, producer: MessageStructure, consumer: MessageStructure
    ) -> Adapted | None:
        """Return a map with what it drops, where the edge is proven with it."""

        def judge(factor: int) -> tuple[Adapted | None, bool]:
            try:
                losses = adapt(parse(rules), producer.schema, consumer.schema).losses
            except (MappingError, UnfitError):
                return None, True
            seconds = factor * _PAIR_SECONDS
            verdict = check_edge(
                producer, consumer, rules, losses, seconds=seconds, suggest_seconds=0
            )
            found = Adapted(rules, losses) if verdict.compatible else None
            return found, not verdict.is_undecided

        key = producer.fingerprint, f"{consumer.fingerprint} {sorted(rules.items())}"
        return self._answer(self._adapted, key, judge, None)

    def _answer(
        self,
        answers: _Answers[T],
        key: tuple[str, str],
        judge: Callable[[int], tuple[T, bool]],
        unjudged: T,
    ) -> T:
        """Return what is known of a pair; judge it where there is time."""
        known = answers.get(key)
        now = self._clock()
        if known is None or now >= known.again:
            if now > self._end:
                self.unjudged += 1
                return unjudged if known is None else known.result
            factor = 1 if known is None else min(_MOST_FACTOR, 2 * known.factor)
            report, is_decided = judge(factor)
            again = math.inf if is_decided else self._clock() + _PATIENCE * factor * _PAIR_SECONDS
            known = answers[key] = _Answer(report, factor, again)
            if len(answers) > _REMEMBERED:
                answers.popitem(last=False)
        answers.move_to_end(key)
        return known.result


def _rules_for(consumer: MessageStructure, rules: Options) -> dict[str, object]:
    """Return the rules for fields that a consumer has; of `a.b` it is `a` that counts."""
    schema = consumer.schema
    has = schema.get("properties") if rules and isinstance(schema, Mapping) else None
    if not isinstance(has, Mapping):
        return {}
    return {path: rule for path, rule in rules.items() if path.partition(".")[0] in has}


def _read(
    lines: str, producer: MessageStructure, consumer: MessageStructure, seconds: float
) -> Adapted | None:
    """Return what suggested lines say, where the edge is proven with them."""
    from uoarm._support.yaml import read  # noqa: PLC0415 - slow import

    written = read(lines, "").value if lines else None
    if not isinstance(written, dict) or "map" not in written:
        return None
    made = Adapted(written["map"], tuple(written.get("allow_loss", ())))
    proven = check_edge(
        producer,
        consumer,
        made.mapping,
        made.allow_loss,
        seconds=seconds,
        suggest_seconds=0,
    )
    return made if proven.compatible else None


_REMEMBERED_FITS = 100_000


@frozen(eq=False)
class _Key:
    """An edge's identity: both structures and the very mapping object of the configuration."""

    producer: MessageStructure
    consumer: MessageStructure
    mapping: Mapping[str, object] | None
    allow_loss: tuple[str, ...]
    meaning: Meaning
    digest: int = field(init=False)

    def __attrs_post_init__(self) -> None:
        whole = (self.producer, self.consumer, id(self.mapping), self.allow_loss, self.meaning)
        object.__setattr__(self, "digest", hash(whole))

    def __hash__(self) -> int:
        return self.digest

    def __eq__(self, other: object) -> bool:
        return (
            isinstance(other, _Key)
            and self.mapping is other.mapping
            and self.allow_loss == other.allow_loss
            and self.meaning == other.meaning
            and self.producer == other.producer
            and self.consumer == other.consumer
        )


class EdgeChecks:
    """Asks the catalogue and the edge check, each question once.

    Args:
        catalogue: knows structures, and remembers them itself.
        check_edge: judges an edge; pure, so that its answers can be kept.
    """

    def __init__(self, catalogue: StructureCatalogue, check_edge: EdgeCheck) -> None:
        self._catalogue = catalogue
        self._check_edge = check_edge
        self._judged: dict[_Key, Judgement] = {}

    def structures(self, component: Component) -> Structures | Unavailable:
        """Return a component's structures or why they cannot be had."""
        return self._catalogue.structures(component)

    def edge(
        self,
        producer: Component,
        output: Output,
        structures: Structures,
        consumer: Component,
        port: Input,
    ) -> Edge | tuple[Reason, ...]:
        """Return the checked edge, or why it does not fit."""
        wanted = self.structures(consumer)
        if isinstance(wanted, Unavailable):
            return (Reason(wanted.sentence, error_code="UOA-212"),)
        sent = structures.by_port[f"output.{output.name}"]
        taken = wanted.by_port[f"input.{port.name}"]
        judged = self._judge(_Key(sent, taken, port.mapping, port.allow_loss, port.meaning))
        if not judged.compatible:
            return tuple(judged.reasons)
        return Edge(
            producer=producer.name,
            output=output.name,
            consumer=consumer.name,
            input=port.name,
            producer_structure=sent,
            consumer_structure=taken,
            mapping=port.mapping,
            losses=tuple(judged.losses),
            warnings=tuple(
                f"{producer.name}.{output.name} -> {consumer.name}.{port.name}: {warning}"
                for warning in judged.warnings
            ),
            unstated=tuple(judged.unstated),
            strict=port.meaning.level is MeaningLevel.STRICT,
        )

    def _judge(self, key: _Key) -> Judgement:
        judged = self._judged.get(key)
        if judged is None:
            judged = self._check_edge(
                key.producer, key.consumer, key.mapping, key.allow_loss, key.meaning
            )
            if len(self._judged) >= _REMEMBERED_FITS:
                self._judged.clear()
            self._judged[key] = judged
        return judged


def command_mistakes(component: Component, structures: Structures) -> tuple[Reason, ...]:
    """Return why inputs of a component could not be stopped or limited as they should."""
    return tuple(
        reason
        for port in component.inputs
        if port.endpoint.command is not None
        for reason in _mistakes(
            f"input {port.name!r}", port.endpoint.command, structures.by_port[f"input.{port.name}"]
        )
    )


def lifetime_warnings(edge: Edge, output: Output, port: Input) -> tuple[str, ...]:
    """Warn of commands that expire before the output that feeds them is due to renew them."""
    command = port.endpoint.command
    if command is None or command.lifetime is None or output.expect is None:
        return ()
    period = 1 / output.expect.rate
    if period < command.lifetime:
        return ()
    place = f"{edge.producer}.{edge.output} -> {edge.consumer}.{edge.input}"
    lives = f"commands live for {command.lifetime:g} s, and the next one comes after {period:g} s"
    return (f"{place}: {lives}: the stop message will follow each",)


def _mistakes(place: str, command: CommandPolicy, structure: MessageStructure) -> Iterator[Reason]:
    if command.stop is not None:
        check = message_check(structure, f"the stop message of its {place}")
        try:
            check(command.stop.message)
        except MessageError as error:
            yield Reason(str(error), error_code="UOA-217")
    for limit in command.limits:
        problem = number_problem(structure, limit.path)
        if problem:
            sentence = f"limits of its {place}: {problem}"
            yield Reason(sentence, path=limit.path, error_code="UOA-217")
