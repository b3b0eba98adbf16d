"""What a recording does as time passes: no clock, no file."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from uoarm.errors import UsageError
from uoarm.record._options import (
    Instant,
    RecordingSchedule,
    RecordingStep,
    RecordOptions,
    read_split,
)

BEGIN = Instant(10**18, 5 * 10**9)


def after(seconds: float, set_by: float = 0.0) -> Instant:
    nanoseconds = int(seconds * 1e9)
    return Instant(BEGIN.wall + nanoseconds + int(set_by * 1e9), BEGIN.steady + nanoseconds)


def due(
    schedule: RecordingSchedule, now: Instant, octets: int = 0, *, waiting: bool = True
) -> RecordingStep:
    return schedule.due(now, file_octets=octets, all_octets=octets, waiting=waiting)


def test_a_chunk_is_written_after_its_time_and_only_where_there_is_one() -> None:
    schedule = RecordingSchedule(RecordOptions(), BEGIN)
    assert due(schedule, after(0.5)) is RecordingStep.NOTHING
    assert due(schedule, after(1.0)) is RecordingStep.FLUSH
    schedule.flushed(after(1.0))
    assert due(schedule, after(1.5)) is RecordingStep.NOTHING
    assert due(schedule, after(9.0), waiting=False) is RecordingStep.NOTHING


def test_it_ends_after_its_time_or_size() -> None:
    schedule = RecordingSchedule(RecordOptions.of(duration=3, max_size="1kB"), BEGIN)
    assert due(schedule, after(0.1), 999) is RecordingStep.NOTHING
    assert due(schedule, after(0.2), 1000) is RecordingStep.END
    assert due(schedule, after(3.0), 0) is RecordingStep.END
    assert schedule.end_cause == "it lasted 3 s"


@given(st.floats(0.6, 1e6), st.sampled_from([-1, 1]))
def test_a_set_clock_splits_once(step: float, sign: int) -> None:
    schedule = RecordingSchedule(RecordOptions(), BEGIN)
    assert due(schedule, after(0.1)) is RecordingStep.NOTHING
    assert due(schedule, after(0.2, sign * step)) is RecordingStep.SPLIT
    assert due(schedule, after(0.3, sign * step)) is RecordingStep.NOTHING


def test_a_clock_that_is_slewed_does_not() -> None:
    schedule = RecordingSchedule(RecordOptions(chunk_seconds=1e9), BEGIN)
    for turn in range(1000):
        assert due(schedule, after(turn, turn * 5e-4)) is RecordingStep.NOTHING


def test_it_says_how_long_nothing_is_due() -> None:
    options = RecordOptions.of(duration=10, split="4s")
    schedule = RecordingSchedule(options, BEGIN)
    assert schedule.wait(after(0.25), waiting=True) == pytest.approx(0.75)
    assert schedule.wait(after(0.25), waiting=False) == pytest.approx(3.75)
    schedule.file_begins(after(4))
    assert due(schedule, after(7.9), waiting=False) is RecordingStep.NOTHING
    assert due(schedule, after(8.0), waiting=False) is RecordingStep.SPLIT
    assert RecordingSchedule(RecordOptions(), BEGIN).wait(after(1), waiting=False) is None


_some_seconds = st.floats(0.001, 100)


@given(
    st.none() | _some_seconds,
    st.none() | _some_seconds,
    _some_seconds,
    st.lists(st.booleans(), max_size=20),
)
def test_a_writer_that_does_what_is_due_never_turns_without_waiting(
    duration: float | None, split: float | None, chunk: float, waits: list[bool]
) -> None:
    options = RecordOptions(duration=duration, split_seconds=split, chunk_seconds=chunk)
    schedule, now = RecordingSchedule(options, BEGIN), BEGIN
    for waiting in waits:
        seconds = schedule.wait(now, waiting=waiting)
        if seconds is None:
            continue
        assert seconds > 0
        passed = int(seconds * 1e9) + 2  # no clock is exact to the nanosecond
        now = Instant(now.wall + passed, now.steady + passed)
        step = due(schedule, now, waiting=waiting)
        assert step is not RecordingStep.NOTHING
        if step is RecordingStep.END:
            return
        (schedule.file_begins if step is RecordingStep.SPLIT else schedule.flushed)(now)


@pytest.mark.parametrize(
    ("text", "meaning"),
    [
        ("512MB", (512_000_000, None)),
        ("2GiB", (2 * 1024**3, None)),
        (1000, (1000, None)),
        ("10min", (None, 600.0)),
        ("1.5 h", (None, 5400.0)),
        (None, (None, None)),
    ],
)
def test_sizes_and_times_are_read(text: str | int | None, meaning: object) -> None:
    assert read_split(text) == meaning


@pytest.mark.parametrize("text", ["", "0", "-1", "ten", "5 miles", "0s"])
def test_what_is_neither_is_refused(text: str) -> None:
    with pytest.raises(UsageError):
        read_split(text)


@pytest.mark.parametrize("text", ["9" * 400, "9" * 400 + "s", "9" * 400 + "GB", 10**400])
def test_what_no_disk_and_no_life_has_is_refused(text: str | int) -> None:
    with pytest.raises(UsageError, match="expected one such as"):
        read_split(text)
    with pytest.raises(UsageError, match="expected one such as"):
        RecordOptions.of(max_size=text)


@pytest.mark.parametrize("seconds", [float("inf"), float("nan"), 1e300, 0, -1])
def test_seconds_are_finite(seconds: float) -> None:
    for name in ("duration", "ring"):
        with pytest.raises(UsageError, match=f"{name} .*: expected seconds"):
            RecordOptions.of(**{name: seconds})  # type: ignore[arg-type]


def test_a_ring_is_not_split() -> None:
    with pytest.raises(UsageError, match="leave out ring or split"):
        RecordOptions.of(ring=5, split="1s")
