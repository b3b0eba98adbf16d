"""What is wrong with a configuration, and where."""

from __future__ import annotations

import json
import re

from attrs import frozen

__all__ = ["Place", "Problem", "clip", "write_path"]

_SHOWN = 60
_PLAIN = re.compile(r"[A-Za-z_][A-Za-z0-9_-]*")


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
        path: where it stands in the data, `$.functions.camera.components[0].priority`; empty where
            it is about the whole file, and no place in it is told.
        sentence: what is wrong: what was expected and what came.
        hint: what to do, empty where the sentence says it.
        file: the file, empty for text that was not read from one.
    """

    place: Place
    path: str
    sentence: str
    hint: str = ""
    file: str = ""

    def __str__(self) -> str:
        where = f":{self.place.line}:{self.place.column}: {self.path}" if self.path else ""
        hint = f" ({self.hint})" if self.hint else ""
        return f"{self.file or '<text>'}{where}: {self.sentence}{hint}"


def clip(value: object) -> str:
    """Write a value as JSON on one line, cut where it is long."""
    if value is None:
        return "nothing"
    if isinstance(value, str) and len(value) > _SHOWN:
        value = f"{value[:_SHOWN]}..."
    text = json.dumps(value, ensure_ascii=False, default=str)
    return text if len(text) <= _SHOWN + 5 else f"{text[:_SHOWN]}..."


def write_path(path: tuple[str | int, ...]) -> str:
    """Write a path as `$.functions.camera.components[0]`; odd keys as `["a b"]`."""
    return "$" + "".join(_step(part) for part in path)


def _step(part: str | int) -> str:
    if isinstance(part, int):
        return f"[{part}]"
    return f".{part}" if _PLAIN.fullmatch(part) and len(part) <= _SHOWN else f"[{clip(part)}]"
