"""Patterns made deterministic as they are walked, one character at a time.

A state says what stood before (the start, a word character, another one) and which threads there
are: a state of the automaton that may have been reached, with what the rest of the text must or
must not begin with. Free edges are followed when it is known what comes next.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from itertools import pairwise
from typing import NamedTuple, TypeAlias

from uoarm.schema.regex._nfa import (
    CLASSES,
    CharSet,
    Nfa,
    UnsupportedPatternError,
    contains,
)
from uoarm.schema.regex._parser import TextCache, compile_pattern

_START, _WORD, _OTHER, _END = range(4)
_MAX_THREADS = 3_000
_MAX_WALKED = 100_000
_MAX_KEPT = 200_000
"""Threads that one walker, and all that are kept, remember, of some 200 octets each."""

_CHARGED_AFTER = 16
"""Characters after which the budget is charged: of 64 known ones, or of 8 threads, as one step."""

Duty: TypeAlias = "tuple[bool, int, WalkState]"
"""Whether the rest must or must not match, which automaton is looking, and how far it is."""
Thread: TypeAlias = "tuple[int, frozenset[Duty]]"
WalkState: TypeAlias = "tuple[int, frozenset[Thread]]"

_NO_DUTIES: frozenset[Duty] = frozenset()


class Walker:
    """One pattern, made deterministic on the way.

    Args:
        work: of the walker that looks with this one; None for one that stands alone.
    """

    def __init__(self, nfa: Nfa, work: list[int] | None = None) -> None:
        self.work = [0] if work is None else work
        """How many threads were followed so far, those of looks included."""
        self._nfa = nfa
        self.last = nfa.last
        self._sees_words = nfa.sees_words()
        self._lookers: list[Walker] = []
        self._looks: list[list[tuple[bool, int, int]]] = [[] for _ in nfa.looks]
        numbers: dict[int, int] = {}  # those that repeat one automaton are walked as one
        for state, looks in enumerate(nfa.looks):
            for sign, inner, target in looks:
                number = numbers.setdefault(id(inner), len(self._lookers))
                if number == len(self._lookers):
                    self._lookers.append(Walker(inner, self.work))
                self._looks[state].append((sign, number, target))
        self.weight = 1
        self._steps: dict[tuple[WalkState, int], WalkState] = {}
        self._accepting: dict[WalkState, bool] = {}
        self._closed: tuple[WalkState | None, int, set[Thread]] = (None, 0, set())
        self.start = self.begin(_START)

    def step(self, state: WalkState, code: int) -> WalkState:
        known = self._steps.get((state, code))
        if known is None:
            follows = self._context(code)
            reached: set[Thread] = set()
            for at, duties in self._closure(state, follows):
                targets = [to for chars, to in self._nfa.edges[at] if contains(chars, code)]
                kept = self._advance(duties, code) if targets else None
                if kept is not None:
                    reached.update((to, kept) for to in targets)
            known = (follows, frozenset(reached))
            self.weight += 1 + len(reached)
            if self.weight > _MAX_WALKED:
                self._steps.clear()
                self._accepting.clear()
                self.weight = 1
            self._steps[state, code] = known
        return known

    def accepts(self, state: WalkState) -> bool:
        known = self._accepting.get(state)
        if known is None:
            known = self._accepting[state] = any(
                at == self.last
                and all(self._lookers[n].accepts(inner) == sign for sign, n, inner in duties)
                for at, duties in self._closure(state, _END)
            )
        return known

    def begin(self, before: int) -> WalkState:
        """Return the state before the first character, given what stood before that."""
        return before, frozenset({(self._nfa.first, _NO_DUTIES)})

    def _context(self, code: int) -> int:
        return _WORD if self._sees_words and contains(CLASSES["w"], code) else _OTHER

    def _advance(self, duties: frozenset[Duty], code: int) -> frozenset[Duty] | None:
        """Return what is left of some duties after a character; None when one is failed."""
        left: set[Duty] = set()
        for sign, number, inner in duties:
            looker = self._lookers[number]
            after = looker.step(inner, code)
            settled = _settled(looker, after)
            if settled is None:
                left.add((sign, number, after))
            elif settled != sign:
                return None
        return frozenset(left)

    def _closure(self, state: WalkState, follows: int) -> set[Thread]:
        # The same as last: a search tries one character after another from a state. What is
        # charged for it stays the same, so that no verdict depends on it.
        last, last_follows, reached = self._closed
        if last is not state or last_follows != follows:
            reached = self._closure_anew(state, follows)
            self._closed = state, follows, reached
        self.work[0] += len(reached)
        return reached

    def _closure_anew(self, state: WalkState, follows: int) -> set[Thread]:
        before, threads = state
        always, asserts = self._nfa.always, self._nfa.asserts
        reached: set[Thread] = set()
        waiting = list(threads)
        while waiting:
            thread = waiting.pop()
            if thread in reached:
                continue
            reached.add(thread)
            if len(reached) > _MAX_THREADS:
                raise UnsupportedPatternError("it can go on in too many ways at once")
            at, duties = thread
            waiting += [(to, duties) for to in always[at]]
            for kind, to in asserts[at]:
                if _holds(kind, before, follows):
                    waiting.append((to, duties))
            for sign, number, to in self._looks[at]:
                duty = (sign, number, self._lookers[number].begin(before))
                waiting.append((to, duties | {duty}))
        return reached


def _settled(looker: Walker, state: WalkState) -> bool | None:
    """Return whether a look matches already, or cannot any more; None when it is open."""
    if not state[1]:
        return False
    return True if any(at == looker.last and not more for at, more in state[1]) else None


def _holds(kind: str, before: int, follows: int) -> bool:
    if kind == "begin":
        return before == _START
    if kind == "end":
        return follows == _END
    return ((before == _WORD) != (follows == _WORD)) == (kind == "boundary")


_UTF_8, _UTF_16 = 4, 2
_LAST_OF_WIDTH = {_UTF_8: (0x7F, 0x7FF, 0xFFFF, 0x10FFFF), _UTF_16: (0xFFFF, 0x10FFFF)}


class CodeUnits(NamedTuple):
    """Texts of at most so many code units: met as a pattern is, but counted, not made into states.

    Attributes:
        widest: units of the widest character: 4 of UTF-8, 2 of UTF-16.
        most: units that a text may have.
    """

    widest: int
    most: int

    def __str__(self) -> str:
        return "octets of UTF-8" if self.widest == _UTF_8 else "code units of UTF-16"

    @property
    def widths(self) -> tuple[CharSet, ...]:
        """The characters of one unit, of two, and so on."""
        ends = (-1, *_LAST_OF_WIDTH[self.widest])
        return tuple(((before + 1, end),) for before, end in pairwise(ends))

    def bound_on(self, other: CodeUnits) -> int:
        """Return how many units of another encoding such texts have at most."""
        if self.widest == other.widest:
            return self.most
        return self.most if self.widest > other.widest else 3 * self.most

    def count(self, text: str) -> int:
        """Return the units of a text; half a surrogate pair has those of its code point."""
        encoding, unit = ("utf-8", 1) if self.widest == _UTF_8 else ("utf-16-le", 2)
        return len(text.encode(encoding, "surrogatepass")) // unit

    def holds(self, text: str) -> bool:
        """Say whether a text has so many at most."""
        return len(text) * self.widest <= self.most or (
            len(text) <= self.most and self.count(text) <= self.most
        )


class UnitWalker:
    """Counts the units of a text as a `Walker` walks a pattern, up to one more than may be."""

    def __init__(self, units: CodeUnits) -> None:
        self._most = units.most
        self._ends = _LAST_OF_WIDTH[units.widest]
        self.start: WalkState = (0, frozenset())

    def step(self, state: WalkState, code: int) -> WalkState:
        width = next(width for width, end in enumerate(self._ends, 1) if code <= end)
        return min(state[0] + width, self._most + 1), state[1]

    def accepts(self, state: WalkState) -> bool:
        return state[0] <= self._most


def _make(pattern: str) -> Walker:
    return Walker(compile_pattern(pattern))


walker_of = TextCache(_make, lambda item: item.weight, _MAX_KEPT)
"""Returns the walker of a pattern, which remembers what it has walked."""


def found_in(pattern: str, text: str, spend: Callable[[int], None] = lambda _: None) -> bool:
    """Say whether a pattern is found in a text, with ECMA-262 meaning.

    A character that was met in this state before is looked up; another one costs all the threads
    that there are, which may be thousands.

    Args:
        pattern: without anchors it may be found anywhere.
        text: to look in.
        spend: called with the work in steps of the budget.

    Raises:
        UnsupportedPatternError: the pattern is not decided here.
    """
    walker = walker_of(pattern)
    state, work = walker.start, walker.work
    at, end = 0, len(text)
    followed, left, cost = work[0], _CHARGED_AFTER, 0
    while at < end:
        char = text[at]
        after = walker.step(state, ord(char))
        at += 1
        if after is state:  # and stays so while the character is the same
            at = _end_of_run(text, at, char)
        state = after
        left -= 1
        if not left:
            cost += _CHARGED_AFTER + 8 * (work[0] - followed)
            spend(cost // 64)
            followed, left, cost = work[0], _CHARGED_AFTER, cost % 64
    return walker.accepts(state)


def _end_of_run(text: str, at: int, char: str) -> int:
    if at + 1 >= len(text) or text[at] != char or text[at + 1] != char:
        return at
    found = re.compile(f"[^{re.escape(char)}]", re.DOTALL).search(text, at)
    return len(text) if found is None else found.start()
