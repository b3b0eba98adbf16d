"""The next state while a step is being worked out: what is shared, used, and to be closed."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Collection, Container, Hashable, Iterable, Iterator, Mapping
from collections.abc import Set as AbstractSet
from itertools import chain
from typing import Any

from uoarm._control.engine import actions as act
from uoarm._control.engine.move import forget_earlier
from uoarm._control.engine.placement import (
    NONE,
    PORTS,
    Batch,
    ComponentRecord,
    DrainingPlan,
    EdgeRecord,
    Kind,
    Part,
    Parts,
    Placement,
)
from uoarm._control.engine.state import ConnectionRecord, State, oldest_first
from uoarm._support.ordered import OrderedMap
from uoarm.errors import ResolutionError
from uoarm.model import Component, Edge, Health, Plan, Step, ValidationMode


class InputInUseError(ResolutionError):
    """An input is in use, fed by something else than a plan would feed it from.

    Attributes:
        producer: from which it would.
    """

    error_code = "UOA-204"

    def __init__(self, text: str, producer: str) -> None:
        super().__init__(text)
        self.producer = producer


class Draft(State):
    """A state that may be changed, and the actions that follow from the changes.

    Every method keeps the records consistent: a part without a user is in no record, and what
    new users share is neither lost nor closing.

    Its maps are those of the state before, and are replaced, never changed: where a step raises,
    that state is untouched.

    Attributes:
        now: the time of the event.
        actions: that follow from it so far.
        concerned: connections for which something may be done now, in the order in which it is.
        do: has an action done, after those so far.
    """

    now: float
    actions: list[act.Action]
    concerned: list[str]
    do: Callable[[act.Action], None]
    # A state refuses to be assigned to; this one is still in the making.
    __setattr__ = object.__setattr__

    @classmethod
    def of(cls, state: State, now: float) -> Draft:
        """Return a draft of what follows a state."""
        made, actions = cls.__new__(cls), list[act.Action]()
        vars(made).update(vars(state), now=now, actions=actions, concerned=[], do=actions.append)
        return made

    def finished(self) -> State:
        """Return the state as it is now."""
        made = State.__new__(State)
        values = vars(made)
        values.update(vars(self))
        del values["now"], values["actions"], values["concerned"], values["do"]
        return made

    def new_id(self) -> int:
        """Return an id that nothing has had before."""
        # Never given again: a late result names what it is about by it, and finds nothing where
        # that is gone.
        self.number += 1
        return self.number

    def put(self, record: ConnectionRecord, **changes: Any) -> ConnectionRecord:
        """Keep a connection with some changes, and return it."""
        changed = record._replace(**changes) if changes else record
        self.connections = self.connections.insert(record.id, changed)
        move, preferred = changed.move, changed.preferred
        if (move is not None and move.retry_at is not None) or (
            preferred is not None and preferred.look_at is not None
        ):
            self.timed = self.timed.insert(record.id)
        elif record.id in self.timed:
            self.timed = self.timed.remove(record.id)
        return changed

    def remove(self, record: ConnectionRecord) -> None:
        """Know a connection no more."""
        # One that was refused as it was requested was never there.
        self.connections = self.connections.discard(record.id)
        self.timed = self.timed.discard(record.id)

    def using(self, components: Iterable[int]) -> list[str]:
        """Return the connections of which a plan uses one of these, oldest first."""
        # Over the users of these alone: a death looks at no connection that it does not concern
        # (`test_growth.py`).
        users = {user for number in components for user in self.components[number].users}
        found = {connection_of(user) for user in users}
        there = (self.connections.get(identity) for identity in found)
        return [item.id for item in oldest_first(item for item in there if item is not None)]

    def publish(self, record: ConnectionRecord) -> None:
        """Have the new state of a connection shown at its handle, and announced."""
        self.do(act.Publish(record))
        self.announce(record, record.state.value, record.cause)

    def announce(self, record: ConnectionRecord, change: str, cause: str = "") -> None:
        """Have a change of a connection announced to the listeners."""
        function = record.wanted.function
        self.do(act.Announce(f"connection {record.id}", change, cause, function))

    def resolve(self, record: ConnectionRecord) -> None:
        """Have the first plan of a request sought, without what is avoided now."""
        function = record.wanted.function
        self.do(act.Resolve(record.waiter, record.id, function, self.avoided_lately()))

    def is_outdated(self, plan: Plan, candidates: int) -> bool:
        """Say whether a plan, found with earlier candidates, has one that is another by now.

        Of changes that are too long ago to be known, any plan may be.
        """
        # The search names the number with which it began: what was superseded since then is in the
        # last so many entries.
        missed = self.candidates - candidates
        if missed <= 0:
            return False
        since = self.replaced[-missed:]
        return len(since) < missed or any(name in others for others in since for name in plan.names)

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
        into: dict[str, list[tuple[Edge, int | None]]] = defaultdict(list)
        for edge in plan.edges:
            into[edge.consumer].append((edge, self._edge_for(edge, beside=beside)))
        # `plan.steps` has producers first, and consumers open first.
        ids = {step.component.name: self._use(step, user) for step in reversed(plan.steps)}
        provider = plan.provider.component.name
        # An application that keeps its provider keeps its ports: its inbox loses nothing and gets
        # nothing twice when only something upstream is replaced.
        so_far = record.current
        stays = so_far is not None and so_far.provider == ids[provider]
        ports = so_far.ports if so_far is not None and stays else self.new_id()
        parts = [Part(Kind.COMPONENT, id_) for id_ in ids.values()]
        outputs: dict[str, set[str]] = defaultdict(set)
        if record.output is not None:
            parts.append(Part(Kind.RECEIVE, ports))
            outputs[provider].add(record.output)
        edges: dict[str, list[int]] = defaultdict(list)
        # An output comes after every edge that it feeds, as its source delivers from the moment in
        # which it opens. The edges of a component open, and then the outputs that they come from.
        for name, id_ in ids.items():
            parts += [Part(Kind.OUTPUT, id_, port) for port in sorted(outputs[name])]
            for edge, joined in into[name]:
                outputs[edge.producer].add(edge.output)
                number = self._join(edge, joined, ids, user, record.validate)
                parts.append(Part(Kind.EDGE, number))
                edges[edge.producer].append(number)
        # Last: what the application sends finds all that it leads to.
        parts.append(Part(Kind.SEND, ports))
        self.concerned.append(record.id)
        fed = tuple(chain(*map(edges.__getitem__, plan.names)))  # producers first
        return Placement(user, plan, ids, ids[provider], fed, ports, tuple(parts))

    def unplace(self, placement: Placement, *, ports: bool = True) -> Parts:
        """Use the parts of a plan no more; return those that are without a user now.

        Args:
            placement: the plan.
            ports: whether the application ports end with it.
        """
        # What a batch has opened by now comes back with `Opened` and is closed as unused then; so
        # only parts that are open already are returned here.
        if self.batches:
            self._cancel(placement)
        components = self._leave_all(placement)  # first: what ends is not reported to be well
        edges, closed = self._part(placement, ports=ports)
        return Parts(components, edges, closed)

    def _cancel(self, placement: Placement) -> None:
        # One batch at most is a plan's own; another's may be opening some of its parts, too.
        for number in sorted({self.parts.get(part, 0) for part in placement.parts}):
            batch = self.batches.get(number)
            # Another connection's batch goes on for that one, and what of it is unused by then is
            # closed (`returns_lost.txt`).
            if batch is not None and batch.user == placement.user:
                self.do(act.CancelBatch(number))

    def start_draining(
        self, connection: str, placement: Placement, lost: tuple[int, ...], *, ports: bool
    ) -> Parts:
        """Use a plan for nothing but what is under way; return the parts that no other plan uses.

        Its edges, and its application ports where these end with it, end at once. Its components
        stay open until `end_draining`.
        """
        # It stays a user of its components, so that they stay open; but where another plan comes to
        # use one meanwhile, that one goes on when this has drained.
        plan = DrainingPlan(connection, placement, lost)
        self.draining = self.draining.insert(placement.user, plan)
        self._count_draining(placement, 1)
        edges, closed = self._part(placement, ports=ports)
        left = (n for n in _producers_first(placement) if self.components[n].only_drains)
        return Parts(tuple(left), edges, closed)

    def end_draining(self, user: str) -> tuple[DrainingPlan, Parts]:
        """Use the components of a plan no more, as nothing is under way; return those left."""
        ended = self.draining[user]
        self.draining = self.draining.remove(user)
        self._count_draining(ended.placement, -1)
        return ended, Parts(self._leave_all(ended.placement))

    def _count_draining(self, placement: Placement, more: int) -> None:
        for number in placement.components.values():
            record = self.components[number]
            record = record._replace(draining=record.draining + more)
            self.components = self.components.insert(number, record)

    def lose(self, lost: Iterable[int]) -> tuple[int, ...]:
        """Share components that died no more; return the edges that end with them."""
        dead = frozenset(lost)
        ended: set[int] = set()
        for component in dead:
            # Its users stay: what they lost with it is counted as each of them ends or moves.
            record = self.components[component]._replace(is_lost=True)
            self.components = self.components.insert(component, record)
            # By its number: of a name that was superseded another instance may serve, and lives
            # (`configured_abandoned.txt`).
            if self.serving.get(record.name) == component:
                self.serving = self.serving.remove(record.name)
            ended.update(joined.id for joined in self._edges_at(record))
        # Both ends at once, before any plan is sought: the next one that is placed would join an
        # edge from the dead (`both.txt`). Sorted, as a set has no order in which a log replays.
        for number in sorted(ended):
            self._unlist(self.edges[number])
        return tuple(sorted(ended))

    def _edges_at(self, component: ComponentRecord) -> Iterator[EdgeRecord]:
        """Yield the edges from and to a component: plans that use one use both its ends."""
        for user in component.users:
            record = self.connections.get(connection_of(user))
            placements = () if record is None else record.plans
            for placement in placements:
                if placement.user != user:
                    continue
                for number in placement.edges:
                    joined = self.edges[number]
                    if component.id in (joined.producer, joined.consumer):
                        yield joined

    def note_health(
        self, component: int, part: Hashable, health: Health, cause: str
    ) -> ComponentRecord:
        """Note the health of a part of a component, and announce it where that is news."""
        record = self.components[component]
        noted = record.health.noted(part, health, cause)
        if noted.is_news(record.health, health, cause):
            subject, function = f"component {record.name}", record.step.component.function
            self.do(act.Announce(subject, noted.health.value, noted.cause, function))
        record = record._replace(health=noted)
        self.components = self.components.insert(component, record)
        return record

    def failed_lately(self, but: Iterable[str]) -> OrderedMap[str, float]:
        """Return the components that died within the last minutes, longest ago first.

        Args:
            but: those that are left out.
        """
        # A map that shares all but a few names with that of the state: thousands may have died, and
        # as many connections seek.
        self.failed = failed = forget_earlier(self.failed, self.now)
        for name in but:
            failed = failed.discard(name)
        return failed

    def avoided_lately(self) -> AbstractSet[str]:
        """Return the components that are avoided now."""
        self.avoided = forget_earlier(self.avoided, self.now)
        return self.avoided.keys()

    def supersede(self, names: Iterable[str]) -> None:
        """Share components no more that are others in the configuration from now on.

        They keep their users; other edges may feed their consumers after a switchover.
        """
        for name in names:
            number = self.serving.get(name)
            if number is None:
                continue
            self.serving = self.serving.remove(name)
            record = self.components[number]._replace(is_superseded=True)
            self.components = self.components.insert(number, record)
            # Edges into it leave `feeding` with it: that is by name, and the next instance of a
            # name has inputs of its own. Edges out of it stay, as their consumers serve still.
            for joined in self._edges_at(record):
                if joined.consumer == number:
                    self._unlist(joined)

    def open(self, record: ConnectionRecord, parts: tuple[Part, ...]) -> None:
        """Have the missing parts of a connection's next plan opened, none of which is being so.

        It is concerned again when that is over, as are the others that use any of them.
        """
        move = record.move
        assert move is not None, "it is on its way to a plan"
        placement = move.next
        assert placement is not None, "there is a plan to open"
        # Of a request in its caller's lane, under its time limit; of members one after another.
        lane = f"switchover {move.group}" if move.group else record.waiter or placement.user
        # One action for all of them, however long the chain: it is one hop, one limit and one
        # event.
        batch = self.new_id()
        self.parts = self.parts.update(dict.fromkeys(parts, batch))
        self.batches = self.batches.insert(batch, Batch(placement.user, parts))
        # What takes commands again is named to do so once.
        used = placement.components.values() if self.recalled else ()
        recalled = tuple(number for number in used if number in self.recalled)
        for number in recalled:
            self.recalled = self.recalled.remove(number)
        is_receiving = not move.rule.is_beside
        self.do(act.Open(lane, batch, record.id, placement, parts, is_receiving, recalled))

    def await_batches(self, record: ConnectionRecord, batches: Iterable[int]) -> None:
        """Have a connection looked at again when each of these batches is over."""
        for number in batches:
            batch = self.batches[number]
            batch = batch._replace(waiting=batch.waiting.insert(record.id))
            self.batches = self.batches.insert(number, batch)

    def component_of(self, placement: Placement, part: Part) -> str:
        """Return the name of the component at which a part of a plan opens."""
        if part.kind in PORTS:
            return placement.plan.provider.component.name
        # Of an edge it is the consumer, whose input is opened.
        number = self.edges[part.id].consumer if part.kind is Kind.EDGE else part.id
        return self.components[number].name

    def settle(
        self, record: ConnectionRecord | None, batch: Batch, done: Collection[Part]
    ) -> Parts:
        """Note what became of a connection's batch that is over; return what is open and unused."""
        plans = () if record is None else record.plans
        # Mostly all is open, and the plan that it was opened for is there still, which uses it all.
        if len(done) == len(batch.parts) and any(plan.user == batch.user for plan in plans):
            return Parts()
        # What was used as the opening began may have lost its last user since. Ports are the
        # connection's own, and in no record: its two plans say which ids are in use.
        ports = () if record is None else record.ports
        used: dict[Kind, Container[int]] = {
            Kind.COMPONENT: self.components,
            Kind.OUTPUT: self.components,
            Kind.EDGE: self.edges,
            Kind.RECEIVE: ports,
            Kind.SEND: ports,
        }
        done = frozenset(done)
        # What was done and has a user is open from now on, as its batch is over.
        left = [part for part in batch.parts if part not in done or part.id not in used[part.kind]]
        for part in left:
            self.parts = self.parts.remove(part)
        unused = [part for part in left if part in done]
        return Parts(
            tuple(part.id for part in unused if part.kind is Kind.COMPONENT),
            tuple(part.id for part in unused if part.kind is Kind.EDGE),
            tuple({part.id for part in unused if part.kind in PORTS}),
        )

    def rivals(self, plan: Plan) -> dict[int, EdgeRecord]:
        """Return the edges that feed what a plan would feed from elsewhere, by their ids."""
        numbers = ((edge, self.feeding.get((edge.consumer, edge.input))) for edge in plan.edges)
        return {
            number: self.edges[number]
            for edge, number in numbers
            if number is not None and not self._is_origin(number, edge)
        }

    def switch_inputs(self, edges: Iterable[int]) -> tuple[tuple[int, int | None], ...]:
        """Let edges that are held take the places of others; return each with the other one.

        Raises:
            ResolutionError: another connection uses an edge that would end. Nothing has changed.
        """
        # Judged for all edges before the first is switched: either all inputs change or none.
        held = [self.edges[number] for number in dict.fromkeys(edges) if self.edges[number].is_held]
        pairs = [(joined, self.feeding.get(joined.key)) for joined in held]
        for joined, other in pairs:
            users = () if other is None else self.edges[other].users
            left = set(map(connection_of, users)) - set(map(connection_of, joined.users))
            if left:
                raise ResolutionError(
                    f"input {'.'.join(joined.key)} is fed for {', '.join(sorted(left))} by "
                    "another component still"
                )
        for joined, _ in pairs:
            self.beside = self.beside.remove(joined.key)
            self.feeding = self.feeding.insert(joined.key, joined.id)
            self.edges = self.edges.insert(joined.id, joined._replace(is_held=False))
        return tuple((joined.id, other) for joined, other in pairs)

    def _edge_for(self, edge: Edge, *, beside: bool) -> int | None:
        """Return the edge that is there already and does; None: a new one may be there.

        Raises:
            InputInUseError: none may.
        """
        key = edge.consumer, edge.input
        standing = self.feeding.get(key)
        if standing is None or self._is_origin(standing, edge):
            return standing
        # Beside the edge that feeds there is room for one more: of two plans that want to take the
        # place of a third, one is refused here and its switchover abandoned.
        waiting = self.beside.get(key)
        if beside and (waiting is None or self._is_origin(waiting, edge)):
            return waiting
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
        # An instance that only drains is taken over as it is: a device may be open once only, and
        # an application would get each message twice. One that is commanded was stopped when it was
        # replaced and refuses what comes, until the opening of the plan recalls it.
        name = step.component.name
        found = self.serving.get(name)
        if found is None:
            record = ComponentRecord(self.new_id(), step, NONE.insert(user))
            self.serving = self.serving.insert(name, record.id)
            trouble = self.troubled.get(step.component.bridge)
            if trouble is not None:
                health = record.health.noted("bridge", Health.DEGRADED, trouble)
                record = record._replace(health=health)
        else:
            record = self.components[found]
            if record.only_drains and _is_commanded(step.component):
                self.recalled = self.recalled.insert(record.id)
            record = record.used_by(record.users.insert(user))
        self.components = self.components.insert(record.id, record)
        return record.id

    def _join(
        self,
        edge: Edge,
        found: int | None,
        ids: Mapping[str, int],
        user: str,
        validate: ValidationMode,
    ) -> int:
        """Use the edge that is there already, or a new one in its place or beside it."""
        if found is not None:
            self._check_for(self.edges[found], user, validate)
            return found
        key = edge.consumer, edge.input
        is_held = key in self.feeding
        ends = ids[edge.producer], ids[edge.consumer]
        joined = EdgeRecord(self.new_id(), edge, *ends, is_held=is_held).used_by(user, validate)
        self.edges = self.edges.insert(joined.id, joined)
        if is_held:
            self.beside = self.beside.insert(key, joined.id)
        else:
            self.feeding = self.feeding.insert(key, joined.id)
        return joined.id

    def _check_for(self, joined: EdgeRecord, user: str, mode: ValidationMode | None) -> None:
        """Have an edge checked as its users wish, one of whom wishes this, or leaves."""
        changed = joined.used_by(user, mode)
        self.edges = self.edges.insert(joined.id, changed)
        # Only for a change: thousands may join an edge that is checked already (`changing.txt`).
        if changed.strictest is not joined.strictest:
            self.do(act.SetCheck(joined.id))

    def _part(
        self, placement: Placement, *, ports: bool
    ) -> tuple[tuple[int, ...], tuple[int, ...]]:
        """Use the edges of a plan no more, nor its ports where these end with it.

        Returns:
            Edges that are open and have no user now, and ports.
        """
        # One that is being opened is in no list here: `settle` returns it when its batch is over.
        edges = [edge for edge in placement.edges if self._part_edge(edge, placement.user)]
        edges = [edge for edge in edges if self._close_part(Part(Kind.EDGE, edge))]
        for kind in PORTS if ports else ():
            self._close_part(Part(kind, placement.ports))
        return tuple(edges), (placement.ports,) if ports else ()

    def _leave_all(self, placement: Placement) -> tuple[int, ...]:
        """Use the components of a plan no more; return those that have no user now."""
        left = _producers_first(placement)
        return tuple(number for number in left if self._leave(number, placement.user))

    def _part_edge(self, edge: int, user: str) -> bool:
        """Take a user of an edge back; True when it was the last."""
        joined = self.edges[edge]
        if len(joined.users) > 1:
            self._check_for(joined, user, None)
            return False
        # The input is free in this very step, for a plan that is placed next
        # (`configured_away.txt`).
        self._unlist(joined)
        self.edges = self.edges.remove(edge)
        return True

    def _unlist(self, joined: EdgeRecord) -> None:
        # By id: another edge may have taken its place at the input since.
        if self.feeding.get(joined.key) == joined.id:
            self.feeding = self.feeding.remove(joined.key)
        if self.beside.get(joined.key) == joined.id:
            self.beside = self.beside.remove(joined.key)
        # Where it is a native link nothing of it is taken in any more, nor left standing.
        for component, end in joined.ends:
            record = self.components.get(component)
            if record is not None and end in record.health.reported and not record.is_lost:
                self.note_health(component, end, Health.OK, "its native link has ended")

    def _leave(self, component: int, user: str) -> bool:
        """Take a user of a component back; True when it was the last."""
        record = self.components[component]
        users = record.users.remove(user)
        if users:
            self.components = self.components.insert(component, record.used_by(users))
            return False
        self.components = self.components.remove(component)
        self.recalled = self.recalled.discard(component) if self.recalled else self.recalled
        # Another instance of the name may serve by now.
        if self.serving.get(record.name) == component:
            self.serving = self.serving.remove(record.name)
        self._close_part(Part(Kind.COMPONENT, component))
        for output in record.step.component.outputs:
            self._close_part(Part(Kind.OUTPUT, component, output.name))
        return True

    def _close_part(self, part: Part) -> bool:
        """Forget a part that is open; one that is being opened is looked at when that is over."""
        batch = self.parts.get(part)
        if batch is None or batch in self.batches:
            return False
        self.parts = self.parts.remove(part)
        return True


def _producers_first(placement: Placement) -> tuple[int, ...]:
    return tuple(reversed(tuple(placement.components.values())))


def _is_commanded(component: Component) -> bool:
    """Say whether a component moves something: one that was replaced takes no commands any more."""
    return any(input_.endpoint.command is not None for input_ in component.inputs)


def by_age(connections: Iterable[str]) -> list[str]:
    """Return ids of connections, the oldest first: c9 before c10."""
    # By the record's number it would cost a look-up of each, and some have ended.
    return sorted(set(connections), key=lambda identity: (len(identity), identity))


def connection_of(user: str) -> str:
    """Return the id of the connection that a user of parts is."""
    return user.partition("#")[0]
