"""Whether a host lives: how long it has been silent, and that late answers count."""

from __future__ import annotations

import threading
from collections import deque
from collections.abc import Callable
from itertools import pairwise
from typing import Any, cast

import pytest
from hypothesis import given
from hypothesis import strategies as st

from uoarm._host.transport import liveness
from uoarm._host.transport.liveness import Heartbeat, LivenessMonitor, Silence
from uoarm._host.transport.transport import LinkLostError, Transport
from uoarm.errors import BridgeError, FailureReason
from uoarm.testing import patience

INTERVAL = liveness._INTERVAL_SECONDS

moments = st.lists(
    st.tuples(st.sampled_from(["asked", "received"]), st.floats(0, 100)), max_size=30
)


@given(moments)
def test_silence_is_counted_from_the_last_answer_and_by_questions(
    happened: list[tuple[str, float]],
) -> None:
    silence, now, received, unanswered = Silence(3.0, 0.0), 0.0, 0.0, 0
    for what, later in happened:
        now += later
        if what == "asked":
            silence.asked()
            unanswered += 1
        else:
            silence.answered(now)
            received, unanswered = now, 0
        assert silence.seconds(now) == min(now - received, unanswered * INTERVAL)
        assert silence.is_over(now) is (silence.seconds(now) > 3.0)


@given(moments)
def test_doubt_is_reported_when_it_begins_and_when_it_is_over(
    happened: list[tuple[str, float]],
) -> None:
    silence, now, reports = Silence(3.0, 0.0), 0.0, [False]
    for what, later in happened:
        now += later
        silence.asked() if what == "asked" else silence.answered(now)
        change = silence.doubt(now)
        if change is not None:
            reports.append(change)
        assert reports[-1] is silence.in_doubt is (silence.seconds(now) > 1.0)
    assert all(flag is not other for flag, other in pairwise(reports))


def test_a_process_that_was_stopped_gives_no_host_up_for_its_own_silence() -> None:
    silence = Silence(3.0, 0.0)
    silence.asked()
    assert not silence.is_over(3600.0)


class LateTransport:
    """Answers each question when it is asked the one after the next few."""

    def __init__(self, late: int | None) -> None:
        self.late = late
        self.asked = 0
        self.enough = threading.Event()
        self._waiting: deque[Callable[[Any], None]] = deque()

    def ask_later(self, key: str, take: Callable[[Any], None], *, timeout: float) -> None:
        self.asked += 1
        self._waiting.append(take)
        if self.late is not None and len(self._waiting) > self.late:
            self._waiting.popleft()([])
        if self.asked == 40:
            self.enough.set()
        if self.late is None and self.asked % 2:
            raise BridgeError("the link is closed")


class Answers:
    """A transport over which every question is answered with one error."""

    def __init__(self, error: BridgeError) -> None:
        self.error = error

    def ask(self, key: str, request: object, *, timeout: float) -> object:
        raise self.error


class Patient:
    """A condition that notes that a thread waited."""

    def __init__(self) -> None:
        self.waited = False

    def __enter__(self) -> None: ...
    def __exit__(self, *_: object) -> None: ...
    def notify_all(self) -> None: ...

    def wait_for(self, predicate: Callable[[], bool], timeout: float) -> bool:
        self.waited = True
        return predicate()


@pytest.mark.parametrize(
    ("error", "waits"),
    [
        (BridgeError("the node is not there", FailureReason.UNAVAILABLE), False),
        (LinkLostError("the link is closed"), True),
    ],
)
def test_why_a_host_died_is_waited_for_only_where_the_link_is_lost(
    error: BridgeError, waits: bool
) -> None:
    monitor = LivenessMonitor("far", lambda *_: None, lambda _: None)
    monitor._news = news = Patient()  # type: ignore[assignment] # all that it is asked for
    with pytest.raises(BridgeError) as caught:
        monitor.ask(cast(Transport, Answers(error)), "describe", {})
    assert caught.value is error
    assert news.waited is waits


def heart(
    transport: LateTransport, doubts: list[object], over: threading.Event, limit: float
) -> Heartbeat:
    def end(silent: float) -> None:
        doubts.append(silent)
        over.set()

    return Heartbeat(
        "far",
        cast(Transport, transport),
        silence=limit,
        on_answer=lambda _: None,
        on_doubt=doubts.append,
        on_silence=end,
    )


def test_answers_that_come_late_are_signs_of_life(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(liveness, "_INTERVAL_SECONDS", 0.01)
    transport, reports, over = LateTransport(late=5), list[object](), threading.Event()
    heartbeat = heart(transport, reports, over, 0.1)
    heartbeat.start()
    assert transport.enough.wait(patience())
    heartbeat.stop()
    heartbeat.join(patience())
    assert not over.is_set()


def test_a_host_that_does_not_answer_is_doubted_and_then_given_up(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(liveness, "_INTERVAL_SECONDS", 0.01)
    transport, reports, over = LateTransport(late=None), list[object](), threading.Event()
    heartbeat = heart(transport, reports, over, 0.1)
    heartbeat.start()
    assert over.wait(patience())
    heartbeat.join(patience())
    doubt, silent = reports
    assert doubt is True
    assert isinstance(silent, float)
    assert 0.1 < silent < 0.12
