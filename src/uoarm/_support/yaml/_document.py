"""A configuration as plain values, and the place of each of its parts."""

from __future__ import annotations

import json
import math
import re
from collections.abc import Mapping, Sequence
from typing import TypeAlias

from attrs import define, field, frozen

from uoarm._encodable import encodable, shown
from uoarm.errors import ConfigurationError

_SHOWN = 60
_LISTED = 50
_PLAIN = re.compile(r"[A-Za-z_][A-Za-z0-9_-]*")


@frozen(order=True)
class Position:
    """A place in a file, counted from one."""

    line: int
    column: int


@frozen(kw_only=True)
class Problem:
    """One mistake.

    Attributes:
        place: where it stands.
        path: where it stands in the data, `$.functions.camera.components[0].priority`; empty where
            it is about the whole file, and no place in it is named.
        sentence: what is wrong: what was expected and what came.
        hint: what to do, empty where the sentence says it.
        file: the file, empty for text that was not read from one.
        error_code: of `uoarm.error_codes`.
    """

    place: Position
    path: str
    sentence: str
    hint: str = ""
    file: str = ""
    error_code: str = "UOA-103"

    def __str__(self) -> str:
        where = f":{self.place.line}:{self.place.column}: {self.path}" if self.path else ""
        hint = f" ({self.hint})" if self.hint else ""
        return f"{self.file or '<text>'}{where}: {self.sentence}{hint}"


def mistakes_error(problems: Sequence[Problem]) -> ConfigurationError:
    """Return the error of mistakes: it lists the first 50, counts the rest, and has their code."""
    lines = [str(problem) for problem in problems[:_LISTED]]
    if len(problems) > _LISTED:
        lines.append(f"... and {len(problems) - _LISTED:,} more")
    codes = {problem.error_code for problem in problems}
    return ConfigurationError("\n".join(lines), error_code=codes.pop() if len(codes) == 1 else "")


def clip(value: object) -> str:
    """Write a value as JSON on one line, cut where it is long."""
    if value is None:
        return "nothing"
    if value.__class__ is int:
        return shown(value, _SHOWN)
    if isinstance(value, str) and len(value) > _SHOWN:
        value = f"{value[:_SHOWN]}..."
    try:
        text = encodable(json.dumps(value, ensure_ascii=False, default=str))
    except ValueError:  # a number that is too long to be written, or an object in itself
        return shown(value, _SHOWN)
    return text if len(text) <= _SHOWN + 5 else f"{text[:_SHOWN]}..."


def write_path(path: tuple[str | int, ...]) -> str:
    """Write a path as `$.functions.camera.components[0]`; odd keys as `["a b"]`."""
    return "$" + "".join(_step(part) for part in path)


def write_flow(value: object) -> str:
    """Write a value as YAML in one line: as JSON, but for characters that only YAML escapes."""
    try:
        text = json.dumps(value, ensure_ascii=False)
    except ValueError:  # a number that is too long to be written in tens
        text = json.dumps(shown(value), ensure_ascii=False)
    return "".join(
        character if character.isprintable() else f"\\U{ord(character):08x}" for character in text
    )


def _step(part: str | int) -> str:
    if isinstance(part, int):
        return f"[{part}]"
    return f".{part}" if _PLAIN.fullmatch(part) and len(part) <= _SHOWN else f"[{clip(part)}]"


Path: TypeAlias = "tuple[str | int, ...]"


@define(eq=False)
class NodePosition:
    """Where one value stands, and in a mapping its key; `parts` mirrors what is inside it.

    A tree beside the values costs the same memory at every depth, where a table by path does not.
    """

    place: Position
    key: Position | None = None
    parts: dict[str, NodePosition] | list[NodePosition] | None = None


@frozen
class Document:
    """What was read of a file.

    Attributes:
        value: dicts, lists, strings, numbers, booleans, None.
        root: places of the value and all that is in it.
        problems: what is wrong with the file as YAML.
        whole: reading got to the end; else `value` says nothing.
        text: what was read, without a byte order mark.
    """

    value: object
    root: NodePosition
    problems: tuple[Problem, ...] = ()
    whole: bool = True
    text: str = field(default="", eq=False, repr=False)

    def place(self, path: Path) -> Position:
        """Return the place of the value at a path, or of the nearest value around it."""
        return self._spot(path)[0].place

    def key_place(self, path: Path) -> Position:
        """Return the place of the key at the end of a path, or of its value where it has none."""
        spot, found = self._spot(path)
        return spot.key if found and spot.key is not None else spot.place

    def _spot(self, path: Path) -> tuple[NodePosition, bool]:
        spot = self.root
        for part in path:
            inner: NodePosition | None = None
            if isinstance(spot.parts, dict) and isinstance(part, str):
                inner = spot.parts.get(part)
            elif isinstance(spot.parts, list) and isinstance(part, int):
                inner = spot.parts[part] if part < len(spot.parts) else None
            if inner is None:
                return spot, False
            spot = inner
        return spot, True


_MAX_DIGITS = 1000
_NUMBER_STARTS = frozenset("+-.0123456789")
_INTEGER = re.compile(r"[-+]?[0-9]+")
_OCTAL = re.compile(r"0o[0-7]+")
_HEXADECIMAL = re.compile(r"0x[0-9a-fA-F]+")
_FLOAT = re.compile(r"[-+]?(\.[0-9]+|[0-9]+(\.[0-9]*)?)([eE][-+]?[0-9]+)?")
_NOT_FINITE = re.compile(r"[-+]?\.(inf|Inf|INF)|\.(nan|NaN|NAN)")
_WORDS: Mapping[str, object] = {
    "": None,
    "~": None,
    **dict.fromkeys(("null", "Null", "NULL")),
    **dict.fromkeys(("true", "True", "TRUE"), True),
    **dict.fromkeys(("false", "False", "FALSE"), False),
}


class ScalarError(ValueError):
    """A number that JSON cannot hold; the text is the sentence to show."""


def resolve(text: str) -> object:
    """Return the string, number, boolean or None that unquoted text stands for.

    `yes`, `no`, `on` and `off` are strings, `010` is ten, `0o10` is eight, `1:30` is a string.

    Raises:
        ScalarError: the text is a number that is not finite or far too long.
    """
    if text in _WORDS:
        return _WORDS[text]
    if text[0] not in _NUMBER_STARTS:
        return text
    if _NOT_FINITE.fullmatch(text):
        raise ScalarError(f"{text} is not a number of JSON")
    if _FLOAT.fullmatch(text) or _OCTAL.fullmatch(text) or _HEXADECIMAL.fullmatch(text):
        if len(text) > _MAX_DIGITS:
            raise ScalarError(f"a number of {len(text):,} digits; {_MAX_DIGITS:,} are allowed")
        return _number(text)
    return text


def _number(text: str) -> int | float:
    if _INTEGER.fullmatch(text):
        return int(text)
    if text.startswith(("0o", "0x")):
        return int(text, 0)
    number = float(text)
    if math.isinf(number):
        raise ScalarError(f"{text} is larger than the largest number")
    return number
