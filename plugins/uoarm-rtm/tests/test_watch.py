"""When checks are made: one that hangs holds up no other, and none is made twice at once."""

from __future__ import annotations

import contextlib
import threading
from collections.abc import Iterator
from functools import partial
from itertools import pairwise

import pytest
from _uoarm_rtm_stubs import RTC
from endpoints import ANSWERS, HANGS_AFTER, Make, Start, checked, of, sink
from tests.inbox import Inbox  # type: ignore[import-not-found]
from uoarm_rtm._health import PortFault, PortStatus, blamed
from uoarm_rtm._peer import Connector
from uoarm_rtm._servants import Callbacks, ComponentLifecycle
from uoarm_rtm._watch import Check, CheckQueue, Ticker

from uoarm.errors import BridgeError
from uoarm.model import Health, Role
from uoarm.testing import Background, patience, wait


def causes(events: Inbox, words: str) -> set[str]:
    """The components, as the configuration has them, of which this is said."""
    return {
        event.component or event.channel.endpoint.component
        for event in events.messages
        if words in event.cause and not (event.component or "").endswith(".rtc")
    }


def test_a_component_that_dies_while_it_is_asked_is_gone(
    make_bridge: Make, peer: Start, monkeypatch: pytest.MonkeyPatch
) -> None:
    bridge, events = make_bridge(), Inbox()
    bridge.watch(events)
    mortal = peer("Mortal")
    mortal.activate()
    channel = sink(bridge, of("Mortal", Role.INPUT, "in"))
    alive = Connector.alive

    def alive_no_more(connector: Connector, end: int) -> bool:
        mortal.kill()  # it has just said that it is active
        return alive(connector, end)

    monkeypatch.setattr(Connector, "alive", alive_no_more)
    assert events.event(Health.LOST, "gone").channel is channel
    assert not causes(events, "has ended the connection")


def test_hung_components_hold_up_no_other(make_bridge: Make, peer: Start) -> None:
    bridge, events = make_bridge(), Inbox()
    bridge.watch(events)
    hung = [peer(f"Hung{number}") for number in range(3)]
    healthy, mortal = peer("Healthy"), peer("Mortal")
    channels = {}
    for component in (*hung, healthy, mortal):
        component.activate()
        channels[component.name] = sink(bridge, of(component.name, Role.INPUT, "in"))
        checked(bridge, f"{component.name}.rtc")
    for component in hung:
        component.freeze()
    for _ in range(2):  # in several rounds, of which the first asks those that hang
        for act, health, words in (
            (healthy.deactivate, Health.DEGRADED, "inactive"),
            (healthy.activate, Health.OK, "works again"),
        ):
            events.messages.clear()
            act()
            event = events.event(health, words)
            assert event.channel is channels["Healthy"]
            assert not causes(events, "it hangs")
    mortal.kill()
    events.event(Health.LOST, "gone")
    lost = events.event(Health.LOST, "component Mortal.rtc died: only its name is left")
    assert lost.component == "Mortal.rtc"
    appeared = peer("Later")
    assert events.event(Health.OK, "component Later.rtc appeared").component == "Later.rtc"
    appeared.end()
    assert events.event(Health.LOST, "component Later.rtc left").component == "Later.rtc"
    # All that while those that hang had not yet reached the limit of a call.
    assert not causes(events, "it hangs")


def test_several_hangs_are_reported_after_the_limit_of_one_call(
    make_bridge: Make, peer: Start
) -> None:
    bridge, events = make_bridge(call_timeout=HANGS_AFTER), Inbox()
    # The measure: a call that may take three times as long, or twice on a machine that is slow.
    other = make_bridge("other", watch=0, call_timeout=min(ANSWERS, 3 * HANGS_AFTER))
    bridge.watch(events)
    first = peer("From")
    first.activate()
    first.ask_the_other_port()  # so its port hangs, too, as long as that
    hung = [peer(f"Into{number}") for number in range(4)]
    for component in hung:
        component.activate()
        at = of(component.name, Role.INPUT, "in")
        assert bridge.link(of("From", Role.OUTPUT, "out"), at) is not None
        sink(bridge, at)
        checked(bridge, f"{component.name}.rtc")
    for component in hung:
        component.freeze()
    has_ended = threading.Event()

    def measure() -> None:
        with contextlib.suppress(BridgeError):
            other.describe(of("Into0", Role.INPUT, "in"))
        has_ended.set()

    measuring = Background(measure)
    names = {component.name for component in hung}
    wait(lambda: has_ended.is_set() or causes(events, "it hangs") == names)
    assert not has_ended.is_set(), f"{causes(events, 'it hangs')} of {names}"
    for component in hung:
        component.thaw()
    measuring.result()


class Clock:
    """Plays a queue of checks, each of which takes its time; notes which began when."""

    def __init__(self, queue: CheckQueue, takes: dict[Check, float]) -> None:
        self.now = 0.0
        self.queue = queue
        self.takes = takes
        self.began: list[tuple[float, Check]] = []
        self._ends: list[tuple[float, Check]] = []

    @property
    def running(self) -> int:
        return len(self._ends)

    def play(self, until: float) -> None:
        """Let time pass as a pool of threads does: what may begin does, and is looked at anew."""
        while True:
            while (check := self.queue.take(self.now)) is not None:
                self.began.append((self.now, check))
                check()
                self._ends.append((self.now + self.takes.get(check, 0.001), check))
            times = [time for time, _ in self._ends]
            wake_at = self.queue.wake_at(self.now)
            if wake_at is not None:
                assert wake_at > self.now, "a loop that turns for nothing"
                times.append(wake_at)
            self.now = min(times)
            if self.now > until:
                self.now = until
                return
            for end in [end for end in self._ends if end[0] <= self.now]:
                self._ends.remove(end)
                self.queue.done(end[1], self.now)

    def times(self, check: Check) -> list[float]:
        return [time for time, begun in self.began if begun is check]


def made(
    count: int, *, pause: float = 1.0, most: int = 32, **takes: float
) -> tuple[Clock, list[Check]]:
    """A queue with rounds of so many checks; `c3=2.0`: the one of that number takes so long."""
    checks: list[Check] = [named(number) for number in range(count)]

    def collect() -> None:
        queue.begin_round(checks)

    queue = CheckQueue(collect, pause, most)
    long = {checks[int(name[1:])]: seconds for name, seconds in takes.items()}
    return Clock(queue, long), checks


def named(number: int) -> Check:
    def check() -> None: ...

    check.__name__ = f"check {number}"
    return check


def test_checks_are_made_in_turn_one_at_a_time_with_a_pause_between_rounds() -> None:
    clock, checks = made(3)
    clock.play(2.5)
    assert [check for _, check in clock.began if check in checks] == 3 * checks
    assert [round(time, 3) for time in clock.times(checks[0])] == [0.001, 1.005, 2.009]
    assert clock.running == 0


def test_one_that_takes_long_holds_up_no_other_and_is_made_once_at_a_time() -> None:
    clock, checks = made(3, c0=5.0)
    clock.play(3.5)
    assert clock.times(checks[0]) == [0.001]
    assert [round(time, 3) for time in clock.times(checks[1])] == [0.021, 1.024, 2.027, 3.03]
    clock.play(6.2)
    assert len(clock.times(checks[0])) == 2


def test_what_hung_begins_after_the_others_and_takes_half_of_the_places() -> None:
    hung = {f"c{number}": 100.0 for number in range(10)}
    clock, checks = made(12, most=8, **hung)
    clock.play(99.0)
    assert clock.running == 8, "at first it is not known which hang"
    clock.play(202.0)
    assert clock.running == 4
    healthy = clock.times(checks[11])
    assert len([time for time in healthy if time > 202.0 - 20]) >= 15
    clock.takes.clear()
    clock.play(1000.0)
    for check in checks:
        assert len([time for time in clock.times(check) if time > 900]) >= 90


def test_a_request_is_met_at_once_and_once_more_and_no_flood_keeps_others_waiting() -> None:
    clock, checks = made(40, pause=1000.0)
    clock.play(0.5)
    before = len(clock.began)
    for _ in range(3):
        clock.queue.request(checks[7], clock.now)
    clock.play(2.0)
    assert [check for _, check in clock.began[before:]] == [checks[7]] * 2
    assert [round(time, 3) for time in clock.times(checks[7])[1:]] == [0.5, 0.521]
    clock, checks = made(40, pause=0.1)

    def flood() -> None:
        for check in checks[:5]:
            clock.queue.request(check, clock.now)

    for step in range(1, 200):
        clock.play(step / 100)
        flood()
    assert len(clock.times(checks[39])) > 5
    gaps = clock.times(checks[0])
    assert min(later - sooner for sooner, later in pairwise(gaps)) > 0


def test_a_request_during_a_check_is_met_after_it() -> None:
    clock, checks = made(1, pause=1000.0, c0=1.0)
    clock.play(0.5)
    clock.queue.request(checks[0], clock.now)
    clock.play(10.0)
    assert [round(time, 3) for time in clock.times(checks[0])] == [0.001, 1.021, 2.041]


def test_what_follows_a_check_comes_before_what_waits() -> None:
    clock, checks = made(2, pause=1000.0)
    follower = named(9)
    follow: Iterator[None] = iter([None])

    def first() -> None:
        if next(follow, 0) is None:
            clock.queue.follow(follower)

    checks.insert(0, first)
    clock.play(1.0)
    assert [check for _, check in clock.began][1:] == [first, follower, *checks[1:]]


def test_threads_are_as_many_as_checks_that_hang_and_end_after_them() -> None:
    free = threading.Event()
    count = [0]

    def hang() -> None:
        free.wait(patience())

    def rounds() -> list[Check]:
        return [*hanging, counted]

    def counted() -> None:
        count[0] += 1

    hanging: list[Check] = [partial(hang) for _ in range(3)]
    ticker = Ticker(rounds, 0.01)
    ticker.start()
    wait(lambda: watching() >= 4)
    now = count[0]
    wait(lambda: count[0] > now + 20)
    assert watching() <= 3 + 2
    free.set()
    wait(lambda: watching() <= 2, "threads that are not needed stay")
    ticker.close(patience())
    assert watching() == 0


def test_a_check_that_raises_hurts_no_other(caplog: pytest.LogCaptureFixture) -> None:
    seen = threading.Event()

    def broken() -> None:
        raise RuntimeError("broken")

    ticker = Ticker(lambda: [broken, seen.set], 0.01)
    ticker.start()
    assert seen.wait(patience())
    ticker.close(patience())
    assert "a check of OpenRTM failed" in caplog.text


def watching() -> int:
    return sum(thread.name == "uoarm-rtm-watch" for thread in threading.enumerate())


def status(fault: PortFault, asked_at: float = 1.0, wrong_at: float = 1.5) -> PortStatus:
    return PortStatus(fault, "", "", asked_at, wrong_at)


FINE, INACTIVE = status(PortFault.NONE), status(PortFault.INACTIVE)
FRESH = status(PortFault.NONE, asked_at=2.0)
ENDED, STUCK = status(PortFault.ENDED), status(PortFault.STUCK)
ENDED_TOO = status(PortFault.ENDED, asked_at=2.0, wrong_at=2.5)
GONE, HANGS, FAILED = (
    status(fault) for fault in (PortFault.GONE, PortFault.HANGS, PortFault.FAILED)
)


@pytest.mark.parametrize(
    ("statuses", "end"),
    [
        ((None, None), None),
        ((FINE, None), None),
        ((FINE, INACTIVE), None),
        ((None, GONE), 1),  # what is found of a component itself needs no other sign
        ((FAILED, FINE), 0),
        ((HANGS, None), 0),
        ((ENDED, None), None),  # the other one may be gone: it has not been asked yet,
        ((ENDED, FINE), None),  # or before this one had ended the connection
        ((ENDED, FRESH), 0),
        ((FRESH, ENDED), 1),
        ((ENDED, GONE), 1),
        ((STUCK, FINE), None),
        ((STUCK, HANGS), 1),
        ((STUCK, FRESH), 0),
        ((ENDED, ENDED), None),
        ((ENDED, ENDED_TOO), 0),
    ],
)
def test_the_surest_sign_says_which_end_is_to_blame(
    statuses: tuple[PortStatus | None, PortStatus | None], end: int | None
) -> None:
    assert blamed(statuses) == end


def test_what_a_callback_raises_is_written_within_bounds(caplog: pytest.LogCaptureFixture) -> None:
    def broken() -> None:
        raise RuntimeError("broken " * 100_000)

    lifecycle = ComponentLifecycle(Callbacks(activated=broken, aborting=broken))
    for _ in range(20):
        assert lifecycle.activate() == RTC.RTC_ERROR
        lifecycle.state = RTC.INACTIVE_STATE
    assert len(caplog.records) == 2
    assert len(caplog.text) < 20_000
    assert "a component's callback failed while it was aborting" in caplog.text
