"""Text that can be encoded and printed: halves of surrogate pairs and control characters cannot."""

from __future__ import annotations

import re

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
