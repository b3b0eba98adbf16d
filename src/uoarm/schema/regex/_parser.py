"""Regular expressions of ECMA-262 as nondeterministic automata.

A pattern is searched for, not matched whole; `^` and `$` are assertions at the ends of the text.
The grammar is that of the `u` flag, and beyond it what ECMA-262 without the flag reads as plain
characters (a lone brace, an escaped hyphen). What other engines read otherwise keeps the meaning of
ECMA-262 and is `disputed`. What ECMA-262 itself gives two meanings, what is not regular, or looks
behind, raises `UnsupportedPatternError`.
"""

from __future__ import annotations

import re
from collections import OrderedDict
from collections.abc import Callable
from operator import attrgetter
from threading import Lock
from typing import Generic, TypeAlias, TypeVar

from attrs import define

from uoarm.schema.regex._nfa import (
    ANY,
    CLASSES,
    DOT,
    CharSet,
    MalformedPatternError,
    Nfa,
    UnsupportedPatternError,
    complement,
    property_chars,
    union,
)

T = TypeVar("T")


class TextCache(Generic[T]):
    """Makes what belongs to a text, and keeps it until others weigh too much.

    May be called from several threads; two of them may make the same thing at once.

    Args:
        make: makes it; what it raises is not kept.
        weigh: says how much it weighs, which may grow.
        most: what all may weigh together.
    """

    def __init__(self, make: Callable[[str], T], weigh: Callable[[T], int], most: int) -> None:
        self._make = make
        self._weigh = weigh
        self._most = most
        self._lock = Lock()
        self._kept: OrderedDict[str, T] = OrderedDict()

    def __call__(self, text: str) -> T:
        """Return what belongs to a text."""
        with self._lock:
            found = self._kept.get(text)
            if found is not None:
                self._kept.move_to_end(text)
                return found
        made = self._make(text)
        with self._lock:
            self._kept[text] = made
            weight = sum(map(self._weigh, self._kept.values()))
            while weight > self._most and len(self._kept) > 1:
                weight -= self._weigh(self._kept.popitem(last=False)[1])
        return made

    def cache_clear(self) -> None:
        with self._lock:
            self._kept.clear()


_MAX_REPEAT = 1000
_MAX_DIGITS = 9  # int() refuses thousands of them
_MAX_ATOMS = 50_000
_MAX_LOOKS = 8
"""Looks ahead within one another: each is walked by one that is called by the one around it."""
_COUNT = re.compile(r"\{([0-9]+)(,([0-9]*))?\}")
_UP_TO = re.compile(r"\{,[0-9]*\}")
_NAME = re.compile(r"[A-Za-z_$][A-Za-z0-9_$]*(?=>)")
_HEX = {"x": re.compile("[0-9A-Fa-f]{2}"), "u": re.compile("[0-9A-Fa-f]{4}")}
_BRACED = re.compile(r"\{([0-9A-Fa-f]+)\}")
_LOW_HALF = re.compile(r"\\u([Dd][C-Fc-f][0-9A-Fa-f]{2})")
_SETS = re.compile(r"\[|&&|--|~~")
_SURROGATES = range(0xD800, 0xE000)
_HIGH_HALVES = range(0xD800, 0xDC00)
_LAST_OF_16_BITS = 0xFFFF
_LAST = 0x10FFFF
_CONTROLS = {"f": 12, "n": 10, "r": 13, "t": 9, "v": 11, "0": 0}
_SYNTAX = set("^$\\.*+?()[]{}|/")

Piece: TypeAlias = "tuple[int, int]"
"""First and last state of a part."""


def _compile(pattern: str) -> Nfa:
    """Return the automaton that accepts the texts in which the pattern is found."""
    if any(ord(char) in _SURROGATES for char in pattern):
        raise UnsupportedPatternError("it has half a surrogate pair")
    parser = _Parser(pattern)
    nfa = parser.nfa
    first, last = parser.read()
    if parser.unicode and parser.lenient:
        raise UnsupportedPatternError("it is written half for the u flag and half without it")
    before = nfa.state()
    nfa.edges[before].append((ANY, before))
    nfa.always[before].append(first)
    _finish(nfa, before, last)
    return nfa


_MAX_KEPT = 60_000
"""States of all automata that are kept, of some 500 octets each."""
compile_pattern = TextCache(_compile, attrgetter("weight"), _MAX_KEPT)


def is_disputed(pattern: str) -> bool:
    """Say whether an engine that is not one of ECMA-262 may read a pattern otherwise.

    Raises:
        UnsupportedPatternError: the pattern is not decided here.
    """
    return any(part.disputed for part in compile_pattern(pattern).parts())


def _finish(nfa: Nfa, first: int, last: int) -> None:
    """Let an automaton begin at a state and accept whatever comes after another."""
    after = nfa.state()
    nfa.edges[after].append((ANY, after))
    nfa.always[last].append(after)
    nfa.first, nfa.last = first, after


@define
class _Group:
    """A group that is being read: its ends, and those of its alternative so far.

    `start` is where it begins in the text, `mark` the number of states before it. A look ahead has
    its sign, and the automaton around it.
    """

    start: int
    mark: int
    first: int
    last: int
    begin: int
    end: int
    sign: bool | None = None
    around: Nfa | None = None


class _Parser:
    """Reads one pattern, with a stack of its own for the groups.

    `unicode` says that the pattern has what only the `u` flag gives a meaning, `lenient` that it
    has what only goes without the flag.
    """

    def __init__(self, pattern: str) -> None:
        self.text = pattern
        self.at = 0
        self.nfa = Nfa()
        self._groups: list[_Group] = []
        self._looks = 0
        self._atoms = 0
        self._names: set[str] = set()
        self.unicode = any(ord(char) > _LAST_OF_16_BITS for char in self.text)
        self.lenient = False

    def read(self) -> Piece:
        """Return the first and last state of the whole pattern."""
        self._open(0, 0)
        while self.at < len(self.text):
            start, mark = self.at, len(self.nfa.always)
            char = self.text[start]
            self.at += 1
            if char == "|":
                self._end_alternative()
                group = self._groups[-1]
                group.begin = group.end = self.nfa.state()
            elif char == "(":
                self._enter_group(start, mark)
            elif char == ")":
                if len(self._groups) == 1:
                    raise MalformedPatternError(f"unbalanced ) in {self.text!r}")
                self._append(*self._close())
            else:
                self._append(start, mark, *self._atom(char))
        if len(self._groups) > 1:
            raise MalformedPatternError(f"a group is not closed in {self.text!r}")
        self._end_alternative()
        return self._groups[0].first, self._groups[0].last

    def _open(self, start: int, mark: int) -> _Group:
        state = self.nfa.state
        first, last, begin = state(), state(), state()
        self._groups.append(_Group(start, mark, first, last, begin, begin))
        return self._groups[-1]

    def _enter_group(self, start: int, mark: int) -> None:
        self._count()
        sign: bool | None = None
        if self._take("?"):
            if self._take("<"):
                if self.text[self.at : self.at + 1] in {"=", "!"}:
                    raise UnsupportedPatternError("it looks behind")
                self._name()
            elif self._take("="):
                sign = True
            elif self._take("!"):
                sign = False
            elif not self._take(":"):
                raise UnsupportedPatternError("a group of an unknown kind")
        if sign is None:
            self._open(start, mark)
            return
        self._looks += 1
        if self._looks > _MAX_LOOKS:
            raise UnsupportedPatternError(f"more than {_MAX_LOOKS} looks ahead within one another")
        around, self.nfa = self.nfa, Nfa()
        group = self._open(start, mark)
        group.sign, group.around = sign, around

    def _close(self) -> tuple[int, int, int, int]:
        """End the innermost group; return its start, its mark, and its first and last state."""
        self._end_alternative()
        group = self._groups.pop()
        if group.around is None or group.sign is None:
            return group.start, group.mark, group.first, group.last
        inner, self.nfa = self.nfa, group.around
        _finish(inner, group.first, group.last)
        self._looks -= 1
        first, last = self.nfa.state(), self.nfa.state()
        self.nfa.looks[first].append((group.sign, inner, last))
        return group.start, group.mark, first, last

    def _end_alternative(self) -> None:
        group = self._groups[-1]
        self.nfa.always[group.first].append(group.begin)
        self.nfa.always[group.end].append(group.last)

    def _append(self, start: int, mark: int, first: int, last: int) -> None:
        """Let a part, as often as it is repeated, follow what the alternative has so far."""
        first, last = self._quantified(start, mark, first, last)
        group = self._groups[-1]
        self.nfa.always[group.end].append(first)
        group.end = last

    def _count(self) -> None:
        self._atoms += 1
        if self._atoms > _MAX_ATOMS:
            raise UnsupportedPatternError("the pattern is too large")

    def _atom(self, char: str) -> Piece:
        self._count()
        if char == "[":
            return self._on(self._char_class())
        if char == ".":
            self.nfa.disputed = True
            return self._on(DOT)
        if char in "^$":
            return self._assert("begin" if char == "^" else "end")
        if char == "\\":
            if self._take("b"):
                return self._assert("boundary")
            if self._take("B"):
                return self._assert("inside")
            return self._on(self._escape(in_class=False))
        if char in "*+?" or (char == "{" and _COUNT.match(self.text, self.at - 1)):
            raise MalformedPatternError(f"nothing to repeat at {self.at} in {self.text!r}")
        if char == "{" and _UP_TO.match(self.text, self.at - 1):
            raise UnsupportedPatternError("engines differ on a repetition without a lower bound")
        self.lenient |= char in "{}]"
        return self._on(((ord(char), ord(char)),))

    def _name(self) -> None:
        found = _NAME.match(self.text, self.at)
        if found is None:
            raise UnsupportedPatternError("a group of an unknown kind")
        if found[0] in self._names:
            raise UnsupportedPatternError(f"two groups are called {found[0]!r}")
        self._names.add(found[0])
        self.at = found.end() + 1

    def _assert(self, kind: str) -> Piece:
        if self.text[self.at : self.at + 1] in {"*", "+", "?"} or _COUNT.match(self.text, self.at):
            raise MalformedPatternError(f"nothing to repeat at {self.at} in {self.text!r}")
        self.nfa.disputed |= kind != "begin"
        first, last = self.nfa.state(), self.nfa.state()
        self.nfa.asserts[first].append((kind, last))
        return first, last

    def _quantified(self, start: int, mark: int, first: int, last: int) -> Piece:
        before = self.at
        least, most = self._quantifier()
        if self.at > before:
            self._take("?")
            self.lenient |= self.text.startswith(("(?=", "(?!"), start)
        if (least, most) == (1, 1):
            return first, last
        copies = max(least, 1 if most is None else most, 1)
        size = len(self.nfa.always) - mark
        pieces = [(first, last)]
        for number in range(1, copies):
            self.nfa.copy(mark, size)
            pieces.append((first + number * size, last + number * size))
        begin, end = self.nfa.state(), self.nfa.state()
        at = begin
        for number, (index, other) in enumerate(pieces):
            if number >= least:
                self.nfa.always[at].append(end)
            self.nfa.always[at].append(index)
            at = other
        if most is None:
            self.nfa.always[at].append(pieces[-1][0])
        if most != 0:
            self.nfa.always[at].append(end)
        return begin, end

    def _quantifier(self) -> tuple[int, int | None]:
        if self._take("*"):
            return 0, None
        if self._take("+"):
            return 1, None
        if self._take("?"):
            return 0, 1
        found = _COUNT.match(self.text, self.at)
        if found is None:
            return 1, 1
        self.at = found.end()
        low, comma, high = found[1], found[2], found[3]
        if max(len(low), len(high or "")) > _MAX_DIGITS:
            raise UnsupportedPatternError(f"a repetition of more than {_MAX_REPEAT}")
        least = int(low)
        most = (int(high) if high else None) if comma else least
        if max(least, most or 0) > _MAX_REPEAT:
            raise UnsupportedPatternError(f"a repetition of more than {_MAX_REPEAT}")
        if most is not None and most < least:
            raise MalformedPatternError("a repetition from more to less")
        return least, most

    def _char_class(self) -> CharSet:
        start = self.at
        negated = self._take("^")
        members: CharSet = ()
        if self.text[self.at : self.at + 1] == "]":
            self.nfa.disputed = True  # others begin a class with a bracket
        while not self._take("]"):
            if self.at >= len(self.text):
                raise MalformedPatternError(f"a class is not closed in {self.text!r}")
            low, single = self._member()
            if self.text[self.at : self.at + 1] == "-" and self.text[
                self.at + 1 : self.at + 2
            ] not in {
                "]",
                "",
            }:
                self.at += 1
                high, ends = self._member()
                self.lenient |= not (single and ends)
                if not (single and ends):
                    self.lenient = True  # a hyphen beside \\d and the like is itself
                    low = union(union(low, high), ((0x2D, 0x2D),))
                elif high[0][0] < low[0][0]:
                    raise MalformedPatternError("a range from more to less")
                else:
                    low = ((low[0][0], high[0][0]),)
            members = union(members, low)
        if _SETS.search(self.text, start, self.at):
            self.nfa.disputed = True  # others have classes in classes
        return complement(members) if negated else members

    def _member(self) -> tuple[CharSet, bool]:
        """Return the next characters of a class, and whether they are one, as ranges need."""
        char = self.text[self.at]
        self.at += 1
        if char != "\\":
            return ((ord(char), ord(char)),), True
        single = self.text[self.at : self.at + 1] not in {*CLASSES, "p", "P"}
        return self._escape(in_class=True), single

    def _escape(self, *, in_class: bool) -> CharSet:
        if self.at >= len(self.text):
            raise MalformedPatternError("a lone backslash at the end")
        char = self.text[self.at]
        self.at += 1
        if char in CLASSES:
            self.nfa.disputed = True
            return CLASSES[char]
        if char == "0" and self.text[self.at : self.at + 1].isdigit():
            raise UnsupportedPatternError("a number in base eight")
        if char in _CONTROLS:
            return ((_CONTROLS[char], _CONTROLS[char]),)
        if char == "b" and in_class:
            return ((8, 8),)
        if char in "xu":
            return self._code(char)
        if char in "pP":
            return self._property(negated=char == "P")
        if (
            char == "c"
            and self.text[self.at : self.at + 1].isascii()
            and self.text[self.at : self.at + 1].isalpha()
        ):
            self.at += 1
            code = ord(self.text[self.at - 1]) % 32
            return ((code, code),)
        if char in _SYNTAX or not (char.isalnum() or char in "<>"):
            self.lenient |= not (char in _SYNTAX or (in_class and char == "-"))
            return ((ord(char), ord(char)),)
        raise UnsupportedPatternError(f"\\{char} is not decided here")

    def _property(self, *, negated: bool) -> CharSet:
        close = self.text.find("}", self.at)
        if not self._take("{") or close < 0:
            raise MalformedPatternError("\\p needs a property in braces")
        name, self.at = self.text[self.at : close], close + 1
        self.unicode = True
        chars = property_chars(name)
        if chars is None:
            raise UnsupportedPatternError(f"the property {name!r}")
        return complement(chars) if negated else chars

    def _code(self, kind: str) -> CharSet:
        found = _BRACED.match(self.text, self.at) if kind == "u" else None
        if found is None:
            found = _HEX[kind].match(self.text, self.at)
        if found is None:
            raise MalformedPatternError(f"\\{kind} needs hexadecimal digits")
        self.unicode |= found.re is _BRACED
        self.at = found.end()
        code = int(found[found.lastindex or 0], 16)
        if code in _HIGH_HALVES and found.lastindex is None:
            low = _LOW_HALF.match(self.text, self.at)
            if low is not None:
                self.at = low.end()
                self.unicode = self.nfa.disputed = True
                code = 0x10000 + (code - 0xD800) * 0x400 + int(low[1], 16) - 0xDC00
        if code > _LAST:
            raise MalformedPatternError(f"{code:x} is no character")
        if code in _SURROGATES:
            raise UnsupportedPatternError("it has half a surrogate pair")
        return ((code, code),)

    def _on(self, chars: CharSet) -> Piece:
        first, last = self.nfa.state(), self.nfa.state()
        self.nfa.edges[first].append((chars, last))
        return first, last

    def _take(self, char: str) -> bool:
        if self.text[self.at : self.at + 1] == char:
            self.at += 1
            return True
        return False
