"""Regular expressions of ECMA-262 (u flag) as nondeterministic automata.

A pattern is searched for, not matched whole; `^` and `$` are assertions at the ends of the text.
What is not regular, or looks behind, raises `UnsupportedPatternError`.
"""

from __future__ import annotations

from functools import lru_cache
from typing import TypeAlias

from uoarm.schema._charsets import ANY, CLASSES, DOT, CharSet, complement, union
from uoarm.schema._nfa import MalformedPatternError, Nfa, UnsupportedPatternError
from uoarm.schema._properties import property_chars

__all__ = ["compile_pattern"]

_MAX_REPEAT = 1000
_MAX_DIGITS = 9  # int() refuses thousands of them
_CONTROLS = {"f": 12, "n": 10, "r": 13, "t": 9, "v": 11, "0": 0}
_SYNTAX = set("^$\\.*+?()[]{}|/")

Piece: TypeAlias = "tuple[int, int]"
"""First and last state of a part."""


@lru_cache(maxsize=1024)
def compile_pattern(pattern: str) -> Nfa:
    """Return the automaton that accepts the texts in which the pattern is found."""
    parser = _Parser(pattern)
    nfa = parser.nfa
    first, last = parser.alternation()
    if parser.at < len(pattern):
        raise MalformedPatternError(f"unbalanced ) in {pattern!r}")
    before = nfa.state()
    nfa.edges[before].append((ANY, before))
    nfa.always[before].append(first)
    _finish(nfa, before, last)
    return nfa


def _finish(nfa: Nfa, first: int, last: int) -> None:
    """Let an automaton begin at a state and accept whatever comes after another."""
    after = nfa.state()
    nfa.edges[after].append((ANY, after))
    nfa.always[last].append(after)
    nfa.first, nfa.last = first, after


class _Parser:
    """Recursive descent over one pattern; depth is bounded."""

    def __init__(self, pattern: str) -> None:
        self.text = pattern
        self.at = 0
        self.nfa = Nfa()
        self._depth = 0

    def alternation(self) -> Piece:
        self._depth += 1
        if self._depth > 100:  # noqa: PLR2004 - groups within groups
            raise UnsupportedPatternError("groups are nested too deep")
        first, last = self.nfa.state(), self.nfa.state()
        while True:
            begin, end = self._sequence()
            self.nfa.always[first].append(begin)
            self.nfa.always[end].append(last)
            if not self._take("|"):
                self._depth -= 1
                return first, last

    def _sequence(self) -> Piece:
        first = last = self.nfa.state()
        while self.at < len(self.text) and self.text[self.at] not in "|)":
            start = self.at
            begin, end = self._atom()
            begin, end = self._quantified(start, begin, end)
            self.nfa.always[last].append(begin)
            last = end
        return first, last

    def _atom(self) -> Piece:
        char = self.text[self.at]
        self.at += 1
        if char == "(":
            return self._group()
        if char == "[":
            return self._on(self._char_class())
        if char == ".":
            return self._on(DOT)
        if char in "^$":
            return self._assert("begin" if char == "^" else "end")
        if char == "\\":
            if self._take("b"):
                return self._assert("boundary")
            if self._take("B"):
                return self._assert("inside")
            return self._on(self._escape(in_class=False))
        if char in "*+?" or (char == "{" and self._looks_counted()):
            raise MalformedPatternError(f"nothing to repeat at {self.at} in {self.text!r}")
        return self._on(((ord(char), ord(char)),))

    def _group(self) -> Piece:
        if self._take("?"):
            if self._take("<"):
                if self.at < len(self.text) and self.text[self.at] in "=!":
                    raise UnsupportedPatternError("it looks behind")
                self.at = self.text.find(">", self.at) + 1 or len(self.text)
            elif self._take("="):
                return self._look(sign=True)
            elif self._take("!"):
                return self._look(sign=False)
            elif not self._take(":"):
                raise UnsupportedPatternError("a group of an unknown kind")
        piece = self.alternation()
        self._close()
        return piece

    def _close(self) -> None:
        if not self._take(")"):
            raise MalformedPatternError(f"a group is not closed in {self.text!r}")

    def _look(self, *, sign: bool) -> Piece:
        around, inner = self.nfa, Nfa()
        self.nfa = inner
        _finish(inner, *self.alternation())
        self.nfa = around
        self._close()
        first, last = around.state(), around.state()
        around.looks[first].append((sign, inner, last))
        return first, last

    def _assert(self, kind: str) -> Piece:
        first, last = self.nfa.state(), self.nfa.state()
        self.nfa.asserts[first].append((kind, last))
        return first, last

    def _quantified(self, start: int, first: int, last: int) -> Piece:
        least, most = self._quantifier()
        if (least, most) == (1, 1):
            return first, last
        self._take("?")
        after = self.at
        pieces = [(first, last)]
        copies = max(least, 1 if most is None else most, 1)
        for _ in range(copies - 1):
            self.at = start
            pieces.append(self._atom())
        self.at = after
        begin, end = self.nfa.state(), self.nfa.state()
        at = begin
        for number, (one, other) in enumerate(pieces):
            if number >= least:
                self.nfa.always[at].append(end)
            self.nfa.always[at].append(one)
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
        if not self._looks_counted():
            return 1, 1
        close = self.text.index("}", self.at)
        low, comma, high = self.text[self.at + 1 : close].partition(",")
        self.at = close + 1
        if max(len(low), len(high)) > _MAX_DIGITS:
            raise UnsupportedPatternError(f"a repetition of more than {_MAX_REPEAT}")
        least = int(low)
        most = (int(high) if high else None) if comma else least
        if max(least, most or 0) > _MAX_REPEAT:
            raise UnsupportedPatternError(f"a repetition of more than {_MAX_REPEAT}")
        if most is not None and most < least:
            raise MalformedPatternError("a repetition from more to less")
        return least, most

    def _looks_counted(self) -> bool:
        at = self.at if self.text[self.at : self.at + 1] == "{" else self.at - 1
        close = self.text.find("}", at)
        if self.text[at : at + 1] != "{" or close < 0:
            return False
        low, _, high = self.text[at + 1 : close].partition(",")
        return low.isdecimal() and (not high or high.isdecimal())

    def _char_class(self) -> CharSet:
        negated = self._take("^")
        members: CharSet = ()
        while not self._take("]"):
            if self.at >= len(self.text):
                raise MalformedPatternError(f"a class is not closed in {self.text!r}")
            low = self._member()
            single = len(low) == 1 and low[0][0] == low[0][1]
            if (
                single
                and self.text[self.at : self.at + 1] == "-"
                and self.text[self.at + 1 : self.at + 2] not in {"]", ""}
            ):
                self.at += 1
                high = self._member()
                if high[0][0] < low[0][0]:
                    raise MalformedPatternError("a range from more to less")
                low = ((low[0][0], high[-1][1]),)
            members = union(members, low)
        return complement(members) if negated else members

    def _member(self) -> CharSet:
        char = self.text[self.at]
        self.at += 1
        return self._escape(in_class=True) if char == "\\" else ((ord(char), ord(char)),)

    def _escape(self, *, in_class: bool) -> CharSet:
        if self.at >= len(self.text):
            raise MalformedPatternError("a lone backslash at the end")
        char = self.text[self.at]
        self.at += 1
        if char in CLASSES:
            return CLASSES[char]
        if char in _CONTROLS:
            return ((_CONTROLS[char], _CONTROLS[char]),)
        if char == "b" and in_class:
            return ((8, 8),)
        if char in "xu":
            return self._code(char)
        if char in "pP":
            return self._property(negated=char == "P")
        if char == "c" and self.text[self.at : self.at + 1].isalpha():
            self.at += 1
            code = ord(self.text[self.at - 1]) % 32
            return ((code, code),)
        if char in _SYNTAX or char == "-" or not char.isalnum():
            return ((ord(char), ord(char)),)
        raise UnsupportedPatternError(f"\\{char} is not decided here")

    def _property(self, *, negated: bool) -> CharSet:
        close = self.text.find("}", self.at)
        if not self._take("{") or close < 0:
            raise MalformedPatternError("\\p needs a property in braces")
        name, self.at = self.text[self.at : close], close + 1
        chars = property_chars(name)
        if chars is None:
            raise UnsupportedPatternError(f"the property {name!r}")
        return complement(chars) if negated else chars

    def _code(self, kind: str) -> CharSet:
        if kind == "u" and self._take("{"):
            close = self.text.find("}", self.at)
            digits, self.at = self.text[self.at : close], close + 1
        else:
            width = 4 if kind == "u" else 2
            digits = self.text[self.at : self.at + width]
            self.at += width
        try:
            code = int(digits, 16)
        except ValueError:
            raise MalformedPatternError(f"\\{kind} needs hexadecimal digits") from None
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
