"""What the control plane has done: calls into bridges, each in a lane, and quick steps of our own.

The actions of one lane are done one after another, in the order given; lanes know nothing of each
other. What needs to come after something else is asked for only when that is done.
"""

from __future__ import annotations

from typing import TypeAlias

from attrs import frozen

from uoarm._control.engine.state import ConnectionRecord, Part, Parts, Placement
from uoarm.model import Plan

__all__ = [
    "Action",
    "Adopt",
    "Announce",
    "CallAction",
    "CancelBatch",
    "CheckPreferred",
    "Close",
    "Drain",
    "FindReplacement",
    "Finish",
    "Forget",
    "HandOver",
    "Listen",
    "LocalAction",
    "Open",
    "Publish",
    "Release",
    "Reply",
    "Resolve",
    "RetireBridge",
    "SetCheck",
    "Stop",
    "SwitchInputs",
    "WakeAt",
    "Warn",
]


@frozen
class Resolve:
    """Look for the plan of a request; comes back as `Resolved`.

    Attributes:
        avoided: components to do without, where anything else can do.
    """

    lane: str
    connection: str
    function: str
    avoided: frozenset[str]


@frozen
class Open:
    """Open parts in this order, up to the first that fails; comes back as `Opened`.

    Attributes:
        is_heard: whether the application hears a new provider from its first message on, else
            from `HandOver`.
    """

    lane: str
    batch: int
    connection: str
    placement: Placement
    parts: tuple[Part, ...]
    is_heard: bool


@frozen
class Close:
    """Close what an end or an opening in vain leaves behind.

    Attributes:
        placement: whose losses are counted with it; those of one that ran out since it was
            replaced.
        lost: components of it that died: what was under way in them is lost.
        ends: whether the connection has ended: comes back as `Ended`.
    """

    lane: str
    connection: str
    parts: Parts
    placement: Placement | None = None
    lost: tuple[int, ...] = ()
    ends: bool = False


@frozen
class Finish:
    """Let what is under way in a plan that was replaced arrive; comes back as `RanOut`.

    Attributes:
        parts: edges and application ports to be closed then, and components, to be drained, which
            nobody else uses.
        lost: components of the plan that died.
    """

    lane: str
    connection: str
    parts: Parts
    placement: Placement
    lost: tuple[int, ...]


@frozen
class Drain:
    """Wait until what is under way has reached the application; comes back as `Drained`."""

    lane: str
    connection: str
    placement: Placement


@frozen
class FindReplacement:
    """Look for a plan that the application cannot tell from its own; `ReplacementSought`.

    Attributes:
        excluded: components that may not be used.
        failed: components to do without, where anything else can do, longest failed first.
        avoided: the same, all at once.
    """

    lane: str
    connection: str
    attempt: int
    plan: Plan
    output: str | None
    excluded: frozenset[str]
    failed: tuple[str, ...]
    avoided: frozenset[str]
    switchover: int = 0


@frozen
class CheckPreferred:
    """See whether a plan is what a request would get now; comes back as `PreferredChecked`."""

    lane: str
    connection: str
    plan: Plan
    avoided: frozenset[str]


@frozen
class SwitchInputs:
    """Let edges that are held feed their inputs in place of others; `InputsSwitched`.

    Attributes:
        edges: ids, each with the one whose place it takes, if there is one.
    """

    lane: str
    switchover: int
    edges: tuple[tuple[int, int | None], ...]


@frozen
class Release:
    """Close components before what takes their place is opened, as one of them can be open only.

    Attributes:
        components: ids; what they lose is counted when their plans end.
    """

    lane: str
    components: tuple[int, ...]


@frozen
class Publish:
    """Show a connection as it is from now on, to whoever holds its handle."""

    record: ConnectionRecord


@frozen
class Announce:
    """Tell the listeners of a change, with the function concerned, where there is one."""

    subject: str
    change: str
    cause: str = ""
    function: str = ""


@frozen
class Reply:
    """Wake whoever waits for a request or a kill."""

    waiter: str
    error: BaseException | None = None


@frozen
class HandOver:
    """Let the application hear the next plan and no other, and note the gap.

    Attributes:
        lane: where it is done when that may call the application: see `is_heard`.
        is_heard: whether the application hears the next plan already, from when it was opened;
            otherwise it may get a retained message now.
        record: the connection from then on, for who sees the gap before it is published.
        since: when messages ceased.
        time: of the change.
    """

    lane: str
    connection: str
    before: Placement
    after: Placement
    is_heard: bool
    record: ConnectionRecord
    since: float
    time: float
    cause: str


@frozen
class Listen:
    """Let the application hear the application ports of this id again."""

    connection: str
    ports: int


@frozen
class Stop:
    """Let nothing more through these edges, so that what each of them had counted stands."""

    edges: tuple[int, ...]


@frozen
class SetCheck:
    """Check the messages of an edge as its strictest user wishes now."""

    edge: int


@frozen
class CancelBatch:
    """Begin to open no further part of a batch."""

    batch: int


@frozen
class Forget:
    """Ask for the structures of these components again the next time."""

    components: tuple[str, ...]


@frozen
class RetireBridge:
    """Close a bridge that was lost."""

    bridge: str


@frozen
class Adopt:
    """Resolve with this revision of the configuration, and start bridges as it says."""

    revision: int


@frozen
class WakeAt:
    """Tell when this time is reached."""

    time: float


@frozen
class Warn:
    """Write to the log what no caller and no listener gets."""

    connection: str
    text: str


CallAction: TypeAlias = (
    Resolve
    | Open
    | Close
    | Finish
    | Drain
    | FindReplacement
    | CheckPreferred
    | SwitchInputs
    | Release
)
LocalAction: TypeAlias = (
    Publish
    | Announce
    | Reply
    | HandOver
    | Listen
    | Stop
    | SetCheck
    | CancelBatch
    | Forget
    | RetireBridge
    | Adopt
    | WakeAt
    | Warn
)
Action: TypeAlias = CallAction | LocalAction
