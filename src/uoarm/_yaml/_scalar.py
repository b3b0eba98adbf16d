"""What a plain scalar means, by the core schema of YAML 1.2."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping

__all__ = ["ScalarError", "resolve"]

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
