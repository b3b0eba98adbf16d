"""What the control plane is told: what applications ask, and what became of its actions.

Frozen values without objects of bridges, so that a trace of them can be kept and replayed.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Hashable, Mapping
from enum import Enum
from typing import Any, TypeAlias, get_args

import attrs
from attrs import frozen

from uoarm._control.engine.state import Kind, Part
from uoarm.errors import BridgeError, FailureReason, UoarmError
from uoarm.model import FailoverPolicy, FailureLimits, Health, Plan, PortRef, Role, ValidationMode

__all__ = [
    "CandidatesChanged",
    "Configured",
    "Drained",
    "Ended",
    "Event",
    "FindPlan",
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
    "read_event",
    "write_event",
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

_EVENTS: Mapping[str, Callable[..., Event]] = {kind.__name__: kind for kind in get_args(Event)}

FindPlan = Callable[[str, tuple[str, ...]], Plan]
"""Returns the plan of a function that consists of these components, producers first."""


def write_event(event: Event, now: float) -> str:
    """Return an event as one line of JSON."""
    fields = {field.name: _plain(getattr(event, field.name)) for field in attrs.fields(type(event))}
    return json.dumps({"at": now, "event": type(event).__name__, **fields})


def read_event(line: str, find_plan: FindPlan) -> tuple[Event, float]:
    """Return the event of a line that `write_event` made, and its time.

    Raises:
        KeyError: there is no such event.
    """
    said: dict[str, Any] = json.loads(line)
    now, kind = said.pop("at"), said.pop("event")
    readers: dict[str, Callable[[Any], object]] = dict(_READERS)
    readers["plan"] = lambda told: _plan(told, find_plan)
    values = {name: readers.get(name, _same)(value) for name, value in said.items()}
    make: Callable[..., Event] = _EVENTS[kind]
    return make(**values), now


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
    if isinstance(value, frozenset):
        return [_plain(item) for item in sorted(value)]
    if isinstance(value, tuple):
        return [_plain(item) for item in value]
    if isinstance(value, FailoverPolicy):
        return attrs.asdict(value)
    return value


def _plan(told: list[str] | None, find_plan: FindPlan) -> Plan | None:
    return None if told is None else find_plan(told[0], tuple(told[1:]))


def _error(told: list[str] | str | None) -> BaseException | str | None:
    if not isinstance(told, list):
        return told
    name, text, *reason = told
    kind = _error_class(name)
    made = kind.__new__(kind)  # its own __init__ may want what the log does not have
    made.args = (text,)
    for word in reason:
        vars(made)["reason"] = FailureReason(word) if isinstance(made, BridgeError) else word
    return made


def _error_class(name: str) -> type[BaseException]:
    """Return the error of uoarm or of a plugin that has this name; a stand-in where there is none.

    Only what is imported already is found: no line of a log has anything imported.
    """
    kinds: list[type[BaseException]] = [UoarmError]
    for kind in kinds:
        if kind.__name__ == name:
            return kind
        kinds += kind.__subclasses__()
    return type(name, (Exception,), {})


def _part(told: list[str] | str) -> object:
    return told if isinstance(told, str) else (Role(told[0]), told[1])


def _same(value: object) -> object:
    return value


_READERS: Mapping[str, Callable[[Any], object]] = {
    "wanted": lambda told: PortRef(*told),
    "validate": ValidationMode,
    "health": Health,
    "error": _error,
    "part": _part,
    "done": lambda told: tuple(Part(Kind(kind), *rest) for kind, *rest in told),
    "spared": frozenset,
    "policy": lambda told: FailoverPolicy(**{**told, "failing": FailureLimits(**told["failing"])}),
    "superseded": frozenset,
    "functions": frozenset,
}
