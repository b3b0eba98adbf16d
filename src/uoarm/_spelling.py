"""Which known word a wrong one is meant to be, within bounds of what it costs to find it."""

from __future__ import annotations

from collections.abc import Collection, Iterable
from heapq import nlargest
from itertools import pairwise

_COMPARISONS = 300_000
_COMPARED = 64
_CALL = 20
_LONGEST = 128
_LISTED = 8


def nearest(word: str, known: Collection[str]) -> str:
    """Return the known word that was meant, "" where none is near.

    Of many words those are compared letter by letter that share most pairs of letters.
    """
    import difflib  # noqa: PLC0415 - for mistakes only

    if len(known) > _COMPARED:
        pairs = set(pairwise(word))
        known = nlargest(_COMPARED, known, lambda name: len(pairs.intersection(pairwise(name))))
    return next(iter(difflib.get_close_matches(word, known, n=1)), "")


def did_you_mean(name: object, known: Iterable[str]) -> str:
    """Return the end of an error text about a name that is not known: which one is near it.

    Names of any number and length may be given: of many those that share most pairs of letters are
    compared, and nothing is near a name of more than 128 letters.

    Returns:
        `; did you mean 'x'?`; empty where none is near, and where `name` is no text.

    Example:
        >>> did_you_mean("/chater", ["/chatter", "/rosout"])
        "; did you mean '/chatter'?"
    """
    if not isinstance(name, str) or len(name) > _LONGEST:
        return ""
    close = nearest(name, [word for word in known if word != name])
    return f"; did you mean {close!r}?" if close else ""


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
        close = nearest(word, known)
        return f'did you mean "{close}"?' if close else ""

    def guess_or_list(self, word: str, known: Collection[str], what: str) -> str:
        """Return a guess, or where there is none the first few known words."""
        return self.guess(word, known) or f"{what}: {_some(known)}"


def _some(known: Collection[str]) -> str:
    words = list(known)[:_LISTED]
    more = f" and {len(known) - _LISTED:,} more" if len(known) > _LISTED else ""
    return (", ".join(words) + more) or "none"
