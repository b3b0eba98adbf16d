"""What is reported of a connection and of a channel: events and times in, reports out."""

from __future__ import annotations

import itertools
import threading
from pathlib import Path
from typing import Any

from hypothesis import given
from hypothesis import strategies as st

from uoarm.bridge import ChannelHealth, ChannelMonitor, ChannelReport, Disconnection, HealthReason
from uoarm.model import Health
from uoarm.testing import ManualClock, patience


def test_a_disconnection_is_reported_once_lost_once_and_over_once() -> None:
    disconnection = Disconnection(grace=10.0)
    assert disconnection.up() is None
    reported = [disconnection.down(now, final=False) for now in (0.0, 1.0, 9.9, 10.0, 11.0)]
    assert reported == [Health.DEGRADED, None, None, Health.LOST, None]
    assert disconnection.is_over
    assert [disconnection.up(), disconnection.up()] == [Health.OK, None]
    assert disconnection.down(20.0, final=True) is Health.LOST


def test_what_no_client_relied_upon_is_not_lost_and_its_coming_is_news() -> None:
    disconnection = Disconnection(grace=10.0)
    assert [disconnection.down(now, final=True) for now in (0.0, 100.0)] == [None, None]
    assert disconnection.up() is Health.OK


def test_it_says_how_long_a_break_may_still_last() -> None:
    disconnection = Disconnection(grace=10.0)
    disconnection.up()
    assert disconnection.left(0.0) is None
    disconnection.down(1.0, final=False)
    assert [disconnection.left(now) for now in (1.0, 4.0, 12.0)] == [10.0, 7.0, 0.0]
    disconnection.down(12.0, final=False)
    assert disconnection.left(12.0) is None


def said(report: ChannelReport | None) -> tuple[Health, str]:
    assert report is not None
    return report.health, report.cause


def test_silence_is_a_loss_once_and_messages_put_it_off() -> None:
    health = ChannelHealth("/image", 10.0, stale_after=2.0)
    assert health.tick(12.0) is None
    assert health.passed(12.0) is None
    assert health.tick(14.0) is None
    report = health.tick(14.1)
    assert said(report) == (Health.LOST, "silent: /image: no message for 2 s")
    assert (health.is_over, health.is_silent) == (True, True)
    assert [health.tick(20.0), health.passed(20.0), health.connected(20.0, 3)] == [None] * 3


def test_simulated_time_may_begin_anew() -> None:
    health = ChannelHealth("/image", 100.0, stale_after=2.0)
    assert health.tick(5.0) is None
    assert said(health.tick(7.1))[0] is Health.LOST


def test_the_last_peer_that_goes_is_a_loss_where_one_is_required() -> None:
    required = ChannelHealth("/image", 0.0)
    optional = ChannelHealth("/image", 0.0, peer_required=False)
    for health in (required, optional):
        assert [health.connected(1.0, count) for count in (0, 2, 1)] == [None] * 3
    gone = "disconnected: /image: its publisher ended"
    assert said(required.connected(2.0, 0, "its publisher ended")) == (Health.LOST, gone)
    assert optional.connected(2.0, 0, "its publisher ended") is None


def test_a_grace_lies_between_a_break_and_a_loss() -> None:
    health = ChannelHealth("cuff", 0.0, grace=5.0)
    health.connected(0.0)
    assert said(health.connected(1.0, 0, "the line broke"))[0] is Health.DEGRADED
    assert health.tick(5.9) is None
    assert said(health.connected(5.9)) == (Health.OK, "cuff: a peer is connected")
    health.connected(7.0, 0, "the line broke")
    assert health.connected(8.0, 0, "the port is gone") is None, "only the cause is another"
    report = health.tick(12.0)
    assert report == ChannelReport(
        Health.LOST,
        "disconnected: cuff: no peer for 5 s: the port is gone",
        7.0,
        HealthReason.DISCONNECTED,
    )


def test_a_grace_lies_between_silence_and_a_loss_and_a_message_ends_it() -> None:
    health = ChannelHealth("cuff", 0.0, stale_after=1.0, grace=5.0)
    note = "; is it on?"
    silent = (Health.DEGRADED, "silent: cuff: no message for 1 s; is it on?")
    assert said(health.tick(1.5, note)) == silent
    assert health.tick(2.0, "; another note") is None
    assert said(health.passed(3.0)) == (Health.OK, "cuff: a message passed")
    assert said(health.tick(4.5))[0] is Health.DEGRADED
    assert said(health.tick(9.1)) == (Health.LOST, "silent: cuff: no message for 6 s")


def test_a_disconnection_explains_silence_which_is_counted_anew_after_it() -> None:
    health = ChannelHealth("cuff", 0.0, stale_after=1.0, grace=5.0)
    health.connected(0.0)
    assert said(health.tick(1.5))[1].startswith("silent: ")
    assert said(health.connected(2.0, 0, "the line broke"))[1].startswith("disconnected: ")
    assert health.tick(4.0) is None
    assert said(health.connected(5.0))[0] is Health.OK
    assert health.tick(6.0) is None
    assert said(health.tick(6.1))[1].startswith("silent: ")


def test_a_refusal_is_over_with_the_next_message_and_one_of_the_channel_is_not() -> None:
    health = ChannelHealth("/cmd", 0.0)
    assert said(health.refused(1.0, "denied")) == (Health.DEGRADED, "refused: /cmd: denied")
    assert health.refused(2.0, "denied again") is None
    assert said(health.passed(3.0)) == (Health.OK, "/cmd: a message passed")
    assert said(health.refused(4.0, "no such type", final=True))[0] is Health.LOST


def test_what_the_peer_says_of_itself_is_reported_as_it_changes() -> None:
    health = ChannelHealth("arm", 0.0)
    for cause in ("inactive", "not initialised"):
        report = health.peer_reported(1.0, Health.DEGRADED, cause)
        assert said(report) == (Health.DEGRADED, f"peer: arm: {cause}")
        assert health.peer_reported(1.5, Health.DEGRADED, cause) is None
    assert said(health.peer_reported(2.0, Health.OK, "active")) == (Health.OK, "arm: active")
    assert said(health.peer_reported(3.0, Health.FINISHED, "shut down"))[0] is Health.FINISHED
    assert health.is_over


def test_a_rate_is_judged_over_a_window() -> None:
    health = ChannelHealth("/scan", 0.0, rate=10.0)
    for count in range(3):
        health.passed(0.1 * count)
    assert health.tick(0.9) is None
    slow = "slow: /scan: 3 messages a second, 10 are expected"
    assert said(health.tick(1.0)) == (Health.DEGRADED, slow)
    assert health.tick(2.0) is None
    for count in range(5):
        health.passed(2 + 0.1 * count)
    assert said(health.tick(3.0)) == (Health.OK, "/scan: 5 messages a second")


def test_the_worst_of_several_faults_is_the_status() -> None:
    health = ChannelHealth("/scan", 0.0, rate=10.0)
    health.tick(1.0)
    assert health.refused(1.5, "denied") is None, "it is degraded already"
    assert health.status.reason is HealthReason.SLOW
    assert said(health.refused(2.0, "gone", final=True)) == (Health.LOST, "refused: /scan: gone")


STEPS = st.one_of(
    st.tuples(st.just("passed")),
    st.tuples(st.just("tick")),
    st.tuples(st.just("connected"), st.integers(0, 2)),
    st.tuples(st.just("refused"), st.just("no"), st.booleans()),
    st.tuples(st.just("peer_reported"), st.sampled_from(Health), st.just("so")),
)


@given(
    steps=st.lists(st.tuples(st.floats(0, 3), STEPS), max_size=40),
    stale_after=st.none() | st.floats(0.1, 5),
    rate=st.none() | st.floats(0.1, 100),
    grace=st.floats(0, 3),
)
def test_each_change_is_reported_once_and_nothing_after_an_end(
    steps: list[tuple[float, Any]], stale_after: float | None, rate: float | None, grace: float
) -> None:
    health = ChannelHealth("it", 0.0, stale_after=stale_after, rate=rate, grace=grace)
    now, reports = 0.0, [health.status]
    for pause, (name, *arguments) in steps:
        now += pause
        if name == "refused":
            report = health.refused(now, arguments[0], final=arguments[1])
        else:
            report = getattr(health, name)(now, *arguments)
        if report is not None:
            assert report is health.status
            assert report.since <= now
            reports.append(report)
    for before, after in itertools.pairwise(reports):
        assert (before.health, before.cause) != (after.health, after.cause)
        assert before.health not in {Health.LOST, Health.FINISHED}
        is_well = after.health is Health.OK
        assert is_well is (after.reason is None)
        assert is_well or after.cause.startswith(f"{getattr(after.reason, 'value', '')}: it: ")


def test_a_monitor_reports_in_order_without_its_lock_and_nothing_once_closed() -> None:
    clock, reports = ManualClock(), list[tuple[Health, str]]()

    def report(health: Health, cause: str) -> None:
        reports.append((health, cause))
        if len(reports) == 1:
            # As a thread that comes meanwhile: it does not wait, and what it brings comes after.
            thread = threading.Thread(target=monitor.passed)
            thread.start()
            thread.join(patience())
            assert not thread.is_alive()

    monitor = ChannelMonitor(ChannelHealth("/a", clock(), stale_after=1.0), report, clock)
    monitor.connected()
    monitor.refused("denied")
    assert [health for health, _ in reports] == [Health.DEGRADED, Health.OK]
    clock.advance(0.5)
    assert monitor.facts() == {"seconds_since_message": 0.5, "stale_after": 1.0}
    monitor.peer_reported(Health.DEGRADED, "inactive")
    monitor.close()
    clock.advance(1.5)
    monitor.tick()
    assert monitor.is_silent
    assert len(reports) == 3


def test_the_page_has_every_reason() -> None:
    page = Path(__file__).parents[2] / "docs" / "writing-a-bridge.md"
    text = page.read_text(encoding="utf-8")
    for reason in HealthReason:
        assert f"| `{reason.value}` | {reason.meaning} |" in text
