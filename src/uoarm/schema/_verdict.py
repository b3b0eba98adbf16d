"""Verdicts: what a check came to, with everything a person needs to understand it."""

from __future__ import annotations

from typing import Any

from attrs import asdict, field, frozen

from uoarm.schema._values import build, describe


@frozen
class CheckBudget:
    """How much a check may cost before it answers undecided.

    Attributes:
        steps: sub-questions, branches and parts of values that are looked at.
        seconds: time, of the whole check.
        octets: memory that the check holds, besides the two schemas themselves.
    """

    steps: int = 1_000_000
    seconds: float = 10.0
    octets: int = 200 * 2**20


@frozen
class MismatchReason:
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
        undecided: why it is not known; None when the question is decided.
        reasons: why it is refused.
        counterexample: a message valid for the producer and invalid for the consumer. Read it
            only when `incompatible` and not `abridged`: None is a message too.
        abridged: whether the message is too long to be written out unasked;
            `build_counterexample` does it.
        excerpt: the part of the counterexample that matters; shortened where it is long.
        losses: what is accepted but not kept whole.
        disputed_patterns: patterns of either side that engines which are not of ECMA-262, such as
            Python's `re` and Rust's `regex`, read otherwise. The verdict rests on ECMA-262.
    """

    compatible: bool
    undecided: str | None = None
    reasons: tuple[MismatchReason, ...] = ()
    counterexample: Any = field(default=None, hash=False)
    excerpt: Any = field(default=None, hash=False)
    losses: tuple[Loss, ...] = ()
    abridged: bool = False
    disputed_patterns: tuple[str, ...] = ()
    _message: Any = field(default=None, hash=False, eq=False, repr=False)

    @property
    def incompatible(self) -> bool:
        """Whether containment is refuted by the counterexample."""
        return not self.compatible and self.undecided is None

    def to_dict(self) -> dict[str, Any]:
        """Return the verdict as plain JSON values; an abridged counterexample in short."""
        return {
            "compatible": self.compatible,
            "undecided": self.undecided,
            "reasons": tuple(asdict(reason) for reason in self.reasons),
            "counterexample": describe(self._message) if self.abridged else self.counterexample,
            "excerpt": self.excerpt,
            "losses": tuple(asdict(loss) for loss in self.losses),
            "abridged": self.abridged,
            "disputed_patterns": self.disputed_patterns,
            "incompatible": self.incompatible,
        }

    def build_counterexample(self) -> Any:
        """Return the counterexample of a refusal, written out however long it is.

        Parts that are equal may be one object, so that it is held in less memory than its JSON
        text, which can be longer than any memory.
        """
        return build(self._message) if self.abridged else self.counterexample
