"""Why a connection moves from one plan to another, and what differs between the reasons.

A connection has the plan that is open and at most one move to another. The mechanisms are the same
for all: a plan is sought, placed and opened, takes over, and what was before drains and closes.
"""

from __future__ import annotations

from collections.abc import Mapping
from enum import Enum

from attrs import frozen

__all__ = ["RULES", "MoveReason", "MoveRule"]


class MoveReason(Enum):
    """Why the plan that is open is to be another one."""

    DEATH = "death"
    RETURN = "return"
    CONFIGURATION = "configuration"

    __hash__ = object.__hash__  # members are singletons


@frozen
class MoveRule:
    """What a reason of a move means for it.

    Attributes:
        called: what the move is, in a sentence.
        cause: the cause of the gap; empty: what died says it.
        is_beside: whether the plan before runs until what is new is open: inputs that it feeds
            change hands at once, for all who share them, and messages are counted up to then.
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
    is_beside: bool
    avoids_failed: bool
    is_owed: bool
    is_shared: bool
    may_stay: bool
    is_counted: bool
    remembers: bool


# The same table, in words, stands in docs/architecture.md.
RULES: Mapping[MoveReason, MoveRule] = {
    MoveReason.DEATH: MoveRule(
        called="its takeover",
        cause="",
        is_beside=False,
        avoids_failed=True,
        is_owed=False,
        is_shared=False,
        may_stay=False,
        is_counted=True,
        remembers=True,
    ),
    MoveReason.RETURN: MoveRule(
        called="its return",
        cause="its preferred components are available again",
        is_beside=True,
        avoids_failed=False,
        is_owed=False,
        is_shared=True,
        may_stay=False,
        is_counted=True,
        remembers=False,
    ),
    MoveReason.CONFIGURATION: MoveRule(
        called="its move",
        cause="the configuration was changed",
        is_beside=True,
        avoids_failed=True,
        is_owed=True,
        is_shared=False,
        may_stay=True,
        is_counted=False,
        remembers=False,
    ),
}
