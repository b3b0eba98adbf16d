"""What should be open, and what remains to be done for it: two functions of the state alone.

`step` applies an event to the state; what follows is the difference, of which it takes what may be
done now. Which plan is wanted is found outside, by a search whose result is an event.
"""

from __future__ import annotations

from collections.abc import Collection
from itertools import filterfalse
from typing import NamedTuple

from uoarm._control.engine.move import MovePhase
from uoarm._control.engine.state import ConnectionRecord, Kind, Part, State

__all__ = ["Remaining", "desired", "difference"]


class Remaining(NamedTuple):
    """A phase that a connection has before it; it comes after the one before it in the difference.

    Attributes:
        phase: what is to be done.
        parts: of an opening: what nothing has open yet, in the order in which it opens.
        awaits: what else comes before it: of an opening the batches that open some of it for
            others, of a switching the other members whose plans are not open.
        is_begun: whether its result is awaited, which is an event.
    """

    phase: MovePhase
    parts: tuple[Part, ...] = ()
    awaits: Collection[int | str] = ()
    is_begun: bool = False


def desired(state: State) -> frozenset[Part]:
    """Return what should be open: the plans that run or are to, and components that drain.

    What was lost is among it until its connection moves or ends: its losses are counted then. The
    tables of the state say who uses what of this.
    """
    plans = (plan for record in state.connections.values() for plan in record.plans)
    parts = {part for plan in plans for part in plan.parts}
    # Of a plan that was replaced the edges are closed at once, the components when all has arrived.
    ending = (plan.placement.components.values() for plan in state.draining.values())
    return frozenset(parts.union(Part(Kind.COMPONENT, id_) for ids in ending for id_ in ids))


def difference(state: State, record: ConnectionRecord) -> tuple[Remaining, ...]:
    """Return what a connection has before it until it is as it should be; empty: it is.

    The order is partial over all connections: those of one connection follow one another, and what
    stands first waits for what it says that it awaits.
    """
    move = record.move
    if move is None:
        return ()
    phases = move.rule.phases
    if move.next is None:
        # A plan is being sought, will be when it is time, or is not wanted any more.
        begun = Remaining(move.phase, is_begun=True)
        return (begun, *map(Remaining, phases[1:]))
    parts, awaits = _missing(state, move.next.parts)
    opening = (Remaining(MovePhase.OPENING, parts, awaits),) if parts else ()
    # Of one that moves alone nothing is switched: after a death its inputs feed nothing, and a
    # request has none yet.
    if not move.group:
        return (*opening, Remaining(MovePhase.TAKING_OVER))
    group = state.switchovers[move.group]
    # A persistent set, as a group may have thousands of members that come here one after another.
    others, is_begun = group.unopened.discard(record.id), group.is_switching
    switching = Remaining(MovePhase.SWITCHING, (), others, is_begun)
    return (*opening, switching, Remaining(MovePhase.TAKING_OVER))


def _missing(state: State, parts: tuple[Part, ...]) -> tuple[tuple[Part, ...], tuple[int, ...]]:
    """Return which parts are not open, and the batches that open some of these already."""
    # Where another batch opens some of it, even the rest waits: opened beside it, an output might
    # come before an edge that it feeds. What that batch fails at is asked for again here.
    opened_by, batches = state.parts, state.batches
    if not batches:  # mostly; then what has a number is open
        return tuple(filterfalse(opened_by.__contains__, parts)), ()
    found = [(part, opened_by.get(part)) for part in parts]
    left = [(part, batch) for part, batch in found if batch is None or batch in batches]
    return (
        tuple(part for part, _ in left),
        tuple(batch for _, batch in left if batch is not None),
    )
