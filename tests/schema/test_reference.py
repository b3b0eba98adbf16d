"""The judge itself is judged: by the official suite, and by jsonschema-rs on random schemas."""

from __future__ import annotations

from typing import TYPE_CHECKING

import jsonschema_rs
import pytest
from hypothesis import given
from hypothesis.strategies import DataObject, data
from tests.schema._ecma import UnsupportedPatternError, compiled
from tests.schema._reference import Reference, UnsupportedSchemaError
from tests.schema._strategies import Body, schemas

from uoarm.testing._instances import Builder, DrawnChoices, mutate

if TYPE_CHECKING:
    from tests.schema._official import Group

_NO_VOCABULARY = "schema that uses custom metaschema with with no validation vocabulary"
_LEGACY_ESCAPE = "\\a is not an ECMA 262 control escape"


def test_reference_validator_agrees_with_the_official_suite(
    official_groups: tuple[Group, ...],
) -> None:
    unread = 0
    for group in official_groups:
        if group.description in {_NO_VOCABULARY, _LEGACY_ESCAPE}:
            continue
        for value, valid in group.cases:
            try:
                accepted = Reference(group.schema).accepts(value)
            except (UnsupportedSchemaError, UnsupportedPatternError):
                unread += 1
                continue
            assert accepted is valid, (group.keyword, group.description, value)
    assert unread <= 160, "remote references, dynamic references, \\p classes and little else"


@given(schemas, data())
def test_reference_validator_agrees_with_jsonschema_rs(schema: Body, more: DataObject) -> None:
    choices = DrawnChoices(more.draw)
    value = mutate(choices, Builder(schema, choices).candidate())
    assert Reference(schema).accepts(value) is jsonschema_rs.is_valid(schema, value)


@pytest.mark.parametrize(
    ("pattern", "text", "found"),
    [
        ("^a$", "a\n", False),
        ("^\\d$", "\u0663", False),
        ("^.$", "\u2028", False),
        ("^\\s$", "\ufeff", True),
        ("^\\s$", "\x1c", False),
        ("^[\\d_]$", "_", True),
        ("^\\u{1F600}$", "\U0001f600", True),
        ("[]", "a", False),
        ("^[^]$", "\n", True),
        ("^(?<year>\\d{4})$", "2026", True),
    ],
)
def test_patterns_have_their_ecma_meaning(pattern: str, text: str, found: bool) -> None:
    assert (compiled(pattern).search(text) is not None) is found
