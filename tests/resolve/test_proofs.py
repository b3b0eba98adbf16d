"""Proofs about what was discovered: judged once if they can be, again where time was short."""

from __future__ import annotations

import pytest
from tests.structures import closed

from uoarm._resolve import Proofs, _proofs
from uoarm.model import MessageStructure, Schema
from uoarm.testing import ManualClock, patience


def structure(most: int) -> MessageStructure:
    """Return a structure that takes some looking at to be compared with another."""
    fields: dict[str, Schema] = {
        f"field{number}": {"type": "integer", "maximum": most + number} for number in range(50)
    }
    return MessageStructure({"type": "object", "properties": fields})


SMALL, LARGE = structure(9), structure(99)
UNDECIDED = "it cannot be decided whether every message fits: the budget of time ran out"


@pytest.fixture
def clock() -> ManualClock:
    return ManualClock()


@pytest.fixture
def proofs(clock: ManualClock) -> Proofs:
    made = Proofs(clock)
    made.begin_round()
    return made


def test_what_was_not_decided_in_time_is_judged_again_later(
    proofs: Proofs, clock: ManualClock, monkeypatch: pytest.MonkeyPatch
) -> None:
    with monkeypatch.context() as hurried:
        hurried.setattr(_proofs, "_PAIR_SECONDS", 1e-9)
        assert proofs.refusal(SMALL, LARGE).startswith(UNDECIDED)
    monkeypatch.setattr(_proofs, "_PAIR_SECONDS", patience())
    assert proofs.refusal(SMALL, LARGE).startswith(UNDECIDED)  # too early
    clock.advance(1.0)
    assert proofs.refusal(SMALL, LARGE) == ""


def test_nor_is_a_map_given_up_for_want_of_time(
    proofs: Proofs, clock: ManualClock, monkeypatch: pytest.MonkeyPatch
) -> None:
    number: Schema = {"type": "integer"}
    given = MessageStructure(
        {"type": "object", "properties": {"value": number}, "required": ["value"]}
    )
    wanted = MessageStructure(closed(data=number))
    assert proofs.refusal(given, wanted)
    with monkeypatch.context() as hurried:
        hurried.setattr(_proofs, "_PAIR_SECONDS", 1e-9)
        hurried.setattr(_proofs, "_SUGGEST_SECONDS", 0.0)
        assert proofs.adapted(given, wanted) is None
    monkeypatch.setattr(_proofs, "_PAIR_SECONDS", patience())
    monkeypatch.setattr(_proofs, "_SUGGEST_SECONDS", patience())
    clock.advance(1.0)
    found = proofs.adapted(given, wanted)
    assert found is not None
    assert found.mapping == {"data": "value"}


def test_what_was_decided_stays_so_when_no_time_is_left(proofs: Proofs, clock: ManualClock) -> None:
    refused = proofs.refusal(LARGE, SMALL)
    clock.advance(_proofs._ROUND_SECONDS + 1)
    assert proofs.refusal(SMALL, LARGE) == "it was not compared yet, for want of time"
    assert proofs.unjudged == 1
    assert proofs.refusal(LARGE, SMALL) == refused != ""
    proofs.begin_round()
    assert proofs.refusal(SMALL, LARGE) == ""
