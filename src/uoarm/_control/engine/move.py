"""Why a connection moves, through which phases, and what differs between the reasons: one table.

A connection has the plan that is open and at most one move to another. The mechanisms are the same
for all: a plan is sought, placed and opened, takes over, and what was before drains and closes.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from enum import Enum

from attrs import frozen

from uoarm._support.ordered import OrderedMap
from uoarm.model import FailoverPolicy

__all__ = [
    "RULES",
    "MovePhase",
    "MoveReason",
    "MoveRule",
    "OnOpenFailure",
    "forget_earlier",
    "recently",
]

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

    ENDS = "the connection ends with the error"
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
        failing=OnOpenFailure.ENDS,
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
