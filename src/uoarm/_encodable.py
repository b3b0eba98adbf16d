"""Text that can be encoded: half of a surrogate pair, which a string of Python may hold, cannot."""

from __future__ import annotations


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
