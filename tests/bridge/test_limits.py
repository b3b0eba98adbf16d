"""What commands may ask for: whatever is sent, and whenever, what passes is within its limits."""

from __future__ import annotations

import math
from typing import Any

from attrs import frozen
from hypothesis import given
from hypothesis import strategies as st

from uoarm.bridge._watchdog import CommandState
from uoarm.model import CommandPolicy, FieldLimit, StopMessage

LIFETIME = 0.25
REST = 0.0
# Sixteenths: exact in binary, so that what is just within a limit is so for both who count.
SIXTEENTHS = st.integers(-64, 64).map(lambda number: number / 16)


@frozen
class Sent:
    """A command, so many seconds after the one before."""

    value: Any
    pause: float


ODD = st.sampled_from([math.nan, math.inf, -math.inf, True, None, "1", 10**400])
SENT = st.builds(
    Sent,
    st.one_of(SIXTEENTHS, SIXTEENTHS, SIXTEENTHS, ODD),
    st.integers(0, 8).map(lambda n: n / 16),
)
LIMITS = st.builds(
    FieldLimit,
    st.just("v"),
    minimum=st.one_of(st.none(), st.integers(-32, 0).map(lambda n: n / 16)),
    maximum=st.one_of(st.none(), st.integers(0, 32).map(lambda n: n / 16)),
    rate=st.one_of(st.none(), st.integers(0, 128).map(lambda n: n / 16)),
)


def passed(limit: FieldLimit, commands: list[Sent], begin: float) -> list[bool]:
    """Say of each command whether it passed; the stop is taken as soon as it is due."""
    state = CommandState(CommandPolicy(LIFETIME, StopMessage({"v": REST}), (limit,)), begin)
    now, reports = begin, []
    for command in commands:
        now += command.pause
        if state.is_due(now):
            assert state.begin_stop(now)
            state.stop_taken(now)
        refused = state.offer({"v": command.value}, now)
        assert refused is None or refused.reason == "beyond-limits"
        if refused is None:
            state.sent(now)
        reports.append(refused is None)
    return reports


def may_pass(limit: FieldLimit, commands: list[Sent]) -> list[bool]:
    """Say the same by the words of the page, without the state."""
    before, since, reports = REST, math.inf, []
    for command in commands:
        since += command.pause
        if since >= LIFETIME:
            before, since = REST, math.inf
        value = command.value
        is_fit = (
            isinstance(value, float)
            and math.isfinite(value)
            and (limit.minimum is None or value >= limit.minimum)
            and (limit.maximum is None or value <= limit.maximum)
            and (limit.rate is None or abs(value - before) <= limit.rate * min(since, LIFETIME))
        )
        if is_fit:
            before, since = value, 0.0
        reports.append(is_fit)
    return reports


@given(limit=LIMITS, commands=st.lists(SENT, max_size=12))
def test_what_passes_is_what_the_limits_say(limit: FieldLimit, commands: list[Sent]) -> None:
    assert passed(limit, commands, 0.0) == may_pass(limit, commands)


@given(limit=LIMITS, commands=st.lists(SENT, max_size=12), begin=st.integers(-(2**30), 2**30))
def test_only_what_passes_between_two_commands_counts_and_no_clock(
    limit: FieldLimit, commands: list[Sent], begin: int
) -> None:
    """The clock may begin anywhere, as it does after each start of a machine."""
    assert passed(limit, commands, float(begin)) == passed(limit, commands, 0.0)
