"""Why a connection moves, through which phases, and what differs between the reasons: one table.

A connection has the plan that is open and at most one move to another. The mechanisms are the same
for all: a plan is sought, placed and opened, takes over, and what was before drains and closes.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from enum import Enum
from typing import NamedTuple

from attrs import frozen

from uoarm._control.engine.placement import Placement
from uoarm._support.ordered import OrderedMap
from uoarm.model import ConnectionState, FailoverPolicy

# For so long what failed is tried last, and what was avoided is done without.
_REMEMBERED_SECONDS = 300.0


class MoveReason(Enum):
    """Why the plan that is open is to be another one, or none."""

    REQUEST = "request"
    DEATH = "death"
    RETURN = "return"
    CONFIGURATION = "configuration"
    END = "end"

    __hash__ = object.__hash__  # members are singletons


class MovePhase(Enum):
    """How far a move is. Only a switching of inputs is interrupted by nothing."""

    SEEKING = "seeking"
    WAITING = "waiting"  # until it is time to seek again, or until others have moved away
    OPENING = "opening"
    SWITCHING = "switching"
    TAKING_OVER = "taking over"  # within one event: no state has it
    DRAINING = "draining"  # nothing is opened any more, and what is open closes

    __hash__ = object.__hash__


class OnOpenFailure(Enum):
    """What happens where the plan of a move cannot be opened."""

    SEEKS = "another plan is sought"
    STAYS = "all who move together stay where they are"
    CLOSES = "nothing is opened; what is open closes whatever goes wrong"

    __hash__ = object.__hash__


_ALONE = MovePhase.SEEKING, MovePhase.OPENING, MovePhase.TAKING_OVER
_TOGETHER = MovePhase.SEEKING, MovePhase.OPENING, MovePhase.SWITCHING, MovePhase.TAKING_OVER


@frozen
class MoveRule:
    """What a reason of a move means for it.

    Attributes:
        called: what the move is, in a sentence.
        cause: the cause of the gap; empty: what died says it.
        announced: the change that listeners get when the next plan has taken over; empty: they get
            the state in which the connection ends.
        patience: for how many seconds it waits: after a death for what can take over, before a
            return while its plan is there without a break.
        failing: what happens where its plan cannot be opened.
        phases: that it goes through, in their order; while it seeks it may have to wait.
        avoids_failed: whether what failed lately is tried last.
        is_owed: whether it is begun anew where it was disturbed, as a caller waits for it; else
            each looks for itself again.
        is_shared: whether who is about to move for it may join another move of the same input.
        may_stay: whether one that finds nothing other leaves the others to move without it; else
            all stay.
        is_counted: whether it counts for `failover.limit`, which ends what moves too often.
        remembers: whether the plan before is returned to.
    """

    called: str
    cause: str
    announced: str
    failing: OnOpenFailure
    phases: tuple[MovePhase, ...] = _ALONE
    patience: Callable[[FailoverPolicy], float] = lambda _: 0.0
    avoids_failed: bool = False
    is_owed: bool = False
    is_shared: bool = False
    may_stay: bool = False
    is_counted: bool = False
    remembers: bool = False

    @property
    def is_beside(self) -> bool:
        """Whether the plan before runs until what is new is open.

        Inputs that it feeds change hands at once, for all who share them, and messages are counted
        up to then.
        """
        return MovePhase.SWITCHING in self.phases


# docs/control-plane.md says it in words.
RULES: Mapping[MoveReason, MoveRule] = {
    MoveReason.REQUEST: MoveRule(
        called="its request",
        cause="",
        announced="running",
        failing=OnOpenFailure.SEEKS,
    ),
    MoveReason.DEATH: MoveRule(
        called="its takeover",
        cause="",
        announced="replaced",
        failing=OnOpenFailure.SEEKS,
        patience=lambda policy: policy.wait,
        avoids_failed=True,
        is_counted=True,
        remembers=True,
    ),
    MoveReason.RETURN: MoveRule(
        called="its return",
        cause="its preferred components are available again",
        announced="replaced",
        failing=OnOpenFailure.STAYS,
        patience=lambda policy: policy.return_after or 0.0,
        phases=_TOGETHER,
        is_shared=True,
        is_counted=True,
    ),
    MoveReason.CONFIGURATION: MoveRule(
        called="its move",
        cause="the configuration was changed",
        announced="replaced",
        failing=OnOpenFailure.STAYS,
        phases=_TOGETHER,
        avoids_failed=True,
        is_owed=True,
        may_stay=True,
    ),
    MoveReason.END: MoveRule(
        called="its end",
        cause="",
        announced="",
        failing=OnOpenFailure.CLOSES,
        phases=(MovePhase.DRAINING,),
    ),
}


class Move(NamedTuple):
    """On the way from the plan that is open to another one, or to none.

    Attributes:
        reason: what it is for; `RULES` says what follows from that.
        since: when it began; after a death, when that was noticed: messages are lost since then.
        cause: as the status and the gap show it.
        next: the plan that is being opened; None before there is one.
        group: id of the switchover in which it moves together with others; 0: alone.
        lost: ids of components that died. In a switchover, of those that did while the inputs
            change hands, after which they are replaced.
        dead: names of what may come back: all of a dead bridge.
        excluded: names that cannot take over: the dead, and those that failed to open.
        retry_at: while it waits: when to search again.
        outcome: of an end: how it ends.
        killer: of an end: the caller that waits for it; empty: none.
        error: of an end: what the request fails with, where that is more than the cause.
    """

    reason: MoveReason
    phase: MovePhase
    since: float
    cause: str = ""
    next: Placement | None = None
    # Where it is not 0, the connection is a member of that switchover. One that ended while the
    # inputs changed hands is still listed there, and passed over.
    group: int = 0
    lost: tuple[int, ...] = ()
    dead: frozenset[str] = frozenset()
    excluded: frozenset[str] = frozenset()
    retry_at: float | None = None
    outcome: ConnectionState = ConnectionState.CLOSED
    killer: str = ""
    error: BaseException | None = None

    @property
    def rule(self) -> MoveRule:
        """What its reason means."""
        return RULES[self.reason]

    @property
    def has_lost(self) -> bool:
        """Whether something died that it replaces, at once or after the switchover."""
        return self.reason is MoveReason.DEATH or bool(self.lost)

    def as_death(self) -> Move:
        """Return the move that replaces, alone, what was lost during this one."""
        return self._replace(reason=MoveReason.DEATH, phase=MovePhase.SEEKING, next=None, group=0)


def forget_earlier(times: OrderedMap[str, float], now: float) -> OrderedMap[str, float]:
    """Return times without those longer ago than is remembered: names come and go for ever.

    Args:
        times: in their own order, which is why a name that is set anew is the last.
        now: the time.
    """
    # The first is the oldest: this costs what it forgets, however many are kept.
    while times and times[oldest := times.first()] < now - _REMEMBERED_SECONDS:
        times = times.discard(oldest)
    return times


def recently(times: Mapping[str, float], now: float) -> frozenset[str]:
    """Return what happened within the last five minutes."""
    if not times:
        return frozenset()
    # All are looked at: who only reads, in any thread, finds also what no event has forgotten yet.
    return frozenset(name for name, time in times.items() if time >= now - _REMEMBERED_SECONDS)
