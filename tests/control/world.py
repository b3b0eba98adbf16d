"""A world without threads in which the control plane acts: whatever may happen next is a move.

Every action of `step` waits here until a move does it, well or badly. What is open is kept, and
what must always hold is checked after each move.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Collection, Hashable, Iterator, Mapping
from typing import Any

from attrs import evolve
from rpds import HashTrieMap

from uoarm._adapt import check_edge
from uoarm._control.engine import actions as act
from uoarm._control.engine import events as ev
from uoarm._control.engine.draft import connection_of
from uoarm._control.engine.move import MovePhase, MoveReason
from uoarm._control.engine.placement import Kind, Part, Parts, Placement
from uoarm._control.engine.state import ConnectionRecord, State
from uoarm._control.engine.step import difference, step
from uoarm._resolve import Resolver, StructureCache, find_replacement
from uoarm.config import compare, loads
from uoarm.errors import BridgeError, ResolutionError
from uoarm.model import (
    Component,
    ConnectionState,
    FailoverPolicy,
    Health,
    Input,
    Output,
    Plan,
    PortRef,
    ValidationMode,
)
from uoarm.testing import MemoryBridge

NUMBER: Any = {"type": "integer"}
FACE = """
version: 1
bridges: {one: {plugin: memory}, two: {plugin: memory}}
functions:
  camera:
    components:
      - {name: best, bridge: one, priority: 2, output: {endpoint: [best]}}
      - {name: spare, bridge: two, priority: 1, output: {endpoint: [spare]}}
  face:
    components:
      - {name: finder, bridge: two, input: {from: camera, endpoint: [finder]},
         output: {endpoint: [finder]}}
"""
NAME = """
version: 1
bridges: {one: {plugin: memory}, two: {plugin: memory}}
functions:
  camera:
    components:
      - {name: best, bridge: one, priority: 2, output: {endpoint: [best]}}
      - {name: spare, bridge: two, priority: 1, output: {endpoint: [spare]}}
  face:
    components:
      - name: finder
        bridge: two
        priority: 2
        input:
          {from: camera, endpoint: [finder], lifetime: 5, stop: {message: 0}, meaning: stated}
        output: {endpoint: [finder]}
      - {name: second, bridge: one, priority: 1, input: {from: camera, endpoint: [second]},
         output: {endpoint: [second]}}
  name:
    components:
      - {name: namer, bridge: one, output: {endpoint: [namer]},
         inputs: {face: {from: face, endpoint: [namer]}, view: {from: camera, endpoint: [viewer]}}}
"""
PORTS = """
version: 1
bridges: {one: {plugin: memory}, two: {plugin: memory}}
functions:
  camera:
    components:
      - name: best
        bridge: one
        outputs: {picture: {endpoint: [picture]}, mask: {endpoint: [mask]}}
  drive:
    components:
      - {name: wheels, bridge: two, priority: 2, input: {endpoint: [wheels]}}
      - {name: tracks, bridge: one, priority: 1, input: {endpoint: [tracks]}}
  mark:
    components:
      - {name: marker, bridge: two, output: {endpoint: [marker]},
         inputs: {colour: {endpoint: [colour]},
                  view: {from: camera.picture, endpoint: [view]},
                  mask: {from: camera.mask, endpoint: [masked]}}}
"""
OTHERS: Mapping[str, Callable[[str], str]] = {
    "another camera": lambda text: text.replace("endpoint: [best]", "endpoint: [better]"),
    "another order": lambda text: text.replace("priority: 2", "priority: 0"),
    "no spare": lambda text: "\n".join(line for line in text.splitlines() if "spare" not in line),
    "another bridge": lambda text: text.replace("two: {plugin: memory}", "two: {plugin: memory2}"),
    "a new name": lambda text: text.replace("name: finder", "name: detector"),
}
"""What a configuration is changed to."""
_EYE = "      - {name: eye, bridge: one, priority: 0, output: {endpoint: [eye]}}\n"


def discovered(text: str) -> str:
    """Return a configuration with a camera that was discovered, behind those that are named."""
    return text.replace("  face:\n", f"{_EYE}  face:\n", 1)


def desired(state: State) -> frozenset[Part]:
    """Return what should be open: the plans that run or are to, and components that drain.

    What was lost is among it until its connection moves or ends: its losses are counted then. The
    tables of the state say who uses what of this.
    """
    plans = (plan for record in state.connections.values() for plan in record.plans)
    parts = {part for plan in plans for part in plan.parts}
    # Of a plan that was replaced the edges are closed at once, the components when all has arrived.
    ending = (plan.placement.components.values() for plan in state.draining.values())
    return frozenset(parts.union(Part(Kind.COMPONENT, id_) for ids in ending for id_ in ids))


class Plans:
    """What the resolver would find, for each set of components that it may not use."""

    def __init__(self, text: str) -> None:
        self.text = text
        self.robot = loads(text)
        bridges = {name: MemoryBridge(name, {}) for name in self.robot.bridges}
        for component in self.robot.components():
            ports: tuple[Input | Output, ...] = (*component.inputs, *component.outputs)
            for name in {port.endpoint.address[0] for port in ports}:
                bridges[component.bridge].loop(name, NUMBER)  # an emitter is one that takes nothing
        self._resolver = Resolver(self.robot, StructureCache(bridges.__getitem__), check_edge)
        self._found: dict[tuple[str, frozenset[str]], Plan | ResolutionError] = {}

    def __call__(self, function: str, excluded: frozenset[str]) -> Plan:
        key = function, excluded
        if key not in self._found:
            try:
                self._found[key] = self._resolver.resolve(function, excluded=excluded)
            except ResolutionError as error:
                self._found[key] = error
        found = self._found[key]
        if isinstance(found, Plan):
            return found
        raise found


class World:
    """One state, what waits to be done, and what is open.

    Args:
        plans: of the robot.
        policy: for failover.
    """

    def __init__(self, plans: Plans, policy: FailoverPolicy) -> None:
        self.plans = plans
        bridges = {item.name: item.bridge for item in plans.robot.components()}
        self.state = State(policy, bridges)
        self.now = 0.0
        self.lanes: dict[str, tuple[act.CallAction, ...]] = {}
        self.dead: frozenset[str] = frozenset()
        self.open: frozenset[Part] = frozenset()
        self.cancelled: frozenset[int] = frozenset()
        self.replies: tuple[str, ...] = ()
        self.asked: tuple[str, ...] = ()
        self.handed: tuple[tuple[str, tuple[str, ...]], ...] = ()
        self.wake_at: float | None = None
        self.first = self.before = self.next = plans
        self.earlier: Plans | None = None  # with the candidates before, in the same revision
        self.seen: frozenset[Component] = frozenset()
        self._texts: dict[int, tuple[object, Hashable]] = {}

    def copy(self) -> World:
        """Return a world that goes its own way from here; all that it holds is immutable."""
        made = World.__new__(World)
        made.__dict__.update(self.__dict__)
        made.lanes = dict(self.lanes)
        return made

    def post(self, event: ev.Event) -> None:
        """Give an event to the control plane, and keep what it asks for."""
        self.state, actions = step(self.state, event, self.now)
        for action in actions:
            self._keep(action)
        self.check()

    # What applications and bridges may do.

    def request(self, identity: str, function: str) -> None:
        """Ask for a function."""
        self.asked += (f"request {identity}",)
        wanted = PortRef(function, None)
        self.post(ev.Requested(identity, wanted, ValidationMode.OFF, f"request {identity}"))

    def kill(self, identity: str) -> None:
        """End a connection, or ask for it once more."""
        waiter = f"kill {identity} {len(self.asked)}"
        self.asked += (waiter,)
        self.post(ev.Killed(identity, waiter))

    def stop(self) -> None:
        """Close the manager."""
        self.asked += ("stop",)
        self.post(ev.Stopped("stop"))

    def die(self, name: str) -> None:
        """Let a component die."""
        self.dead |= {name}
        self._report(name, Health.LOST)

    def revive(self, name: str) -> None:
        """Let a component be there again, without an event."""
        self.dead -= {name}

    def finish(self, name: str) -> None:
        """Let a component have played all that it has."""
        self._report(name, Health.FINISHED)

    def configure(self, plans: Plans) -> None:
        """Change the configuration."""
        waiter = f"configure {len(self.asked)}"
        self.asked += (waiter,)
        self.next = plans
        found = compare(self.plans.robot, plans.robot)
        bridges = {item.name: item.bridge for item in plans.robot.components()}
        self.dead &= frozenset(bridges)
        self.post(
            ev.Configured(
                self.state.revision + 1,
                waiter,
                self.state.policy,
                bridges,
                found.superseded,
                found.functions,
            )
        )

    def discover(self, plans: Plans) -> None:
        """Have other candidates in the same configuration."""
        every = {
            component.name: component.bridge
            for robot in (self.plans.robot, plans.robot)
            for component in robot.components()
        }
        # What is in use goes on as it runs; nothing else of the candidates before may be opened.
        used = {instance.name for instance in self.state.components.values()}
        in_use = (item for item in self.plans.robot.components() if item.name in used)
        self.seen |= {evolve(component, priority=0) for component in in_use}
        superseded = compare(self.plans.robot, plans.robot).superseded - used
        number = self.state.candidates + 1
        self.post(ev.CandidatesChanged(every, "so it is", number, superseded))
        self.earlier, self.plans = self.plans, plans

    def pass_time(self, seconds: float) -> None:
        """Let time pass."""
        self.now += seconds
        self.wake_at = None
        self.post(ev.TimeReached())

    # What becomes of actions.

    def do(
        self,
        lane: str,
        *,
        fails_at: int | None = None,
        is_late: bool = False,
        is_old: bool = False,
    ) -> None:
        """Do the next action of a lane.

        Args:
            is_late: whether a search was made with the configuration before.
            is_old: whether it was made with the candidates before.
            lane: its name.
            fails_at: of an opening: the number of the part that cannot be opened; of any other
                action that can fail: not None lets it fail.
        """
        action, *rest = self.lanes.pop(lane)
        if rest:
            self.lanes[lane] = tuple(rest)
        if is_late:
            assert isinstance(action, act.Resolve)
            event: ev.Event | None = self._resolve(action, self.before, self.state.revision - 1)
        elif is_old:
            event = self._do_old(action)
        else:
            event = self._do(action, fails_at)
        if event is not None:
            self.post(event)

    def moves(self) -> Iterator[tuple[str, Callable[[World], None]]]:
        """Yield every way in which a waiting action can come to its end, by a name."""
        for lane, actions in self.lanes.items():
            yield f"do {lane}", lambda world, lane=lane: world.do(lane)  # type: ignore[misc]
            first = actions[0]
            if self.earlier is not None and isinstance(first, act.Resolve | act.FindReplacement):
                yield f"old {lane}", lambda world, lane=lane: world.do(lane, is_old=True)  # type: ignore[misc]
            if isinstance(first, act.Open):
                for at in range(len(first.parts)):
                    yield (
                        f"fail {lane} at {at}",
                        lambda world, lane=lane, at=at: world.do(lane, fails_at=at),  # type: ignore[misc]
                    )
            elif isinstance(first, act.Resolve):
                if self.state.revision:
                    yield f"late {lane}", lambda world, lane=lane: world.do(lane, is_late=True)  # type: ignore[misc]
            elif isinstance(first, act.SwitchInputs):
                yield f"fail {lane}", lambda world, lane=lane: world.do(lane, fails_at=0)  # type: ignore[misc]

    def settle(self) -> None:
        """Do all that waits, well, and let time pass until nothing is left to be done."""
        for _ in range(200):
            if self.lanes:
                self.do(next(iter(self.lanes)))
            elif self.wake_at is not None and self._waits():
                self.pass_time(max(0.0, self.wake_at - self.now) + 0.001)
            else:
                return
        raise AssertionError("it never comes to rest")

    def key(self) -> Hashable:
        """Return what distinguishes two worlds."""
        plans = self.plans.text, self.earlier and self.earlier.text
        state = tuple(map(self._text, vars(self.state).values()))
        lanes = tuple((lane, *map(self._text, actions)) for lane, actions in self.lanes.items())
        return state, lanes, self.dead, self.open, plans

    def _text(self, value: object) -> Hashable:
        """Return a value as text: once, as what a step does not touch is the same object after it.

        It is kept with its text, so that no other object has its number meanwhile.
        """
        known = self._texts.get(id(value))
        if known is None:
            if isinstance(value, HashTrieMap):
                text: Hashable = frozenset((key, self._text(item)) for key, item in value.items())
            else:
                text = repr(value)
            known = self._texts[id(value)] = value, text
        return known[1]

    # What always holds.

    def check(self) -> None:
        """Raise where an invariant does not hold."""
        state = self.state
        self._check_users()
        replies = set(self.replies)
        assert replies.issubset(self.asked)
        assert len(replies) == len(self.replies), self.replies
        for part, batch in state.parts.items():
            if batch in state.batches:
                assert part in state.batches[batch].parts
            else:
                assert part in self.open, f"{part} is thought to be open"
        for key, number in state.feeding.items():
            record = state.edges[number]
            assert record.key == key
            assert state.serving.get(key[0]) == record.consumer
            assert not state.components[record.producer].is_lost
        for name, number in state.serving.items():
            assert state.components[number].name == name
            assert not state.components[number].is_lost
        # What is wanted again while it drains, or is being stopped, is that instance and no other.
        usable = [
            record.name
            for record in state.components.values()
            if not record.is_lost and not record.is_superseded
        ]
        assert len(usable) == len(set(usable)), usable
        for connection in state.connections.values():
            self._check_move(connection)
            # Whatever may be done now was taken by the step: what stands first is under way.
            for first in difference(state, connection)[:1]:
                assert first.is_begun or first.batches or first.members, first
                if first.phase is MovePhase.OPENING:
                    self._check_awaited(connection, first.batches)

    def _check_awaited(self, connection: ConnectionRecord, batches: Collection[int]) -> None:
        """Each batch that a connection waits for is its own, or knows that it does."""
        for number in batches:
            batch = self.state.batches[number]
            assert connection.id in {connection_of(batch.user), *batch.waiting}

    def _check_move(self, connection: ConnectionRecord) -> None:
        """A connection has one move at most, and the plan that it leads to belongs to it."""
        move, state = connection.move, connection.state
        if connection.current is not None and connection.is_active:
            # What moves, or failed to, has the plan before open, or says what of it is lost.
            lost = () if move is None else move.lost
            for part in connection.current.parts:
                assert part in self.open
                if part.kind in {Kind.COMPONENT, Kind.OUTPUT}:
                    assert part.id in lost or not self.state.components[part.id].is_lost
        if move is None:
            assert state is ConnectionState.RUNNING
            return
        if move.group:
            group = self.state.switchovers[move.group]
            assert connection.id in group.members
            assert move.reason is group.reason
            assert (move.phase is MovePhase.SWITCHING) == group.is_switching
            # What dies while inputs change hands is left for the end of that move.
            assert not move.lost or group.is_switching
        assert bool(move.group) == move.rule.is_beside
        assert (move.retry_at is not None) <= (move.phase is MovePhase.WAITING)
        assert (move.next is not None) == (move.phase in {MovePhase.OPENING, MovePhase.SWITCHING})
        # A first plan that lost something and could not be opened is replaced before the reply.
        assert (state is ConnectionState.OPENING) == (
            bool(connection.waiter) and move.reason is not MoveReason.END
        )
        assert (move.reason is MoveReason.REQUEST) == (connection.current is None)
        if state is ConnectionState.OPENING:
            assert move.reason in {MoveReason.REQUEST, MoveReason.DEATH}
        assert (move.reason is MoveReason.END) == (state is ConnectionState.CLOSING)
        assert (move.reason is MoveReason.END) == (move.phase is MovePhase.DRAINING)
        if state is ConnectionState.WAITING:
            assert move.reason is MoveReason.DEATH

    def check_at_rest(self) -> None:
        """Raise where something is open that is not wanted, or the other way round."""
        state = self.state
        assert not state.batches
        assert not state.draining
        assert not state.switchovers
        assert not state.outdated
        assert not state.recalled
        assert Counter(self.replies) == Counter(self.asked)
        wanted = desired(state)
        for record in state.connections.values():
            assert record.next is None
            assert record.state in {ConnectionState.RUNNING, ConnectionState.WAITING}
            # A move ends: with the next plan, or by saying that nothing is open.
            assert (record.move is None) == (record.state is ConnectionState.RUNNING)
            lost = record.move.lost if record.move is not None else ()
            placed = record.placement
            if record.state is ConnectionState.RUNNING:
                for number in placed.components.values():
                    assert not state.components[number].is_superseded
                there = {evolve(item, priority=0) for item in self.plans.robot.components()}
                there |= self.seen
                assert all(
                    evolve(step.component, priority=0) in there for step in placed.plan.steps
                )
            for part in placed.parts:
                if part.kind in {Kind.COMPONENT, Kind.OUTPUT}:
                    assert (part.id in lost) == state.components[part.id].is_lost
            assert wanted.issuperset(placed.parts)
        opened = {part for part in self.open if part.kind is not Kind.OUTPUT or part in wanted}
        assert opened == wanted, (opened - wanted, wanted - opened)

    def _check_users(self) -> None:
        components: dict[int, set[str]] = {}
        edges: dict[int, set[str]] = {}
        for record in self.state.connections.values():
            if record.state is ConnectionState.CLOSING:
                assert record.next is None
                continue
            for placement in (record.current, record.next):
                if placement is None:
                    continue
                for number in placement.components.values():
                    components.setdefault(number, set()).add(placement.user)
                for number in placement.edges:
                    edges.setdefault(number, set()).add(placement.user)
        for ending in self.state.draining.values():
            for number in ending.placement.components.values():
                components.setdefault(number, set()).add(ending.placement.user)
        assert {
            n: set(instance.users) for n, instance in self.state.components.items()
        } == components
        assert {n: set(edge.users) for n, edge in self.state.edges.items()} == edges

    # How.

    def _waits(self) -> bool:
        """Say whether time brings anything: what waits for ever for a better plan is at rest."""
        return any(
            record.reason is MoveReason.DEATH
            or (record.preferred is not None and self._is_chosen(record.preferred.plan))
            for record in self.state.connections.values()
        )

    def _is_chosen(self, plan: Plan) -> bool:
        """Say whether a request would get this plan now, as `check_preferred` does."""
        try:
            return self.plans(plan.function, self.dead).names == plan.names
        except ResolutionError:
            return False

    def _report(self, name: str, health: Health) -> None:
        bridge = self.state.bridges[name]
        self.post(ev.HealthReported(bridge, health, "so it is", name, "component"))

    def _keep(self, action: act.Action) -> None:
        if isinstance(action, act.Reply):
            self.replies += (action.waiter,)
        elif isinstance(action, act.HandOver):
            assert action.before.plan != action.after.plan or action.cause
            self.handed += ((action.connection, action.after.plan.names),)
        elif isinstance(action, act.Adopt):
            assert action.revision == self.state.revision
            self.before, self.plans, self.earlier = self.plans, self.next, None
            self.seen = frozenset()
        elif isinstance(action, act.CancelBatch):
            self.cancelled |= {action.batch}
        elif isinstance(action, act.WakeAt):
            assert action.time > self.now, "the timer would turn without a pause"
            self.wake_at = min(action.time, self.wake_at or action.time)
        elif isinstance(action, act.CallAction.__args__):
            self.lanes[action.lane] = (*self.lanes.get(action.lane, ()), action)

    def _do(self, action: act.CallAction, fails_at: int | None) -> ev.Event | None:
        if isinstance(action, act.Open):
            return self._open(action, fails_at)
        if isinstance(action, act.Close):
            self._close(action.parts)
            return ev.Ended(action.connection) if action.ends else None
        if isinstance(action, act.Finish):
            self._close(evolve(action.parts, components=()))
            return ev.RanOut(action.placement.user)
        if isinstance(action, act.Drain):
            return ev.Drained(action.connection)
        if isinstance(action, act.Resolve):
            return self._resolve(action, self.plans, self.state.revision)
        if isinstance(action, act.Release):
            return None
        assert not isinstance(action, act.OpenOffer | act.CloseOffer), "nothing is on offer here"
        if isinstance(action, act.FindReplacement):
            return self._find(action)
        if isinstance(action, act.CheckPreferred):
            return ev.PreferredChecked(action.connection, self._is_chosen(action.plan))
        return ev.InputsSwitched(action.switchover, "" if fails_at is None else "no")

    def _do_old(self, action: act.CallAction) -> ev.Event:
        """Find a plan with the candidates before."""
        assert self.earlier is not None
        now, self.plans = self.plans, self.earlier
        event = self._do(action, None)
        self.plans = now
        assert isinstance(event, ev.Resolved | ev.ReplacementSought)
        return event

    def _resolve(self, action: act.Resolve, plans: Plans, revision: int) -> ev.Event:
        try:
            plan = plans(action.function, self.dead)
        except ResolutionError as error:
            return ev.Resolved(action.connection, None, error, revision)
        return ev.Resolved(
            action.connection, plan, revision=revision, candidates=self._candidates()
        )

    def _find(self, action: act.FindReplacement) -> ev.Event:
        asked = action.connection, action.attempt
        try:
            plan = find_replacement(
                action.plan,
                action.output,
                action.excluded | self.dead,
                tuple(action.failed),
                self.plans,
            )
        except ResolutionError as error:
            return ev.ReplacementSought(*asked, None, str(error), action.switchover)
        return ev.ReplacementSought(
            *asked, plan, switchover=action.switchover, candidates=self._candidates()
        )

    def _candidates(self) -> int:
        """Return the number of the candidates with which a plan is found."""
        return self.state.candidates - (self.plans is self.earlier)

    def _open(self, action: act.Open, fails_at: int | None) -> ev.Event:
        done: list[Part] = []
        for number, part in enumerate(action.parts):
            if action.batch in self.cancelled or number == fails_at:
                return ev.Opened(action.batch, tuple(done), BridgeError("no"))
            assert part not in self.open, f"{part} is opened twice"
            self._check_order(action.placement, part)
            self.open |= {part}
            done.append(part)
        return ev.Opened(action.batch, tuple(done))

    def _check_order(self, placement: Placement, part: Part) -> None:
        """An output opens after all that it feeds; everything opens after its component."""
        before = placement.parts[: placement.parts.index(part)]
        if part.kind is Kind.OUTPUT:
            for number in placement.edges:
                record = self.state.edges.get(number)
                if record is None or record.producer != part.id:
                    continue
                if record.edge.output == part.port:
                    assert Part(Kind.EDGE, number) in before
        if part.kind is not Kind.COMPONENT:
            for number in placement.components.values():
                assert Part(Kind.COMPONENT, number) in before
        assert all(part in self.open or part in self.state.parts for part in before)

    def _close(self, parts: Parts) -> None:
        for part in tuple(self.open):
            if part.kind in {Kind.COMPONENT, Kind.OUTPUT}:
                gone = part.id in parts.components
            elif part.kind is Kind.EDGE:
                gone = part.id in parts.edges
            else:
                gone = part.id in parts.ports
            if gone:
                self.open -= {part}
