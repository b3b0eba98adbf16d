"""What is open, as objects, by the ids of the state; how parts of a plan open and close.

Here are the calls into bridges. They may take long and fail; the driver makes them in lanes, and
turns what becomes of them into events.
"""

from __future__ import annotations

import threading
from collections.abc import Callable, Hashable, Iterable, Iterator, Mapping
from functools import partial
from itertools import chain
from typing import Protocol, TypeVar

from attrs import define, field

from uoarm._bridges import BridgeSet
from uoarm._control.engine import actions as act
from uoarm._control.engine import events as ev
from uoarm._control.engine.draft import by_age, connection_of
from uoarm._control.engine.placement import (
    PORTS,
    ComponentRecord,
    EdgeRecord,
    Kind,
    LinkEnd,
    Part,
    Parts,
    Placement,
)
from uoarm._control.engine.state import State, oldest_first
from uoarm._control.live.connection_runtime import ConnectionRuntime
from uoarm._dataplane import Clock, FailureWatch, Route
from uoarm._parts import ApplicationPorts, LiveComponent, LiveEdge
from uoarm._safety import EmergencyStop
from uoarm.bridge import Bridge, HealthEvent, NativeLink
from uoarm.errors import BridgeError, ConnectionClosedError, FailureReason
from uoarm.model import ComponentStatus, Health, RouteStatus, Step, ValidationMode

T = TypeVar("T")

_HANGING = 4
_DRAIN_SECONDS = 30.0
_PLAN_DRAIN_SECONDS = 2.0
_LEAVING_SECONDS = 2.0


class StateOwner(Protocol):
    """Owns the state of this moment, and takes events."""

    state: State

    def post(self, event: ev.Event) -> None:
        """Take an event."""

    def queue(self, event: ev.Event) -> None:
        """Have an event handled behind those so far, by who asked for it."""


@define(eq=False)
class Ending:
    """Objects in no other list any more, and what is accounted for with them.

    Attributes:
        user: the name under which the plan used them; empty: that plan had ended already.
        ports, edges, components: to be closed, producers first.
        placed_edges, placed_components: all of the plan that ends.
        lost: components of it that died.
        runtime: of the connection; None where it has ended, and nothing is accounted for.
    """

    user: str
    ports: list[ApplicationPorts]
    edges: list[LiveEdge]
    components: list[LiveComponent]
    placed_edges: list[LiveEdge]
    placed_components: list[LiveComponent]
    lost: list[LiveComponent]
    runtime: ConnectionRuntime | None

    def ended(self) -> Iterator[Route]:
        """Yield the routes that end with the plan, once each."""
        for ports in self.ports:
            yield from ports.routes()
        if self.runtime is not None:
            yield from self.runtime.losses.ended_edges(self.placed_edges)

    def gone(self) -> list[LiveComponent]:
        """Return the components that died or were closed."""
        return [
            *self.lost,
            *(component for component in self.placed_components if component.is_closed),
        ]


class OpenedParts:
    """The parts of a batch that are open. For the thread that opens and the one that waits for it.

    Each part is either among those that count as open, or taken out by the thread that opened it.

    Args:
        parts: of the batch, in the order in which they open.
    """

    def __init__(self, parts: tuple[Part, ...]) -> None:
        # Guards the count and whether it was read: a part may open just as its batch is given up.
        self._lock = threading.Lock()
        self._parts = parts
        self._count = 0
        self._is_over = False

    def add(self) -> bool:
        """Note that the next part is open, and in its table; False where it comes too late."""
        with self._lock:
            self._count += not self._is_over
            return not self._is_over

    def end(self) -> tuple[Part, ...]:
        """Return the parts that are open; those that open later do not count."""
        with self._lock:
            self._is_over = True
            return self._parts[: self._count]


class _LeavingComponents:
    """Components from when they are in no other list to when they are closed. For any thread.

    A replaced bridge is in use so long, and no other instance of a name opens beside them. Those of
    which a thread has not come back are known still, so that their number can be bounded.

    Attributes:
        by_name: the instances of each name.
    """

    def __init__(self) -> None:
        # Guards changes of all: the owner of the state adds, lanes take out. Who looks needs no
        # lock, as a name's instances are replaced as a whole. They are found by name: thousands may
        # leave at once while as many open, and each of those looks (`test_growth.py`).
        self._lock = threading.Lock()
        self.by_name: dict[str, tuple[LiveComponent, ...]] = {}
        self._opening: tuple[LiveComponent, ...] = ()
        self._hanging: dict[str, list[LiveComponent]] = {}

    def add(self, lives: Iterable[LiveComponent]) -> None:
        """List components that are to be closed."""
        with self._lock:
            for live in lives:
                name = live.component.name
                self.by_name[name] = (*self.by_name.get(name, ()), live)

    def every(self) -> Iterator[LiveComponent]:
        """Yield all instances."""
        return chain.from_iterable(self.by_name.copy().values())

    def settle(self, closed: Iterable[LiveComponent]) -> None:
        """Take out what is closed, or hangs as it closes."""
        with self._lock:
            # What another thread opens still closes as that comes out, and is looked at again here.
            looked_at, self._opening = (*closed, *self._opening), ()
            for live in looked_at:
                name, is_hanging = live.component.name, live.is_hanging
                if is_hanging:
                    self._hanging.setdefault(name, []).append(live)
                if is_hanging or live.is_over:
                    left = tuple(item for item in self.by_name.pop(name, ()) if item is not live)
                    if left:
                        self.by_name[name] = left
                else:
                    self._opening = (*self._opening, live)

    def refuse_hanging(self, name: str) -> None:
        """Raise a BridgeError where too many instances of a name were let go of and hang still."""
        if name not in self._hanging:
            return
        with self._lock:
            hanging = [live for live in self._hanging.pop(name, ()) if live.is_hanging]
            if hanging:
                self._hanging[name] = hanging
        if len(hanging) >= _HANGING:
            raise BridgeError(
                f"component {name!r} hangs: it has not let go of {len(hanging)} earlier "
                "connections; it can be opened again when it does",
                FailureReason.UNAVAILABLE,
            )


@define(eq=False, slots=False)
class LiveParts:
    """The objects of open parts.

    Args:
        owner: of the state by whose ids they are found.
        judged: called, with a component's id, when the verdict on what it raises changes.
        announce: takes a subject, a change, its cause and the function, for listeners.
    """

    _owner: StateOwner
    _bridges: BridgeSet
    _clock: Clock
    _judged: Callable[[int, Health, str], None]
    emergency_stop: EmergencyStop
    _announce: Callable[[str, str, str, str], None]
    # By the ids of the state. Lanes add what they have opened, and the owner of the state takes
    # out what is to be closed, in one call each; who goes over one makes a copy first. What is
    # not here any more as a lane comes to it was given up: `open` takes the `KeyError` so.
    runtimes: dict[str, ConnectionRuntime] = field(factory=dict, init=False)
    components: dict[int, LiveComponent] = field(factory=dict, init=False)
    edges: dict[int, LiveEdge] = field(factory=dict, init=False)
    ports: dict[int, ApplicationPorts] = field(factory=dict, init=False)
    _draining: dict[str, Ending] = field(factory=dict, init=False)
    _leaving: _LeavingComponents = field(factory=_LeavingComponents, init=False)

    def shared(self) -> tuple[LiveComponent, ...]:
        """Return the components that are in use and well enough to be shared."""
        records = self._owner.state.shared()
        return tuple(_there(self.components.copy(), (record.id for record in records)))

    def feeding(self) -> tuple[LiveEdge, ...]:
        """Return the edges that feed something."""
        objects = self.edges.copy()
        return tuple(_there(objects, sorted(self._owner.state.feeding.values())))

    def routes(self) -> tuple[RouteStatus, ...]:
        """Return the counters of these edges; one that is being opened has none yet."""
        statuses = (joined.status() for joined in self.feeding())
        return tuple(status for status in statuses if status is not None)

    def statuses(self) -> tuple[ComponentStatus, ...]:
        """Return what the status map shows of components."""
        objects, records = self.components.copy(), self._owner.state.shared()
        return tuple(_status(record, objects.get(record.id)) for record in records)

    def connections(self) -> tuple[ConnectionRuntime, ...]:
        """Return the connections that have a plan and have not ended, oldest first."""
        runtimes = self.runtimes.copy()
        records = oldest_first(self._owner.state.connections.values())
        found = (runtimes.get(record.id) for record in records)
        return tuple(
            runtime for runtime in found if runtime is not None and runtime.record is not None
        )

    def listen(self, connection: str, ports: int) -> None:
        """Let an application receive at the application ports of this id again."""
        found, runtime = self.ports.get(ports), self.runtimes.get(connection)
        if found is not None and runtime is not None:
            runtime.receiver.deliver_from(found.route, found.outlet)

    def stop(self, edges: Iterable[int]) -> None:
        """Let nothing more through edges."""
        for joined in _there(self.edges, edges):
            if joined.route is not None:
                joined.route.stop()

    def renew_check(self, edge: int) -> None:
        """Check the messages of an edge as its strictest user wishes now."""
        for joined in _there(self.edges, (edge,)):
            joined.renew_check()

    def edges_of(self, placement: Placement) -> list[LiveEdge]:
        """Return the edges of a plan that are open, those of the first producers first."""
        return _there(self.edges, placement.edges)

    def take(
        self, connection: str, parts: Parts, placement: Placement | None, lost: Iterable[int]
    ) -> Ending:
        """Return the objects of parts without a user, and what went with their plan.

        Args:
            connection: which accounts for it.
            parts: to be closed.
            placement: the plan that ends; None: parts that opened after theirs had ended.
            lost: its components that died.
        """
        user = "" if placement is None else placement.user
        ending = self._draining.pop(user, None)
        if ending is None:
            ending = self._ending_of(connection, parts, placement, lost)
        ending.components = _there(self.components, parts.components)
        # Before they are gone from the others: another thread may look.
        self._leaving.add(ending.components)
        _taken(self.components, parts.components)
        return ending

    def take_draining(self, action: act.Finish) -> Ending:
        """Return the objects of a plan that drains; its components are still there for others."""
        ending = self._ending_of(action.connection, action.parts, action.placement, action.lost)
        self._draining[action.placement.user] = ending
        return ending

    def is_quick(self, action: act.Open) -> bool:
        """Say whether parts open at once, as none needs a call into a bridge that may hang.

        Bridges are asked: not for the thread that owns the state.
        """
        plan = action.placement.plan
        # A stop message may go out, or an earlier instance is waited for.
        if action.recalled or not self._leaving.by_name.keys().isdisjoint(plan.names):
            return False
        if all(part.kind in PORTS for part in action.parts) and all(
            port.source is not None for port in plan.provider.component.inputs
        ):
            return True
        return all(map(self._opens_at_once, plan.steps))

    def _opens_at_once(self, step: Step) -> bool:
        component = step.component
        bridge = self._bridges.running(component.bridge)
        return (
            bridge is not None
            and not bridge.capabilities.link
            and all(map(bridge.is_quick, component.endpoints))
        )

    def open(self, action: act.Open, state: State, done: OpenedParts, cancelled: set[int]) -> None:
        """Open parts in their order.

        Args:
            action: says which.
            state: when they were asked for.
            done: gets each that is open.
            cancelled: the batches of which nothing more is opened.

        Raises:
            UoarmError: the next one could not be opened.
            ConnectionClosedError: the batch was cancelled.
        """
        # Before the first part: a command that finds its input open must find also what it is to
        # stop before it is sent.
        replaced = self._replaced_by(action)
        for live in _there(self.components, action.recalled):
            live.recall(replaced, self.components.copy().values())
        batch = action.batch
        try:
            for part in action.parts:
                if batch in cancelled:
                    raise ConnectionClosedError(f"{action.connection} was given up")
                match part.kind:
                    case Kind.COMPONENT:
                        self._enter(state.components[part.id], replaced)
                    case Kind.RECEIVE:
                        self._receive(action)
                    case Kind.OUTPUT:
                        self._open_output(part)
                    case Kind.EDGE:
                        self._connect(state.edges[part.id])
                    case Kind.SEND:
                        self._send(action)
                # After it is open and in its table: `Opened` says no more than is there.
                if not done.add():
                    self._take_back(part)
                    raise ConnectionClosedError(f"{action.connection} was given up")
        except KeyError as error:  # what it needs was taken out meanwhile
            raise ConnectionClosedError(f"{action.connection} was given up") from error

    def _take_back(self, part: Part) -> None:
        """Close a part that opened as its batch was given up; what it needs is closed by now."""
        closed: LiveComponent | LiveEdge | ApplicationPorts | None = None
        match part.kind:
            case Kind.COMPONENT:
                closed = self.components.pop(part.id, None)
            case Kind.EDGE:
                closed = self.edges.pop(part.id, None)
            case Kind.RECEIVE | Kind.SEND:
                closed = self.ports.pop(part.id, None)
        if closed is not None:  # else it was in its table before, and was taken out with the others
            closed.close()

    def close(self, ending: Ending, *, ends: bool) -> None:
        """Close what has no user, and account for it.

        Args:
            ending: what to close.
            ends: whether the connection ends: then only what died loses what was under way.
        """
        self._close(ending)
        if ending.runtime is None:
            return
        losses = ending.runtime.losses
        # After all is closed: what was under way arrives, or is counted by what lost it. The gap
        # was noted by `HandOver`, which came before in the same lane.
        gone = losses.close(ending.lost if ends else ending.gone())
        routes = losses.ended_edges(ending.placed_edges) if ends else ending.ended()
        gap = ending.runtime.take_gap(ending.user)
        if gap is None:
            losses.settle(gone, routes)
        else:
            losses.count(gap, gone, routes)

    def finish(self, ending: Ending) -> None:
        """Let what is under way in a plan pass, and no new messages; its components stay open."""
        # Producers first, so that what the one lets pass is waited for in the next.
        for joined in ending.placed_edges:
            if joined in ending.edges:
                joined.finish()
            if joined.consumer in ending.components:
                joined.consumer.drain(_PLAN_DRAIN_SECONDS)
        for ports in ending.ports:
            ports.close()

    def release(self, components: Iterable[int]) -> None:
        """Close components whose plans have not ended yet."""
        for live in _there(self.components, components):
            live.close()

    def uses(self, bridge: Bridge) -> bool:
        """Say whether a component of a bridge is open, or on its way to be closed."""
        lives = chain(self.components.copy().values(), self._leaving.every())
        return any(live.bridge is bridge for live in lives)

    def drain(self, edges: Iterable[LiveEdge]) -> None:
        """Wait until what is under way has passed every edge, half a minute for each at most."""
        for joined in edges:
            if joined.route is not None:
                joined.route.drain(_DRAIN_SECONDS)
                joined.consumer.drain(_DRAIN_SECONDS)

    def switch_inputs(self, edges: Iterable[tuple[int, int | None]]) -> None:
        """Let edges that were held feed their inputs in place of others.

        What waits in a queue passes first, five seconds for each edge at most.

        Raises:
            BridgeError: a bridge could not link both ends of an edge.
        """
        for edge, other in edges:
            for before in _there(self.edges, () if other is None else (other,)):
                before.finish()
            for joined in _there(self.edges, (edge,)):
                joined.release(self._clock)

    def _ending_of(
        self, connection: str, parts: Parts, placement: Placement | None, lost: Iterable[int]
    ) -> Ending:
        user, placed, edges = "", parts.components, parts.edges
        if placement is not None:
            user, edges = placement.user, placement.edges
            placed = tuple(placement.components.values())
        placed_edges = _there(self.edges, edges)
        return Ending(
            user=user,
            ports=_taken(self.ports, parts.ports),
            edges=_taken(self.edges, parts.edges),
            components=_there(self.components, parts.components),
            placed_edges=placed_edges,
            placed_components=_there(self.components, placed),
            lost=_there(self.components, lost),
            runtime=self.runtimes.get(connection),
        )

    def _replaced_by(self, action: act.Open) -> list[LiveComponent]:
        """Return the components of a connection's running plan, where another is being opened."""
        runtime = self.runtimes.get(action.connection)
        record = None if runtime is None else runtime.record
        if record is None or record.current is None:
            return []
        if record.current.user == action.placement.user:  # this is what it runs
            return []
        return _there(self.components, record.current.components.values())

    def _enter(self, record: ComponentRecord, replaced: list[LiveComponent]) -> None:
        """Make an instance of a component; nothing of it is opened yet.

        Args:
            record: of the instance.
            replaced: what runs now; it does from now on what those of its function did.

        Raises:
            BridgeError: its bridge does not start, or threads of earlier connections hang in it,
                too many to risk another one.
        """
        component = record.step.component
        self._leaving.refuse_hanging(component.name)
        bridge = self._bridges.get(component.bridge)
        # What the framework gives to two instances that are open at once is counted by both, and
        # a device may be open once only (`test_late_losses.py`).
        for leaving in self._leaving.by_name.get(component.name, ()):
            if leaving.bridge is bridge:
                leaving.wait_over(_LEAVING_SECONDS)
        limits, report = self._owner.state.policy.failing, partial(self._judged, record.id)
        failures = FailureWatch(component.name, limits, self._clock, report)
        subject, function = f"component {component.name}", component.function
        live = LiveComponent(
            record.step,
            bridge,
            failures,
            self.emergency_stop,
            lambda cause: self._announce(subject, "leased", cause, function),
        )
        if replaced:
            live.replace(replaced)
        self.components[record.id] = live

    def _open_output(self, part: Part) -> None:
        """Open an output that has a route; one that only feeds native links stays closed."""
        live = self.components[part.id]
        if live.outlets[part.port].routes:
            live.open_output(part.port)

    def _connect(self, record: EdgeRecord) -> None:
        joined = LiveEdge(
            record.edge,
            self.components[record.producer],
            self.components[record.consumer],
            partial(self._strictness, record.id),
            held=record.is_held,
        )
        joined.open(self._clock)
        self.edges[record.id] = joined
        # After it is listed: a user that wishes more came before this look, or finds it there.
        joined.renew_check()

    def _strictness(self, edge: int) -> ValidationMode:
        record = self._owner.state.edges.get(edge)
        return ValidationMode.OFF if record is None else record.strictest

    def _receive(self, action: act.Open) -> None:
        runtime, ports = self._ports_of(action)
        # Before it is attached: a message that comes at once would be dropped as `replaced`.
        if action.is_receiving:
            runtime.receiver.deliver_from(ports.route, ports.outlet)
        ports.attach()  # an output that retains a message gives it at once

    def _send(self, action: act.Open) -> None:
        runtime, ports = self._ports_of(action)
        assert runtime.record is not None, "published when its plan was known"
        ports.feed(runtime.id, runtime.record.validate, self._clock)

    def _ports_of(self, action: act.Open) -> tuple[ConnectionRuntime, ApplicationPorts]:
        runtime = self.runtimes[action.connection]
        number = action.placement.ports
        ports = self.ports.get(number)
        if ports is None:
            record = runtime.record
            assert record is not None, "published when its plan was known"
            provider = self.components[action.placement.provider]
            route = outlet = None
            if record.output is not None:
                outlet = provider.outlets[record.output]
                route = runtime.receiver.route(
                    provider, record.output, record.id, record.validate, self._clock
                )
            ports = self.ports[number] = ApplicationPorts(provider, route, outlet)
        return runtime, ports

    def _close(self, ending: Ending) -> None:
        """Close ports, edges, then components, producers first. Failures are logged."""
        for ports in ending.ports:
            ports.close()
        for joined in ending.edges:
            joined.close()
        for live in ending.components:
            live.begin_close()
        for live in ending.components:
            live.close()
        self._leaving.settle(ending.components)
        self._bridges.retire_replaced(self.uses)


def subject_of(event: HealthEvent) -> tuple[str | None, Hashable]:
    """Return the component that a report is about, None for a bridge, and which part of it."""
    channel, component = event.channel, event.component
    if channel is None:
        if component is None:
            return None, "bridge"
        return component, ("component", event.about) if event.about else "component"
    # Found by its endpoint: it may report before its opening has returned.
    end = channel.endpoint
    if not isinstance(channel, NativeLink):
        return end.component, (end.role, end.port)
    ends = (end, channel.sink) if component != channel.sink.component else (channel.sink, end)
    near, far = ends
    return near.component, LinkEnd(near.role, near.port, far.component, far.port)


def _there(objects: Mapping[int, T], ids: Iterable[int]) -> list[T]:
    return [objects[id_] for id_ in ids if id_ in objects]


def _taken(objects: dict[int, T], ids: Iterable[int]) -> list[T]:
    return [objects.pop(id_) for id_ in ids if id_ in objects]


def _status(record: ComponentRecord, live: LiveComponent | None) -> ComponentStatus:
    """Return what the status map shows of a component; its object is None while it opens."""
    channels = () if live is None else live.channel_statuses()
    return ComponentStatus(
        name=record.name,
        function=record.step.component.function,
        bridge=record.step.component.bridge,
        health=record.health.health,
        users=tuple(by_age(map(connection_of, record.users))),
        cause=record.health.cause,
        channels=channels,
        failed=0 if live is None else live.failures.failed,
        last_error="" if live is None else live.failures.last_error,
        lost=sum(channel.lost for channel in channels),
    )
