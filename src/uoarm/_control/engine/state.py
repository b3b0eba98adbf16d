"""What the control plane knows: frozen values, of which `step` makes the next."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import NamedTuple

from attrs import define, field, frozen, setters
from rpds import HashTrieMap, HashTrieSet

from uoarm._control.engine.move import RULES, Move, MoveReason, MoveRule
from uoarm._control.engine.placement import (
    NONE,
    NOTHING,
    Batch,
    ComponentHealth,
    ComponentRecord,
    DrainingPlan,
    EdgeRecord,
    Part,
    Placement,
)
from uoarm._support.ordered import OrderedMap
from uoarm.model import (
    ConnectionState,
    FailoverPolicy,
    OfferState,
    Plan,
    PortRef,
    ValidationMode,
)

# Of a cause that names components; thousands may die with one bridge.
_LISTED = 8


class Preference(NamedTuple):
    """The plan to which a connection returns when it is there again.

    Attributes:
        plan: the first one that was lost.
        available_since: when it was seen first without a break; None: it is not there.
        look_at: when to look for it.
        is_looking: whether a look for it is under way.
    """

    plan: Plan
    available_since: float | None = None
    look_at: float | None = None
    is_looking: bool = False

    def unseen(self) -> Preference:
        """Return it as not there, and with no look due."""
        return self._replace(available_since=None, look_at=None)


class ConnectionRecord(NamedTuple):
    """One request, from asking to end.

    Attributes:
        id: `c1`, `c2`, ...
        wanted: the function, and the output where one is named.
        waiter: the caller that waits for the reply to the request; empty: none any more.
        state: as it was published last, and `cause`.
        has_callback: whether a callback waits for the messages, so that there must be an output.
        output: of the provider, whose messages the application receives.
        current: the plan that is open, or was until the end; None before the first one is.
        move: on the way to another plan, or to the end; None: it stays.
        attempt: counts plans and searches, so that a late result is known as such.
        preferred: what it returns to when that is there again.
        changes: when its plan changed within the last minute.
        finished: why it ends when all that is under way has arrived; empty: it does not.
        number: of its request; the oldest has the lowest.
    """

    id: str
    wanted: PortRef
    validate: ValidationMode
    # Emptied with the one `Reply` to the request, so that there never is a second one.
    waiter: str
    state: ConnectionState = ConnectionState.OPENING
    cause: str = ""
    has_callback: bool = False
    output: str | None = None
    current: Placement | None = None
    # One at most: another reason takes the place of the one so far, or waits for its end. It is
    # None only in a connection that runs.
    move: Move | None = None
    # Grows with each search and each plan that is given up. A result with an earlier number is
    # dropped (`step`), and parts of an abandoned plan belong to a user that no plan has any more.
    attempt: int = 1
    preferred: Preference | None = None
    changes: tuple[float, ...] = ()
    # Set once and never taken back: a source that has finished is not played again. No move of its
    # own, since what dies until all has arrived is replaced still.
    finished: str = ""
    number: int = 0

    @property
    def next(self) -> Placement | None:
        """The plan that is being opened."""
        return None if self.move is None else self.move.next

    @property
    def reason(self) -> MoveReason | None:
        """Why it moves; None: it does not."""
        return None if self.move is None else self.move.reason

    @property
    def plans(self) -> tuple[Placement, ...]:
        """The plans whose parts should be open: none when it ends."""
        if self.state is ConnectionState.CLOSING:
            return ()
        return tuple(filter(None, (self.current, self.next)))

    @property
    def has_plan(self) -> bool:
        """Whether a plan is open, or being opened: none is while the first one is sought."""
        return self.current is not None or self.next is not None

    @property
    def is_killed(self) -> bool:
        """Whether it ends because it was killed, so that what waits is not read."""
        move = self.move
        return move is not None and bool(move.killer) and move.outcome is ConnectionState.CLOSED

    @property
    def is_active(self) -> bool:
        """Whether it runs, or waits for what can take over."""
        return self.state in {ConnectionState.RUNNING, ConnectionState.WAITING}

    @property
    def ports(self) -> tuple[int, ...]:
        """Ids of its application ports; none when it ends."""
        return tuple(plan.ports for plan in self.plans)

    @property
    def placement(self) -> Placement:
        """The plan that runs, with its parts; before the first one does, that one."""
        placement = self.current or self.next
        assert placement is not None, "only a request that is being resolved has no plan"
        return placement

    @property
    def components(self) -> tuple[str, ...]:
        """The names of its components; while it waits, those that are left."""
        lost = self.move.lost if self.move is not None else ()
        waits = self.state is ConnectionState.WAITING
        ids = self.placement.components
        return tuple(
            name for name in self.placement.plan.names if not (waits and ids[name] in lost)
        )


@frozen
class Switchover:
    """Connections that change to better plans at once, since an input has one producer.

    Attributes:
        members: connections by id, with the plan found for each, None while it is sought.
        unsought: those whose plan is to be sought, the one that is sought first.
        began: when the messages of the plans so far are counted to.
        joined: users of edges that plans of members take the places of, who are members, too.
        unopened: members whose plans are placed and not open as a whole.
        reason: why the plans are better.
        is_switching: whether the inputs are changing hands, which nothing interrupts.
    """

    id: int
    members: OrderedMap[str, Plan | None]
    unsought: OrderedMap[str, None]
    began: float
    reason: MoveReason
    # Of an edge that thousands use, each member's plan would name all of them once more.
    joined: HashTrieMap[int, Mapping[str, ValidationMode]] = NOTHING
    unopened: HashTrieSet[str] = NONE
    # From `SwitchInputs` to `InputsSwitched`. Meanwhile the state says that the new edges feed,
    # and the objects may not yet: neither a death nor a change may undo what is half done.
    is_switching: bool = False

    @property
    def rule(self) -> MoveRule:
        """What that reason means."""
        return RULES[self.reason]


class OfferRecord(NamedTuple):
    """That one function is open in a framework: a want of the manager itself.

    Attributes:
        state: as the status shows it, and `cause`.
        number: id of what is open, opens or closes; 0: nothing.
        is_busy: whether it opens, or closes.
        is_tried: whether the first attempt is over.
        is_wanted: whether it is to be open; else it closes and goes.
        is_renewed: whether it begins anew then, as the configuration has another of the name.
        ended: what it is over for, and why: OPENING where it broke, FINISHED.
        failures: attempts in a row that failed, or did not last.
        begun: when it was opened last.
        retry_at: when it is to be opened; None: no time changes anything.
    """

    name: str
    state: OfferState = OfferState.OPENING
    cause: str = ""
    number: int = 0
    is_open: bool = False
    is_busy: bool = False
    is_tried: bool = False
    is_wanted: bool = True
    is_renewed: bool = False
    ended: tuple[OfferState, str] | None = None
    failures: int = 0
    begun: float = 0.0
    retry_at: float | None = None

    @property
    def shown(self) -> tuple[str, str]:
        """What listeners learn: the state, and its cause where something is wrong."""
        return self.state.value, "" if self.state is OfferState.OPEN else self.cause


# Persistent maps: an event makes new ones that share with those before all that it did not touch,
# so that it costs what it touches. Threads that read see one state, from which nothing vanishes.
# They have no order; where one matters, it is by the numbers in the records.
@define(slots=False, on_setattr=setters.frozen)
class State:
    """Everything. Only a `Draft`, which is the next state in the making, can be assigned to.

    Attributes:
        policy: whether, how often, and whether to return.
        bridges: the bridge of each component of the configuration.
        troubled: why a whole bridge is degraded, by its name.
        parts: with the batch that opens each; where that is over, the part is open.
        serving: the instance of each component that new users share.
        services: how components are that are called and not well, by name: nothing of them is open.
        feeding: the edge that feeds each input.
        beside: the edge that will, after a switchover.
        batches: what is being opened, by number.
        draining: what was replaced and is open still, by the user of its parts.
        recalled: components that only drained, refuse commands since, and are used again.
        timed: connections that may wait for a time.
        failed: when a component died last, longest ago first.
        avoided: the same for those that emitted too little or raised too often.
        number: the last id given.
        is_closing: whether no request is taken any more.
        closers: callers that wait until every connection has ended.
        outdated: connections whose plan may be another in this revision.
        configurers: callers that wait until all those have moved.
        candidates: how many changes of candidates there were in this revision.
        replaced: the candidates that were superseded by the last of these, newest last.
        offers: what the manager keeps open in frameworks, and what of that closes, by name.
        due: offers that wait for a time.
        leaving: offers that are wanted no more, and close.
    """

    policy: FailoverPolicy
    bridges: Mapping[str, str]
    troubled: HashTrieMap[str, str] = NOTHING
    # The invariants below are checked after each event by `World.check` in tests/control/world.py.
    # Of several that may be meant, the oldest acts first.
    connections: HashTrieMap[str, ConnectionRecord] = NOTHING
    # An instance is here as long as it has a user: a running, an opening or a draining plan.
    components: HashTrieMap[int, ComponentRecord] = NOTHING
    edges: HashTrieMap[int, EdgeRecord] = NOTHING
    # A part is in one batch at most, and none is opened that is open or being opened.
    parts: HashTrieMap[Part, int] = NOTHING
    # One instance a name. One that died or was superseded leaves at once, though its users stay.
    serving: HashTrieMap[str, int] = NOTHING
    services: HashTrieMap[str, ComponentHealth] = NOTHING
    # One edge an input, from a producer that lives to the instance that serves.
    feeding: HashTrieMap[tuple[str, str], int] = NOTHING
    beside: HashTrieMap[tuple[str, str], int] = NOTHING
    batches: HashTrieMap[int, Batch] = NOTHING
    draining: HashTrieMap[str, DrainingPlan] = NOTHING
    switchovers: HashTrieMap[int, Switchover] = NOTHING
    # From the plan that uses one again to the opening that lets commands through again.
    recalled: HashTrieSet[int] = NONE
    # Kept by `Draft.put`: all that wait to search or look again, and no other.
    timed: HashTrieSet[str] = NONE
    # Their order is that of the times: a name that is set anew is the last.
    failed: OrderedMap[str, float] = field(factory=OrderedMap)
    avoided: OrderedMap[str, float] = field(factory=OrderedMap)
    requests: int = 0
    # Counts on over everything that is numbered: no id of an object is ever given again.
    number: int = 0
    is_closing: bool = False
    closers: tuple[str, ...] = ()
    revision: int = 0
    # These two are settled together, in `switchover.continue_reconfiguration`.
    outdated: HashTrieSet[str] = NONE
    configurers: tuple[str, ...] = ()
    candidates: int = 0
    replaced: tuple[frozenset[str], ...] = ()
    offers: HashTrieMap[str, OfferRecord] = NOTHING
    # Kept as offers are: a look at all of them for each one that opens would be quadratic.
    due: HashTrieSet[str] = NONE
    leaving: HashTrieSet[str] = NONE

    def shared(self) -> tuple[ComponentRecord, ...]:
        """Return the instances that new users share, without those that only drain."""
        records = (self.components[number] for number in sorted(self.serving.values()))
        return tuple(record for record in records if not record.only_drains)


def oldest_first(records: Iterable[ConnectionRecord]) -> list[ConnectionRecord]:
    """Return connections in the order of their requests."""
    return sorted(records, key=lambda record: record.number)


def listed(names: Sequence[str]) -> str:
    """Return the first of several names, and how many more there are.

    Of a bridge that dies with thousands, each connection's cause would name them all.
    """
    shown = ", ".join(map(repr, names[:_LISTED]))
    return f"{shown} and {len(names) - _LISTED} more" if len(names) > _LISTED else shown
