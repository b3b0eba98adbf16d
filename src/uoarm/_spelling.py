"""The words that are allowed somewhere, and which of them a misspelt one was meant to be."""

from __future__ import annotations

from collections.abc import Collection

__all__ = ["Speller", "any_of"]

_COMPARISONS = 300_000
_CALL = 20
_LONGEST = 128
_LISTED = 8


class Speller:
    """Finds the nearest known word; stops guessing when one file has cost enough comparisons.

    Without the budget a file whose thousands of references are all wrong would take minutes.
    """

    def __init__(self) -> None:
        self._left = _COMPARISONS

    def guess(self, word: str, known: Collection[str]) -> str:
        """Return `did you mean "x"?`, or nothing when no word is near."""
        self._left -= len(known) + _CALL
        if self._left < 0 or len(word) > _LONGEST:
            return ""
        import difflib  # noqa: PLC0415 - for mistakes only

        close = difflib.get_close_matches(word, known, n=1)
        return f'did you mean "{close[0]}"?' if close else ""

    def guess_or_list(self, word: str, known: Collection[str], what: str) -> str:
        """Return a guess, or where there is none the first few known words."""
        return self.guess(word, known) or f"{what}: {_some(known)}"


def _some(known: Collection[str]) -> str:
    words = list(known)[:_LISTED]
    more = f" and {len(known) - _LISTED:,} more" if len(known) > _LISTED else ""
    return (", ".join(words) + more) or "none"


def any_of(allowed: Collection[object]) -> str:
    """Write a choice: `a, b or c`; truth values as files have them."""
    words = [str(item).lower() if isinstance(item, bool) else str(item) for item in allowed]
    return words[0] if len(words) == 1 else f"{', '.join(words[:-1])} or {words[-1]}"
