"""Finding a text: of a length in an interval, matching some patterns and not others.

The automata are made deterministic as they are walked, all together, one layer for each length.
A bound on length is never turned into states: when nothing but length matters, the text is made
directly; where layers repeat, the walk stops.
"""

from __future__ import annotations

from collections.abc import Callable, Collection
from typing import TypeAlias

from uoarm.schema._charsets import CLASSES
from uoarm.schema._regex import compile_pattern
from uoarm.schema._walker import WalkState, walker_of

__all__ = ["TooLong", "shortest_word"]

State: TypeAlias = "tuple[WalkState | str | None, ...]"

MAX_TEXT = 4_000_000
_MAX_LAYERS = 5_000
_MAX_WORK = 400_000
_LAST, _SURROGATES = 0x10FFFF, range(0xD800, 0xE000)
_FAVOURITES = "aAbcdefgxyz0123456789_- ./:"


class TooLong(Exception):  # noqa: N818 - a limit that was met, not a fault
    """The text would be, or the walk was, longer than is affordable."""


def shortest_word(
    wanted: Collection[str],
    unwanted: Collection[str],
    least: int,
    most: int | None,
    excluded: Collection[str] = (),
    spend: Callable[[int], None] = lambda _: None,
) -> str | None:
    """Return a shortest text, or None when there is none.

    Args:
        wanted: patterns that must be found in it.
        unwanted: patterns that must not be.
        least: characters at least.
        most: characters at most, None for any number.
        excluded: texts that it must not be.
        spend: is told how much work is done.

    Raises:
        UnsupportedPatternError: a pattern is not decided here.
        TooLong: the text or the search for it is longer than is affordable.
    """
    if most is not None and most < least:
        return None
    if not wanted and not unwanted and not any(len(one) == least for one in excluded):
        if least > MAX_TEXT:
            raise TooLong(f"the shortest text has {least:,} characters")
        return "a" * least
    search = _Search(wanted, unwanted, excluded)
    return search.run(least, most, spend)


class _Search:
    def __init__(
        self, wanted: Collection[str], unwanted: Collection[str], excluded: Collection[str]
    ) -> None:
        self._walkers = [walker_of(one) for one in (*wanted, *unwanted)]
        self._wanted = len(wanted)
        self._excluded = frozenset(excluded)
        self._prefixes = {one[:n] for one in excluded for n in range(len(one) + 1)}
        self._letters = _letters([*wanted, *unwanted], excluded)

    def run(self, least: int, most: int | None, spend: Callable[[int], None]) -> str | None:
        start: State = (*(one.start for one in self._walkers), "" if self._excluded else None)
        if least == 0 and self._accepts(start):
            return ""
        layers: list[dict[State, tuple[State, str] | None]] = [{start: None}]
        seen: dict[frozenset[State], int] = {}
        work = 0
        while most is None or len(layers) <= most:
            layer: dict[State, tuple[State, str] | None] = {}
            for state in layers[-1]:
                for letter in self._letters:
                    layer.setdefault(self._step(state, letter), (state, letter))
                weight = len(self._letters) * _weight(state)
                work += weight
                spend(weight // 64)
                if work > _MAX_WORK or len(layers) > _MAX_LAYERS:
                    raise TooLong("the search for a text was given up")
            if not layer:
                return None
            layers.append(layer)
            length = len(layers) - 1
            if length >= least:
                for state in layer:
                    if self._accepts(state):
                        return _read_back(layers, state)
                kind = frozenset(layer)
                if kind in seen:
                    return None
                seen[kind] = length
        return None

    def _step(self, state: State, letter: str) -> State:
        code = ord(letter)
        after: list[WalkState | str | None] = [
            walker.step(part, code)  # type: ignore[arg-type] # the first parts are walks
            for walker, part in zip(self._walkers, state, strict=False)
        ]
        prefix = state[-1]
        longer = f"{prefix}{letter}" if isinstance(prefix, str) else None
        after.append(longer if longer in self._prefixes else None)
        return tuple(after)

    def _accepts(self, state: State) -> bool:
        if state[-1] is not None and state[-1] in self._excluded:
            return False
        return all(
            walker.accepts(part) == (number < self._wanted)  # type: ignore[arg-type] # walks
            for number, (walker, part) in enumerate(zip(self._walkers, state, strict=False))
        )


def _weight(state: State) -> int:
    """Return about how much work one step from a state is."""
    return sum(
        len(one[1]) + sum(len(duties) for _, duties in one[1])
        for one in state
        if isinstance(one, tuple)
    )


def _read_back(layers: list[dict[State, tuple[State, str] | None]], state: State) -> str:
    letters: list[str] = []
    for layer in reversed(layers[1:]):
        before = layer[state]
        assert before is not None
        state, letter = before
        letters.append(letter)
    return "".join(reversed(letters))


def _letters(patterns: Collection[str], excluded: Collection[str]) -> list[str]:
    """Return one character for each class that the patterns and texts tell apart."""
    cuts = {0, 0xD800, 0xE000}
    for pattern in patterns:
        nfa = compile_pattern(pattern)
        sets = [chars for part in nfa.parts() for edges in part.edges for chars, _ in edges]
        if nfa.sees_words():
            sets.append(CLASSES["w"])
        cuts |= {cut for chars in sets for low, high in chars for cut in (low, high + 1)}
    for text in excluded:
        for char in text:
            cuts |= {ord(char), ord(char) + 1}
    bounds = sorted(one for one in cuts if one <= _LAST)
    letters = []
    for low, high in zip(bounds, [*bounds[1:], _LAST + 1], strict=True):
        if low not in _SURROGATES:
            letters.append(_nicest(low, high - 1))
    return sorted(letters, key=lambda one: (_rank(one), one))


def _nicest(low: int, high: int) -> str:
    for char in _FAVOURITES:
        if low <= ord(char) <= high:
            return char
    return chr(low)


def _rank(char: str) -> int:
    position = _FAVOURITES.find(char)
    return position if position >= 0 else len(_FAVOURITES)
