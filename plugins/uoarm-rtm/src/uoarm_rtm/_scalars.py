"""Single values on their way to the wire: exact types pass at once, near ones are converted."""

from __future__ import annotations

import operator
from collections.abc import Callable
from typing import Any, Literal, TypeAlias

import numpy as np

from uoarm.model import Message
from uoarm_rtm._schema import FLOAT_MAX
from uoarm_rtm._shape import INTEGERS

__all__ = ["CODES", "SIZES", "IdlMismatch", "Order", "checker", "shown"]

Order: TypeAlias = Literal["<", ">"]
"""Little-endian or big-endian, as the struct module and numpy write it."""

CODES = {
    "octet": "B",
    "boolean": "B",
    "char": "B",
    "short": "h",
    "unsigned short": "H",
    "long": "i",
    "unsigned long": "I",
    "long long": "q",
    "unsigned long long": "Q",
    "float": "f",
    "double": "d",
}
"""Codes of the struct module, the same in numpy, for all scalars but `wchar`."""

SIZES = {"B": 1, "h": 2, "H": 2, "i": 4, "I": 4, "q": 8, "Q": 8, "f": 4, "d": 8}
"""Bytes of each code, which are its alignment in CDR too."""


class IdlMismatch(Exception):  # noqa: N818 - a sentence for `_explain`, which adds the path
    """A value does not fit; the text says what was expected and what came."""


def shown(value: object) -> str:
    """Return a short description of a value for an error's sentence."""
    text = repr(value)
    if len(text) > 60:  # noqa: PLR2004 - what fits in a sentence
        text = f"{text[:57]}..."
    return f"{type(value).__name__} {text}"


def checker(name: str) -> Callable[[Message], Any]:
    """Return the function that turns a value into what `struct` packs for a scalar.

    It raises Misfit. `wchar` has none: it is written as text.
    """
    if name == "boolean":
        return _boolean
    if name == "char":
        return _char
    if name in INTEGERS:
        return _integer(name)
    return _number(name)


def _boolean(value: Message) -> bool:
    if not isinstance(value, bool | np.bool_):
        raise IdlMismatch(f"expected true or false, got {shown(value)}")
    return bool(value)


def _char(value: Message) -> int:
    if not isinstance(value, str) or len(value) != 1 or ord(value) > 255:  # noqa: PLR2004 - a byte
        raise IdlMismatch(f"expected one character of Latin-1, got {shown(value)}")
    return ord(value)


def _integer(name: str) -> Callable[[Message], int]:
    low, high = INTEGERS[name]

    def check(value: Message) -> int:
        if isinstance(value, float | np.floating) and value == value // 1:
            value = int(value)  # JSON knows no difference between 1 and 1.0
        if isinstance(value, bool | np.bool_) or not hasattr(value, "__index__"):
            raise IdlMismatch(f"expected an integer ({name}), got {shown(value)}")
        number = operator.index(value)
        if not low <= number <= high:
            raise IdlMismatch(f"expected {low} to {high} ({name}), got {number}")
        return number

    return check


def _number(name: str) -> Callable[[Message], float]:
    def check(value: Message) -> float:
        if isinstance(value, bool) or not isinstance(value, int | float | np.number):
            raise IdlMismatch(f"expected a number ({name}), got {shown(value)}")
        try:
            number = float(value)
        except (OverflowError, TypeError) as error:
            raise IdlMismatch(f"expected a number ({name}), got {shown(value)}") from error
        if name == "float" and abs(number) > FLOAT_MAX and abs(number) != float("inf"):
            raise IdlMismatch(f"expected at most 3.4e38 in size (float), got {shown(value)}")
        return number

    return check
