"""Finding a text: of a length in an interval, matching some patterns and not others.

The automata are made deterministic as they are walked, all together, one layer for each length.
A bound on length is never turned into states: when nothing but length matters, the text is made
directly; where a layer comes again, so do those after it, and longer texts are read off the period.
"""

from __future__ import annotations

from bisect import bisect_left, bisect_right
from collections.abc import Collection, Sequence
from typing import TypeAlias

from uoarm._encodable import shown
from uoarm.schema._errors import Meter
from uoarm.schema.regex._nfa import CLASSES, CharSet
from uoarm.schema.regex._parser import compile_pattern
from uoarm.schema.regex._walker import CodeUnits, UnitWalker, WalkState, walker_of

Pattern: TypeAlias = "str | CodeUnits"
Rivals: TypeAlias = "tuple[int, int] | None"
"""Which of the sorted excluded texts begin like this one; None where none does."""
WordState: TypeAlias = "tuple[tuple[WalkState, ...], Rivals]"
Layer: TypeAlias = "dict[WordState, tuple[WordState, str] | None]"
"""The states after as many characters as the layer's number, each with how it is reached."""

MAX_TEXT = 4_000_000
_LAST, _SURROGATES = 0x10FFFF, (0xD800, 0xDFFF)
_FAVOURITES = "aAbcdefgxyz0123456789_- ./:"
_WIDE = "\U0001f600"
_AGREED = ((0x21, 0x7E), (0xA1, 0xA9), (0x2190, 0x21FF), (0x1F600, 0x1F64F))
"""Characters that are a digit, a word, a space or the end of a line to every engine, or to none."""
_OF_STATE, _OF_THREAD = 300, 100
"""About the octets of what is kept of a state, and of each thread in it."""


class TooLong(Exception):  # noqa: N818 - a limit that was met, not a fault
    """The text would be longer than is affordable, or none that can be written."""


def shortest_word(
    wanted: Collection[Pattern],
    unwanted: Collection[Pattern],
    least: int,
    most: int | None,
    excluded: Collection[str],
    meter: Meter,
    *,
    without_nul: bool = False,
) -> str | None:
    """Return a shortest text, or None when there is none.

    Where only code units are counted, it may be a longer one that is as easily read.

    Args:
        wanted: patterns that must be found in it.
        unwanted: patterns that must not be.
        least: characters at least.
        most: characters at most, None for any number.
        excluded: texts that it must not be.
        meter: is spent.
        without_nul: whether it must not have the character NUL.

    Raises:
        UnsupportedPatternError: a pattern is not decided here.
        TooLong: the text is longer than is affordable.
        BudgetError: the search is.
    """
    for units in wanted:
        if isinstance(units, CodeUnits):
            most = units.most if most is None else min(most, units.most)
    if (most is not None and most < least) or _are_too_few(wanted, unwanted, most):
        return None
    if not excluded and (text := _counted(wanted, unwanted, least, most)):
        return text
    if not wanted and not unwanted and not any(len(name) == least for name in excluded):
        _check_length(least)
        return "a" * least
    letters, halves = _letters([*wanted, *unwanted], excluded, without_nul=without_nul)
    found = _search(_Search(wanted, unwanted, excluded, letters, meter), least, most)
    if found is None and halves:
        letters += halves
        if _search(_Search(wanted, unwanted, excluded, letters, meter), least, most) is not None:
            raise TooLong("only texts with half a surrogate pair are left, which UTF-8 has not")
    return found


def _search(search: _Search, least: int, most: int | None) -> str | None:
    try:
        return search.run(least, most)
    finally:
        search.close()


def _are_too_few(
    wanted: Collection[Pattern], unwanted: Collection[Pattern], most: int | None
) -> bool:
    """Say whether no text can have the code units that it must have at least."""
    return any(
        isinstance(beyond, CodeUnits)
        and (
            (most is not None and most * beyond.widest <= beyond.most)
            or any(
                isinstance(units, CodeUnits) and units.bound_on(beyond) <= beyond.most
                for units in wanted
            )
        )
        for beyond in unwanted
    )


def _counted(
    wanted: Collection[Pattern], unwanted: Collection[Pattern], least: int, most: int | None
) -> str | None:
    """Return a text where nothing but code units and length matters, if one is found at once."""
    units = [pattern for pattern in (*wanted, *unwanted) if isinstance(pattern, CodeUnits)]
    if not units or len(units) < len(wanted) + len(unwanted):
        return None
    text = ""
    for beyond in unwanted:
        assert isinstance(beyond, CodeUnits)
        wide, rest = divmod(beyond.most + 1, beyond.widest)
        _check_length(wide + rest)
        text = max(text, _WIDE * wide + "a" * rest, key=len)
    _check_length(least)
    text = text.ljust(least, "a")
    fits = most is None or len(text) <= most
    holds = all(pattern.holds(text) == (pattern in wanted) for pattern in units)
    return text if fits and holds else None


def _check_length(length: int) -> None:
    if length > MAX_TEXT:
        raise TooLong(f"the shortest text has {shown(length)} characters")


class _Search:
    def __init__(
        self,
        wanted: Collection[Pattern],
        unwanted: Collection[Pattern],
        excluded: Collection[str],
        letters: Sequence[str],
        meter: Meter,
    ) -> None:
        meter.spend(len(excluded) // 16)
        self._meter = meter
        patterns = (*wanted, *unwanted)
        self._walkers = [
            walker_of(name) if isinstance(name, str) else UnitWalker(name) for name in patterns
        ]
        self._wanted = len(wanted)
        counts = [place for place, name in enumerate(patterns) if isinstance(name, CodeUnits)]
        self._count = counts[0] if len(counts) == 1 else None
        self._excluded = sorted(excluded)
        self._letters = letters
        self._layers: list[Layer] = []
        self._held = 0

    def run(self, least: int, most: int | None) -> str | None:
        rivals = (0, len(self._excluded)) if self._excluded else None
        start: WordState = (tuple(walker.start for walker in self._walkers), rivals)
        self._layers.append({start: None})
        seen: dict[frozenset[WordState], int] = {}
        while True:
            length, layer = len(self._layers) - 1, self._layers[-1]
            if length >= least:
                for state in layer:
                    if self._accepts(state, length):
                        return self._read_back(length, state, length, 1)
            if not layer or (most is not None and length >= most):
                return None
            if all(rivals is None for _, rivals in layer):
                kind = frozenset(layer)
                if kind in seen:
                    return self._beyond(seen[kind], least, most)
                seen[kind] = length
            self._layers.append(self._next(layer, length))

    def close(self) -> None:
        """Give back the memory that the walk has held."""
        self._meter.release(self._held)

    def _next(self, layer: Layer, length: int) -> Layer:
        after: Layer = {}
        for state in layer:
            weight = len(self._letters) * _weight(state)
            self._meter.spend(1 + weight // 8)
            for letter in self._letters:
                after.setdefault(self._step(state, letter, length), (state, letter))
        if self._count is not None:
            after = self._best(after, self._count)
        octets = sum(_OF_STATE + _OF_THREAD * _weight(state) for state in after)
        self._meter.hold(octets)
        self._held += octets
        return after

    def _best(self, layer: Layer, place: int) -> Layer:
        """Keep one of those that differ in the count alone: all that helps another helps it, too.

        The count is to be large where it is of a bound that the text must not keep.
        """
        sign = -1 if place >= self._wanted else 1
        ordered = sorted(layer, key=lambda state: sign * state[0][place][0])
        kept: dict[object, WordState] = {}
        for state in ordered:
            walks, rivals = state
            kept.setdefault((walks[:place], walks[place + 1 :], rivals), state)
        return {state: layer[state] for state in kept.values()}

    def _beyond(self, first: int, least: int, most: int | None) -> str | None:
        """Return a text longer than all layers, of which the last is like the first given."""
        last = len(self._layers) - 1
        period = last - first
        shortest = max(least, last + 1)
        for length in range(shortest, shortest + period):
            if most is not None and length > most:
                return None
            self._meter.spend()
            for state in self._layers[first + (length - first) % period]:
                if self._accepts(state, length):
                    _check_length(length)
                    return self._read_back(length, state, last, period)
        return None

    def _read_back(self, length: int, state: WordState, last: int, period: int) -> str:
        """Return a text that leads to a state; what lies beyond the last layer is periodic."""
        pieces: list[str] = []
        came: dict[tuple[int, WordState], int] = {}
        while length > 0:
            place = length if length <= last else last - period + 1 + (length - last - 1) % period
            if length > last and (place, state) in came:
                since = came[place, state]
                cycle = "".join(pieces[since:])
                times = (length - last) // len(cycle)
                pieces.append(cycle * times)
                length -= len(cycle) * times
                came.clear()
            came[place, state] = len(pieces)
            found = self._layers[place][state]
            assert found is not None
            state, letter = found
            pieces.append(letter)
            length -= 1
        return "".join(pieces)[::-1]

    def _step(self, state: WordState, letter: str, length: int) -> WordState:
        code = ord(letter)
        walks, rivals = state
        after = tuple(
            walker.step(part, code) for walker, part in zip(self._walkers, walks, strict=True)
        )
        return after, None if rivals is None else self._narrowed(rivals, letter, length)

    def _narrowed(self, rivals: tuple[int, int], letter: str, length: int) -> Rivals:
        def after(text: str) -> str:
            return text[length : length + 1]

        low = bisect_left(self._excluded, letter, *rivals, key=after)
        high = bisect_right(self._excluded, letter, low, rivals[1], key=after)
        return (low, high) if low < high else None

    def _accepts(self, state: WordState, length: int) -> bool:
        walks, rivals = state
        if rivals is not None and len(self._excluded[rivals[0]]) == length:
            return False
        return all(
            walker.accepts(part) == (number < self._wanted)
            for number, (walker, part) in enumerate(zip(self._walkers, walks, strict=True))
        )


def _weight(state: WordState) -> int:
    """Return about how much work one step from a state is."""
    return sum(len(pair[1]) + sum(len(duties) for _, duties in pair[1]) for pair in state[0])


def _letters(
    patterns: Sequence[Pattern], excluded: Collection[str], *, without_nul: bool
) -> tuple[list[str], list[str]]:
    """Return one character for each class that the patterns and texts distinguish.

    Classes that only have halves of surrogate pairs come second.
    """
    sets: dict[CharSet, None] = {}
    for pattern in patterns:
        if isinstance(pattern, CodeUnits):
            sets.update(dict.fromkeys(pattern.widths))
            continue
        nfa = compile_pattern(pattern)
        edges = (chars for part in nfa.parts() for edges in part.edges for chars, _ in edges)
        sets.update(dict.fromkeys({id(chars): chars for chars in edges}.values()))
        if nfa.sees_words():
            sets[CLASSES["w"]] = None
    singles = {ord(char) for text in excluded for char in text} | ({0} if without_nul else set())
    changes: dict[int, int] = {0: 0}
    members = [(_SURROGATES,), *sets, *(((code, code),) for code in sorted(singles))]
    for number, chars in enumerate(members):
        for low, high in chars:
            changes[low] = changes.get(low, 0) ^ (1 << number)
            changes[high + 1] = changes.get(high + 1, 0) ^ (1 << number)
    best: dict[int, str] = {}
    nul = "\0" if without_nul else None
    halves: dict[int, str] = {}
    kind = 0
    bounds = sorted(change for change in changes if change <= _LAST)
    for low, end in zip(bounds, [*bounds[1:], _LAST + 1], strict=True):
        kind ^= changes[low]
        if kind & 1:
            halves.setdefault(kind ^ 1, chr(low))
        else:
            letter = _nicest(low, end - 1)
            known = best.setdefault(kind, letter)
            best[kind] = min(known, letter, key=_order)
    lone = [half for kind, half in halves.items() if kind not in best]
    letters = (letter for letter in best.values() if letter != nul)
    return sorted(letters, key=_order), lone


def _order(char: str) -> tuple[int, str]:
    return _rank(char), char


def _nicest(low: int, high: int) -> str:
    """Return the character of a range that people and engines most probably read alike."""
    for char in _FAVOURITES:
        if low <= ord(char) <= high:
            return char
    for first, last in _AGREED:
        if low <= last and high >= first:
            return chr(max(low, first))
    return chr(low)


def _rank(char: str) -> int:
    position = _FAVOURITES.find(char)
    if position >= 0:
        return position
    agreed = any(first <= ord(char) <= last for first, last in _AGREED)
    return len(_FAVOURITES) + (0 if agreed else 1)
