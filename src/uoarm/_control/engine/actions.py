"""What the control plane has done: calls into bridges, each in a lane, and quick steps of our own.

The actions of one lane are done one after another, in the order given; lanes know nothing of each
other. What needs to come after something else is asked for only when that is done.
What a call is about is taken from the state as it is asked for: by the time that it is done, the
state may have forgotten it.
"""

from __future__ import annotations

from collections.abc import Collection
from collections.abc import Set as AbstractSet
from typing import TypeAlias

from attrs import frozen

from uoarm._control.engine.placement import Part, Parts, Placement
from uoarm._control.engine.state import ConnectionRecord
from uoarm._support.ordered import OrderedMap
from uoarm.model import Plan


@frozen
class Resolve:
    """Look for the plan of a request; comes back as `Resolved`.

    Attributes:
        avoided: components to do without, where anything else can do.
    """

    # That of the request, which its caller's thread drives: so resolving and opening are one call
    # under one time limit. Searches of connections that run have lanes of their own, by attempt.
    lane: str
    connection: str
    function: str
    avoided: AbstractSet[str]


@frozen
class Open:
    """Open parts in this order, up to the first that fails; comes back as `Opened`.

    Attributes:
        is_receiving: whether the application receives from a new provider at once, else from
            `HandOver` on.
        recalled: ids of components that are open and were stopped as they were replaced: they take
            commands again first, also where the batch was cancelled.
    """

    lane: str
    batch: int
    connection: str
    placement: Placement
    # Only what no other batch opens and nothing has open: opening twice is impossible by design.
    parts: tuple[Part, ...]
    is_receiving: bool
    recalled: tuple[int, ...] = ()


@frozen
class Close:
    """Close what an end or an abandoned opening leaves behind.

    Attributes:
        placement: whose losses are counted with it; those of one that drained since it was
            replaced. None: those of the parts.
        lost: components of it that died: what was under way in them is lost.
        ends: whether the connection has ended: comes back as `Ended`.
    """

    # Of an end: that of the kill, so that the caller closes what it had open. Of anything else:
    # one of its own, since a close may take long and nothing waits for it.
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
            no other plan uses.
        lost: components of the plan that died.
    """

    lane: str
    connection: str
    # The components are not closed here but after `RanOut`, by a `Close`, where no other plan has
    # begun to use them meanwhile.
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
    """Look for a plan that gives the application what its own gave; `ReplacementSought`.

    Attributes:
        excluded: components that may not be used.
        failed: components to do without, where anything else can do, longest failed first.
        avoided: the same, all at once.
    """

    lane: str
    connection: str
    # Comes back with the result, which is dropped where the connection has gone on since.
    attempt: int
    plan: Plan
    output: str | None
    excluded: frozenset[str]
    failed: OrderedMap[str, float]
    avoided: AbstractSet[str]
    switchover: int = 0


@frozen
class CheckPreferred:
    """See whether a plan is what a request would get now; comes back as `PreferredChecked`."""

    lane: str
    connection: str
    plan: Plan
    avoided: AbstractSet[str]


@frozen
class SwitchInputs:
    """Let edges that are held feed their inputs in place of others; `InputsSwitched`.

    Attributes:
        edges: ids, each with the one whose place it takes, if there is one.
    """

    # The lane of the switchover, after the openings of all members: nothing is switched before
    # everything is open.
    lane: str
    switchover: int
    edges: tuple[tuple[int, int | None], ...]


@frozen
class Release:
    """Close components before what takes their place is opened, as one of them can be open only.

    Attributes:
        components: ids; what they lose is counted when their plans end.
    """

    # That in which the replacement is sought and opened next, so that it comes after this.
    lane: str
    components: tuple[int, ...]


@frozen
class OpenOffer:
    """Open an offer: request its function, and open its side in the framework; `OfferOpened`."""

    lane: str
    name: str
    number: int


@frozen
class CloseOffer:
    """Close what is open for an offer; comes back as `OfferClosed`."""

    lane: str
    name: str
    number: int


@frozen
class Publish:
    """Show a connection as it is from now on to the holders of its handle."""

    record: ConnectionRecord


@frozen
class Announce:
    """Notify the listeners of a change, with the function concerned, where there is one."""

    subject: str
    change: str
    cause: str = ""
    function: str = ""


@frozen
class Reply:
    """Wake the caller that waits for a request, a kill or a change."""

    waiter: str
    error: BaseException | None = None


@frozen
class HandOver:
    """Let the application receive from the next plan and no other, and note the gap.

    Attributes:
        lane: where it is done when that may call the application: see `is_receiving`.
        is_receiving: whether the application receives from it already, since it was opened;
            otherwise it may get a retained message now.
        record: the connection from then on, for readers of the gap before it is published.
        since: when messages ceased.
        time: of the change.
    """

    lane: str
    connection: str
    before: Placement
    after: Placement
    is_receiving: bool
    # Set with the gap, in the thread that notes it: who reads the gap sees the plan behind it.
    record: ConnectionRecord
    since: float
    time: float
    cause: str


@frozen
class Listen:
    """Let the application receive at the application ports of this id again."""

    connection: str
    ports: int


@frozen
class Stop:
    """Let nothing more through these edges, so that what each of them had counted stands."""

    # Done at once and not in a lane: a component that died must not be fed, nor feed, until a
    # worker thread comes to it.
    edges: tuple[int, ...]


@frozen
class SetCheck:
    """Check the messages of an edge as its strictest user wishes now."""

    edge: int


@frozen
class CancelBatch:
    """Begin to open no further part of a batch."""

    # The call under way is not interrupted; what it opens comes back in `Opened` and is closed.
    batch: int


@frozen
class Forget:
    """Ask for the structures of these components again the next time.

    Attributes:
        function: of those, only those that it may use; empty: all of them.
    """

    components: Collection[str]
    # Thousands may have died with one bridge, and each of as many connections waits for its own.
    function: str = ""


@frozen
class RetireBridge:
    """Close a bridge that was lost."""

    # By a thread of its own: what is dying may hang as it is closed.
    bridge: str


@frozen
class Adopt:
    """Resolve with this revision of the configuration, and start bridges as it says."""

    # Done by the owner of the state, between two events: no event sees a state of one revision
    # and bridges of another.
    revision: int


@frozen
class WakeAt:
    """Post `TimeReached` at this time."""

    # Always later than now, or the timer would turn without a pause; the tests' world asserts it.
    time: float


@frozen
class Warn:
    """Write to the log what no caller and no listener gets."""

    connection: str
    text: str


# May block, fail or call foreign code: done in a lane, and answered by an event.
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
    | OpenOffer
    | CloseOffer
)
# Quick and without foreign code: done at once, in order, by the thread that owns the state.
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
