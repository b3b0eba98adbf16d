"""What the resolver asks of others: structures of components, and verdicts on edges."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Protocol, TypeAlias

from attrs import frozen

from uoarm.model import Component, Meaning, MessageStructure, Reason

__all__ = ["Catalogue", "EdgeCheck", "Judgement", "Structures", "Unavailable"]


@frozen
class Unavailable:
    """Why a component's structures cannot be had now."""

    sentence: str


@frozen
class Structures:
    """The structures of a component's ports by name, and what a reader should know of them."""

    by_port: Mapping[str, MessageStructure]
    warnings: tuple[str, ...] = ()


class Catalogue(Protocol):
    """Knows the structures of components."""

    def structures(self, component: Component) -> Structures | Unavailable:
        """Return structures keyed `input.NAME`, `output.NAME`, or `request` and `reply`."""


class Judgement(Protocol):
    """The verdict on one edge."""

    @property
    def compatible(self) -> bool:
        """Whether every message of the producer is accepted."""

    @property
    def reasons(self) -> tuple[Reason, ...]:
        """Why not, when it is not."""

    @property
    def losses(self) -> tuple[str, ...]:
        """Fields that are dropped on the way, all of them allowed by name."""

    @property
    def warnings(self) -> tuple[str, ...]:
        """What a careful reader should know."""

    @property
    def unstated(self) -> tuple[str, ...]:
        """Paths of what fits in shape, of whose meaning one side says nothing."""


EdgeCheck: TypeAlias = Callable[
    [
        MessageStructure,
        MessageStructure,
        "Mapping[str, object] | None",
        "tuple[str, ...]",
        Meaning,
    ],
    Judgement,
]
