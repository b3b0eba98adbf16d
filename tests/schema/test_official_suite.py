"""Verdicts that follow from the official suite: a ``const`` is contained where it is valid."""

from __future__ import annotations

from typing import TYPE_CHECKING

from tests.schema._ecma import UnsupportedPatternError
from tests.schema._judge import answer, verify_counterexample
from tests.schema._reference import Reference, UnsupportedSchemaError
from tests.schema._suite_pairs import const_pairs, schema_pairs

from uoarm.schema import check

if TYPE_CHECKING:
    from tests.schema._official import Group

# Not decided: what leaves the document, and, for now, the two keywords that see other keywords.
_OUTSIDE = {
    "refRemote",
    "dynamicRef",
    "anchor",
    "vocabulary",
    "optional/dynamicRef",
    "unevaluatedItems",
    "unevaluatedProperties",
}


def test_a_const_is_contained_exactly_where_it_is_valid_and_few_are_left_undecided(
    official_groups: tuple[Group, ...],
) -> None:
    given = [(answer(check(p.producer, p.consumer)), p) for p in const_pairs(official_groups)]
    wrong = [
        (found, pair)
        for found, pair in given
        if found not in {"undecided", "yes" if pair.contained else "no"}
    ]
    assert not wrong, wrong[:5]
    known = [(found, pair.keyword) for found, pair in given if pair.keyword not in _OUTSIDE]
    undecided = [keyword for found, keyword in known if found == "undecided"]
    assert len(undecided) <= len(known) * 0.05, sorted(set(undecided))


def test_no_instance_of_a_group_disproves_a_verdict_between_its_schemas(
    official_groups: tuple[Group, ...],
) -> None:
    for pair in schema_pairs(official_groups):
        verdict = check(pair.producer, pair.consumer)
        try:
            takes, wants = Reference(pair.producer), Reference(pair.consumer)
            if verdict.compatible:
                for value in pair.instances:
                    assert not takes.accepts(value) or wants.accepts(value), (value, pair)
            elif verdict.incompatible:
                verify_counterexample(verdict, pair.producer, pair.consumer)
        except (UnsupportedSchemaError, UnsupportedPatternError):
            continue
