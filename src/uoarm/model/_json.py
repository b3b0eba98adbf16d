"""JSON as it comes in, within a budget, and as it goes out; and values in an error's text.

Every number is finite and every text can be encoded, in both directions.
"""

from __future__ import annotations

import json
import math
import re
from array import array
from collections.abc import Mapping, Sequence
from itertools import accumulate
from typing import Any

from attrs import field, frozen
from attrs.validators import ge

from uoarm.errors import ControlMessageError
from uoarm.model._message import message_octets

__all__ = [
    "Budget",
    "Spending",
    "count_names",
    "finite",
    "read_json",
    "scan_json",
    "show_value",
    "write_json",
]

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


@frozen
class Budget:
    """Bounds of one message, held by every decoder before it does the work.

    A decoder that counts a value twice or too generously refuses early, never late.

    Attributes:
        octets: of the message as it comes.
        elements: values and names of members, however deep they lie; octets and a typed array are
            one each.
        depth: levels of nested lists and objects.
        dimensions: of one array that says how many it has.
    """

    octets: int = field(default=16_777_216, validator=ge(1))
    elements: int = field(default=500_000, validator=ge(1))
    depth: int = field(default=64, validator=ge(1))
    dimensions: int = field(default=8, validator=ge(1))


class Spending:
    """How much of a budget one message has used; one decoder's at a time.

    Each method raises ControlMessageError when the budget does not allow it.

    Attributes:
        budget: what it may cost.
        elements: counted so far; never fewer than there are.
    """

    def __init__(self, budget: Budget) -> None:
        self.budget = budget
        self.elements = 0

    def octets(self, count: int) -> None:
        """Check the length of the message as it comes."""
        if count > self.budget.octets:
            allowed = f"{self.budget.octets:,} are allowed"
            raise ControlMessageError(f"it has {count:,} bytes; {allowed}")

    def add(self, elements: int) -> None:
        """Count elements that are about to be made."""
        self.elements += elements
        if self.elements > self.budget.elements:
            raise ControlMessageError(f"it holds more than {self.budget.elements:,} values")

    def depth(self, levels: int) -> None:
        """Check how deep it is nested."""
        if levels > self.budget.depth:
            raise ControlMessageError(f"nested more than {self.budget.depth} levels deep")

    def dimensions(self, sizes: Sequence[Any], items: int) -> None:
        """Check the sizes that an array of several dimensions claims, and count its rows.

        Done so that no product is taken of numbers that nothing in the message stands for.

        Args:
            sizes: one for each dimension, the outermost first.
            items: how many values the array has.
        """
        if not 1 <= len(sizes) <= self.budget.dimensions:
            most = self.budget.dimensions
            raise ControlMessageError(f"{len(sizes):,} dimensions; 1 to {most} are allowed")
        count = 1
        rows = 0
        for size in sizes:
            rows += count
            if type(size) is not int or not 1 <= size <= items:
                raise ControlMessageError(
                    f"dimensions must be whole numbers from 1 to the {items:,} items that came"
                )
            count *= size
            if count > items:
                break
        if count != items:
            raise ControlMessageError(f"the dimensions do not hold the {items:,} items that came")
        self.add(rows + items)


_STRING = re.compile(r'"[^"]*(?:"|\Z)')
_BRACKETS = bytes.maketrans(b"[{]}", b"\x01\x01\xff\xff")
_OTHERS = bytes(index for index in range(256) if index not in b"[{]}")


def scan_json(text: str, spending: Spending) -> None:
    """Refuse text that would cost more than its budget; spend what it costs otherwise.

    Linear in the length of the text, and without a pass over its strings where that is not needed:
    brackets, commas and colons within them count as if they stood outside, unless the budget would
    not allow it.

    Raises:
        ControlMessageError: it holds too much, or is nested too deep.
    """
    opened = text.count("[") + text.count("{")
    elements = 1 + opened + text.count(",") + text.count(":")
    left = spending.budget.elements - spending.elements
    if elements > left or opened > spending.budget.depth:
        outside = _without_strings(text, 2 * left)
        opened = outside.count("[") + outside.count("{")
        elements = 1 + opened + outside.count(",") + outside.count(":")
        spending.add(elements)
        if opened > spending.budget.depth:
            spending.depth(_depth(outside))
    else:
        spending.add(elements)


def count_names(text: str) -> int:
    """Return how many names of members JSON text has, those that are given twice included."""
    return _without_strings(text, len(text)).count(":")


def _without_strings(text: str, quotes: int) -> str:
    """Return what stands outside of strings; each string is a value or a name."""
    plain = text
    if "\\" in text:
        plain = text.replace("\\\\", "").replace('\\"', "")
    if plain.count('"') > quotes:
        raise ControlMessageError(f"it holds more than {quotes // 2:,} texts")
    return _STRING.sub("", plain)


def _depth(outside: str) -> int:
    steps = outside.encode("utf-8", "replace").translate(_BRACKETS, _OTHERS)
    return max(accumulate(array("b", steps)), default=0)


_SMALL = 4096


def show_value(value: Any, most: int = 60) -> str:
    """Return a value as Python would write it, cut after some characters.

    What takes more than 4 KiB of memory is shown by its kind and length: to write out a list of a
    million numbers for sixty characters of it would take longer than to decode it.
    """
    if isinstance(value, str | bytes):
        shown = repr(value[:most])
        return shown if len(value) <= most else f"{shown}..."
    if message_octets(value, most=_SMALL) > _SMALL:
        if isinstance(value, Mapping):
            return f"an object with {len(value):,} members"
        if isinstance(value, list | tuple):
            return f"a list of {len(value):,} values"
        return f"a large {type(value).__name__}"
    shown = repr(value)
    return shown if len(shown) <= most else f"{shown[:most]}..."
