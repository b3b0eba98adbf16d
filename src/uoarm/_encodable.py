"""Text that can be encoded and printed: halves of surrogate pairs and control characters cannot.

Nor can values as they are: Python writes whole numbers of 4,300 digits at most, and all of a list.
"""

from __future__ import annotations

import re
import reprlib

# Terminals obey C0 and C1 characters. Those of Unicode end a line, or have text run the other way.
_CONTROL = re.compile(r"[\x00-\x08\x0b-\x1f\x7f-\x9f\u2028-\u202e\u2066-\u2069]")


def is_encodable(text: str) -> bool:
    """Say whether text can be encoded as UTF-8."""
    if text.isascii():
        return True
    try:
        text.encode()
    except UnicodeEncodeError:
        return False
    return True


def encodable(text: str) -> str:
    r"""Return text for people that can be encoded: halves of pairs are written as `\ud800`."""
    return text if text.isascii() else text.encode(errors="backslashreplace").decode()


def printable(text: str) -> str:
    r"""Return text for a terminal or a log: what controls these is written as `\x1b`.

    Tabs and ends of lines stay. Halves of surrogate pairs are for `encodable`.
    """
    return _CONTROL.sub(lambda found: repr(found[0])[1:-1], text.replace("\r\n", "\n"))


_LINE, _BEGIN, _END = 2_000, 1_500, 400


def in_short_lines(text: str) -> str:
    """Return text without the middle of lines that are longer than 2,000 characters.

    What came from elsewhere, such as a name, is said in an error, and may be of any length.
    """
    if len(text) <= _LINE:
        return text
    return "\n".join(
        line if len(line) <= _LINE else f"{line[:_BEGIN]} ... {line[-_END:]}"
        for line in text.split("\n")
    )


_LONG = 10**40


class _Short(reprlib.Repr):
    def repr_int(self, value: int, level: int) -> str:
        del level
        if abs(value) < _LONG:
            return repr(value)
        return f"a whole number of {value.bit_length():,} bits"


_SHORT = _Short()
_SHORT.maxstring = _SHORT.maxother = 90


def shown(value: object, most: int = 80) -> str:
    """Return a value in words for an error: at most so many characters, whatever it is."""
    text = encodable(_SHORT.repr(value))
    return text if len(text) <= most else f"{text[: most - 3]}..."
