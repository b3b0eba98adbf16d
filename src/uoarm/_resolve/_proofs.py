"""Proofs about structures that were discovered: each pair is judged once, within a time limit."""

from __future__ import annotations

import time
from collections import OrderedDict
from collections.abc import Callable, Mapping
from typing import Any, TypeVar

from attrs import frozen

from uoarm._adapt import check_edge
from uoarm._yaml import read
from uoarm.model import MessageStructure

__all__ = ["Adapted", "Proofs"]

T = TypeVar("T")

_PAIR_SECONDS = 0.5
_SUGGEST_SECONDS = 2.0
_ROUND_SECONDS = 10.0
_REMEMBERED = 50_000


@frozen
class Adapted:
    """How messages of one structure become such of another: as they are, or through a map."""

    mapping: Mapping[str, Any] | None = None
    allow_loss: tuple[str, ...] = ()


class Proofs:
    """Judges pairs and remembers them. For one thread at a time.

    In one round it takes some ten seconds at most; what it has not judged then does not fit yet,
    and is judged in a later one.

    Args:
        clock: a monotonic clock, in seconds.
    """

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        self._clock = clock
        self._refusals: OrderedDict[tuple[str, str], str] = OrderedDict()
        self._adapted: OrderedDict[tuple[str, str], Adapted | None] = OrderedDict()
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
        if key not in self._refusals:
            if self._clock() > self._end:
                self.unjudged += 1
                return "it was not compared yet, for want of time"
            verdict = check_edge(producer, consumer, seconds=_PAIR_SECONDS, suggest_seconds=0)
            told = [f"{one.path}: {one.sentence}".removeprefix(": ") for one in verdict.reasons]
            self._refusals[key] = "" if verdict.compatible else "; ".join(told[:3]) or "refused"
        return _used(self._refusals, key)

    def adapted(self, producer: MessageStructure, consumer: MessageStructure) -> Adapted | None:
        """Return how messages fit: as they are, or with the map that is suggested, proven to."""
        if not self.refusal(producer, consumer):
            return Adapted()
        key = producer.fingerprint, consumer.fingerprint
        if key not in self._adapted:
            if self._clock() > self._end:
                self.unjudged += 1
                return None
            verdict = check_edge(
                producer, consumer, seconds=_PAIR_SECONDS, suggest_seconds=_SUGGEST_SECONDS
            )
            lines = verdict.reasons[0].suggestion if verdict.reasons else ""
            self._adapted[key] = _read(lines, producer, consumer)
        return _used(self._adapted, key)


def _read(lines: str, producer: MessageStructure, consumer: MessageStructure) -> Adapted | None:
    """Return what suggested lines say, where the edge is proven with them."""
    written = read(lines, "").value if lines else None
    if not isinstance(written, dict) or "map" not in written:
        return None
    made = Adapted(written["map"], tuple(written.get("allow_loss", ())))
    proven = check_edge(
        producer,
        consumer,
        made.mapping,
        made.allow_loss,
        seconds=_PAIR_SECONDS,
        suggest_seconds=0,
    )
    return made if proven.compatible else None


def _used(kept: OrderedDict[tuple[str, str], T], key: tuple[str, str]) -> T:
    kept.move_to_end(key)
    if len(kept) > _REMEMBERED:
        kept.popitem(last=False)
    return kept[key]
