"""The comparison of locks: in which direction each port is judged, and by what each edge is."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import pytest

from uoarm._lock import Lock, LockFinding, LockOutcome, compare
from uoarm._lock._record import LockedEdge, LockedFunction, LockedPart, LockedStructure

NUMBER: dict[str, Any] = {"type": "number"}
SMALL: dict[str, Any] = {"type": "number", "minimum": 0, "maximum": 9}


def lock(
    sent: Any, taken: Any, asked: Any = NUMBER, *, meaning: str = "stated",
    alike: tuple[tuple[str, ...], ...] = (),
) -> Lock:  # fmt: skip
    """Return a lock of a source that feeds a sink, which takes `asked` of the application."""
    parts = (
        LockedPart("a", "source", "x", "x", {"output.out": "sent"}),
        LockedPart("b", "sink", "x", "x", {"input.in": "taken", "input.asked": "asked"}),
    )
    edge = LockedEdge("a", "out", "b", "in", None, (), meaning, alike, ())
    structures = {"sent": sent, "taken": taken, "asked": asked}
    return Lock(
        {"sink": LockedFunction(parts, (edge,))},
        {name: LockedStructure("", structure) for name, structure in structures.items()},
    )


def outcomes(before: Lock, after: Lock | Mapping[str, Any]) -> dict[str, LockOutcome]:
    found: list[LockFinding] = list(compare(before, after))
    assert len({finding.subject for finding in found}) == len(found)
    return {finding.subject: finding.outcome for finding in found}


@pytest.mark.parametrize(
    ("before", "after", "outcome"),
    [(SMALL, NUMBER, LockOutcome.FITS), (NUMBER, SMALL, LockOutcome.BREAKS)],
)
def test_what_applications_send_may_widen_only(
    before: Any, after: Any, outcome: LockOutcome
) -> None:
    found = outcomes(lock(NUMBER, NUMBER, before), lock(NUMBER, NUMBER, after))
    assert found == {"a.out -> b.in": LockOutcome.FITS, "input.asked": outcome}


def test_an_edge_is_judged_as_it_was_locked() -> None:
    one, other = {**NUMBER, "x-unit": "m"}, {**NUMBER, "x-unit": "s"}
    edge = "a.out -> b.in"
    assert outcomes(lock(one, one), lock(other, one))[edge] is LockOutcome.BREAKS
    assert outcomes(lock(one, one, meaning="off"), lock(other, one))[edge] is LockOutcome.FITS
    named, called = {**NUMBER, "x-type": "a/A"}, {**NUMBER, "x-type": "b/B"}
    assert outcomes(lock(named, named), lock(called, named))[edge] is LockOutcome.BREAKS
    alike = (("a/A", "b/B"),)
    assert outcomes(lock(named, named, alike=alike), lock(called, named))[edge] is LockOutcome.FITS


def test_a_schema_that_names_no_type_is_of_the_type_that_it_stands_for() -> None:
    named = {**NUMBER, "x-type": "a/A"}
    found = list(compare(lock(named, NUMBER, meaning="strict"), {"a/A": dict(SMALL)}))
    assert [finding.changed for finding in found] == [True, False]
    both = lock(named, named, meaning="strict")
    assert outcomes(both, {"a/A": dict(NUMBER)})["a.out -> b.in"] is LockOutcome.FITS
