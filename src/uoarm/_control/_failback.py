"""When a better plan is there again: all connections that share an input return to it at once."""

from __future__ import annotations

from attrs import evolve

from uoarm._control._actions import ChangeOver, CheckPreferred, FindReplacement, WakeAt, Warn
from uoarm._control._draft import Draft
from uoarm._control._endings import drop_next, end_return, look_later
from uoarm._control._events import ChangedOver, PreferredChecked, ReplacementSought
from uoarm._control._failover import hand_over, seek
from uoarm._control._state import ComponentFailure, ConnectionRecord, Return, names, recently
from uoarm.errors import ResolutionError
from uoarm.model import ConnectionState, Plan

__all__ = ["abandon", "advance", "changed_over", "checked", "found", "look", "seek_for"]

_CAUSE = "its preferred components are available again"
_RECONFIGURED = "the configuration was changed"


def look(draft: Draft, record: ConnectionRecord) -> None:
    """Have somebody look for the preferred plan, when it is time."""
    if record.look_at is None or record.is_looking or record.preferred is None:
        return
    if record.look_at > draft.now:
        draft.actions.append(WakeAt(record.look_at))
        return
    if not _may_return(record):
        look_later(draft, record)
        return
    draft.put(record, is_looking=True, look_at=None)
    lane = f"{record.id}?"
    draft.actions.append(
        CheckPreferred(lane, record.id, record.preferred, recently(draft.stale, draft.now))
    )


def checked(draft: Draft, event: PreferredChecked) -> None:
    """Return when the preferred plan was available for long enough without a break."""
    record = draft.connections.get(event.connection)
    if record is None or record.preferred is None:
        return
    record = draft.put(record, is_looking=False)
    if not event.is_available or not _may_return(record):
        look_later(draft, draft.put(record, available_since=None))
        return
    since = draft.now if record.available_since is None else record.available_since
    record = draft.put(record, available_since=since)
    if draft.now - since < (draft.policy.return_after or 0.0):
        look_later(draft, record)
        return
    number = draft.new_id()
    draft.returns[number] = Return(number, {record.id: None}, draft.now)
    seek_for(draft, draft.put(record, returning=number))


def found(draft: Draft, record: ConnectionRecord, event: ReplacementSought) -> None:
    """Note the better plan of a member; open all when each has one."""
    group = draft.returns.get(event.returning)
    if group is None or record.returning != group.id:
        return
    members = {**group.members, record.id: event.plan}
    rivals = set[str]() if event.plan is None else draft.rivals(event.plan)
    if group.is_reconfiguration:
        if event.plan is None or _serves(draft, record, event.plan):
            del members[record.id]  # what it cannot go on with is replaced after the change-over
            draft.put(record, returning=0)
        if event.plan is None:
            draft.actions.append(Warn(record.id, f"stays where it is: {event.error}"))
    elif event.plan is None or names(event.plan) == names(record.placement.plan):
        abandon(draft, group, event.error or "its preferred components are gone again")
        return
    for identity in sorted(rivals - set(members)):
        for other in _with_whom(draft, identity):
            draft.put(drop_next(draft, draft.connections[other]), returning=group.id)
            members[other] = None
    group = draft.returns[group.id] = evolve(group, members=members)
    for identity, plan in members.items():
        if plan is None:
            seek_for(draft, draft.connections[identity])
            return
    if not members:
        del draft.returns[group.id]
        return
    for identity, plan in members.items():
        member = draft.connections[identity]
        assert plan is not None, "each has one"
        user = f"{identity}#{member.attempt}"
        try:
            placement = draft.place(member, plan, user, beside=True)
        except ResolutionError as error:
            abandon(draft, group, str(error))
            return
        draft.put(member, next=placement)
    advance(draft, group)


def advance(draft: Draft, group: Return) -> None:
    """Have what is missing opened; let the inputs change hands when all is open."""
    if group.is_changing:
        return
    edges: list[int] = []
    is_open = True
    for identity in group.members:
        record = draft.connections[identity]
        if record.next is None:
            return
        placement = draft.open(record, record.next, f"return {group.id}", is_heard=False)
        draft.put(record, next=placement)
        is_open = is_open and not draft.missing(placement)
        edges += placement.edges
    if not is_open:
        return
    try:
        pairs = draft.change_over(edges)
    except ResolutionError as error:
        abandon(draft, group, str(error))
        return
    draft.returns[group.id] = evolve(group, is_changing=True)
    draft.actions.append(ChangeOver(f"return {group.id}", group.id, pairs))


def changed_over(draft: Draft, event: ChangedOver) -> None:
    """Let the better plans be the ones that run; where that failed, look for any plan."""
    group = draft.returns.pop(event.returning)
    for identity in group.members:
        record = draft.connections.get(identity)
        if record is None or record.next is None or not record.goes_on:
            continue
        failure = record.failure
        if event.error:
            what = "its move" if group.is_reconfiguration else "its return"
            cause = f"{what} failed: {event.error}"
            record = draft.put(drop_next(draft, record), returning=0, available_since=None)
            failure = failure or ComponentFailure(group.began, cause, (), frozenset(), frozenset())
            seek(draft, draft.put(record, failure=failure))
            continue
        moves, cause = record.moves, _RECONFIGURED if group.is_reconfiguration else _CAUSE
        hand_over(draft, record, group.began, cause, returns=True)
        record = draft.connections[identity]
        if group.is_reconfiguration:  # what somebody asked for is no sign of trouble
            record = draft.put(record, moves=moves)
        ids = set(record.placement.components.values())
        if any(draft.components[one].is_lost for one in ids):
            lost = tuple(one for one in ids if draft.components[one].is_lost)
            dead = frozenset(draft.components[one].name for one in lost)
            cause = "its preferred components were lost again"
            failure = ComponentFailure(draft.now, cause, lost, dead, dead)
            seek(draft, draft.put(record, failure=failure))


def abandon(draft: Draft, group: Return, error: str) -> None:
    """Leave all where they are."""
    first = next(iter(group.members))
    draft.actions.append(Warn(first, f"stays where it is: {error}"))
    end_return(draft, group.id, is_vain=True)


def seek_for(draft: Draft, record: ConnectionRecord) -> None:
    """Look for the better plan of a member."""
    record = draft.put(record, attempt=record.attempt + 1)
    is_reconfiguration = draft.returns[record.returning].is_reconfiguration
    draft.actions.append(
        FindReplacement(
            lane=f"return {record.returning}",
            connection=record.id,
            attempt=record.attempt,
            plan=record.placement.plan,
            output=record.output,
            excluded=frozenset(),
            failed=draft.failed_lately() if is_reconfiguration else (),
            avoided=recently(draft.stale, draft.now),
            returning=record.returning,
        )
    )


def _with_whom(draft: Draft, identity: str) -> tuple[str, ...]:
    """Return who comes along with a connection: all with which it was about to return by itself.

    An input changes hands once, so that of two returns that share one, one must be left.
    """
    record = draft.connections.get(identity)
    if record is None:
        return ()
    group = draft.returns.get(record.returning)
    if group is None:
        return (identity,) if _may_return(record) else ()
    if group.is_changing or group.is_reconfiguration:
        return ()
    del draft.returns[group.id]
    return tuple(group.members)


def _serves(draft: Draft, record: ConnectionRecord, plan: Plan) -> bool:
    """Say whether the plan that runs is the one that was found, and all of it may go on."""
    current = record.placement
    return names(plan) == names(current.plan) and not any(
        draft.components[one].is_superseded for one in current.components.values()
    )


def _may_return(record: ConnectionRecord) -> bool:
    return (
        record.state is ConnectionState.RUNNING
        and record.failure is None
        and not record.returning
        and not record.finished
    )
