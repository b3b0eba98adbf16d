"""Patterns: our automata against Python's engine, on every short text, for random patterns."""

from __future__ import annotations

import unicodedata
from itertools import product
from typing import TYPE_CHECKING

import pytest
from tests.schema._ecma import compiled
from tests.schema._judge import answer
from tests.schema._random_choices import RandomChoices

from uoarm.schema import check
from uoarm.schema._walker import found_in
from uoarm.testing._choices import chance

if TYPE_CHECKING:
    from uoarm.testing._choices import Choices

TEXTS = ["".join(row) for n in range(5) for row in product("a1- \n"[: 5 if n < 4 else 3], repeat=n)]
_ATOMS = ("a", "1", "-", ".", "[a1]", "[^a]", r"\d", r"\w", r"\W", r"\s", "^", "$", r"\b", r"\B")


def random_pattern(choices: Choices, depth: int = 3) -> str:
    parts = [_part(choices, depth) for _ in range(choices.integer(1, 3))]
    text = "".join(parts)
    if depth > 0 and chance(choices, 20):
        return f"{text}|{random_pattern(choices, depth - 1)}"
    return text


def _part(choices: Choices, depth: int) -> str:
    if depth == 0 or chance(choices, 50):
        atom = choices.item(_ATOMS)
        return atom if atom in {"^", "$", r"\b", r"\B"} else atom + _repeat(choices)
    inner = random_pattern(choices, depth - 1)
    if chance(choices, 35):
        return f"(?{choices.item('=!')}{inner})"
    return f"({choices.item(('', '?:'))}{inner})" + _repeat(choices)


def _repeat(choices: Choices) -> str:
    return choices.item(("", "", "", "*", "+", "?", "{2}", "{1,2}", "*?"))


@pytest.mark.parametrize("block", range(20))
def test_a_random_pattern_finds_what_another_engine_finds(block: int) -> None:
    for seed in range(20 * block, 20 * block + 20):
        pattern = random_pattern(RandomChoices(seed))
        expected = [bool(compiled(pattern).search(text)) for text in TEXTS]
        found = [found_in(pattern, text) for text in TEXTS]
        assert found == expected, (seed, pattern)


@pytest.mark.parametrize(
    ("narrow", "wide"),
    [
        (r"^(?=.*\d)(?=.*[a-z]).{8,}$", r"^.{8,}$"),
        (r"^(?=.*\d)(?=.*[a-z]).{8,}$", r"[a-z]"),
        (r"^(?!.*\.\.)[a-z.]+$", r"^[a-z.]+$"),
        (r"^(?!root$)\w+$", r"^\w+$"),
        (r"\bcat\b", r"cat"),
        (r"^\p{Lu}", r"\p{L}"),
        (r"^\p{Nd}+$", r"^\p{Number}*$"),
        (r"^[a-z]+$", r"^[\p{Lowercase_Letter}]+$"),
    ],
)
def test_the_narrower_pattern_is_contained_and_not_the_other_way(narrow: str, wide: str) -> None:
    texts = [{"type": "string", "pattern": pattern} for pattern in (narrow, wide)]
    assert check(texts[0], texts[1]).compatible
    back = check(texts[1], texts[0])
    assert back.incompatible
    assert not found_in(narrow, back.counterexample)


@pytest.mark.parametrize(
    ("pattern", "text"),
    [
        (r"^\u{1f600}$", "\U0001f600"),
        (r"^\u{41}b$", "Ab"),
        (r"^\u0041\x42$", "AB"),
        (r"^\cA\cb$", "\x01\x02"),
        (r"^\t\n\v\f\r\0$", "\t\n\x0b\x0c\r\0"),
        (r"^[\b]$", "\b"),
        (r"^[\]\-a]+$", "]-a"),
        (r"^\.\*\/\-$", ".*/-"),
        (r"^a{2}b{1,}c{0,1}$", "aabbc"),
        (r"^(?<name>a|b)+$", "abba"),
        (r"^\p{gc=Lu}\p{General_Category=Ll}$", "Ab"),
        (r"^\p{ASCII}\p{Any}$", "~\u2028"),
    ],
)
def test_an_escape_means_its_character(pattern: str, text: str) -> None:
    assert found_in(pattern, text)
    assert not found_in(pattern, f"{text}{text}x")
    assert not found_in(pattern, "")


@pytest.mark.parametrize("groups", [99, 100])
def test_groups_may_be_nested_a_hundred_times(groups: int) -> None:
    """Those that were closed before do not count."""
    pattern = f"^{'(a)' * 150}{'(' * groups}b{')' * groups}$"
    if groups < 100:
        assert found_in(pattern, "a" * 150 + "b")
    else:
        assert check({"type": "string"}, {"pattern": pattern}).undecided is not None


def test_a_look_ahead_excludes_one_word() -> None:
    words = {"type": "string", "pattern": "^[a-z]+$"}
    without = {"type": "string", "pattern": "^(?!root$)[a-z]+$"}
    assert check(words, without).counterexample == "root"


@pytest.mark.parametrize("category", ["Lu", "L", "Nd", "P", "Cn", "Zs", "LC"])
def test_a_property_holds_its_category(category: str) -> None:
    parts = {"LC": ("Lu", "Ll", "Lt")}.get(category, (category,))
    for code in range(0, 0x3000, 7):
        expected = unicodedata.category(chr(code)).startswith(parts)
        assert found_in(rf"^\p{{{category}}}$", chr(code)) == expected, code
        assert found_in(rf"^\P{{{category}}}$", chr(code)) != expected, code


@pytest.mark.parametrize("pattern", [r"\p{Script=Greek}", r"\p{Nothing}", r"(?<=a)b", r"(a)\1"])
def test_what_is_not_decided_says_so(pattern: str) -> None:
    verdict = check({"type": "string"}, {"pattern": pattern})
    assert answer(verdict) == "undecided"


def test_a_hostile_look_ahead_ends() -> None:
    pattern = "^" + "".join(f"(?=.*{letter}.*{letter}.*)" for letter in "abcdefghijklm") + "$"
    assert answer(check({"type": "string"}, {"pattern": pattern})) == "no"
    producer = {"type": "string", "pattern": pattern.replace("$", ".*$")}
    assert answer(check(producer, {"maxLength": 20})) in {"no", "undecided"}
