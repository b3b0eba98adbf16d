"""Patterns: our automata against Python's engine, on every short text, for random patterns."""

from __future__ import annotations

import re
import unicodedata
from itertools import product
from typing import TYPE_CHECKING

import jsonschema_rs
import pytest
from tests.schema._ecma import compiled
from tests.schema._judge import answer
from tests.schema._pattern_texts import random_text
from tests.schema._random_choices import RandomChoices

from uoarm.schema import CheckBudget, SchemaError, check
from uoarm.schema.regex import compile_pattern, found_in
from uoarm.schema.regex._nfa import Nfa
from uoarm.testing._instances import chance

if TYPE_CHECKING:
    from collections.abc import Iterator

    from uoarm.testing._instances import Choices

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


def test_a_new_pattern_goes_over_no_automaton_that_is_kept(monkeypatch: pytest.MonkeyPatch) -> None:
    weighed: list[Nfa] = []
    parts = Nfa.parts

    def noted(nfa: Nfa) -> Iterator[Nfa]:
        weighed.append(nfa)
        return parts(nfa)

    monkeypatch.setattr(Nfa, "parts", noted)
    made = [compile_pattern(f"^new{number}(?=a)") for number in range(20)]
    assert weighed == made


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
        (r"^\ud83d\ude00$", "\U0001f600"),
        (r"^[\ud83d\ude00]$", "\U0001f600"),
        (r"^\{12,}$", "{12,}"),
        (r"^\{2}$", "{2}"),
        (r"^[]ba{2}|^\{1,2}$", "{1,2}"),
        (r"^a{1}?b$", "ab"),
        (r"^[\w-.]$", "-"),
        (r"^[a-\d]$", "-"),
        (r"^a{b}]$", "a{b}]"),
    ],
)
def test_an_escape_means_its_character(pattern: str, text: str) -> None:
    assert found_in(pattern, text)
    assert not found_in(pattern, f"{text}{text}x")
    assert not found_in(pattern, "")


@pytest.mark.parametrize("groups", [99, 100, 400])
def test_groups_may_be_nested_however_deep(groups: int) -> None:
    pattern = f"^{'(a)' * 150}{'(' * groups}b{')' * groups}{{2}}$"
    assert found_in(pattern, "a" * 150 + "bb")
    assert not found_in(pattern, "a" * 150 + "b")


def test_looks_ahead_may_be_nested_eight_times() -> None:
    """Those that were closed before do not count."""
    nested = "^(?=a)(?=a)" + "(?=a" * 8 + ")" * 8
    assert found_in(nested, "a" * 8)
    assert not found_in(nested, "a" * 7)
    deeper = {"pattern": "(?=a" * 9 + ")" * 9}
    assert answer(check({"type": "string"}, deeper)) == "undecided"


def test_a_repeated_part_is_repeated_whole() -> None:
    pattern = r"^(?:x(?=[yz](?!q))(?:[yz]|w\b){2}|-){2,3}$"
    for text, found in (
        ("xyz-", True), ("xyzxzy", True), ("xyz", False), ("xy-", False), ("xyq-", False),
        ("xyzxwy", False), ("---", True), ("----", False), ("xyw-", True), ("xyz-xzz", True),
    ):  # fmt: skip
        assert found_in(pattern, text) is found is bool(re.search(pattern, text)), text


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


@pytest.mark.parametrize(
    "pattern",
    [
        r"\p{Script=Greek}",
        r"[\p{L}-z]",
        r"[\P{L}-z]",
        r"[a-\P{L}]",
        r"\p{Nothing}",
        r"(?<=a)b",
        r"(a)\1",
        "a{,3}",
        r"\01",
        r"\<a\>",
        r"\p{L}\-",
        "\\-\U0001f600?",
        r"\ud83d",
        "(?<n>a)(?<n>b)",
        "(?P<n>a)",
        r"\c\u00e9",
    ],
)
def test_what_is_not_decided_says_so(pattern: str) -> None:
    verdict = check({"type": "string"}, {"pattern": pattern})
    assert answer(verdict) == "undecided"


def test_a_hostile_look_ahead_ends() -> None:
    pattern = "^" + "".join(f"(?=.*{letter}.*{letter}.*)" for letter in "abcdefghijklm") + "$"
    assert answer(check({"type": "string"}, {"pattern": pattern})) == "no"
    producer = {"type": "string", "pattern": pattern.replace("$", ".*$")}
    brief = CheckBudget(seconds=0.3)
    assert answer(check(producer, {"maxLength": 20}, budget=brief)) in {"no", "undecided"}


@pytest.mark.parametrize(
    "pattern",
    [
        r"\u{110000}",
        r"\u{",
        r"\u{x}",
        r"\x4",
        r"\u+041",
        "^*",
        r"\b+",
        "{2}",
        "a{2}{3}",
        "[a",
        "(",
        "[b-a]",
    ],
)
def test_a_malformed_pattern_is_reported(pattern: str) -> None:
    with pytest.raises(SchemaError):
        check({"pattern": pattern}, True)


def test_a_brace_that_is_escaped_repeats_nothing() -> None:
    assert answer(check({"const": "{{"}, {"pattern": r"\{12,}"})) == "no"
    assert answer(check({"const": "{12,}"}, {"pattern": r"\{12,}"})) == "yes"


def test_a_hostile_repetition_of_looks_ahead_costs_its_length() -> None:
    pattern = {"pattern": "(?=" * 4 + "a" + "){900}" * 4}
    budget = CheckBudget(steps=5_000, seconds=1_000.0)
    assert answer(check({"type": "string"}, pattern, budget=budget)) == "no"
    assert answer(check({"const": "ba"}, pattern, budget=budget)) == "yes"


@pytest.mark.parametrize("block", range(10))
def test_any_text_as_a_pattern_ends_in_a_verdict_or_in_an_error(block: int) -> None:
    choices = RandomChoices(block)
    for _ in range(100):
        pattern = random_text(choices.item)
        try:
            answer(
                check({"type": "string"}, {"pattern": pattern}, budget=CheckBudget(steps=20_000))
            )
        except SchemaError as error:
            assert "regular expression" in str(error)


@pytest.mark.parametrize(
    ("pattern", "known"),
    [
        (r"^[\x00-\ud7ff\ue000-\u{10ffff}]*$", "undecided"),
        (r"^\P{Cs}*$", "undecided"),
        (r"^[\x00-\ufffe\u{10000}-\u{10ffff}]*$", "no"),
        (r"^(\ue000|[^\ue000])*$", "yes"),
    ],
)
def test_half_a_pair_is_no_text_and_no_proof(pattern: str, known: str) -> None:
    """A Python text may hold half a surrogate pair; UTF-8 cannot, and other validators differ."""
    assert answer(check({"type": "string"}, {"pattern": pattern})) == known


@pytest.mark.parametrize(
    ("wide", "narrow"),
    [(r"^\S$", "^[!-~]$"), ("^.$", r"^[\x00-~]$"), (r"^\W$", "^[ -@]$"), (r"^\D$", r"^[\x00-~]$")],
)
def test_a_counterexample_is_read_alike_by_other_engines(wide: str, narrow: str) -> None:
    verdict = check({"type": "string", "pattern": wide, "minLength": 1}, {"pattern": narrow})
    text = verdict.counterexample
    assert re.search(wide, text)
    assert not re.search(narrow, text)
    assert jsonschema_rs.is_valid({"pattern": wide}, text)
    assert not jsonschema_rs.is_valid({"pattern": narrow}, text)


@pytest.mark.parametrize(
    ("pattern", "disputed"),
    [("^[a-z]+", False), ("^a$", True), (r"\d", True), (r"[\w]", True), ("a.", True),
     ("[]a]", True), ("[[a]", True), (r"^(?=.)a", True), (r"\bx", True), ("^(a|b){2,3}x", False),
     (r"\ud83d\ude00", True)],
)  # fmt: skip
def test_the_verdict_names_patterns_that_other_engines_read_otherwise(
    pattern: str, disputed: bool
) -> None:
    schema = {"type": "string", "pattern": pattern}
    named = (pattern,) if disputed else ()
    assert check(schema, schema).disputed_patterns == named
    assert check({"type": "string"}, schema).disputed_patterns == named
    assert check(True, {"patternProperties": {pattern: False}}).disputed_patterns == named
    assert (
        check({"patternProperties": {pattern: False}}, True).to_dict()["disputed_patterns"] == named
    )
