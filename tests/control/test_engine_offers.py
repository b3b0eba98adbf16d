"""Offers as wants of the engine: when they open, close and are tried again, without a thread."""

from __future__ import annotations

from typing import TypeVar

import pytest
from attrs import define, field
from tests.control.event_log import read_event

from uoarm._control.engine import actions as act
from uoarm._control.engine import events as ev
from uoarm._control.engine.state import OfferRecord, State
from uoarm._control.engine.step import step
from uoarm.model import FailoverPolicy, Health, OfferState

A = TypeVar("A")


@define
class Offering:
    """A state with what was asked for and announced; an action waits until a test answers it."""

    state: State = field(factory=lambda: State(FailoverPolicy(), {"finder": "one"}))
    now: float = 0.0
    actions: list[act.Action] = field(factory=list)

    def post(self, event: ev.Event) -> None:
        self.state, actions = step(self.state, event, self.now)
        self.actions += actions
        offers = self.state.offers.values()
        assert set(self.state.due) == {item.name for item in offers if item.retry_at is not None}
        assert set(self.state.leaving) == {item.name for item in offers if not item.is_wanted}

    def want(self, *names: str, replaced: frozenset[str] = frozenset()) -> None:
        self.post(ev.OffersWanted(names, replaced))

    def taken(self, kind: type[A]) -> A:
        """Return the only action of a kind that was asked for since the last look."""
        (found,) = [action for action in self.actions if isinstance(action, kind)]
        self.actions.clear()
        return found

    def are_left_alone(self) -> bool:
        return not any(isinstance(item, act.OpenOffer | act.CloseOffer) for item in self.actions)

    def announced(self) -> list[str]:
        return [action.change for action in self.actions if isinstance(action, act.Announce)]

    def opened(self, cause: str = "") -> act.OpenOffer:
        action = self.taken(act.OpenOffer)
        self.post(ev.OfferOpened(action.name, action.number, cause))
        return action

    def closed(self) -> None:
        action = self.taken(act.CloseOffer)
        self.post(ev.OfferClosed(action.name, action.number))

    def report(self, action: act.OpenOffer, health: Health = Health.LOST, cause: str = "") -> None:
        self.post(ev.OfferReported(action.name, action.number, health, cause))

    def pass_time(self, seconds: float) -> None:
        self.now += seconds
        self.post(ev.TimeReached())

    @property
    def only(self) -> OfferRecord:
        (record,) = self.state.offers.values()
        return record


def test_pauses_grow_to_half_a_minute() -> None:
    there, pauses = Offering(), []
    there.want("net:camera")
    for _ in range(8):
        there.opened("no")
        assert (there.only.state, there.only.cause) == (OfferState.FAILED, "no")
        pauses.append(there.taken(act.WakeAt).time - there.now)
        there.pass_time(pauses[-1])
    assert pauses == [1, 2, 4, 8, 16, 30, 30, 30]


def test_it_is_not_opened_before_its_time_and_says_again_when_that_is() -> None:
    there = Offering()
    there.want("net:camera")
    there.opened("no")
    there.taken(act.WakeAt)
    there.pass_time(0.5)
    assert there.taken(act.WakeAt).time == 1.0


def test_what_breaks_again_and_again_is_opened_with_pauses() -> None:
    there, opened = Offering(), []
    there.want("net:camera")
    for _ in range(20):
        if not there.are_left_alone():
            opened.append(there.now)
            there.report(there.opened(), cause="it fell over")
            there.closed()
        there.pass_time(1.0)
    assert opened == [0, 1, 2, 4, 8, 16]


def test_what_has_lasted_is_opened_at_once_however_often_it_failed_before() -> None:
    there = Offering()
    there.want("net:camera")
    for _ in range(3):
        there.opened("no")
        there.pass_time(30.0)
    action = there.opened()
    there.pass_time(30.0)
    there.report(action)
    there.closed()
    there.opened()
    assert there.only.state is OfferState.OPEN


def test_what_is_well_again_has_it_tried_but_not_without_any_pause() -> None:
    there = Offering()
    there.want("net:camera")
    there.opened("no")
    there.taken(act.WakeAt)
    well = ev.HealthReported("one", Health.OK, "it was started again")
    there.post(well)
    assert there.are_left_alone()
    assert there.taken(act.WakeAt).time == 0.1
    there.pass_time(0.1)
    there.opened("no")
    there.pass_time(0.2)
    there.actions.clear()
    there.post(well)
    there.opened()
    assert there.only.state is OfferState.OPEN


def test_what_is_unwanted_while_it_opens_is_closed_when_it_has_opened() -> None:
    there = Offering()
    there.want("net:camera")
    action = there.taken(act.OpenOffer)
    there.want()
    assert there.are_left_alone()
    there.post(ev.OfferOpened(action.name, action.number))
    assert there.only.state is OfferState.OPEN
    there.closed()
    assert there.announced() == ["closed"]
    assert not there.state.offers


def test_what_broke_while_it_opened_is_closed_and_opened_again_under_another_number() -> None:
    there = Offering()
    there.want("net:camera")
    first = there.taken(act.OpenOffer)
    there.report(first, cause="it fell over")
    assert there.are_left_alone()
    there.post(ev.OfferOpened(first.name, first.number))
    there.closed()
    second = there.opened()
    assert second.number != first.number
    there.report(first)
    there.post(ev.OfferClosed(first.name, first.number))
    assert there.are_left_alone()  # late reports of the first are about nothing that is there


def test_what_has_finished_stays_closed_whatever_is_well_again() -> None:
    there = Offering()
    there.want("net:camera")
    there.report(there.opened(), Health.FINISHED, "the film is over")
    there.closed()
    assert (there.only.state, there.only.cause) == (OfferState.FINISHED, "the film is over")
    there.post(ev.HealthReported("one", Health.OK, "it was started again"))
    there.pass_time(100.0)
    assert there.are_left_alone()


def test_what_a_bridge_says_of_an_open_one_is_shown_and_taken_back() -> None:
    there = Offering()
    there.want("net:camera")
    action = there.opened()
    there.report(action, Health.DEGRADED, "it is slow")
    assert there.only.cause == "it is slow"
    there.report(action, Health.OK)
    assert there.only.cause == ""
    assert there.announced() == ["open", "degraded", "ok"]


@pytest.mark.parametrize("is_slow", [False, True])
def test_what_is_new_opens_after_what_is_offered_no_more_has_closed(*, is_slow: bool) -> None:
    there = Offering()
    there.want("net:camera")
    there.opened()
    there.want("net:arm")
    assert [type(action) for action in there.actions if isinstance(action, act.OpenOffer)] == []
    if is_slow:
        there.taken(act.CloseOffer)
        there.pass_time(5.0)
    else:
        there.closed()
    assert there.opened().name == "net:arm"


def test_what_is_offered_otherwise_is_closed_and_begins_anew() -> None:
    there = Offering()
    there.want("net:camera")
    there.opened("no")
    there.want("net:camera", replaced=frozenset({"net:camera"}))
    action = there.opened()
    there.actions.clear()
    there.want("net:camera", replaced=frozenset({"net:camera"}))
    there.closed()
    assert there.only.failures == 0
    assert there.opened().number != action.number


def test_what_is_wanted_again_while_it_closes_is_opened_again() -> None:
    there = Offering()
    there.want("net:camera")
    there.opened()
    there.want()
    closing = there.taken(act.CloseOffer)
    there.want("net:camera")
    there.post(ev.OfferClosed(closing.name, closing.number))
    there.opened()
    assert there.only.is_wanted


def test_offers_in_a_log_are_read_back() -> None:
    for event in (
        ev.OffersWanted(("net:camera", "net:arm"), frozenset({"net:arm"})),
        ev.OfferOpened("net:arm", 3, "no"),
        ev.OfferClosed("net:arm", 3),
        ev.OfferReported("net:arm", 3, Health.LOST, "it fell over"),
    ):
        line = ev.write_event(event, 1.5)
        assert read_event(line, lambda *_: pytest.fail("there is no plan")) == (event, 1.5)
