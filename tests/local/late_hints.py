"""Components whose hints are read when they are asked for, as CPython 3.14 does without more."""

from dataclasses import dataclass
from typing import TYPE_CHECKING

from attrs import define

if TYPE_CHECKING:
    from decimal import Decimal as Absent


def takes(message: Absent) -> None:
    """Take what has no class at run time."""


class Doubles:
    kept: Absent

    def __init__(self, kept: Absent | None = None) -> None:
        if kept is not None:
            self.kept = kept

    def __call__(self, message: Absent) -> Absent:
        return message * 2


@dataclass
class Whole:
    part: Part  # noqa: F821 - defined below


@define
class Defined:
    part: Part  # noqa: F821 - defined below


@dataclass
class Part:
    value: int
