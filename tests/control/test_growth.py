"""What is done for one connection does not grow with what died beside it."""

from __future__ import annotations

import math
import tracemalloc
from collections.abc import Callable, Iterator
from functools import partial

import pytest
from tests.calls import calls_of
from tests.control.world import Plans, World

from uoarm import RobotManager
from uoarm._control.engine import actions as act
from uoarm._control.engine import events as ev
from uoarm._control.engine.state import State
from uoarm._control.engine.step import step
from uoarm._parts import LiveComponent, OfferedFunction
from uoarm._resolve import find_replacement
from uoarm.config import loads
from uoarm.errors import ResolutionError
from uoarm.model import (
    Component,
    FailoverPolicy,
    Health,
    OfferState,
    Plan,
    PortRef,
    Robot,
    ValidationMode,
)
from uoarm.testing import MemoryBridge, patience, wait

NAMES = tuple(f"camera{number}" for number in range(12))
HEAD = "version: 1\nbridges: {one: {plugin: memory}}\nfunctions:\n"
CAMERAS = f"{HEAD}  camera:\n    components:\n" + "".join(
    f"      - {{name: {name}, bridge: one, priority: {priority}, output: {{endpoint: [{name}]}}}}\n"
    for priority, name in enumerate(reversed(NAMES))
)
APART = HEAD + "".join(
    f"  {name}s:\n    components:\n"
    f"      - {{name: {name}, bridge: one, output: {{endpoint: [{name}]}}}}\n"
    for name in NAMES
)


class Counted:
    """Plans that count how often one is asked for."""

    def __init__(self) -> None:
        self.plans = Plans(CAMERAS)
        self.asked = 0

    def __call__(self, function: str, excluded: frozenset[str]) -> Plan:
        self.asked += 1
        return self.plans(function, excluded)


@pytest.mark.parametrize("dead", range(len(NAMES)))
def test_what_failed_longest_ago_takes_over_where_nothing_else_can(dead: int) -> None:
    """Of those that failed, in the order of their deaths, the first that is not excluded."""
    resolve = Counted()
    plan = resolve("camera", frozenset())
    failed = (*NAMES[6:], *NAMES[:6])
    found = find_replacement(plan, None, frozenset(failed[:dead]), failed, resolve)
    assert found.provider.component.name == failed[dead]
    assert resolve.asked <= 3 + math.ceil(math.log2(len(failed)))


def test_where_nothing_takes_over_the_number_of_deaths_costs_no_search() -> None:
    resolve = Counted()
    plan = resolve("camera", frozenset())
    with pytest.raises(ResolutionError):
        find_replacement(plan, None, frozenset(NAMES), NAMES, resolve)
    assert resolve.asked == 2


def test_a_bridge_that_dies_with_many_is_no_longer_a_list_in_each_connection() -> None:
    """A connection knows what it lost itself; the names that died are one value for all."""
    world = World(Plans(APART), FailoverPolicy(wait=10.0))
    sought: list[act.FindReplacement] = []
    keep = world._keep

    def kept(action: act.Action) -> None:
        if isinstance(action, act.FindReplacement):
            sought.append(action)
        keep(action)

    for name in NAMES:
        function = f"{name}s"
        plan, waiter = world.plans(function, frozenset()), f"request {name}"
        world.asked += (waiter,)
        world.post(
            ev.Requested(
                name,
                PortRef(function),
                ValidationMode.OFF,
                waiter,
                plan,
                has_callback=False,
                revision=0,
            )
        )
    world.settle()
    world._keep = kept  # type: ignore[method-assign]
    world.dead |= frozenset(NAMES)
    world.post(ev.HealthReported("one", Health.LOST, "it crashed"))
    records = world.state.connections.values()
    assert [record.move and len(record.move.lost) for record in records] == [1] * len(NAMES)
    assert len(sought) == len(NAMES)
    assert len({id(action.failed) for action in sought}) == 1


def side_by_side(count: int) -> str:
    """Return so many functions, half of them in a bridge of their own, each with a spare."""
    text = "version: 1\nbridges: {one: {plugin: memory}, two: {plugin: memory}}\nfunctions:\n"
    return text + "".join(
        f"  f{number}:\n    components:\n"
        f"      - {{name: a{number}, bridge: {'two' if number % 2 else 'one'}, priority: 1,"
        f" output: {{endpoint: [a{number}]}}}}\n"
        f"      - {{name: b{number}, bridge: one, output: {{endpoint: [b{number}]}}}}\n"
        for number in range(count)
    )


class Work:
    """Counts what the control plane does: calls, and octets that are held at once."""

    def __init__(self, plans: Plans) -> None:
        self.state = State(
            FailoverPolicy(wait=10.0), {item.name: item.bridge for item in plans.robot.components()}
        )
        self.plans = plans
        self.now = 0.0

    def request(self, identity: str, function: str) -> None:
        plan = self.plans(function, frozenset())
        waiter = f"request {identity}"
        self.play(
            ev.Requested(identity, PortRef(function), ValidationMode.OFF, waiter, plan),
        )

    def play(self, event: ev.Event) -> None:
        """Have an event handled, and all that follows from it, as if it were done at once."""
        events = [event]
        while events:
            self.state, actions = step(self.state, events.pop(0), self.now)
            for action in actions:
                following = self._done(action)
                if following is not None:
                    events.append(following)

    def _done(self, action: act.Action) -> ev.Event | None:
        match action:
            case act.Open():
                return ev.Opened(action.batch, action.parts)
            case act.Close(ends=True):
                return ev.Ended(action.connection)
            case act.Finish():
                return ev.RanOut(action.placement.user)
            case act.SwitchInputs():
                return ev.InputsSwitched(action.switchover)
            case act.FindReplacement():
                try:
                    plan = self.plans(action.plan.function, frozenset(self._may_not(action)))
                except ResolutionError as error:
                    return ev.ReplacementSought(
                        action.connection, action.attempt, None, str(error), action.switchover
                    )
                return ev.ReplacementSought(
                    action.connection, action.attempt, plan, switchover=action.switchover
                )
        return None

    def _may_not(self, action: act.FindReplacement) -> Iterator[str]:
        for component in self.plans.robot.functions[action.plan.function].components:
            if component.name in action.excluded or component.name in action.failed:
                yield component.name

    def of(self, what: Callable[[], object]) -> tuple[int, int]:
        """Return how many calls something takes, and how many octets at once."""
        tracemalloc.start()
        before = tracemalloc.get_traced_memory()[0]
        try:
            calls = calls_of(what)
        finally:
            peak = tracemalloc.get_traced_memory()[1] - before
            tracemalloc.stop()
        return calls, peak


def one_event_each(work: Work) -> None:
    """Request, kill, die, wait for the time and come back, of one connection beside others."""
    work.request("more", "f1")
    work.play(ev.Killed("more", "kill more"))
    work.play(ev.HealthReported("one", Health.LOST, "it was unplugged", "a0", "component"))
    work.now += 1.0
    work.play(ev.TimeReached())
    work.play(ev.HealthReported("one", Health.DEGRADED, "it is hot", "a2", "component"))
    work.play(ev.HealthReported("two", Health.FINISHED, "it was played", "a3", "component"))


@pytest.mark.parametrize("function", ["f{}", "f4"], ids=["apart", "all share one"])
def test_what_happens_to_one_connection_costs_the_same_beside_few_and_beside_many(
    function: str,
) -> None:
    spent = []
    for others in (40, 640):
        work = Work(Plans(side_by_side(others)))
        for number in range(others):
            work.request(f"c{number}", function.format(number))
        spent.append(work.of(lambda: one_event_each(work)))  # noqa: B023 - at once
    (few_calls, few_octets), (many_calls, many_octets) = spent
    assert many_calls <= 1.1 * few_calls
    assert many_octets <= 1.5 * few_octets


@pytest.mark.parametrize("function", ["f{}", "f1"], ids=["apart", "all share one"])
def test_what_happens_to_all_grows_with_their_number(function: str) -> None:
    spent = []
    for count in (40, 320):
        plans = Plans(side_by_side(count))
        work = Work(plans)

        def all_of_it() -> None:
            for number in range(count):  # noqa: B023 - at once
                work.request(f"c{number}", function.format(number))  # noqa: B023
            work.play(ev.HealthReported("two", Health.LOST, "it crashed"))  # noqa: B023
            bridges = work.state.bridges  # noqa: B023
            work.play(  # noqa: B023
                ev.Configured(
                    1,
                    "configure",
                    work.state.policy,  # noqa: B023
                    bridges,
                    frozenset(),
                    frozenset(plans.robot.functions),  # noqa: B023
                )
            )
            work.play(ev.Stopped("stop"))  # noqa: B023
            assert not work.state.connections  # noqa: B023

        spent.append(work.of(all_of_it)[0])
    assert spent[1] <= 8**1.1 * spent[0]


def begin_offers(work: Work, count: int) -> None:
    work.play(ev.OffersWanted(tuple(f"net:f{number}" for number in range(count)), frozenset()))


def open_offers(work: Work, cause: str = "") -> None:
    for record in tuple(work.state.offers.values()):
        work.play(ev.OfferOpened(record.name, record.number, cause))


def break_offers(work: Work) -> None:
    for record in tuple(work.state.offers.values()):
        work.play(ev.OfferReported(record.name, record.number, Health.LOST, "it fell over"))
    close_offers(work)


def close_offers(work: Work) -> None:
    for record in tuple(work.state.offers.values()):
        work.play(ev.OfferClosed(record.name, record.number))


def test_what_becomes_of_all_offers_grows_with_their_number() -> None:
    steps: list[list[int]] = []
    for count in (40, 320):
        work = Work(Plans(side_by_side(1)))
        spent = [
            work.of(partial(begin_offers, work, count))[0],
            work.of(partial(open_offers, work, "no"))[0],
            work.of(partial(work.play, ev.HealthReported("one", Health.OK, "", "a0")))[0],
        ]
        work.now += 1.0
        spent.append(work.of(partial(work.play, ev.TimeReached()))[0])
        spent += [
            work.of(partial(open_offers, work))[0],
            work.of(partial(break_offers, work))[0],
            work.of(partial(open_offers, work))[0],
            work.of(partial(work.play, ev.OffersWanted((), frozenset())))[0],
            work.of(partial(close_offers, work))[0],
        ]
        assert not work.state.offers
        steps.append(spent)
    for few, many in zip(*steps, strict=True):
        assert many <= 8**1.1 * few


def test_what_becomes_of_a_connection_concerns_the_offer_that_it_is_behind(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    looks: list[str] = []

    def note(offered: OfferedFunction) -> None:
        looks.append(offered.offer.function)

    bridge, net = MemoryBridge("one"), MemoryBridge("net")
    for name in NAMES:
        bridge.emitter(name, {"type": "integer"})
        net.taker(name, {"type": "integer"})
    offers = "".join(f"    {name}s: {{output: {{endpoint: [{name}]}}}}\n" for name in NAMES)
    text = APART.replace("plugin: memory}", "plugin: memory}, net: {plugin: memory}", 1)
    robot = loads(f"{text}offer:\n  net:\n{offers}")
    with RobotManager(robot, bridges={"one": bridge, "net": net}) as manager:
        assert {status.state for status in manager.offer(timeout=patience())} == {OfferState.OPEN}
        monkeypatch.setattr(OfferedFunction, "provider_changed", note)
        bridge.die(NAMES[3])
        wait(lambda: looks)
    assert set(looks) == {f"{NAMES[3]}s"}


def test_a_component_that_closes_looks_at_no_other_that_does(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    looks: list[str] = []

    def is_over(live: LiveComponent) -> bool:
        looks.append(live.component.name)
        return bool(original(live))

    original = vars(LiveComponent)["is_over"].fget
    monkeypatch.setattr(LiveComponent, "is_over", property(is_over))
    bridge = MemoryBridge("one")
    for name in NAMES:
        bridge.emitter(name, {"type": "integer"})
    with RobotManager(loads(APART), bridges={"one": bridge}) as robot:
        for name in NAMES:
            robot.request(f"{name}s")
    assert sorted(looks) == sorted(NAMES)


def test_structures_of_a_component_are_not_looked_for_among_all(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    looks = 0
    original = Robot.components

    def components(robot: Robot) -> Iterator[Component]:
        nonlocal looks
        for component in original(robot):
            looks += 1
            yield component

    bridge = MemoryBridge("one")
    for name in NAMES:
        bridge.emitter(name, {"type": "integer"})
    with RobotManager(loads(APART), bridges={"one": bridge}) as robot:
        monkeypatch.setattr(Robot, "components", components)
        for name in NAMES:
            assert list(robot.structures(name)) == ["output.default"]
    assert looks <= len(NAMES)
