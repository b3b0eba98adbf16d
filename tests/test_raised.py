"""What foreign code raises: whose failure it is, its text, and how many records it makes."""

from __future__ import annotations

import logging

import pytest

from uoarm._raised import LimitedLog, is_raised, text_of
from uoarm.errors import BridgeError, ConnectionClosedError, FailureReason, MessageError
from uoarm.testing import ManualClock


@pytest.mark.parametrize(
    ("error", "own"),
    [
        (ValueError("no"), True),
        (BridgeError("its reply is none", FailureReason.BAD_MESSAGE), True),
        (BridgeError("no link", FailureReason.UNAVAILABLE), False),
        (MessageError("a field is missing"), False),
        (ConnectionClosedError("it has ended"), False),
    ],
)
def test_what_is_closed_away_or_unfit_is_nobodys_exception(error: Exception, own: bool) -> None:
    assert is_raised(error) is own


def test_the_text_of_an_error_is_bounded_and_never_raises() -> None:
    class Broken(Exception):  # noqa: N818 - as foreign code may call it
        def __str__(self) -> str:
            raise OSError("even this")

    assert text_of(Broken()) == "Broken, whose text raised OSError"
    assert len(text_of(ValueError("x" * 10_000))) == 1000


def test_records_beyond_the_limit_are_counted_in_the_next_one(
    caplog: pytest.LogCaptureFixture,
) -> None:
    clock = ManualClock()
    log = LimitedLog(logging.getLogger("uoarm.test"), burst=2, clock=clock)
    for number in range(5):
        log.write(logging.WARNING, f"record {number}")
    clock.advance(10)
    log.write(logging.WARNING, "record 5")
    assert [one.getMessage() for one in caplog.records] == [
        "record 0",
        "record 1",
        "record 5 (and 3 more since the last record)",
    ]
