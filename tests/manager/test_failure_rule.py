"""The rule by which a component that raises is degraded, lost, and well again."""

from __future__ import annotations

from uoarm._dataplane import FailureRule
from uoarm.model import FailureLimits, Health


def _play(rule: FailureRule, outcomes: str, seconds: float, begin: float = 0.0) -> list[Health]:
    """Play `.` for a success and `x` for a failure, one every so many seconds."""
    reports = []
    for number, outcome in enumerate(outcomes):
        rule.note(outcome == ".", outcome == "x", begin + number * seconds)
        reports.append(rule.health)
    return reports


def test_successes_are_no_news() -> None:
    rule = FailureRule(FailureLimits())
    assert not rule.note(1000, 0, 0.0)
    assert rule.health is Health.OK


def test_the_first_failure_degrades_at_once() -> None:
    rule = FailureRule(FailureLimits())
    assert rule.note(0, 1, 0.0)
    assert rule.health is Health.DEGRADED


def test_ten_failures_over_half_a_second_are_a_loss_and_neither_alone_is() -> None:
    assert _play(FailureRule(FailureLimits()), "x" * 11, 0.05)[-2:] == [
        Health.DEGRADED,
        Health.LOST,
    ]
    assert _play(FailureRule(FailureLimits()), "x" * 100, 0.005)[-1] is Health.DEGRADED
    assert _play(FailureRule(FailureLimits()), "x" * 9, 60.0)[-1] is Health.DEGRADED
    assert _play(FailureRule(FailureLimits()), "x" * 10, 60.0)[-1] is Health.LOST


def test_one_success_begins_the_count_anew() -> None:
    rule = FailureRule(FailureLimits())
    assert _play(rule, "x" * 10 + "." + "x" * 10, 0.05)[-1] is Health.DEGRADED
    assert rule.note(0, 1, 1.1)
    assert rule.health is Health.LOST


def test_a_smaller_share_bears_some_successes_and_no_more() -> None:
    limits = FailureLimits(share=0.5, messages=10, seconds=0)
    assert _play(FailureRule(limits), "x." * 5, 1.0)[-1] is Health.LOST
    assert _play(FailureRule(limits), "x.." * 100, 1.0)[-1] is Health.DEGRADED
    assert Health.LOST not in _play(FailureRule(limits), "x.." * 100, 1.0)


def test_it_is_well_after_as_many_messages_and_seconds_without_a_failure() -> None:
    rule = FailureRule(FailureLimits())
    assert _play(rule, "x" + "." * 11, 0.05)[-2:] == [Health.DEGRADED, Health.OK]
    rule = FailureRule(FailureLimits())
    assert _play(rule, "x" + "." * 9 + "x" + "." * 10, 0.05)[-1] is Health.DEGRADED


def test_what_is_reported_in_batches_is_judged_like_single_messages() -> None:
    rule = FailureRule(FailureLimits())
    rule.note(0, 30, 0.0)
    assert rule.note(0, 5, 0.6)
    assert rule.health is Health.LOST
    rule = FailureRule(FailureLimits())
    rule.note(1, 30, 0.0)
    rule.note(0, 30, 0.6)
    assert rule.health is Health.DEGRADED, "there was a success in it"


def test_lost_is_the_end() -> None:
    rule = FailureRule(FailureLimits(messages=1, seconds=0))
    assert rule.note(0, 1, 0.0)
    assert rule.health is Health.LOST
    assert not rule.note(1000, 0, 100.0)
    assert rule.health is Health.LOST
