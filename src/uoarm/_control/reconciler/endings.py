"""The end of a connection, and of a plan that was opened in vain."""

from __future__ import annotations

from uoarm._control.reconciler.actions import Close, Drain, Listen, Publish, WakeAt
from uoarm._control.reconciler.draft import Draft
from uoarm._control.reconciler.state import ConnectionRecord
from uoarm.model import ConnectionState

__all__ = ["cancel_switchover", "drop_next", "end", "finish_if_asked", "look_later"]

_LEAST_LOOK_SECONDS = 0.05


def end(
    draft: Draft,
    record: ConnectionRecord,
    outcome: ConnectionState,
    cause: str,
    lane: str = "",
) -> None:
    """Begin to end a connection; once it has begun, nothing changes how it ends.

    Args:
        draft: the state.
        record: the connection, which has a plan.
        outcome: CLOSED or FAILED.
        cause: why; empty for a kill by the application.
        lane: where to close what only it used; empty: one of its own, which waits for nobody.
    """
    if record.state is ConnectionState.CLOSING:
        return
    record = drop_next(draft, record)
    if record.switchover and not draft.switchovers[record.switchover].is_switching:
        cancel_switchover(draft, record.switchover)
        record = draft.connections[record.id]
    placement = record.placement
    parts = draft.unplace(placement)
    lost = record.failure.lost if record.failure is not None else ()
    record = draft.put(
        record, state=ConnectionState.CLOSING, outcome=outcome, cause=cause, switchover=0
    )
    draft.actions += [
        Publish(record),
        Close(lane or f"{record.id}!", record.id, parts, placement, lost, ends=True),
    ]


def drop_next(draft: Draft, record: ConnectionRecord) -> ConnectionRecord:
    """Close a plan that was opened in vain, hear the one so far again, and count what was lost."""
    placement = record.next
    if placement is None:
        return record
    record = draft.put(record, next=None, attempt=record.attempt + 1)
    ports = record.placement.ports
    parts = draft.unplace(placement, ports=placement.ports != ports)
    draft.actions += [
        Listen(record.id, ports),
        Close(f"{placement.user}!", record.id, parts, placement),
    ]
    return record


def cancel_switchover(draft: Draft, number: int, *, is_vain: bool = False) -> None:
    """Leave the members of a return where they are; each looks for its plan again later.

    None has ended: the first that did would have cancelled it. Not while inputs change hands.

    Args:
        draft: the state.
        number: of the return.
        is_vain: whether members of a reconfiguration should not try it together once more.
    """
    group = draft.switchovers.pop(number)
    if group.is_reconfiguration and not is_vain:
        draft.outdated |= frozenset(group.members)
    for identity in group.members:
        record = drop_next(draft, draft.connections[identity])
        record = draft.put(record, switchover=0, available_since=None, look_at=None)
        if record.preferred is not None:
            look_later(draft, record)


def finish_if_asked(draft: Draft, record: ConnectionRecord) -> None:
    """Let what is under way arrive before a connection ends whose source has finished."""
    if record.finished:
        draft.actions.append(Drain(f"{record.id}!drain", record.id, record.placement))


def look_later(draft: Draft, record: ConnectionRecord) -> None:
    """Look for the preferred plan of a connection after a while."""
    wait = max(_LEAST_LOOK_SECONDS, (draft.policy.return_after or 0.0) / 4)
    draft.put(record, look_at=draft.now + wait)
    draft.actions.append(WakeAt(draft.now + wait))
