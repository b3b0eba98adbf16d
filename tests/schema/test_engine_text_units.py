"""Texts that are bounded in code units: `x-max-utf8`, `x-max-utf16`, and `x-nul`."""

from __future__ import annotations

from itertools import product
from typing import Any

import pytest
from tests.schema._random_choices import RandomChoices

from uoarm.schema import CheckBudget, SchemaError, check

LETTERS = "aé←\U0001f600"
TEXTS = ["".join(row) for length in range(4) for row in product(LETTERS, repeat=length)]
PATTERNS = ("^a*$", "^[aé]*$", "^[^a]*$", "^.{2,3}$", "←", "^(a|\U0001f600)+$")


def bounded(choices: RandomChoices) -> dict[str, Any]:
    schema: dict[str, Any] = {"type": "string", "maxLength": choices.integer(0, 3)}
    if choices.integer(0, 1):
        schema["x-max-utf8"] = choices.integer(0, 17)
    if choices.integer(0, 1):
        schema["x-max-utf16"] = choices.integer(0, 9)
    if choices.integer(0, 2) == 0:
        schema["pattern"] = choices.item(PATTERNS)
    if choices.integer(0, 3) == 0:
        schema = {"allOf": [schema, {"not": {"type": "string", "x-max-utf8": 3}}]}
    return schema


def takes(schema: dict[str, Any], text: str) -> bool:
    """Judge by one text at a time: whether a text fits a schema is the same question."""
    return check({"const": text}, schema).compatible


def counted(schema: dict[str, Any], text: str) -> bool:
    inner = schema["allOf"][0] if "allOf" in schema else schema
    octets, units = len(text.encode()), len(text.encode("utf-16-le")) // 2
    return bool(octets <= inner.get("x-max-utf8", 99) and units <= inner.get("x-max-utf16", 99))


@pytest.mark.parametrize("block", range(4))
def test_containment_is_that_of_every_short_text(block: int) -> None:
    for seed in range(30 * block, 30 * block + 30):
        choices = RandomChoices(seed)
        producer, consumer = bounded(choices), bounded(choices)
        sample = [choices.item(TEXTS) for _ in range(4)]
        for text in sample:
            assert not takes(producer, text) or counted(producer, text), (seed, producer, text)
        # Patterns distinguish no other characters, so that what refutes is among these.
        verdict = check(producer, consumer)
        assert verdict.undecided is None, (seed, verdict)
        if verdict.compatible:
            made = [text for text in TEXTS if takes(producer, text)]
            assert all(takes(consumer, text) for text in made), (seed, producer, consumer)
        else:
            text = verdict.counterexample
            assert takes(producer, text), (seed, producer, text)
            assert not takes(consumer, text), (seed, consumer, text)


@pytest.mark.parametrize(
    ("producer", "consumer"),
    [
        ({"type": "string", "maxLength": 5}, {"type": "string", "x-max-utf8": 22}),
        ({"type": "string", "maxLength": 11}, {"type": "string", "x-max-utf16": 22}),
        ({"pattern": "^[ -~]{0,22}$", "type": "string"}, {"x-max-utf8": 22, "x-max-utf16": 22}),
        ({"enum": ["é" * 11, "idle"]}, {"type": "string", "x-max-utf8": 22}),
        ({"type": "string", "x-max-utf8": 22}, {"type": "string", "x-max-utf16": 22}),
        ({"type": "string", "x-max-utf16": 22}, {"type": "string", "x-max-utf8": 66}),
        ({"type": "string", "x-max-utf8": 22}, {"type": "string", "maxLength": 22}),
        ({"type": "string", "maxLength": 250_000}, {"type": "string", "x-max-utf8": 1_000_000}),
        ({"type": "integer"}, {"x-max-utf8": 0}),
    ],
)
def test_what_certainly_fits(producer: dict[str, object], consumer: dict[str, object]) -> None:
    assert check(producer, consumer).compatible


@pytest.mark.parametrize(
    ("producer", "consumer"),
    [
        ({"type": "string"}, {"x-max-utf8": 22}),
        ({"type": "string", "maxLength": 22}, {"maxLength": 22, "x-max-utf8": 22}),
        ({"type": "string", "maxLength": 22}, {"maxLength": 22, "x-max-utf16": 22}),
        ({"enum": ["é" * 12, "idle"]}, {"x-max-utf8": 22}),
        ({"type": "string", "x-max-utf16": 22}, {"x-max-utf8": 65}),
        ({"type": "string", "x-max-utf8": 60_000}, {"x-max-utf8": 59_999}),
        ({"type": "string", "pattern": "^[a-zé]*$"}, {"x-max-utf8": 5000}),
        ({"type": "string", "pattern": "^.+$"}, {"x-max-utf8": 5000}),
    ],
)
def test_what_is_refused_with_a_text(
    producer: dict[str, object], consumer: dict[str, object]
) -> None:
    verdict = check(producer, consumer, budget=CheckBudget(octets=400_000_000))
    assert verdict.incompatible
    assert check({"const": verdict.counterexample}, consumer).incompatible


def test_the_reason_counts() -> None:
    producer = {"type": "object", "properties": {"name": {"type": "string", "maxLength": 22}}}
    consumer = {"properties": {"name": {"type": "string", "maxLength": 22, "x-max-utf8": 22}}}
    [reason] = check({**producer, "required": ["name"]}, consumer).reasons
    assert reason.path == "name"
    assert "23 octets of UTF-8 are more than 22" in reason.sentence


def test_any_text_is_taken_to_have_no_nul_but_a_text_that_is_listed() -> None:
    none = {"type": "string", "x-nul": False}
    assert check({"type": "string"}, none).compatible
    assert check({"type": "string", "pattern": "^.+$"}, none).compatible
    assert check({"enum": ["idle", "busy"]}, none).compatible
    verdict = check({"enum": ["idle", "a\0b"]}, none)
    assert verdict.counterexample == "a\0b"
    assert "the character NUL" in verdict.reasons[0].sentence
    assert check(none, {"type": "string"}).compatible
    assert check({**none, "pattern": "^[\\0a]$"}, {"const": "a"}).compatible


def test_a_bound_is_a_number() -> None:
    with pytest.raises(SchemaError, match="x-max-utf8"):
        check(True, {"x-max-utf8": "22"})
    with pytest.raises(SchemaError, match="x-nul"):
        check(True, {"x-nul": 0})
