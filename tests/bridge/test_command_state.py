"""Commands that expire, decided without a thread or a clock: in every order of what can happen."""

from __future__ import annotations

import math

import pytest
from hypothesis import settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, invariant, precondition, rule

from uoarm.bridge._watchdog import CommandState
from uoarm.model import CommandPhase, CommandPolicy, FieldLimit, StopMessage

LIFETIME = 0.25
POLICY = CommandPolicy(LIFETIME, StopMessage({"v": 0.0}))
GO = {"v": 0.5}


class AnyOrder(RuleBasedStateMachine):
    """One input, whose commands and stops are sent, overtake each other, and fail, in any order.

    What the sink took stands in `taken`: of a command and a stop that are sent at the same time
    it is not known which one arrives last, so that both count as last.
    """

    def __init__(self) -> None:
        super().__init__()
        self.now = 100.0
        self.state = CommandState(POLICY, self.now)
        self.sending = False
        self.stopping = False
        self.crossed = False
        self.renewed: float | None = None
        self.last: set[str] = set()
        self.held_since_release = False

    @rule(seconds=st.sampled_from([0.0, 0.01, 0.1, LIFETIME, 3.0]))
    def pass_time(self, seconds: float) -> None:
        self.now += seconds

    @precondition(lambda self: not self.sending)
    @rule(age=st.sampled_from([0.0, 0.1, LIFETIME, 9.0]))
    def offer(self, age: float) -> None:
        refused = self.state.offer(GO, self.now, age)
        if refused is None:
            assert not self.held_since_release
            assert age < LIFETIME
            self.sending, self.crossed = True, self.stopping
            self.renewed = self.now - age

    @precondition(lambda self: self.sending)
    @rule()
    def sent(self) -> None:
        self.sending = False
        self.last = {"go", "stop"} if self.crossed else {"go"}
        self.state.sent(self.now)

    @precondition(lambda self: not self.stopping)
    @rule()
    def look(self) -> None:
        due = self.state.is_due(self.now)
        if due and not self.held_since_release:
            assert self.renewed is not None
            assert self.now >= self.renewed + LIFETIME, "nothing is stopped before time"
        if due and self.state.begin_stop(self.now):
            self.stopping, self.crossed = True, self.sending

    @precondition(lambda self: self.stopping)
    @rule(fails=st.booleans())
    def stop_ends(self, *, fails: bool) -> None:
        self.stopping = False
        if fails:
            self.state.stop_failed(self.now, "it raised")
        else:
            self.last = {"go", "stop"} if self.crossed else {"stop"}
            self.state.stop_taken(self.now)

    @rule()
    def hold(self) -> None:
        self.held_since_release = True
        self.state.hold(self.now)

    @rule()
    def halt(self) -> None:
        if self.state.phase is CommandPhase.MOVING:
            self.renewed = -math.inf
        self.state.halt(self.now)
        assert self.state.phase is not CommandPhase.MOVING

    @rule()
    def release(self) -> None:
        # A stop that was asked for and not taken yet goes on, whatever its command's time was.
        self.held_since_release = False
        self.renewed = -math.inf
        self.state.release()

    @invariant()
    def who_has_stopped_took_the_stop_last(self) -> None:
        if self.state.phase is CommandPhase.STOPPED and not self.sending:
            assert self.last == {"stop"}

    @invariant()
    def what_moves_will_be_woken(self) -> None:
        if self.state.phase is CommandPhase.MOVING:
            assert self.state.wake_at() <= self.now + LIFETIME

    @invariant()
    def what_must_stop_is_due_soon_unless_something_is_under_way(self) -> None:
        if self.state.phase is CommandPhase.STOPPING and not (self.sending or self.stopping):
            assert self.state.wake_at() <= self.now + 0.5

    def teardown(self) -> None:
        """When no client sends any more, the sink took the stop last, if it took anything."""
        self.now += 9
        if self.sending:
            self.sent()
        if self.stopping:
            self.stop_ends(fails=False)
        for _ in range(3):
            self.now += 1
            self.look()
            if self.stopping:
                self.stop_ends(fails=False)
        assert self.last <= {"stop"}
        assert self.state.phase in {CommandPhase.STOPPED, CommandPhase.IDLE}


AnyOrder.TestCase.settings = settings(max_examples=100, stateful_step_count=25, deadline=None)
test_any_order = AnyOrder.TestCase


def limited(**limits: float) -> CommandState:
    limit = FieldLimit("v", **limits)
    return CommandState(CommandPolicy(LIFETIME, StopMessage({"v": 0.0}), (limit,)), 0.0)


def offer(state: CommandState, value: object, now: float) -> str:
    refused = state.offer({"v": value}, now)
    if refused is None:
        state.sent(now)
        return ""
    return refused.reason


@pytest.mark.parametrize("value", [-1.1, 1.1, math.nan, math.inf, True, "1", None])
def test_what_is_beyond_its_limits_is_refused_and_renews_nothing(value: object) -> None:
    state = limited(minimum=-1, maximum=1)
    assert offer(state, 1.0, 1.0) == ""
    assert offer(state, value, 1.2) == "beyond-limits"
    assert dict(state.dropped) == {"beyond-limits": 1}
    assert state.is_due(1.0 + LIFETIME), "the refused one renewed nothing"


def test_a_value_changes_no_faster_than_it_may_also_after_a_pause() -> None:
    state = limited(rate=2.0)
    assert offer(state, 0.6, 1.0) == "beyond-limits", "from the stop's value, within one lifetime"
    assert offer(state, 0.5, 1.0) == ""
    assert offer(state, 0.7, 1.1) == ""
    assert offer(state, 0.95, 1.2) == "beyond-limits"
    assert offer(state, 0.9, 1.2) == ""
    assert state.begin_stop(9.0)
    state.stop_taken(9.0)
    assert offer(state, 0.9, 90.0) == "beyond-limits", "a pause gives no leave for a jump"
    assert offer(state, 0.5, 90.0) == ""


def test_a_stop_that_is_not_taken_is_due_again_and_again() -> None:
    state = CommandState(POLICY, 0.0)
    assert state.offer(GO, 0.0) is None
    state.sent(0.0)
    now, tries = LIFETIME, 0
    while now < 10:
        assert state.begin_stop(now)
        state.stop_failed(now, "it raised")
        refused = state.offer(GO, now)
        assert refused is not None
        assert refused.reason == "stopping", "what did not take its stop takes no command"
        tries, now = tries + 1, state.wake_at()
    assert 20 < tries < 40
    assert state.status(now).cause == "it raised"


def test_a_stop_that_overtook_a_command_is_sent_again_behind_it() -> None:
    state = CommandState(POLICY, 0.0)
    assert state.offer(GO, 0.0) is None
    assert state.begin_stop(1.0)
    state.stop_taken(1.0)
    assert not state.is_due(2.0), "it waits for the command that is under way"
    state.sent(3.0)
    assert state.begin_stop(3.0)
    state.stop_taken(3.0)
    assert state.phase is CommandPhase.STOPPED


def test_without_a_lifetime_only_a_hold_stops() -> None:
    state = CommandState(CommandPolicy(stop=StopMessage(0)), 0.0)
    assert state.offer(1, 0.0) is None
    state.sent(0.0)
    assert not state.is_due(1e9)
    assert state.status(5.0).left is None
    state.hold(1e9)
    assert state.is_due(1e9)
