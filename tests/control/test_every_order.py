"""Every order of events in a small world, as deep as there is time for."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import partial

import pytest
from hypothesis import note, settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, initialize, precondition, rule
from tests.control.world import FACE, NAME, OTHERS, Plans, World, discovered

from uoarm.model import ConnectionState, FailoverPolicy

PLANS = {"face": Plans(FACE), "name": Plans(NAME)}
CHANGED = {
    name: {text: Plans(change(text)) for text in (FACE, NAME)} for name, change in OTHERS.items()
}
BARE = {
    plans.text: plans
    for plans in (
        *PLANS.values(),
        *(item for changed in CHANGED.values() for item in changed.values()),
    )
}
SEEN = {text: Plans(discovered(text)) for text in BARE}
UNSEEN = {plans.text: BARE[text] for text, plans in SEEN.items()}
POLICIES = {
    "failover": FailoverPolicy(),
    "none": FailoverPolicy(enabled=False),
    "waits": FailoverPolicy(wait=1.0),
    "returns": FailoverPolicy(return_after=0.0, limit=100),
}
FUNCTIONS = ("face", "camera", "name")
Move = Callable[[World], None]


def moves(
    world: World, requests: int = 2, changes: int = 0, *, candidates: bool = False
) -> Iterator[tuple[str, Move]]:
    """Yield what may happen next, with so many requests and changes at most.

    With `candidates` a camera is discovered and is gone again, but not while it is in use.
    """
    yield from world.moves()
    if world.state.revision < changes and "stop" not in world.asked:
        for change, plans in CHANGED.items():
            new = plans[world.first.text]
            yield f"configure {change}", partial(_configure, plans=new)
        if world.state.revision:
            yield "configure back", partial(_configure, plans=world.first)
    if candidates and not world.state.configurers:
        if world.plans.text in SEEN:
            yield "see", lambda item: item.discover(SEEN[item.plans.text])
        elif "eye" not in {component.name for component in world.state.components.values()}:
            yield "unsee", lambda item: item.discover(UNSEEN[item.plans.text])
    made = sum(word.startswith("request") for word in world.asked)
    if made < requests:
        asked, function = f"c{made + 1}", FUNCTIONS[made % len(FUNCTIONS)]
        yield f"request {asked}", lambda item: item.request(asked, function)
    for identity in world.state.connections:
        yield f"kill {identity}", lambda one, i=identity: one.kill(i)  # type: ignore[misc]
    for name in world.state.bridges:
        if name in world.dead:
            yield f"revive {name}", lambda one, n=name: one.revive(n)  # type: ignore[misc]
        elif name in world.state.serving:
            yield f"die {name}", lambda one, n=name: one.die(n)  # type: ignore[misc]
            yield f"finish {name}", lambda one, n=name: one.finish(n)  # type: ignore[misc]
    if made == requests and "stop" not in world.asked:
        yield "stop", World.stop
    if world.wake_at is not None:
        yield "time", lambda item: item.pass_time(0.2)


def _configure(world: World, plans: Plans) -> None:
    """Change the configuration; what was discovered is there in the new one, too."""
    world.configure(SEEN[plans.text] if world.plans.text in UNSEEN else plans)


def explore(first: World, depth: int, most: int, *, candidates: bool = False) -> int:
    """Play every order of moves to a depth, breadth first; return how many worlds were seen."""
    seen = {first.key()}
    layer: list[tuple[World, tuple[str, ...]]] = [(first, ())]
    for _ in range(depth):
        following = []
        for world, path in layer:
            for name, move in moves(world, candidates=candidates):
                after, reports = world.copy(), (*path, name)
                with saying(reports):
                    move(after)
                key = after.key()
                if key in seen:
                    continue
                seen.add(key)
                with saying(reports):
                    at_rest = after.copy()
                    at_rest.settle()
                    at_rest.check_at_rest()
                following.append((after, reports))
                if len(seen) >= most:
                    return len(seen)
        layer = following
    return len(seen)


@contextmanager
def saying(path: tuple[str, ...]) -> Iterator[None]:
    """Show how a world was reached in which something does not hold."""
    try:
        yield
    except Exception as error:
        raise AssertionError(" | ".join(path)) from error


def worlds(few: int, many: int) -> pytest.MarkDecorator:
    """Run a test with a few worlds, and at length with many."""
    return pytest.mark.parametrize("most", [few, pytest.param(many, marks=pytest.mark.long)])


@worlds(300, 30_000)
@pytest.mark.parametrize("robot", PLANS)
@pytest.mark.parametrize("policy", POLICIES)
def test_whatever_the_order_nothing_is_left_open_or_unanswered(
    robot: str, policy: str, most: int
) -> None:
    first = World(PLANS[robot], POLICIES[policy])
    assert explore(first, depth=20, most=most) == most


@worlds(125, 2_500)
@pytest.mark.parametrize("change", CHANGED)
@pytest.mark.parametrize("robot", PLANS)
@pytest.mark.parametrize("policy", ["failover", "none", "waits"])
def test_whatever_the_order_a_change_of_configuration_ends_well(
    robot: str, policy: str, change: str, most: int
) -> None:
    first = World(PLANS[robot], POLICIES[policy])
    first.request("c1", "face")
    first.request("c2", "camera")
    for _ in range(8):  # one runs, the other is on its way
        first.do(next(iter(first.lanes)))
        if any(
            connection.state is ConnectionState.RUNNING
            for connection in first.state.connections.values()
        ):
            break
    first.configure(CHANGED[change][PLANS[robot].text])
    assert explore(first, depth=12, most=most) == most


@worlds(150, 3_000)
@pytest.mark.parametrize("robot", PLANS)
@pytest.mark.parametrize("policy", POLICIES)
def test_whatever_the_order_candidates_come_and_go(robot: str, policy: str, most: int) -> None:
    first = World(SEEN[PLANS[robot].text], POLICIES[policy])
    first.dead = frozenset({"best", "spare"})
    first.request("c1", "face")  # with the camera that was discovered
    assert explore(first, depth=12, most=most, candidates=True) == most


@pytest.mark.parametrize("robot", PLANS)
def test_what_began_with_a_spare_and_runs_on_the_best_comes_to_rest(robot: str) -> None:
    """Its preferred plan, the one that died first, is there again and is not the best one."""
    world = World(PLANS[robot], POLICIES["returns"])
    path = ("request c1", "do request c1", "request c2", "die best", "do request c2",
        "do request c2", "revive best", "die spare", "revive spare")  # fmt: skip
    for name in path:
        dict(moves(world))[name](world)
    world.settle()
    world.check_at_rest()


class Walk(RuleBasedStateMachine):
    """Moves that hypothesis chooses, many more of them than every order can have."""

    @initialize(robot=st.sampled_from(sorted(PLANS)), policy=st.sampled_from(sorted(POLICIES)))
    def begin(self, robot: str, policy: str) -> None:
        self.world = World(PLANS[robot], POLICIES[policy])

    @rule(trouble=st.integers(0, 9), choice=st.integers(0, 10_000))
    def move(self, trouble: int, choice: int) -> None:
        """Mostly, let what waits end well: else no walk gets far enough for a takeover."""
        there = list(moves(self.world, requests=12, changes=6, candidates=True))
        well = [pair for pair in there if pair[0].startswith("do ")]
        chosen = well if well and trouble < 7 else there
        if chosen:
            name, make = chosen[choice % len(chosen)]
            note(name)
            make(self.world)

    def teardown(self) -> None:
        if hasattr(self, "world"):
            self.world.settle()
            self.world.check_at_rest()


TestWalk = Walk.TestCase
TestWalk.settings = settings(stateful_step_count=60, max_examples=40)


def running(world: World) -> list[object]:
    """Return what the connections of a world have open, whatever numbers its parts have."""
    names = {number: component.name for number, component in world.state.components.items()}
    reports: list[object] = []
    for record in world.state.connections.values():
        placed = record.placement
        edges = [world.state.edges[number] for number in placed.edges]
        reports.append(
            (
                str(record.wanted),
                sorted(names[number] for number in placed.components.values()),
                sorted((edge.key, names[edge.producer], str(edge.edge)) for edge in edges),
            )
        )
    return reports


class Changes(RuleBasedStateMachine):
    """Requests, kills and changes of configuration in any order, finished or not."""

    @initialize(robot=st.sampled_from(sorted(PLANS)))
    def begin(self, robot: str) -> None:
        self.world = World(PLANS[robot], POLICIES["failover"])

    @rule(choice=st.integers(0, 10_000))
    def work(self, choice: int) -> None:
        there = [
            move
            for name, move in self.world.moves()
            if name.startswith(("do ", "late ")) and "fail" not in name
        ]
        if there:
            there[choice % len(there)](self.world)

    @precondition(lambda self: len(self.world.state.connections) < 4)
    @rule(function=st.sampled_from(FUNCTIONS))
    def ask(self, function: str) -> None:
        world = self.world
        if function in world.plans.robot.functions:
            world.request(f"c{len(world.asked)}", function)

    @precondition(lambda self: len(self.world.state.connections) > 2)
    @rule(choice=st.integers(0, 2))
    def kill(self, choice: int) -> None:
        self.world.kill(sorted(self.world.state.connections)[choice])

    @rule(change=st.sampled_from([*CHANGED, "back"]), is_awaited=st.booleans())
    def configure(self, change: str, *, is_awaited: bool) -> None:
        first = self.world.first
        self.world.configure(first if change == "back" else CHANGED[change][first.text])
        if is_awaited:
            self.compare()

    def compare(self) -> None:
        """Let all that is under way end, and compare what is open with a fresh start."""
        world = self.world
        world.settle()
        world.check_at_rest()
        fresh = World(world.plans, POLICIES["failover"])
        for record in world.state.connections.values():
            fresh.request(record.id, record.wanted.function)
        fresh.settle()
        assert running(world) == running(fresh)
        assert len(world.open) == len(fresh.open)

    def teardown(self) -> None:
        if hasattr(self, "world"):
            self.compare()


TestChanges = Changes.TestCase
TestChanges.settings = settings(stateful_step_count=20, max_examples=30)
