"""The next state while a step is being worked out: what is shared, used, and to be closed."""

from __future__ import annotations

from collections.abc import Container, Iterable, Mapping
from collections.abc import Set as AbstractSet
from itertools import chain
from typing import Any, TypeVar

from uoarm._control.engine.actions import (
    Action,
    Announce,
    CancelBatch,
    Open,
    Publish,
    Resolve,
    SetCheck,
)
from uoarm._control.engine.state import (
    OPEN,
    PORTS,
    Batch,
    ComponentRecord,
    ConnectionRecord,
    DrainingPlan,
    EdgeRecord,
    Kind,
    Part,
    Parts,
    Placement,
    State,
    names,
    only_drains,
    recently,
)
from uoarm.errors import ResolutionError
from uoarm.model import Component, Edge, Plan, Step, ValidationMode

__all__ = ["Draft", "InputInUseError", "connection_of", "strictest"]

Key = TypeVar("Key")
Value = TypeVar("Value")
_STRICTNESS = (ValidationMode.OFF, ValidationMode.SAMPLED, ValidationMode.ALWAYS)


class InputInUseError(ResolutionError):
    """An input is in use, fed by something else than a plan would feed it from.

    Attributes:
        producer: from which it would.
    """

    def __init__(self, text: str, producer: str) -> None:
        super().__init__(text)
        self.producer = producer


class Draft:
    """A state that may be changed, and the actions that follow from the changes.

    Every method keeps the records consistent: a part without a user is in no record, and what
    new users share is neither lost nor closing.

    Args:
        state: before the step; it is not touched.
        now: the time of the event.
    """

    def __init__(self, state: State, now: float) -> None:
        self.now = now
        self.actions: list[Action] = []
        self._failed_lately: tuple[str, ...] | None = None
        # Copies: where a step raises, the executor goes on with the state before it, untouched.
        self.policy = state.policy
        self.bridges = state.bridges
        self.connections = _copied(state.connections)
        self.components = _copied(state.components)
        self.edges = _copied(state.edges)
        self.parts = _copied(state.parts)
        self.serving = _copied(state.serving)
        self.feeding = _copied(state.feeding)
        self.beside = _copied(state.beside)
        self.batches = _copied(state.batches)
        self.draining = _copied(state.draining)
        self.switchovers = _copied(state.switchovers)
        self.failed = _copied(state.failed)
        self.avoided = _copied(state.avoided)
        self.number = state.number
        self.is_closing = state.is_closing
        self.closers = state.closers
        self.revision = state.revision
        self.outdated = state.outdated
        self.postponed = state.postponed
        self.configurers = state.configurers
        self.candidates = state.candidates
        self.replaced = state.replaced

    def state(self) -> State:
        """Return the state as it is now."""
        return State(
            policy=self.policy,
            bridges=self.bridges,
            connections=self.connections,
            components=self.components,
            edges=self.edges,
            parts=self.parts,
            serving=self.serving,
            feeding=self.feeding,
            beside=self.beside,
            batches=self.batches,
            draining=self.draining,
            switchovers=self.switchovers,
            failed=self.failed,
            avoided=self.avoided,
            number=self.number,
            is_closing=self.is_closing,
            closers=self.closers,
            revision=self.revision,
            outdated=self.outdated,
            postponed=self.postponed,
            configurers=self.configurers,
            candidates=self.candidates,
            replaced=self.replaced,
        )

    def new_id(self) -> int:
        """Return an id that nothing has had before."""
        self.number += 1
        return self.number

    def put(self, record: ConnectionRecord, **changes: Any) -> ConnectionRecord:
        """Keep a connection with some changes, and return it."""
        changed = record._replace(**changes) if changes else record
        self.connections[record.id] = changed
        return changed

    def publish(self, record: ConnectionRecord) -> None:
        """Have the new state of a connection shown at its handle, and announced."""
        self.actions.append(Publish(record))
        self.announce(record, record.state.value, record.cause)

    def announce(self, record: ConnectionRecord, change: str, cause: str = "") -> None:
        """Have a change of a connection announced to the listeners."""
        function = record.wanted.function
        self.actions.append(Announce(f"connection {record.id}", change, cause, function))

    def resolve(self, record: ConnectionRecord) -> None:
        """Have the first plan of a request sought, without what is avoided now."""
        avoided = recently(self.avoided, self.now)
        self.actions.append(Resolve(record.waiter, record.id, record.wanted.function, avoided))

    def is_outdated(self, plan: Plan, candidates: int) -> bool:
        """Say whether a plan, found with earlier candidates, has one that is another by now.

        Of changes that are too long ago to be known, any plan may be.
        """
        missed = self.candidates - candidates
        if missed > len(self.replaced):
            return True
        since = self.replaced[-missed:] if missed > 0 else ()
        return any(name in others for others in since for name in names(plan))

    def place(
        self, record: ConnectionRecord, plan: Plan, user: str, *, beside: bool = False
    ) -> Placement:
        """Use the parts of a plan, those that are there already and new ones; nothing is opened.

        Args:
            record: the connection; its application ports stay where the provider does.
            plan: the plan.
            user: the name under which its parts are used.
            beside: whether its inputs may be fed by another edge until a switchover.

        Raises:
            InputInUseError: an input is in use, fed by another component. Nothing has changed.
        """
        # All is judged before anything is changed, so that a refusal leaves nothing behind.
        into: dict[str, list[Edge]] = {}
        for edge in plan.edges:
            self._require_free(edge, beside=beside)
            into.setdefault(edge.consumer, []).append(edge)
        # `plan.steps` has producers first, and consumers open first.
        ids = {step.component.name: self._use(step, user) for step in reversed(plan.steps)}
        provider = plan.provider.component.name
        # An application that keeps its provider keeps its ports: its inbox loses nothing and gets
        # nothing twice when only something upstream is replaced.
        so_far = record.current
        stays = so_far is not None and so_far.provider == ids[provider]
        ports = so_far.ports if so_far is not None and stays else self.new_id()
        parts = [Part(Kind.COMPONENT, id_) for id_ in ids.values()]
        outputs: dict[str, set[str]] = {}
        if record.output is not None:
            parts.append(Part(Kind.RECEIVE, ports))
            outputs[provider] = {record.output}
        edges: dict[str, list[int]] = {name: [] for name in reversed(ids)}  # producers first
        # An output comes after every edge that it feeds, as its source delivers from the moment in
        # which it opens. The edges of a component open, and then the outputs that they come from.
        for name, id_ in ids.items():
            parts += [Part(Kind.OUTPUT, id_, port) for port in sorted(outputs.get(name, ()))]
            for edge in into.get(name, ()):
                outputs.setdefault(edge.producer, set()).add(edge.output)
                joined = self._join(edge, ids, user, record.validate)
                parts.append(Part(Kind.EDGE, joined))
                edges[edge.producer].append(joined)
        # Last: what the application sends finds all that it leads to.
        parts.append(Part(Kind.SEND, ports))
        return Placement(user, plan, ids, tuple(chain(*edges.values())), ports, tuple(parts))

    def unplace(self, placement: Placement, *, ports: bool = True) -> Parts:
        """Use the parts of a plan no more; return those that are without a user now.

        Args:
            placement: the plan.
            ports: whether the application ports end with it.
        """
        # What a batch has opened by now comes back with `Opened` and is closed as unused then; so
        # only parts that are open already are returned here.
        opening = (n for n, batch in self.batches.items() if batch.user == placement.user)
        self.actions += map(CancelBatch, opening)
        edges = self._part_edges(placement)
        closed = self._close_ports(placement) if ports else ()
        return Parts(self._leave_all(placement), edges, closed)

    def start_draining(
        self, connection: str, placement: Placement, lost: tuple[int, ...], *, ports: bool
    ) -> Parts:
        """Use a plan for nothing but what is under way; return the parts that no other plan uses.

        Its edges, and its application ports where these end with it, end at once. Its components
        stay open until `end_draining`.
        """
        # It stays a user of its components, so that they stay open; but where another plan comes to
        # use one meanwhile, that one goes on when this has drained.
        self.draining[placement.user] = DrainingPlan(connection, placement, lost)
        edges = self._part_edges(placement)
        closed = self._close_ports(placement) if ports else ()
        return Parts(
            tuple(
                producer for producer in _producers_first(placement) if self._only_drains(producer)
            ),
            edges,
            closed,
        )

    def end_draining(self, user: str) -> tuple[DrainingPlan, Parts]:
        """Use the components of a plan no more, as nothing is under way; return those left."""
        ended = self.draining.pop(user)
        return ended, Parts(self._leave_all(ended.placement))

    def lose(self, lost: Iterable[int]) -> tuple[int, ...]:
        """Share components that died no more; return the edges that end with them."""
        dead = frozenset(lost)
        for number in dead:
            record = self.components[number]
            # Its users stay: what they lost with it is counted as each of them ends or moves.
            self.components[number] = record._replace(is_lost=True)
            if self.serving.get(record.name) == number:
                del self.serving[record.name]
        ended = [edge for edge in self.edges.values() if dead & {edge.producer, edge.consumer}]
        for joined in ended:
            self._unlist(joined)
        return tuple(joined.id for joined in ended)

    def failed_lately(self, but: AbstractSet[str]) -> tuple[str, ...]:
        """Return the components that died within the last minutes, longest ago first.

        Args:
            but: those that are left out.
        """
        # Once for all connections that seek in one step: thousands may, after as many deaths. What
        # changes `failed` in a step does so before the first of them seeks.
        if self._failed_lately is None:
            recent = recently(self.failed, self.now)
            self._failed_lately = tuple(name for name in self.failed if name in recent)
        failed = self._failed_lately
        if self.failed.keys().isdisjoint(but):
            return failed
        return tuple(name for name in failed if name not in but)

    def supersede(self, names: Iterable[str]) -> None:
        """Share components no more that are others in the configuration from now on.

        They keep their users; other edges may feed their consumers after a switchover.
        """
        numbers = {self.serving.pop(name) for name in names if name in self.serving}
        for number in numbers:
            self.components[number] = self.components[number]._replace(is_superseded=True)
        # Edges into them leave `feeding` with them: that is by name, and the next instance of a
        # name has inputs of its own. Edges out of them stay, as their consumers serve still.
        for joined in self.edges.values() if numbers else ():
            if joined.consumer in numbers:
                self._unlist(joined)

    def open(
        self, record: ConnectionRecord, placement: Placement, lane: str, *, is_receiving: bool
    ) -> bool:
        """Have what is missing of a plan opened, unless some of it is being opened already.

        A connection that waits for a batch, its own or another's, is advanced when that is over.
        Returns whether all of it is open.
        """
        # Where another batch opens some of it, even the rest waits: opened beside it, an output
        # might come before an edge that it feeds. What that batch fails at is asked for again here.
        missing = [part for part in placement.parts if self.parts.get(part) != OPEN]
        if missing and self.parts.keys().isdisjoint(missing):
            batch = self.new_id()
            parts = tuple(missing)
            self.parts.update(dict.fromkeys(parts, batch))
            self.batches[batch] = Batch(placement.user, parts)
            self.actions.append(
                Open(lane, batch, record.id, placement, parts, is_receiving=is_receiving)
            )
        return not missing

    def is_open(self, placement: Placement) -> bool:
        """Say whether all of a plan is open."""
        return all(self.parts.get(part) == OPEN for part in placement.parts)

    def settle(self, batch: Batch, done: Iterable[Part]) -> Parts:
        """Note what became of a batch that is over; return what was opened and has no user."""
        for part in batch.parts:
            del self.parts[part]
        # What was used as the opening began may have lost its last user since. Ports are the
        # connection's own, and in no record: its two plans say which ids are in use.
        record = self.connections.get(connection_of(batch.user))
        ports = () if record is None else record.ports
        used: dict[Kind, Container[int]] = {
            Kind.COMPONENT: self.components,
            Kind.OUTPUT: self.components,
            Kind.EDGE: self.edges,
            Kind.RECEIVE: ports,
            Kind.SEND: ports,
        }
        unused: list[Part] = []
        for part in done:
            if part.id in used[part.kind]:
                self.parts[part] = OPEN
            else:
                unused.append(part)
        return Parts(
            tuple(part.id for part in unused if part.kind is Kind.COMPONENT),
            tuple(part.id for part in unused if part.kind is Kind.EDGE),
            tuple({part.id for part in unused if part.kind in PORTS}),
        )

    def waiting_for(self, batch: Batch) -> list[str]:
        """Return the connections that use a part of a batch and so waited for it, oldest first."""
        users = {batch.user}
        for part in batch.parts:
            if part.kind is Kind.EDGE:
                edge = self.edges.get(part.id)
                users.update(() if edge is None else edge.users)
            elif part.kind not in PORTS:  # which are one connection's own
                component = self.components.get(part.id)
                users.update(() if component is None else component.users)
        # By length first: c9 is older than c10.
        return sorted(
            set(map(connection_of, users)), key=lambda identity: (len(identity), identity)
        )

    def rivals(self, plan: Plan) -> set[str]:
        """Return the connections with edges that feed what a plan would feed from elsewhere."""
        found: set[str] = set()
        for edge in plan.edges:
            standing = self.feeding.get((edge.consumer, edge.input))
            if standing is not None and not self._is_origin(standing, edge):
                found.update(map(connection_of, self.edges[standing].users))
        return found

    def switch_inputs(self, edges: Iterable[int]) -> tuple[tuple[int, int | None], ...]:
        """Let edges that are held take the places of others; return each with the other one.

        Raises:
            ResolutionError: another connection uses an edge that would end. Nothing has changed.
        """
        # Judged for all edges before the first is switched: either all inputs change or none.
        held = [self.edges[number] for number in dict.fromkeys(edges) if self.edges[number].is_held]
        pairs = [(joined, self.feeding.get(joined.key)) for joined in held]
        for joined, other in pairs:
            users = {} if other is None else self.edges[other].users
            left = set(map(connection_of, users)) - set(map(connection_of, joined.users))
            if left:
                raise ResolutionError(
                    f"input {'.'.join(joined.key)} is fed for {', '.join(sorted(left))} by "
                    "another component still"
                )
        for joined, _ in pairs:
            del self.beside[joined.key]
            self.feeding[joined.key] = joined.id
            self.edges[joined.id] = joined._replace(is_held=False)
        return tuple((joined.id, other) for joined, other in pairs)

    def _require_free(self, edge: Edge, *, beside: bool) -> None:
        key = edge.consumer, edge.input
        standing = self.feeding.get(key)
        if standing is None or self._is_origin(standing, edge):
            return
        # Beside the edge that feeds there is room for one more: of two plans that want to take the
        # place of a third, one is refused here and its switchover abandoned.
        waiting = self.beside.get(key)
        if beside and (waiting is None or self._is_origin(waiting, edge)):
            return
        record = self.edges[standing]
        was = self.components[record.producer].is_superseded
        raise InputInUseError(
            f"component {edge.consumer!r} is in use with its input {edge.input!r} fed by "
            f"{'.'.join(record.origin)}{' as it was configured before' if was else ''}; this plan "
            f"feeds it from {edge.producer}.{edge.output}",
            edge.producer,
        )

    def _is_origin(self, number: int, edge: Edge) -> bool:
        """Say whether an edge comes from where another one would come from."""
        # Of the same name, and yet another: what it was before the configuration changed.
        record = self.edges[number]
        is_another = self.components[record.producer].is_superseded
        return record.origin == (edge.producer, edge.output) and not is_another

    def _use(self, step: Step, user: str) -> int:
        """Use the instance of a component that is there already, or a new one."""
        # An instance that only drains is taken over as it is, or an application would get each of
        # its messages twice. Not one that is commanded: it was stopped when it was replaced, and
        # refuses whatever comes then.
        name = step.component.name
        found = self.serving.get(name)
        if found is None or (self._only_drains(found) and _is_commanded(step.component)):
            found = self.serving[name] = self.new_id()
            self.components[found] = ComponentRecord(found, step, (user,))
        else:
            record = self.components[found]
            self.components[found] = record._replace(users=(*record.users, user))
        return found

    def _join(self, edge: Edge, ids: Mapping[str, int], user: str, validate: ValidationMode) -> int:
        """Use the edge that is there already, or a new one in its place or beside it."""
        key = edge.consumer, edge.input
        standing = self.feeding.get(key)
        is_held = standing is not None and not self._is_origin(standing, edge)
        places = self.beside if is_held else self.feeding
        found = places.get(key)
        if found is None:
            found = places[key] = self.new_id()
            ends = ids[edge.producer], ids[edge.consumer]
            self.edges[found] = EdgeRecord(found, edge, *ends, {user: validate}, is_held=is_held)
        else:
            self._check_for(found, {**self.edges[found].users, user: validate})
        return found

    def _check_for(self, edge: int, users: Mapping[str, ValidationMode]) -> None:
        record = self.edges[edge]
        self.edges[edge] = record._replace(users=users)
        if strictest(users) is not strictest(record.users):
            self.actions.append(SetCheck(edge))

    def _only_drains(self, component: int) -> bool:
        return only_drains(self.components[component], self.draining)

    def _part_edges(self, placement: Placement) -> tuple[int, ...]:
        """Use the edges of a plan no more; return those that are open, and have no user now."""
        # One that is being opened is in no list here: `settle` returns it when its batch is over.
        edges = [edge for edge in placement.edges if self._part_edge(edge, placement.user)]
        return tuple(edge for edge in edges if self._close_part(Part(Kind.EDGE, edge)))

    def _close_ports(self, placement: Placement) -> tuple[int, ...]:
        for kind in PORTS:
            self._close_part(Part(kind, placement.ports))
        return (placement.ports,)

    def _leave_all(self, placement: Placement) -> tuple[int, ...]:
        """Use the components of a plan no more; return those that have no user now."""
        left = _producers_first(placement)
        return tuple(number for number in left if self._leave(number, placement.user))

    def _part_edge(self, edge: int, user: str) -> bool:
        """Take a user of an edge back; True when it was the last."""
        record = self.edges[edge]
        left = {other: mode for other, mode in record.users.items() if other != user}
        if left:
            self._check_for(edge, left)
            return False
        self._unlist(record)
        del self.edges[edge]
        return True

    def _unlist(self, record: EdgeRecord) -> None:
        # By id: another edge may have taken its place at the input since.
        for places in (self.feeding, self.beside):
            if places.get(record.key) == record.id:
                del places[record.key]

    def _leave(self, component: int, user: str) -> bool:
        """Take a user of a component back; True when it was the last."""
        record = self.components[component]
        users = tuple(other for other in record.users if other != user)
        if users:
            self.components[component] = record._replace(users=users)
            return False
        del self.components[component]
        # Another instance of the name may serve by now.
        if self.serving.get(record.name) == component:
            del self.serving[record.name]
        self._close_part(Part(Kind.COMPONENT, component))
        for output in record.step.component.outputs:
            self._close_part(Part(Kind.OUTPUT, component, output.name))
        return True

    def _close_part(self, part: Part) -> bool:
        """Forget a part that is open; one that is being opened is looked at when that is over."""
        if self.parts.get(part) != OPEN:
            return False
        del self.parts[part]
        return True


def _copied(mapping: Mapping[Key, Value]) -> dict[Key, Value]:
    # A dict from which something was deleted is copied five times as fast by its own method.
    return mapping.copy() if isinstance(mapping, dict) else dict(mapping)


def _producers_first(placement: Placement) -> tuple[int, ...]:
    return tuple(reversed(tuple(placement.components.values())))


def _is_commanded(component: Component) -> bool:
    """Say whether a component moves something: one that was replaced takes no commands any more."""
    return any(input_.endpoint.command is not None for input_ in component.inputs)


def connection_of(user: str) -> str:
    """Return the id of the connection that a user of parts is."""
    return user.partition("#")[0]


def strictest(users: Mapping[str, ValidationMode]) -> ValidationMode:
    """Return the mode that satisfies every user of an edge."""
    return max(users.values(), key=_STRICTNESS.index)
