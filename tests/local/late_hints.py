"""Components whose hints are read when they are asked for, as CPython 3.14 does without more."""

from typing import TYPE_CHECKING

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
