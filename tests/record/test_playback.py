"""A recording's timeline, without a clock; and that those who wait for it are moved."""

from __future__ import annotations

import threading

import pytest

from uoarm.record import _playback
from uoarm.record._playback import Playback, PlaybackTurn, Timeline
from uoarm.testing import Background, ManualClock, patience, wait

SECOND = 10**9


def test_a_message_is_due_at_its_time() -> None:
    timeline = Timeline(2.0)
    timeline.start(100.0)
    timeline.start(105.0)  # the second reader changes nothing
    assert timeline.wait(4 * SECOND, 100.0) == pytest.approx(2.0)
    assert timeline.wait(4 * SECOND, 102.0) == 0
    assert timeline.position(101.0) == 2 * SECOND


def test_what_stands_lets_nothing_pass_that_lies_ahead() -> None:
    timeline = Timeline(1.0)
    timeline.start(0.0)
    timeline.pause(3.0)
    assert timeline.wait(3 * SECOND, 9.0) == 0
    assert timeline.wait(3 * SECOND + 1, 9.0) is None
    timeline.play(10.0)
    assert timeline.wait(4 * SECOND, 10.0) == pytest.approx(1.0)


def test_another_rate_holds_from_here_on() -> None:
    timeline = Timeline(1.0)
    timeline.start(0.0)
    timeline.set_rate(10.0, 1.0)
    assert timeline.position(2.0) == 11 * SECOND
    timeline.set_rate(None, 2.0)
    assert timeline.wait(10**15, 2.0) == 0


def test_a_seek_goes_on_from_there() -> None:
    timeline = Timeline(1.0, 5 * SECOND)
    timeline.start(0.0)
    assert timeline.position(1.0) == 6 * SECOND
    timeline.seek(2 * SECOND, 1.0)
    assert timeline.position(2.0) == 3 * SECOND


def test_it_stands_from_the_beginning_where_it_is_asked_to() -> None:
    timeline = Timeline(1.0, is_paused=True)
    timeline.start(0.0)
    assert timeline.wait(0, 50.0) is None
    timeline.step([1, 0], 50.0)
    assert timeline.wait(0, 50.0) == 0
    assert timeline.wait(1, 50.0) is None
    timeline.step([1], 50.0)
    assert timeline.wait(1, 50.0) == 0
    timeline.seek(0, 50.0)
    timeline.pause(50.0)  # it stands already
    assert timeline.wait(0, 50.0) is None


@pytest.mark.parametrize(("seconds", "place"), [(1e300, 10.0), (3.0, 3.0), (0.0, 0.0)])
def test_a_seek_ends_at_the_end(seconds: float, place: float) -> None:
    playback = Playback(Timeline(1.0, is_paused=True), 0, 10 * SECOND)
    playback.seek(seconds)
    assert playback.status().position == place


def never() -> bool:
    return False


def test_readers_that_wait_are_moved() -> None:
    clock = ManualClock()
    playback = Playback(Timeline(1.0, is_paused=True), 0, 10 * SECOND, clock)
    begin, lap, generation = playback.join("a")
    assert (begin, lap, generation) == (0, 0, 0)
    playback.begin()
    first = Background(lambda: playback.wait("a", 2 * SECOND, generation, never))
    second = Background(lambda: playback.wait("b", 3 * SECOND, generation, never))
    wait(lambda: len(playback._next) == 2)
    playback.step()
    assert first.result(patience()) is PlaybackTurn.PLAY
    playback.seek(7.0)
    assert second.result(patience()) is PlaybackTurn.ELSEWHERE
    assert playback.join("a") == (7 * SECOND, 0, 1)
    status = playback.status()
    assert (status.position, status.duration, status.is_paused) == (7.0, 10.0, True)


def test_a_message_that_is_due_in_centuries_is_waited_for() -> None:
    playback = Playback(Timeline(1e-9), 0, 10 * SECOND)
    playback.join("a")
    playback.begin()
    asked = threading.Event()

    def is_over() -> bool:
        asked.set()
        return False

    reading = Background(lambda: playback.wait("a", 10 * SECOND, 0, is_over))
    assert asked.wait(patience())
    playback.seek(0.0)  # once it waits: it holds the lock until then
    assert reading.result(patience()) is PlaybackTurn.ELSEWHERE


def test_a_gap_in_which_no_reader_has_a_message_for_long_is_logged_once(
    caplog: pytest.LogCaptureFixture,
) -> None:
    clock = ManualClock()
    playback = Playback(Timeline(1.0), 0, 1000 * SECOND, clock, file="tape.mcap")
    for reader in ("a", "b"):
        playback.join(reader)
    playback.begin()
    first = Background(lambda: playback.wait("a", 600 * SECOND, 0, never))
    wait(lambda: playback._next)
    assert not caplog.messages, "the other reader may have a message at once"
    second = Background(lambda: playback.wait("b", 500 * SECOND, 0, never))
    text = "recording tape.mcap: no message for 500 s; `seek: 500.000`, or the option `from`"
    wait(lambda: caplog.messages)
    playback.play()  # which has both look again
    playback.seek(500.0)
    for reading in (first, second):
        assert reading.result(patience()) is PlaybackTurn.ELSEWHERE
    [said] = caplog.messages
    assert said.startswith(text)


def test_a_step_waits_for_readers_that_were_moved() -> None:
    playback = Playback(Timeline(1.0, is_paused=True), 0, 10 * SECOND)
    playback.join("a")
    playback.begin()

    def read() -> PlaybackTurn:
        assert playback.wait("a", 2 * SECOND, 0, never) is PlaybackTurn.ELSEWHERE
        return playback.wait("a", SECOND, 1, never)

    reading = Background(read)
    wait(lambda: playback._next)
    playback.seek(0.0)
    playback.step()
    assert playback.status().position == 1.0
    assert reading.result(patience()) is PlaybackTurn.PLAY


def test_steps_that_find_every_reader_busy_are_taken_as_one_comes_back(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(_playback, "_STEP_SECONDS", 0.0)
    playback = Playback(Timeline(1.0, is_paused=True), 0, 10 * SECOND)
    playback.join("a")
    playback.begin()
    playback.step()
    playback.step()

    def read(place: int) -> PlaybackTurn:
        return Background(lambda: playback.wait("a", place, playback.generation, never)).result()

    assert read(SECOND) is read(2 * SECOND) is PlaybackTurn.PLAY
    assert playback.status().position == 2.0
    playback.step()
    playback.seek(5.0)
    over = threading.Event()
    waiting = Background(lambda: playback.wait("a", 6 * SECOND, 1, over.is_set))
    wait(lambda: playback._next)
    assert playback.status().position == 5.0, "a step from where it no longer is"
    over.set()
    playback.end("a")
    assert waiting.result() is PlaybackTurn.STOP


def test_a_reader_that_is_over_stops() -> None:
    playback = Playback(Timeline(1.0, is_paused=True), 0, 10 * SECOND)
    *_, generation = playback.join("a")
    over = threading.Event()
    waiting = Background(lambda: playback.wait("a", SECOND, generation, over.is_set))
    wait(lambda: playback._next)
    over.set()
    playback.end("a")
    assert waiting.result(patience()) is PlaybackTurn.STOP


def test_a_reader_that_comes_later_joins_where_the_others_are() -> None:
    clock = ManualClock()
    playback = Playback(Timeline(1.0), 0, 10 * SECOND, clock)
    assert playback.join("a") == (0, 0, 0)
    clock.advance(5.0)  # as long as the first message takes to read
    playback.begin()
    clock.advance(0.5)
    assert playback.join("together with it") == (0, 0, 0)
    clock.advance(2.5)
    assert playback.join("later") == (3 * SECOND, 0, 0)
    clock.advance(20.0)
    assert playback.join("in the third turn", loops=True) == (3 * SECOND, 2, 0)


def test_without_readers_it_begins_anew() -> None:
    clock = ManualClock()
    playback = Playback(Timeline(1.0, 2 * SECOND), 0, 10 * SECOND, clock)
    playback.join("a")
    playback.begin()
    clock.advance(8.0)
    playback.end("a")
    clock.advance(100.0)
    assert playback.join("b") == (2 * SECOND, 0, 0)
    playback.begin()
    clock.advance(1.0)
    assert playback.status().position == 3.0


def test_as_fast_as_messages_are_taken_a_later_reader_misses_none() -> None:
    playback = Playback(Timeline(None), 0, 10 * SECOND, ManualClock())
    *_, generation = playback.join("a")
    playback.begin()
    assert playback.wait("a", 9 * SECOND, generation, never) is PlaybackTurn.PLAY
    assert playback.join("b") == (0, 0, 0)
