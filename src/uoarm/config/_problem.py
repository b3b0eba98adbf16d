"""What is wrong with a configuration, where, and what to do about it."""

from __future__ import annotations

import difflib
from collections.abc import Iterable

from attrs import field, frozen

__all__ = ["Place", "Problem", "did_you_mean"]


@frozen(order=True)
class Place:
    """A place in a file, counted from one."""

    line: int
    column: int


@frozen(kw_only=True)
class Problem:
    """One mistake.

    Attributes:
        place: where it stands.
        path: where it stands in the data, `$.functions.camera.components[0].priority`.
        sentence: what is wrong: what was expected and what came.
        hint: what to do, empty where the sentence says it.
        file: the file, empty for text that was not read from one.
    """

    place: Place
    path: str
    sentence: str
    hint: str = ""
    file: str = field(default="")

    def __str__(self) -> str:
        where = f"{self.file or '<text>'}:{self.place.line}:{self.place.column}"
        hint = f" ({self.hint})" if self.hint else ""
        return f"{where}: {self.path}: {self.sentence}{hint}"


def did_you_mean(word: str, known: Iterable[str]) -> str:
    """Return `did you mean 'x'?` for the nearest known word, or nothing."""
    close = difflib.get_close_matches(word, list(known), n=1)
    return f"did you mean {close[0]!r}?" if close else ""
