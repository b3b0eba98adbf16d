"""Random texts that look like patterns, most of them malformed, and texts to search in."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

_PIECES = (
    "a", "b", "1", "0", "{", "}", "{1,2}", "{2}", "{,2}", "{1", "[", "]", "[^", "[]", "[^]", "(",
    ")", "(?:", "(?=", "(?!", "(?<", "(?<n>", "(?P<n>", "|", "*", "+", "?", "*?", "^", "$", ".",
    r"\d", r"\D", r"\w", r"\W", r"\s", r"\b", r"\B", "\\", r"\{", r"\}", r"\-", "-", r"\u",
    r"\u0041", r"\u{41}", r"\ud83d", r"\ude00", r"\x", r"\x41", r"\c", r"\cA", r"\0", r"\1",
    r"\p{L}", r"\P{Lu}", r"\p", r"\<", r"\_", r"\/", "/", "&&", "--", "[[", ":", ",", "=", "!", "<",
    ">", "\n", "\r", "\u2028", "\u00e9", "\U0001f600", "\u0663", "\\\u00e9", r"\ ",
)  # fmt: skip
TEXTS = [
    "", "a", "b", "1", "0", "ab", "a1", "aa", "aab", "{", "}", "{1,2}", "{2}", "{{", "]", "[", "-",
    "a-", "A", "\n", "a\n", "\r", "\u2028", "\u00e9", "\U0001f600", "\u0663", "a\u00e9", "\\", "_",
    " ", "/", "a b", "b1", "<", ":", ",", "\x01", "uu", "x", "\x1c", "\x85", "\ufeff",
]  # fmt: skip


def random_text(choose: Callable[[Sequence[str]], str]) -> str:
    """A text of up to seven pieces."""
    length = int(choose("1234567"))
    return "".join(choose(_PIECES) for _ in range(length))
