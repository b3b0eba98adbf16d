"""Fit: judged components and edges, remembered by what they depend on."""

from __future__ import annotations

from collections.abc import Mapping

from attrs import field, frozen

from uoarm._resolve._protocols import Catalogue, EdgeCheck, Judgement, Structures, Unavailable
from uoarm.model import (
    Component,
    Edge,
    Input,
    Meaning,
    MeaningLevel,
    MessageStructure,
    Output,
    Reason,
)

__all__ = ["Fit"]

_REMEMBERED = 100_000


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


class Fit:
    """Asks the catalogue and the edge check, each question once.

    Args:
        catalogue: knows structures, and remembers them itself.
        check_edge: judges an edge; pure, so that its answers can be kept.
    """

    def __init__(self, catalogue: Catalogue, check_edge: EdgeCheck) -> None:
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
            return (Reason(wanted.sentence),)
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
            if len(self._judged) >= _REMEMBERED:
                self._judged.clear()
            self._judged[key] = judged
        return judged
