"""Verdicts: what a check came to, with everything a person needs to understand it."""

from __future__ import annotations

from typing import Any

from attrs import asdict, field, frozen

__all__ = ["Budget", "Loss", "Reason", "Verdict"]


@frozen
class Budget:
    """How much a check may cost before it answers undecided.

    Attributes:
        steps: sub-questions and branches.
        seconds: time.
    """

    steps: int = 200_000
    seconds: float = 10.0


@frozen
class Reason:
    """Where and why a message is refused.

    Attributes:
        path: the field, `pose.position.x`, `points[2]`; empty for the whole message.
        producer: what the producer may emit there, as JSON Schema text.
        consumer: what the consumer takes there, as JSON Schema text.
        sentence: the refusal in one sentence.
    """

    path: str
    producer: str
    consumer: str
    sentence: str


@frozen
class Loss:
    """Something that is accepted and yet not kept whole.

    `kind` is `precision`, `ignored`, `nonfinite` or `annotation`.
    """

    path: str
    kind: str
    sentence: str


@frozen
class Verdict:
    """The answer to: is every message of the producer accepted by the consumer?

    Attributes:
        compatible: True only when it is proven.
        undecided: why nobody knows; None when the question is decided.
        reasons: why it is refused.
        counterexample: a message valid for the producer and invalid for the consumer. Read it
            only when `incompatible`: None is a message too.
        excerpt: the part of the counterexample that matters.
        losses: what is accepted but not kept whole.
    """

    compatible: bool
    undecided: str | None = None
    reasons: tuple[Reason, ...] = ()
    counterexample: Any = field(default=None, hash=False)
    excerpt: Any = field(default=None, hash=False)
    losses: tuple[Loss, ...] = ()

    @property
    def incompatible(self) -> bool:
        """Whether containment is refuted by the counterexample."""
        return not self.compatible and self.undecided is None

    def to_dict(self) -> dict[str, Any]:
        """Return the verdict as plain JSON values."""
        return {**asdict(self), "incompatible": self.incompatible}
