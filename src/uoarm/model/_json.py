"""JSON as it comes in and goes out: every number is finite, and every text can be encoded."""

from __future__ import annotations

import json
import math
import re
from collections.abc import Mapping
from typing import Any

__all__ = ["finite", "read_json", "write_json"]

_HALF = re.compile(r"\\u[dD][89a-fA-F]")
_HALVES = re.compile("[\ud800-\udfff]")
_MOST_DIGITS = 1000
_MAY_BE_INFINITE = re.compile(r"[eE]\+?\d{3}|\d{300}")


def read_json(text: str | bytes) -> Any:
    """Return the value that JSON text stands for.

    Whole numbers are exact, of a thousand digits at most. What other readers would take otherwise
    is refused: `NaN` and `Infinity`, which are no JSON; numbers that are infinite in 64 bits, such
    as 1e400; half of a surrogate pair, which no encoding can write; a key that is given twice in
    one object.

    Args:
        text: JSON; octets are UTF-8.

    Raises:
        ValueError: it is none; the text says what is wrong with it.
    """
    text = text if isinstance(text, str) else bytes(text).decode()
    # A function for each number would cost as much as all the rest.
    is_long = _MAY_BE_INFINITE.search(text) is not None
    try:
        value = json.loads(
            text,
            parse_constant=_refuse,
            parse_float=_float if is_long else None,
            parse_int=_integer if is_long else None,
            object_pairs_hook=_unique,
        )
    except RecursionError as error:
        raise ValueError("it is nested too deep") from error
    if _HALF.search(text) and _HALVES.search(json.dumps(value, ensure_ascii=False)):
        raise ValueError("half of a surrogate pair is no character")
    return value


def write_json(value: Any, *, indent: int | None = None) -> str:
    """Return a plain value as JSON text that every reader takes.

    What JSON has no number for is written as a text, as the server's messages have it: "NaN",
    "Infinity" and "-Infinity".

    Raises:
        ValueError: it has no form in JSON.
        TypeError: as that.
    """
    try:
        return json.dumps(value, indent=indent, allow_nan=False)
    except ValueError:  # it is not finite, mostly
        return json.dumps(finite(value), indent=indent, allow_nan=False)


def finite(value: Any) -> Any:
    """Return a copy of a plain value in which each number that is not finite is its name."""
    if isinstance(value, float):
        if math.isfinite(value):
            return value
        return "NaN" if math.isnan(value) else "Infinity" if value > 0 else "-Infinity"
    if isinstance(value, Mapping):
        return {finite(key): finite(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [finite(item) for item in value]
    return value


def _float(text: str) -> float:
    number = float(text)
    if math.isinf(number):
        raise ValueError(f"{text[:40]} is beyond what a number of 64 bits can hold")
    return number


def _integer(text: str) -> int:
    if len(text) > _MOST_DIGITS:
        raise ValueError(f"a whole number of {len(text):,} digits; {_MOST_DIGITS:,} are allowed")
    return int(text)


def _refuse(name: str) -> Any:
    raise ValueError(f"{name} is no number of JSON")


def _unique(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    found = dict(pairs)
    if len(found) < len(pairs):
        twice = next(key for at, (key, _) in enumerate(pairs) if key in dict(pairs[:at]))
        raise ValueError(f"the key {json.dumps(twice)} is given twice in one object")
    return found
