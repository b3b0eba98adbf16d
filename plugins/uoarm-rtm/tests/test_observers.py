"""Components that report their states are checked at once, and keep nothing of ours."""

from __future__ import annotations

import os
import threading
from typing import Any, cast

import pytest
from endpoints import Make, Start, of, source
from test_leftovers import holding
from tests.inbox import Inbox  # type: ignore[import-not-found]
from uoarm_rtm._observers import Observers

from uoarm.bridge import Bridge
from uoarm.model import Health, Role
from uoarm.testing import wait

NEVER = 3600.0  # between two checks that no component asks for


def observed(peer: Start, name: str) -> Any:
    component = peer(name)
    component.take_observers()
    component.activate()
    return component


def test_a_component_that_reports_its_failure_is_checked_at_once(
    make_bridge: Make, peer: Start
) -> None:
    component, events = observed(peer, "Worker"), Inbox()
    bridge = make_bridge(watch=NEVER)
    bridge.watch(events)
    channel = source(bridge, of("Worker", Role.OUTPUT, "out"), Inbox())
    wait(component.observers)
    [seen] = component.observers()
    assert seen["observed_status"] == "RTC_STATUS,EC_STATUS"
    assert seen["uoarm.process"].split("/")[1] == str(os.getpid())
    component.abort()
    assert events.event(Health.LOST, "it is in state ERROR").channel is channel
    bridge.close()
    assert component.observers() == []


def test_both_ends_of_a_native_link_report(make_bridge: Make, peer: Start) -> None:
    first, second, events = observed(peer, "From"), observed(peer, "Into"), Inbox()
    bridge = make_bridge(watch=NEVER)
    bridge.watch(events)
    at = of("Into", Role.INPUT, "in")
    assert bridge.link(of("From", Role.OUTPUT, "out"), at) is not None
    wait(lambda: first.observers() and second.observers())
    second.abort()
    assert events.event(Health.LOST, "it is in state ERROR").component == at.component


def test_an_observer_goes_with_the_last_channel(bridge: Bridge, peer: Start) -> None:
    component = observed(peer, "Worker")
    channels = [source(bridge, of("Worker", Role.OUTPUT, "out"), Inbox()) for _ in range(2)]
    wait(lambda: len(component.observers()) == 1)
    channels[0].close()
    channels[1].close()
    wait(lambda: not component.observers())
    assert component.asked_to_observe() == 1


@pytest.mark.parametrize("observe", [True, False])
def test_a_component_without_observers_is_checked(
    make_bridge: Make, peer: Start, observe: bool
) -> None:
    component, events = peer("Worker"), Inbox()
    component.take_observers(not observe)
    component.activate()
    bridge = make_bridge(observe=observe)
    bridge.watch(events)
    source(bridge, of("Worker", Role.OUTPUT, "out"), Inbox())
    if observe:
        wait(component.asked_to_observe)
    component.abort()
    events.event(Health.LOST, "it is in state ERROR")
    assert component.asked_to_observe() == int(observe)


def test_an_observer_of_a_killed_process_is_removed_by_the_next(
    nameserver: str, make_bridge: Make, peer: Start
) -> None:
    first, second = observed(peer, "From"), observed(peer, "Into")
    with holding(nameserver) as killed:
        wait(lambda: first.observers() and second.observers())
        killed.kill()
        killed.wait()
    source(make_bridge(observe=False), of("From", Role.OUTPUT, "out"), Inbox())
    assert first.observers() == second.observers() == []


def test_a_component_of_which_a_channel_opens_as_the_last_one_closed_is_observed_anew() -> None:
    observers = Observers(cast("Any", None), "rtm", 1.0, lambda _: None)
    entered = threading.Event()

    class Component:
        """Has no channel at the first look, and one from then on."""

        looks = 0

        @property
        def is_used(self) -> bool:
            self.looks += 1
            if self.looks == 1:
                opening.start()
                wait(lambda: entered.is_set() or observers._guard.locked())
            return self.looks > 1

    component: Any = Component()

    def enter() -> None:
        observers.enter(component)
        entered.set()

    opening = threading.Thread(target=enter)
    observers.enter(component)
    (check,) = observers.checks()
    component.looks = 0
    check()
    opening.join()
    assert observers.checks(), "it is to be asked to take an observer"
