"""What is reported of a connection and of a channel: events and times in, reports out."""

from __future__ import annotations

import itertools
import threading
from pathlib import Path
from typing import Any

import pytest
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
    optional = ChannelHealth("/image", 0.0, without_peers=Health.OK)
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
    report = health.refused(1.5, "denied")
    slow = "slow: /scan: 0 messages a second, 10 are expected"
    assert said(report) == (Health.DEGRADED, f"{slow}; refused: /scan: denied")
    assert health.status.reason is HealthReason.SLOW
    assert said(health.refused(2.0, "gone", final=True)) == (Health.LOST, "refused: /scan: gone")


def test_of_several_things_that_a_peer_says_each_stands_until_it_is_well() -> None:
    health = ChannelHealth("agv", 0.0)
    health.peer_reported(1.0, Health.DEGRADED, "flat", "battery")
    report = health.peer_reported(2.0, Health.DEGRADED, "stuck", "wheel")
    assert said(report) == (Health.DEGRADED, "peer: agv: flat; stuck")
    assert health.passed(3.0) is None
    report = health.peer_reported(4.0, Health.OK, "charged", "battery")
    assert said(report) == (Health.DEGRADED, "peer: agv: stuck")
    assert said(health.peer_reported(5.0, Health.OK, "free", "wheel")) == (Health.OK, "agv: free")


def test_an_optional_peer_that_goes_leaves_a_channel_as_stated_whatever_the_grace() -> None:
    for grace in (0.0, 2.0):
        health = ChannelHealth("/a", 0.0, without_peers=Health.DEGRADED, grace=grace)
        health.connected(1.0)
        assert said(health.connected(2.0, 0, "it left")) == (
            Health.DEGRADED,
            "disconnected: /a: it left",
        )
        assert health.tick(100.0) is None
        assert said(health.connected(101.0))[0] is Health.OK


def test_with_the_last_of_optional_peers_goes_what_was_wrong_with_it() -> None:
    health = ChannelHealth("/a", 0.0, without_peers=Health.OK)
    health.connected(0.0)
    health.peer_reported(1.0, Health.DEGRADED, "inactive")
    report = health.connected(2.0, 0, "it left")
    assert said(report) == (Health.OK, "/a: no peer is connected, and none need be")


def test_a_silence_ends_where_messages_are_waited_for_longer() -> None:
    health = ChannelHealth("/a", 0.0, stale_after=1.0, recovers=True)
    health.connected(0.0)
    assert said(health.tick(2.0)) == (Health.LOST, "silent: /a: no message for 1 s")
    assert health.expect(2.0, 1.0) is None
    assert said(health.expect(2.0, 1.5)) == (Health.LOST, "silent: /a: no message for 1.5 s")
    assert said(health.expect(2.0, None)) == (Health.OK, "/a: it may be silent for longer")
    assert health.tick(100.0) is None
    assert said(health.expect(100.0, 5.0))[0] is Health.LOST


def test_what_was_judged_by_its_name_is_wrong_until_that_is_judged_well() -> None:
    health = ChannelHealth("/a", 0.0, without_peers=Health.OK)
    health.judged(0.0, HealthReason.REFUSED, Health.DEGRADED, "incompatible", "qos")
    assert health.connected(1.0) is None
    assert health.connected(2.0, 0, "it left") is None
    assert said(health.judged(3.0, HealthReason.REFUSED, Health.OK, "all fit", "qos")) == (
        Health.OK,
        "/a: all fit",
    )


def test_a_loss_may_be_temporary() -> None:
    health = ChannelHealth("/a", 0.0, stale_after=1.0, recovers=True)
    health.connected(0.0)
    assert said(health.tick(1.5)) == (Health.LOST, "silent: /a: no message for 1 s")
    report = health.connected(2.0, 0, "it ended")
    assert said(report) == (Health.LOST, "disconnected: /a: it ended"), "which explains the silence"
    assert said(health.connected(3.0)) == (Health.OK, "/a: a peer is connected")
    assert said(health.tick(4.5))[0] is Health.LOST, "silence is counted anew"
    assert said(health.passed(5.0)) == (Health.OK, "/a: a message passed")
    assert not health.is_over
    assert said(health.peer_reported(6.0, Health.FINISHED, "off"))[0] is Health.FINISHED
    assert said(health.peer_reported(7.0, Health.OK, "on"))[0] is Health.OK


def test_what_was_missed_is_reported_once_until_messages_come_as_they_should() -> None:
    health = ChannelHealth("/a", 0.0)
    slow = (Health.DEGRADED, "slow: /a: 1 lost")
    assert [said(health.missed(1.0, "1 lost")), health.missed(2.0, "2 lost")] == [slow, None]
    assert [health.tick(9.0), health.passed(2.9), health.tick(9.0), health.passed(9.0)] == [
        None
    ] * 4
    assert said(health.tick(9.1)) == (Health.OK, "/a: messages come as they should")
    assert said(health.missed(10.0, "3 lost"))[0] is Health.DEGRADED


def steady(*, seconds: float = 10.0, gap: float = 0.25) -> tuple[ChannelHealth, float]:
    """Return the health of a channel to which messages came steadily, and the time."""
    health, now = ChannelHealth("/a", 0.0, recovers=True, learns=True), 0.0
    assert health.connected(now) is None
    for _ in range(int(seconds / gap)):
        now += gap
        assert health.passed(now) is health.tick(now) is None
    return health, now


def test_what_came_steadily_and_ceases_is_degraded_until_it_comes_again() -> None:
    health, now = steady()
    assert health.tick(now + 2.9) is None
    text = (
        "silent: /a: no message for 3.2 s, and before one came every 0.25 s or sooner: with "
        "stale_after: 3 in the options it is lost"
    )
    assert said(health.tick(now + 3.25)) == (Health.DEGRADED, text)
    assert said(health.passed(now + 4)) == (Health.OK, "/a: a message passed")
    assert health.tick(now + 100) is None, "what paused once is steady no more"


@pytest.mark.parametrize(("seconds", "gap"), [(4.0, 0.25), (30.0, 2.0)])
def test_of_few_messages_nothing_is_concluded(seconds: float, gap: float) -> None:
    health, now = steady(seconds=seconds, gap=gap)
    assert health.tick(now + 600) is None


def test_a_loss_says_which_option_would_have_reported_it_sooner() -> None:
    for pause, hint in (
        (0.5, ""),
        (20, ", 20.0 s after its last message: stale_after: 3 in the options reports it sooner"),
    ):
        health, now = steady()
        report = health.connected(now + pause, 0, "it left")
        assert said(report) == (Health.LOST, f"disconnected: /a: it left{hint}")


@pytest.mark.parametrize("messages", [1, 2, 5])
def test_of_a_latched_channel_no_stale_after_is_proposed(messages: int) -> None:
    health = ChannelHealth("/map", 0.0, recovers=True, learns=True)
    health.connected(0.0)
    for message in range(messages):
        health.passed(message * 0.1)
    report = health.connected(60.0, 0, "it left")
    assert said(report) == (Health.LOST, "disconnected: /map: it left")


def test_a_silence_that_peers_promise_not_to_reach_may_come_later() -> None:
    health = ChannelHealth("/a", 0.0, recovers=True, learns=True)
    assert health.facts(0.0)["stale_after"] == "never"
    health.stale_after = 1.5
    assert health.wake_at() == 1.5
    report = health.tick(1.6, ", as promised")
    assert said(report) == (Health.LOST, "silent: /a: no message for 1.5 s, as promised")


@given(stale_after=st.floats(0.5, 5), grace=st.floats(0, 3), pauses=st.lists(st.floats(0.1, 9)))
def test_until_it_wakes_no_tick_has_news(
    stale_after: float, grace: float, pauses: list[float]
) -> None:
    health, now = ChannelHealth("/a", 0.0, stale_after=stale_after, grace=grace), 0.0
    health.connected(now)
    for count, pause in enumerate(pauses):
        due = health.wake_at()
        now += pause
        report = health.tick(now)
        assert report is None or (due is not None and now >= due)
        if count % 3 == 1:
            health.connected(now, 1 - min(health.peers, 1))
    # What comes may be explained by what is reported already: then a tick has no news at its time.
    while (due := health.wake_at()) is not None:
        health.tick(due + 1e-6)
        after = health.wake_at()
        assert after is None or after > due
    assert health.status.health is Health.LOST


STEPS = st.one_of(
    st.tuples(st.just("passed")),
    st.tuples(st.just("tick")),
    st.tuples(st.just("connected"), st.integers(0, 2)),
    st.tuples(st.just("refused"), st.just("no"), st.booleans()),
    st.tuples(st.just("missed"), st.just("one")),
    st.tuples(st.just("peer_reported"), st.sampled_from(Health), st.just("so")),
    st.tuples(
        st.just("judged"),
        st.just(HealthReason.REFUSED),
        st.sampled_from(Health),
        st.just("thus"),
        st.sampled_from(["qos", "type"]),
    ),
)


def happen(health: ChannelHealth, now: float, name: str, *arguments: Any) -> ChannelReport | None:
    if name == "refused":
        return health.refused(now, arguments[0], final=arguments[1])
    report: ChannelReport | None = getattr(health, name)(now, *arguments)
    return report


FLOWS = st.fixed_dictionaries(
    {
        "stale_after": st.none() | st.floats(0.1, 5),
        "rate": st.none() | st.floats(0.1, 100),
        "grace": st.floats(0, 3),
        "without_peers": st.sampled_from([Health.OK, Health.DEGRADED, Health.LOST]),
        "learns": st.booleans(),
    }
)
HISTORIES = st.lists(st.tuples(st.floats(0, 3), STEPS), max_size=40)


@given(steps=HISTORIES, flow=FLOWS, recovers=st.booleans())
def test_each_change_is_reported_once_and_nothing_after_an_end(
    steps: list[tuple[float, Any]], flow: dict[str, Any], recovers: bool
) -> None:
    health = ChannelHealth("it", 0.0, recovers=recovers, **flow)
    now, reports = 0.0, [health.status]
    for pause, step in steps:
        now += pause
        report = happen(health, now, *step)
        if report is not None:
            assert report is health.status
            assert report.since <= now
            reports.append(report)
    for before, after in itertools.pairwise(reports):
        assert (before.health, before.cause) != (after.health, after.cause)
        assert recovers or before.health not in {Health.LOST, Health.FINISHED}
        is_well = after.health is Health.OK
        assert is_well is (after.reason is None)
        assert is_well or after.cause.startswith(f"{getattr(after.reason, 'value', '')}: it: ")


@given(steps=HISTORIES, flow=FLOWS)
def test_until_a_loss_what_recovers_is_judged_as_what_does_not(
    steps: list[tuple[float, Any]], flow: dict[str, Any]
) -> None:
    final = ChannelHealth("it", 0.0, **flow)
    recovering = ChannelHealth("it", 0.0, recovers=True, **flow)
    now = 0.0
    for pause, step in steps:
        if final.is_over:
            break
        now += pause
        assert happen(final, now, *step) == happen(recovering, now, *step)


@given(steps=HISTORIES, flow=FLOWS)
def test_what_recovers_is_well_with_the_first_new_peer_whatever_was_before(
    steps: list[tuple[float, Any]], flow: dict[str, Any]
) -> None:
    health, now = ChannelHealth("it", 0.0, recovers=True, **flow), 0.0
    for pause, step in steps:
        now += pause
        happen(health, now, *step)
    for about in ("qos", "type"):  # what has a name is judged well by it
        health.judged(now, HealthReason.REFUSED, Health.OK, "", about)
    health.connected(now, 0)
    health.connected(now, 1)
    assert health.status.health is Health.OK
    assert health.tick(now) is None


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
    page = Path(__file__).parents[2] / "docs" / "channel-health.md"
    text = page.read_text(encoding="utf-8")
    for reason in HealthReason:
        assert f"| `{reason.value}` | {reason.meaning} |" in text
