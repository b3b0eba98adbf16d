"""What waits for a busy loop: worked off after a delay, let go of where it stands."""

from __future__ import annotations

import asyncio
import itertools
import threading
from collections import deque
from collections.abc import Callable

import pytest
from attrs import define, field
from hypothesis import example, given
from hypothesis import strategies as st
from tests.server.conftest import Serve
from tests.server.robot import script
from tests.server.serving import url
from tests.server.talk import Talk, eventually

from uoarm.model import message_octets
from uoarm.server import Limits
from uoarm.server.streams import _feed, _feed_registry
from uoarm.server.streams._feed import Encoder, Envelope, Feed, FeedBacklog
from uoarm.server.streams._workers import LoopMailbox
from uoarm.testing import patience

FRESH = 16
LATE = 0.1
PATIENCE = 1.0


@define
class Path:
    """A source, and a loop that gets to one message after the other; times in seconds."""

    every: float
    now: float = 0.0
    waiting: deque[float] = field(factory=deque)
    backlog: FeedBacklog = field(factory=FeedBacklog)
    ages: list[float] = field(factory=list)
    lost: list[float] = field(factory=list)
    _due: float = 0.0

    def run(self, seconds: float, each: float) -> None:
        """Hand out for so long; each message takes so long."""
        end = self.now + seconds
        while self.now < end:
            self._come()
            if not self.waiting:
                self.now = max(self.now, self._due)
                continue
            left = len(self.waiting)
            came = self.waiting.popleft()
            if self.backlog.lets_go(left, came, self.now):
                assert left > FRESH
                assert self.now - came > LATE
                self.lost.append(self.now)
            else:
                self.ages.append(self.now - came)
                self.now += each
            if not self.waiting:
                self.backlog.worked_off()

    def stand_still(self, seconds: float) -> None:
        self.now += seconds

    def _come(self) -> None:
        while self._due <= self.now:
            self.waiting.append(self._due)
            self._due += self.every


@given(
    st.sampled_from([0.0002, 0.001, 0.01, 0.03]),
    st.lists(st.floats(0.0, 0.45), min_size=1, max_size=5),
)
def test_a_delay_that_is_worked_off_within_a_second_costs_nothing(
    every: float, delays: list[float]
) -> None:
    path = Path(every)
    for delay in delays:
        path.run(0.5, every / 4)
        path.stand_still(delay)
    path.run(2.0, every / 4)
    assert not path.lost


@given(st.sampled_from([0.001, 0.01, 0.03]), st.floats(1.0, 3.0), st.floats(0.2, 3.0))
def test_a_loop_that_just_keeps_up_or_less_gets_what_is_new(
    every: float, slower: float, delay: float
) -> None:
    """Without letting go all would be as late as the one delay was, and later."""
    path = Path(every)
    path.run(0.5, every / 4)
    path.stand_still(delay)
    path.run(2 * PATIENCE, every * slower)
    path.ages.clear()
    path.run(5.0, every * slower)
    each = every * slower
    assert max(path.ages) <= max(LATE, FRESH * each) + 2 * each


def test_once_nothing_waits_a_new_delay_has_its_second() -> None:
    path = Path(0.01)
    path.stand_still(2.0)
    path.run(0.5, 0.001)
    lost = len(path.lost)
    assert lost == 200 - FRESH
    path.stand_still(0.8)
    path.run(0.5, 0.001)
    assert len(path.lost) == lost


def is_let_go(looks: list[tuple[float, int, float]]) -> bool:
    """Say whether the last of these looks (time, waiting, age) finds what is to be let go of.

    It is late; and since nothing waited there was a look at what was late, and one a second after
    that had come, and none between them that found what was not.
    """
    _, waiting, age = looks[-1]
    begun = max((place for place, look in enumerate(looks) if not look[1]), default=-1) + 1
    many = [look for look in looks[begun:] if look[1] > FRESH]
    stood = any(
        later[0] - (first[0] - first[2]) >= PATIENCE
        and all(pair[2] > LATE for pair in many if first[0] <= pair[0] <= later[0])
        for first, later in itertools.combinations_with_replacement(many, 2)
    )
    return waiting > FRESH and age > LATE and stood


def test_every_order_of_looks_lets_go_of_what_stood_for_a_second_and_is_late() -> None:
    kinds = (0, 0.0), (FRESH, 0.75), (FRESH + 1, 0.05), (FRESH + 1, 0.25), (FRESH + 1, 1.5)
    for chosen in itertools.product(kinds, repeat=6):
        backlog, looks = FeedBacklog(), list[tuple[float, int, float]]()
        for place, (waiting, age) in enumerate(chosen):
            now = place / 2
            looks.append((now, waiting, age))
            if waiting:
                assert backlog.lets_go(waiting, now - age, now) == is_let_go(looks), looks
            else:
                backlog.worked_off()


@define(eq=False)
class Reader:
    """Takes down what it is handed, and what it missed."""

    took: list[int] = field(factory=list)
    lost: int = 0

    def miss(self) -> None:
        self.lost += 1

    def offer(self, envelope: Envelope) -> None:
        self.took.append(envelope.number)

    def ended(self, state: str, cause: str) -> None:
        self.took.append(-1)


class Clock:
    now = 0.0

    def __call__(self) -> float:
        return self.now


def work(act: Callable[[Feed, Clock], None], limits: Limits = Limits()) -> None:  # noqa: B008
    async def run() -> None:
        clock = Clock()
        feed = Feed(LoopMailbox(asyncio.get_running_loop()), limits, Encoder(), clock)
        act(feed, clock)
        feed.encoder.close()

    asyncio.run(run())


def test_who_wants_all_gets_what_the_others_miss() -> None:
    def act(feed: Feed, clock: Clock) -> None:
        new, every = Reader(), Reader()
        feed.add(new, missed=new.miss)
        feed.add(every)
        for number in range(100):
            clock.now = number / 100
            feed.take(number)
        clock.now = 5.0
        feed.finish("closed", "kill")
        assert every.took == [*range(1, 101), -1]
        assert new.took == [*range(85, 101), -1]
        assert new.lost == 100 - FRESH
        assert (every.lost, feed.lost) == (0, 0)

    work(act)


@pytest.mark.parametrize(
    "limits", [Limits(feed_messages=20), Limits(feed_bytes=20 * message_octets(bytes(1000)))]
)
def test_what_waits_for_the_loop_is_bounded_in_number_and_in_memory(
    limits: Limits, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(_feed, "_TURN_SECONDS", patience())  # all of it in one turn

    def act(feed: Feed, clock: Clock) -> None:
        reader = Reader()
        feed.add(reader)
        for _ in range(2):  # what was handed out or lost makes room
            for _ in range(64):
                feed.take(bytes(1000))
            feed.finish("closed", "kill") if feed.number > 64 else feed._hand_out()
        assert reader.took == [*range(45, 65), *range(109, 129), -1]
        assert feed.lost == 2 * (64 - 20)

    work(act, limits)


STEPS = st.lists(st.sampled_from([*range(0, 300_000, 70_000), 2_000_000, None]), max_size=200)


@given(STEPS)
@example([2_000_000, *[0] * FRESH])  # the first that is counted comes between two multiples of 16
def test_whatever_is_taken_is_handed_out_in_order_or_counted_as_lost(
    steps: list[int | None],
) -> None:
    most = 1_000_000

    def act(feed: Feed, clock: Clock) -> None:
        reader = Reader()
        feed.add(reader)
        for step in steps:
            if step is None:
                feed._hand_out()
            else:
                feed.take(bytes(step))
                assert feed._waiting[-1].number == feed.number
                held = [envelope.message_octets for envelope in feed._waiting]
                assert sum(held[:-FRESH]) <= most
                if feed.number % FRESH == 0:
                    assert sum(held) <= most or len(held) <= FRESH
        feed.finish("closed", "kill")
        assert reader.took == [*sorted(reader.took[:-1]), -1]
        assert feed.lost + len(reader.took) - 1 == feed.number

    work(act, Limits(feed_bytes=most))


def test_what_is_lost_as_the_loop_comes_for_it_is_no_error(monkeypatch: pytest.MonkeyPatch) -> None:
    def act(feed: Feed, clock: Clock) -> None:
        feed.add(reader := Reader())
        with monkeypatch.context() as patched:
            patched.setattr(Feed, "_can_hand", lambda _: True)  # as it looked a moment before
            feed._hand_next()
        feed.take(1)
        feed.finish("closed", "kill")
        assert reader.took == [1, -1]

    work(act)


def test_what_waited_for_the_first_listener_was_not_late() -> None:
    """Such as latched messages, which come before the client has its reply."""

    def act(feed: Feed, clock: Clock) -> None:
        for number in range(100):
            feed.take(number)
        clock.now = 5.0
        new = Reader()
        feed.add(new, missed=new.miss)
        feed.finish("closed", "kill")
        assert new.took == [*range(1, 101), -1]

    work(act)


@pytest.mark.parametrize(
    ("queue", "loses"),
    [(None, True), ({"length": 500}, False), ({"length": 500, "age": 60}, False)],
)
def test_a_client_that_named_a_queue_loses_nothing_while_the_loop_is_busy(
    serve: Serve, monkeypatch: pytest.MonkeyPatch, queue: dict[str, object] | None, *, loses: bool
) -> None:
    clock, feeds, gate = Clock(), list[Feed](), threading.Event()
    mailboxes: list[LoopMailbox] = []

    def make(mailbox: LoopMailbox, limits: Limits, encoder: Encoder) -> Feed:
        mailboxes.append(mailbox)
        feeds.append(Feed(mailbox, limits, encoder, clock))
        return feeds[-1]

    def busy() -> None:
        gate.wait(patience())

    monkeypatch.setattr(_feed_registry, "Feed", make)
    with Talk(url(serve()), binary=True) as client:
        client.open("picture", **({} if queue is None else {"queue": queue}))
        mailboxes[0].put(busy)
        script.put(*[{"width": 1, "data": b""}] * 100)
        eventually(lambda: feeds[0].number == 100, "all have come")
        clock.now = 5.0
        gate.set()

        def own() -> dict[str, int]:
            counters: dict[str, int] = client.ask("Status")["own"][0]
            return counters

        eventually(lambda: own()["sent"] + own()["dropped"] == 100, "all are accounted for")
        lost = own()["dropped"]
        assert lost == (100 - FRESH if loses else 0)
