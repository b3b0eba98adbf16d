"""What happens to the control plane: what applications ask, and what became of its actions.

Frozen values without objects of bridges, so that a log of them can be kept and replayed: what
happened in the field becomes a test by pasting its log. There a plan is written as its function and
its components, by which it is found in the robot's configuration. An error is written as the name
of its class, its text and, where it has one, its reason.
"""

from __future__ import annotations

import json
from collections.abc import Hashable, Mapping
from enum import Enum
from typing import TypeAlias

import attrs
from attrs import frozen

from uoarm._control.engine.placement import Part
from uoarm.model import FailoverPolicy, Health, Plan, PortRef, ValidationMode


@frozen
class Requested:
    """An application asks for a function.

    Attributes:
        waiter: gets exactly one reply.
        plan: the one that is known already, None when it must be sought.
        has_callback: whether a callback waits for the messages.
        revision: of the configuration that the plan was found with.
        candidates: number of the candidates that it was found with.
    """

    connection: str
    wanted: PortRef
    validate: ValidationMode
    waiter: str
    # Resolving a plan that is known costs nothing, and an event less. It may be outdated when the
    # event is handled: then it is sought anew, as one that was found is (`Resolved`).
    plan: Plan | None = None
    has_callback: bool = False
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
        number: how many changes of candidates led to these, in one configuration.
        superseded: those before that are gone or are others; none of them is in use.
    """

    # Of those that are gone, too: an instance that runs on has its bridge's reports still.
    bridges: Mapping[str, str]
    summary: str
    number: int
    superseded: frozenset[str]


@frozen
class Killed:
    """A connection shall end.

    Attributes:
        waiter: gets exactly one reply, when everything is closed; empty: there is none.
        cause: why it failed, or what else killed it; empty for a kill by the application itself.
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
        error: why the others are not; None: all are.
    """

    # Exactly one for each `Open`: its parts count as being opened until then, by `State.batches`.
    batch: int
    # Also of a batch that was given up or that failed: what is open must be closed.
    done: tuple[Part, ...]
    error: BaseException | None = None


@frozen
class HealthReported:
    """A bridge noticed a change of health.

    Attributes:
        component: its name; None: the whole bridge.
        part: what of it: `bridge`, `component`, alone or with what of it was judged, role and port
            of a channel, a `LinkEnd`, or `messages`: what it raises, which the manager watches.
        spared: instances that were opened since then, at the bridge that followed.
        is_avoided: whether it emits too little or raises too often, which no bridge would notice:
            it is avoided for a while.
        function: of a service, of which no instance is open that would have it.
        instance: the one that it is about, and no other of the name; 0: the one that serves.
    """

    bridge: str
    health: Health
    cause: str
    component: str | None = None
    part: Hashable = "bridge"
    # By number and not by name: a report that comes late, after its bridge was started again, must
    # not be taken for one about the components that the new bridge has opened.
    spared: frozenset[int] = frozenset()
    is_avoided: bool = False
    function: str = ""
    instance: int = 0


@frozen
class Drained:
    """What was under way to an application has arrived, or took too long."""

    # It may have ended, or have another plan by now: the record says whether this matters still.
    connection: str


@frozen
class RanOut:
    """What was under way in a plan that was replaced has arrived, or took too long.

    Attributes:
        user: the name under which the plan used its parts.
    """

    # Exactly one for each `Finish`, whatever fails in it: until then it is in `State.draining`.
    user: str


@frozen
class Ended:
    """Everything that only this connection used is closed."""

    # Exactly one for each `Close` that ends a connection, whatever fails in it: who
    # waits for a kill waits for this.
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
    # A result of an earlier attempt is dropped: what it was sought for has changed.
    attempt: int
    plan: Plan | None
    error: str = ""
    switchover: int = 0
    candidates: int = 0


@frozen
class PreferredChecked:
    """A look whether the preferred plan of a connection is available has ended."""

    connection: str
    is_available: bool


@frozen
class InputsSwitched:
    """The inputs of a return changed hands; with an error they did not."""

    switchover: int
    error: str = ""


@frozen
class OffersWanted:
    """These functions are to be open in frameworks, and no others.

    Attributes:
        replaced: those that are offered otherwise from now on.
    """

    names: tuple[str, ...]
    replaced: frozenset[str] = frozenset()


@frozen
class OfferOpened:
    """An offer is open.

    Attributes:
        cause: why it is not; empty: it is.
    """

    name: str
    number: int
    cause: str = ""


@frozen
class OfferClosed:
    """What was open for an offer is closed."""

    name: str
    number: int


@frozen
class OfferReported:
    """A bridge reports of its side of an offer, or a connection behind it has ended.

    Attributes:
        number: of the opening that it is about.
    """

    name: str
    number: int
    health: Health
    cause: str


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
    | OffersWanted
    | OfferOpened
    | OfferClosed
    | OfferReported
    | TimeReached
    | Stopped
    | Configured
    | CandidatesChanged
)


def write_event(event: Event, now: float) -> str:
    """Return an event as one line of JSON."""
    fields = {field.name: _plain(getattr(event, field.name)) for field in attrs.fields(type(event))}
    return json.dumps({"at": now, "event": type(event).__name__, **fields})


def _plain(value: object) -> object:
    if isinstance(value, Plan):
        return [value.function, *(step.component.name for step in value.steps)]
    if isinstance(value, BaseException):
        reason = getattr(value, "reason", None)
        reports = [type(value).__name__, str(value)]
        return reports if reason is None else [*reports, _plain(reason)]
    if isinstance(value, PortRef):
        return [value.function, value.port]
    if isinstance(value, Enum):
        return value.value
    if isinstance(value, frozenset):  # sorted, so that equal events are equal lines
        return [_plain(item) for item in sorted(value)]
    if isinstance(value, tuple):
        return [_plain(item) for item in value]
    if isinstance(value, FailoverPolicy):
        return attrs.asdict(value)
    return value
