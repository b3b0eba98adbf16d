"""What the control plane is told: what applications ask, and what became of its actions.

Frozen values without objects of bridges, so that a trace of them can be kept and replayed.
"""

from __future__ import annotations

from collections.abc import Hashable, Mapping
from typing import TypeAlias

from attrs import frozen

from uoarm._control.reconciler.state import Part
from uoarm.model import FailoverPolicy, Health, Plan, PortRef, ValidationMode

__all__ = [
    "CandidatesChanged",
    "Configured",
    "Drained",
    "Ended",
    "Event",
    "HealthReported",
    "InputsSwitched",
    "Killed",
    "Opened",
    "PreferredChecked",
    "RanOut",
    "ReplacementSought",
    "Requested",
    "Resolved",
    "Stopped",
    "TimeReached",
]


@frozen
class Requested:
    """An application asks for a function.

    Attributes:
        waiter: gets exactly one reply.
        plan: the one that is known already, None when it must be sought.
        is_heard: whether a callback waits for the messages.
        revision: of the configuration that the plan was found with.
        candidates: number of the candidates that it was found with.
    """

    connection: str
    wanted: PortRef
    validate: ValidationMode
    waiter: str
    plan: Plan | None = None
    is_heard: bool = False
    revision: int = 0
    candidates: int = 0


@frozen
class Resolved:
    """The search for the plan of a request is over.

    Attributes:
        revision: of the configuration in which the search began.
        candidates: number of the candidates with which it began.
    """

    connection: str
    plan: Plan | None
    error: BaseException | None = None
    revision: int = 0
    candidates: int = 0


@frozen
class Configured:
    """The configuration was replaced by another, which was checked.

    Attributes:
        revision: its number.
        waiter: gets one reply, when every connection has moved that can.
        policy: for failover from now on.
        bridges: the bridge of each component.
        superseded: components that are gone or are others from now on, as are those of a bridge
            that is another.
        functions: those for which a request may get another plan now.
    """

    revision: int
    waiter: str
    policy: FailoverPolicy
    bridges: Mapping[str, str]
    superseded: frozenset[str]
    functions: frozenset[str]


@frozen
class CandidatesChanged:
    """Discovered components became candidates, or are none any more. No connection moves for it.

    Attributes:
        bridges: the bridge of each component, those that are no candidates any more included.
        told: what is different.
        number: how many changes of candidates led to these, in one configuration.
        superseded: those before that are gone or are others; none of them is in use.
    """

    bridges: Mapping[str, str]
    told: str
    number: int
    superseded: frozenset[str]


@frozen
class Killed:
    """A connection shall end.

    Attributes:
        waiter: gets exactly one reply, when everything is closed; empty: nobody.
        cause: why it failed, or who else killed it; empty for a kill by the application itself.
        is_failure: whether it ends as failed, which is no kill.
    """

    connection: str
    waiter: str
    cause: str = ""
    is_failure: bool = False


@frozen
class Opened:
    """A batch of parts is open, or one of them could not be opened.

    Attributes:
        done: those that are open.
        error: why the others are not; None: all are.
    """

    batch: int
    done: tuple[Part, ...]
    error: BaseException | None = None


@frozen
class HealthReported:
    """A bridge noticed a change of health.

    Attributes:
        component: its name; None: the whole bridge.
        part: what of it: `bridge`, `component`, role and port of a channel, or `messages`: what
            it raises, which the manager watches itself.
        spared: instances that were opened since then, at the bridge that followed.
        is_avoided: whether it emits too little or raises too often, which no bridge would notice:
            it is avoided for a while.
        function: of a service, of which nothing is open that could tell.
    """

    bridge: str
    health: Health
    cause: str
    component: str | None = None
    part: Hashable = "bridge"
    spared: frozenset[int] = frozenset()
    is_avoided: bool = False
    function: str = ""


@frozen
class Drained:
    """What was under way to an application has arrived, or took too long."""

    connection: str


@frozen
class RanOut:
    """What was under way in a plan that was replaced has arrived, or took too long.

    Attributes:
        user: the name under which the plan used its parts.
    """

    user: str


@frozen
class Ended:
    """Everything that only this connection used is closed."""

    connection: str


@frozen
class ReplacementSought:
    """The search for a plan that can take over is over.

    Attributes:
        attempt: of the connection, as it was when the search began.
        switchover: id of the switchover that it is for; 0: it is for a failover.
        candidates: number of the candidates with which it began.
    """

    connection: str
    attempt: int
    plan: Plan | None
    error: str = ""
    switchover: int = 0
    candidates: int = 0


@frozen
class PreferredChecked:
    """Somebody has looked whether the preferred plan of a connection is available."""

    connection: str
    is_available: bool


@frozen
class InputsSwitched:
    """The inputs of a return changed hands; with an error they did not."""

    switchover: int
    error: str = ""


@frozen
class TimeReached:
    """The time has come that was asked for."""


@frozen
class Stopped:
    """The manager shall close.

    Attributes:
        waiter: gets one reply, when every connection has ended.
    """

    waiter: str


Event: TypeAlias = (
    Requested
    | Resolved
    | Killed
    | Opened
    | HealthReported
    | Drained
    | RanOut
    | Ended
    | ReplacementSought
    | PreferredChecked
    | InputsSwitched
    | TimeReached
    | Stopped
    | Configured
    | CandidatesChanged
)
