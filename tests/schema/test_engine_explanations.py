"""What a person reads: where, what may come, what is taken, and what is not kept whole."""

from __future__ import annotations

from typing import Any

import pytest
from tests.structures import closed

from uoarm.schema import check

WHOLE = {"type": "integer"}
REAL = {"type": "number"}
TEXT = {"type": "string"}


REFUSED: dict[str, tuple[Any, Any, str, str]] = {
    "a type deep inside": (
        closed(pose=closed(x=REAL)), closed(pose=closed(x=WHOLE)), "pose.x", "not of a type",
    ),
    "a type in an array": (
        closed(points={"type": "array", "items": REAL, "minItems": 1}),
        closed(points={"type": "array", "items": TEXT}),
        "points[0]",
        "not of a type",
    ),
    "a missing field": (closed(), closed(x=REAL), "", "'x' is required"),
    "several missing fields": (
        closed(x=REAL),
        closed(x=REAL, y=REAL, z=REAL, w=REAL),
        "",
        "the fields 'y', 'z' and 'w' are required and may be missing",
    ),
    "a field too many": (closed(x=REAL, y=REAL), closed(x=REAL), "", "does not allow"),
    "a value of no list": (closed(m={"const": "b"}), closed(m={"enum": ["a"]}), "m", "none of"),
    "too many items": (
        {"type": "array", "minItems": 5}, {"maxItems": 4}, "", "5 parts are more or fewer",
    ),
    "too few members": (
        {"type": "object", "maxProperties": 0}, {"minProperties": 1}, "", "0 parts are more",
    ),
    "a bound": (closed(x=REAL), closed(x={"maximum": 0}), "x", "does not meet"),
    "through a reference": (
        closed(x=REAL),
        {"$ref": "#/$defs/r", "$defs": {"r": closed(x=WHOLE)}},
        "x",
        "not of a type",
    ),
}  # fmt: skip


@pytest.mark.parametrize(("producer", "consumer", "path", "words"), REFUSED.values(), ids=REFUSED)
def test_a_refusal_names_the_field_and_the_reason(
    producer: Any, consumer: Any, path: str, words: str
) -> None:
    verdict = check(producer, consumer)
    reason = verdict.reasons[0]
    assert (reason.path, words in reason.sentence) == (path, True), reason
    assert reason.producer
    assert reason.consumer


def test_every_field_that_fails_is_named() -> None:
    verdict = check(closed(a=TEXT, b=TEXT, c=REAL), closed(a=WHOLE, b=WHOLE, c=REAL))
    assert sorted(reason.path for reason in verdict.reasons) == ["a", "b"]


def test_the_excerpt_is_the_part_that_matters() -> None:
    verdict = check(closed(a=closed(b={"const": 7}), c=REAL), closed(a=closed(b=TEXT), c=REAL))
    assert verdict.excerpt == 7


@pytest.mark.parametrize(
    ("mine", "theirs", "kind"),
    [
        (WHOLE, REAL, "precision"),
        ({**WHOLE, "minimum": 0, "maximum": 2**53 + 1}, REAL, "precision"),
        ({**REAL, "x-nonfinite": True}, REAL, "nonfinite"),
        ({**TEXT, "format": "uri"}, {**TEXT, "format": "date"}, "annotation"),
    ],
)
def test_what_is_not_kept_whole_is_listed_with_its_field(
    mine: dict[str, Any], theirs: dict[str, Any], kind: str
) -> None:
    verdict = check(closed(x=mine), closed(x=theirs))
    assert [(loss.path, loss.kind) for loss in verdict.losses] == [("x", kind)]


def test_a_field_that_the_consumer_does_not_know_is_listed() -> None:
    verdict = check(closed(x=REAL, y=REAL), {"type": "object", "properties": {"x": REAL}})
    assert [(loss.path, loss.kind) for loss in verdict.losses] == [("y", "ignored")]


@pytest.mark.parametrize(
    ("mine", "theirs"),
    [
        ({**WHOLE, "minimum": -(2**53), "maximum": 2**53}, REAL),
        (WHOLE, WHOLE),
        ({**REAL, "x-unit": "m"}, {**REAL, "x-unit": "m"}),
        (REAL, {**REAL, "x-unit": "m"}),  # what a number means is not a matter of shape
    ],
)
def test_nothing_is_listed_where_nothing_is_lost(
    mine: dict[str, Any], theirs: dict[str, Any]
) -> None:
    assert check(closed(x=mine), closed(x=theirs)).losses == ()


def test_an_object_is_given_no_more_members_than_it_may_have() -> None:
    fields = {"type": "object", "properties": {"a": WHOLE, "b": WHOLE, "c": WHOLE}}
    verdict = check({**fields, "minProperties": 1, "maxProperties": 1}, False)
    assert len(verdict.counterexample) == 1
