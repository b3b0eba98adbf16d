"""How a connection leaves a plan: for the next one, which takes over, or for none, as it ends.

The next plan itself is left where it is abandoned before it takes over.
"""

from __future__ import annotations

from uoarm._control.engine import actions as act
from uoarm._control.engine.draft import Draft
from uoarm._control.engine.move import Move, MovePhase, MoveReason
from uoarm._control.engine.placement import Placement
from uoarm._control.engine.state import ConnectionRecord, Preference
from uoarm.model import ConnectionState, Health

_MINUTE = 60.0
_LEAST_LOOK_SECONDS = 0.05


def hand_over(draft: Draft, record: ConnectionRecord) -> None:
    """Let the next plan be the one that runs, and the one so far drain."""
    move, before, after = record.move, record.placement, record.next
    assert move is not None, "there is a move that comes to its end"
    assert after is not None, "there is a plan to hand over to"
    rule, cause = move.rule, move.rule.cause or move.cause
    ran, waiter = record.state is ConnectionState.RUNNING, record.waiter
    # The first plan that was lost, however many follow: it returns to that one, in one step.
    preferred = None
    if draft.policy.return_after is not None and rule.remembers:
        preferred = (record.preferred or Preference(before.plan)).unseen()
        if after.plan.names == preferred.plan.names:
            preferred = None
    # What is set is not taken back, and is drained already.
    finished = "" if record.finished else _finished_in(draft, after)
    # In one change: no event finds the plan replaced and the move still there, which would replace
    # it again, nor the move gone and the plan that died still in place.
    record = draft.put(
        record,
        waiter="",
        state=ConnectionState.RUNNING,
        cause="",
        current=after,
        move=None,
        preferred=preferred,
        changes=(
            (*changes_lately(draft, record), draft.now) if rule.is_counted else record.changes
        ),
        finished=record.finished or finished,
    )
    # After a death the application has received from the next plan since that was opened, as there
    # was nothing else to receive. In a switchover it receives from the old one up to this moment.
    lane, is_receiving = f"{after.user}>", not rule.is_beside or before.ports == after.ports
    draft.actions += [
        act.HandOver(
            lane, record.id, before, after, is_receiving, record, move.since, draft.now, cause
        ),
        act.Publish(record),
    ]
    if not ran:
        draft.announce(record, record.state.value)
    if waiter:  # what its request opened first died before all of that was open
        draft.do(act.Reply(waiter))
    new = [n for n in after.plan.names if after.components[n] != before.components.get(n)]
    successors = f"{', '.join(new or after.plan.names[-1:])} {'go' if len(new) > 1 else 'goes'} on"
    played = [
        step.component.name
        for step in after.plan.steps
        if step.component.name in new
        and any(structure.is_recorded for structure in step.structures.values())
    ]
    if played:
        who = "" if played == new else f", {', '.join(played)}"
        successors += f"{who} with what was recorded"
    draft.announce(record, rule.announced, f"{cause}; {successors}")
    # In the lane of the handing over, and after it: nothing of the old plan is closed before the
    # application receives from the new one.
    parts = draft.start_draining(record.id, before, move.lost, ports=before.ports != after.ports)
    draft.do(act.Finish(lane, record.id, parts, before, move.lost))
    if finished or waiter:
        finish_if_asked(draft, record)
    if preferred is not None:
        look_later(draft, record)


def end(
    draft: Draft,
    record: ConnectionRecord,
    outcome: ConnectionState,
    cause: str,
    lane: str = "",
    *,
    killer: str = "",
    error: BaseException | None = None,
) -> None:
    """Begin to end a connection; once it has begun, nothing changes how it ends.

    Args:
        draft: the state.
        record: the connection, which has a plan.
        outcome: CLOSED or FAILED.
        cause: why; empty for a kill by the application.
        lane: where to close what only it used; empty: one of its own, for which no caller waits.
        killer: the caller that waits for its end.
        error: what its request fails with, where that is more than the cause.
    """
    # A death while it is being killed, say, must not turn an orderly end into a failure.
    if record.state is ConnectionState.CLOSING:
        return
    # Read before the shared move is cancelled, which takes the member's own with it.
    lost = record.move.lost if record.move is not None else ()
    record = drop_next(draft, record)
    # While inputs change hands the others go on, and this one is passed over when they have.
    group = record.move.group if record.move is not None else 0
    if group and not draft.switchovers[group].is_switching:
        cancel_switchover(draft, group)
        record = draft.connections[record.id]
    # From here on it uses nothing: what is opened for it from now on comes back as unused.
    placement = record.placement
    parts = draft.unplace(placement)
    move = Move(
        MoveReason.END,
        MovePhase.DRAINING,
        draft.now,
        cause,
        lost=lost,
        outcome=outcome,
        killer=killer,
        error=error,
    )
    record = draft.put(
        record, state=ConnectionState.CLOSING, cause=cause, current=placement, move=move
    )
    draft.actions += [
        act.Publish(record),
        act.Close(lane or f"{record.id}!", record.id, parts, placement, lost, ends=True),
    ]


def drop_next(draft: Draft, record: ConnectionRecord) -> ConnectionRecord:
    """Abandon a plan that was opened: receive from the one so far again, and count the losses."""
    move, placement = record.move, record.next
    if move is None or placement is None or record.current is None:
        return record
    # A new attempt, so that the user of the parts that are given up here is none that comes back,
    # and a search that is under way is for nothing.
    move = move._replace(next=None, phase=MovePhase.SEEKING)
    record = draft.put(record, move=move, attempt=record.attempt + 1)
    # Where the provider stays, so do the ports: they are the running plan's, too.
    ports = record.placement.ports
    parts = draft.unplace(placement, ports=placement.ports != ports)
    # It may have received from the next one already, which was opened for that.
    draft.actions += [
        act.Listen(record.id, ports),
        act.Close(f"{placement.user}!", record.id, parts, placement),
    ]
    return record


def cancel_switchover(draft: Draft, number: int, *, is_abandoned: bool = False) -> None:
    """Leave the members of a return where they are; each looks for its plan again later.

    None has ended: the first that did would have cancelled it. Not while inputs change hands.

    Args:
        draft: the state.
        number: of the return.
        is_abandoned: whether members of a reconfiguration should not try it together once more.
    """
    group = draft.switchovers[number]
    draft.switchovers = draft.switchovers.remove(number)
    if group.rule.is_owed and not is_abandoned:
        draft.outdated = draft.outdated.update(group.members)
    for identity in group.members:
        record = drop_next(draft, draft.connections[identity])
        record = draft.put(record, move=None)
        if record.preferred is not None:
            look_later(draft, draft.put(record, preferred=record.preferred.unseen()))


def finish_if_asked(draft: Draft, record: ConnectionRecord) -> None:
    """Let what is under way arrive before a connection ends whose source has finished."""
    if record.finished:
        draft.do(act.Drain(f"{record.id}!drain", record.id, record.placement))


def _finished_in(draft: Draft, placement: Placement) -> str:
    """Say which component of a plan has finished already, while that was being opened."""
    for name, number in placement.components.items():
        if draft.components[number].health.health is Health.FINISHED:
            return f"component {name!r} finished"
    return ""


def look_later(draft: Draft, record: ConnectionRecord) -> None:
    """Look for the preferred plan of a connection after a while."""
    assert record.preferred is not None, "there is a plan to return to"
    # Four looks within the time for which it must be there without a break.
    wait = max(_LEAST_LOOK_SECONDS, (draft.policy.return_after or 0.0) / 4)
    draft.put(record, preferred=record.preferred._replace(look_at=draft.now + wait))
    draft.do(act.WakeAt(draft.now + wait))


def changes_lately(draft: Draft, record: ConnectionRecord) -> tuple[float, ...]:
    """Return when the plan of a connection changed within the last minute."""
    return tuple(time for time in record.changes if draft.now - time < _MINUTE)
