"""The window of what is under way to a slow client, against clients and networks of all speeds."""

from __future__ import annotations

import random
from collections import deque

import pytest
from hypothesis import given
from hypothesis import strategies as st
from tests.sweeps import for_all

from uoarm.server.streams._send_window import SendWindow

STEP = 0.004
WRITE = 2**16


class Link:
    """A client that reads `rate` octets a second from buffers without end, and a flood to it.

    Messages wait always, so that as much is written as the window and `flood` octets a second let.
    """

    def __init__(self, rate: float, round_trip: float, flood: float) -> None:
        self.window = SendWindow()
        self.rate = rate
        self.now = 0.0
        self.read = 0.0
        self._flood = flood
        self.round_trip = round_trip
        self._may_write = 0.0
        self._written = 0
        self._arriving: deque[tuple[float, int]] = deque()  # what was written by when it arrives
        self._there = 0
        self._pings: deque[tuple[float, int]] = deque()  # when they arrive, and behind what
        self._pongs: deque[float] = deque()
        self.pings = 0

    @property
    def under_way(self) -> float:
        """Seconds until what is written now is read."""
        return self.round_trip / 2 + (self._written - self.read) / self.rate

    def ping(self, *, is_behind: bool = True) -> bool:
        wants = self.window.wants_ping(self.now, is_behind=is_behind)
        if wants:
            self.pings += 1
            self.window.asked(self.now)
            self._pings.append((self.now + self.round_trip / 2, self._written))
        return wants

    def step(self, *, is_behind: bool = True) -> None:
        self.now += STEP
        self._may_write = min(self._may_write + self._flood * STEP, 2.0 * WRITE)
        while self._arriving and self._arriving[0][0] <= self.now:
            self._there = self._arriving.popleft()[1]
        self.read = min(self.read + self.rate * STEP, self._there)
        while self._pings and self._pings[0][0] <= self.now and self._pings[0][1] <= self.read:
            self._pings.popleft()
            self._pongs.append(self.now + self.round_trip / 2)
        while self._pongs and self._pongs[0] <= self.now:
            self._pongs.popleft()
            self.window.answered(self.now)
        if self.window.is_stuck(self.now):
            self.ping(is_behind=is_behind)
        while self._may_write >= WRITE and not self.window.is_full(self.now):
            self._may_write -= WRITE
            self._written += WRITE
            self.window.sent += WRITE
            self._arriving.append((self.now + self.round_trip / 2, self._written))
            self.ping(is_behind=is_behind)

    def run(self, seconds: float) -> None:
        for _ in range(round(seconds / STEP)):
            self.step()

    def begin(self) -> None:
        """Have the first ping answered, before anything is written."""
        assert self.ping(is_behind=False)
        self.run_idle(self.round_trip + 2 * STEP)

    def run_idle(self, seconds: float) -> None:
        flood, self._flood = self._flood, 0.0
        for _ in range(round(seconds / STEP)):
            self.step(is_behind=False)
        self._flood = flood


def met() -> SendWindow:
    """Return the window of a client that answers a ping at once while nothing is under way."""
    window = SendWindow()
    window.wants_ping(-10.0, is_behind=False)
    window.asked(-10.0)
    window.answered(-10.0)
    return window


@pytest.mark.parametrize("rate", [5e5, 3e6, 2e7])
@pytest.mark.parametrize("round_trip", [0.0, 0.1, 0.3, 1.0])
@pytest.mark.parametrize("excess", [1.3, 6.0])
def test_what_is_under_way_is_read_within_half_a_second_and_a_round_trip(
    rate: float, round_trip: float, excess: float
) -> None:
    link = Link(rate, round_trip, flood=rate * excess)
    link.begin()
    link.run(8 + 8 * round_trip)
    read, since, most = link.read, link.now, 0.0
    for _ in range(round(3 / STEP)):
        link.step()
        most = max(most, link.under_way)
    assert most < 0.55 + 1.5 * round_trip + 3 * WRITE / rate
    assert link.read - read > 0.85 * rate * (link.now - since)  # and the client has enough to read


def test_a_client_that_reads_faster_again_gets_more() -> None:
    link = Link(1e6, 0.01, flood=2e7)
    link.begin()
    link.run(10)
    link.rate = 1e7
    link.run(3)
    read = link.read
    link.run(1)
    assert link.read - read > 0.85e7


def test_a_network_that_becomes_slower_for_good_is_not_taken_for_a_slow_client() -> None:
    link = Link(2e6, 0.02, flood=4e6)
    link.begin()
    link.run(5)
    link.round_trip = 0.8
    link.run(25)
    read = link.read
    link.run(5)
    assert link.read - read > 0.85 * 5 * 2e6
    link.round_trip = 0.02
    link.run(60)
    assert link.under_way < 0.55


@pytest.mark.parametrize(("rate", "round_trip"), [(5e5, 0.01), (2e6, 0.3), (2e7, 1.0)])
def test_measuring_the_round_trip_costs_little(rate: float, round_trip: float) -> None:
    link = Link(rate, round_trip, flood=4 * rate)
    link.begin()
    link.run(10)
    read = link.read
    link.run(120)
    assert link.read - read > 0.85 * 120 * rate


spells = st.lists(
    st.tuples(
        st.floats(0.05, 4),
        st.sampled_from([0.0, 1e5, 1e6, 1e7]),
        st.sampled_from([0.0, 0.05, 0.5]),
        st.booleans(),
    ),
    max_size=8,
)


@given(spells)
def test_after_whatever_it_has_seen_it_settles(
    plan: list[tuple[float, float, float, bool]],
) -> None:
    link = Link(1e6, 0.05, flood=4e6)
    link.begin()
    for seconds, link.rate, link.round_trip, is_behind in plan:
        for _ in range(round(seconds / STEP)):
            link.step(is_behind=is_behind)
    link.rate, link.round_trip = 1e6, 0.05
    link.run(60 + link.under_way)
    read = link.read
    link.run(10)
    assert link.under_way < 0.75
    assert link.read - read > 0.8 * 10 * 1e6


def test_what_buffers_take_before_anything_waits_is_noticed() -> None:
    """As what would be too old when it is read is dropped, nothing waits after a slow answer."""
    link = Link(1e6, 0.01, flood=4e6)
    link.begin()
    most = 0.0
    for _ in range(round(4 / STEP)):
        link.step(is_behind=False)
        most = max(most, link.under_way)
    assert 1.0 < most < 2.2  # 4 MB/s until the second ping has had no answer for 0.4 s
    assert link.under_way < 0.55


def test_a_client_that_keeps_up_is_pinged_seldom_and_bounded_by_nothing() -> None:
    link = Link(2e7, 0.1, flood=1e7)
    link.begin()
    for _ in range(round(10 / STEP)):
        link.step(is_behind=False)
        assert not link.window.is_full(link.now)
        assert link.window.transit(link.now) < 0.15
    assert 30 <= link.pings <= 42


def test_a_client_that_is_sent_little_is_pinged_once() -> None:
    window = met()
    for now in range(10):
        window.sent += 100
        assert not window.wants_ping(float(now), is_behind=False)


def test_a_client_that_does_not_answer_gets_nothing_more_after_a_while() -> None:
    window = met()
    window.sent += WRITE
    assert window.wants_ping(0.0, is_behind=False)
    window.asked(0.0)
    window.sent += 10**9
    assert not window.wants_ping(0.3, is_behind=False)
    assert not window.is_full(0.3)
    assert window.is_full(0.5)
    assert not window.is_stuck(0.5)
    window.answered(0.6)
    assert window.is_full(0.6)  # for what is behind the ping
    assert window.is_stuck(0.6)


def test_a_client_that_has_caught_up_is_bounded_no_more() -> None:
    link = Link(1e6, 0.01, flood=4e6)
    link.begin()
    link.run(5)
    assert link.window.is_full(link.now)
    link.run_idle(2)  # everything is read
    link.window.wants_ping(link.now, is_behind=False)
    link.window.sent += 10**9
    assert not link.window.is_full(link.now)


@pytest.mark.parametrize("answered", [0, 1])
def test_until_two_answers_or_without_any_how_long_it_takes_is_what_was_waited(
    answered: int,
) -> None:
    window = met()
    window.sent += WRITE
    window.wants_ping(0.0, is_behind=True)
    window.asked(0.0)
    if answered:
        window.answered(2.0)
        assert window.transit(2.5) == 2.0
        assert window.transit(3.5) == 0.0  # it is not known any more
    else:
        assert window.transit(2.5) == 2.5
        assert window.waited(2.5) == 2.5


def test_each_answer_is_a_sign_of_life_however_late() -> None:
    window = met()
    for now in (0.0, 1.0):
        window.sent += WRITE
        window.wants_ping(now, is_behind=True)
        window.asked(now)
    assert window.silent(9.0) == 9.0
    window.answered(9.0)
    assert (window.silent(12.0), window.waited(12.0)) == (3.0, 11.0)
    window.answered(12.0)
    assert window.silent(20.0) == 0


def test_a_window_that_is_full_has_a_ping_under_way_or_asks_for_one() -> None:
    window = met()
    assert window.wants_ping(0.0, is_behind=True)
    window.asked(0.0)
    window.sent += 3 * WRITE
    window.answered(3.0)  # it reads 64 KiB a second
    assert window.is_full(3.0)
    assert window.is_stuck(3.0)
    assert window.wants_ping(3.0, is_behind=True)
    window.asked(3.0)
    assert window.is_full(3.0)
    assert not window.is_stuck(3.0)


@for_all("seed", range(20))
def test_a_free_window_is_never_full_and_has_nothing_known_under_way(seed: int) -> None:
    steps = random.Random(seed)
    window, now, pings = SendWindow(), 0.0, 0
    was_free_again = False
    for _ in range(2000):
        now += steps.choice((0.001, 0.05, 0.3, 2.0))
        window.sent += steps.choice((100, 100_000))
        if window.wants_ping(now, is_behind=steps.random() < 0.05):
            window.asked(now)
            pings += 1
        if pings and steps.random() < 0.6:
            window.answered(now)
            pings -= 1
            was_free_again |= window.is_free
        if window.is_free:
            assert (pings, window.is_full(now), window.is_stuck(now)) == (0, False, False)
            assert window.transit(now) == 0
    assert was_free_again
