"""Changing to better plans while all goes well: all connections that share an input at once.

What is new opens beside what runs; when all of it is open, the inputs change hands. Failback and
changes of configuration begin one.
"""

from __future__ import annotations

from collections.abc import Sequence

from attrs import evolve

from uoarm._control.reconciler.actions import FindReplacement, SwitchInputs, Warn
from uoarm._control.reconciler.draft import Draft
from uoarm._control.reconciler.endings import cancel_switchover, drop_next
from uoarm._control.reconciler.events import InputsSwitched, ReplacementSought
from uoarm._control.reconciler.failover import hand_over, seek
from uoarm._control.reconciler.state import (
    ComponentFailure,
    ConnectionRecord,
    Switchover,
    names,
    recently,
)
from uoarm.errors import ResolutionError
from uoarm.model import ConnectionState, Plan

__all__ = [
    "abandon",
    "advance",
    "begin",
    "found",
    "inputs_switched",
    "may_move",
    "seek_outdated",
]

_RETURNED = "its preferred components are available again"
_RECONFIGURED = "the configuration was changed"


def begin(
    draft: Draft, records: Sequence[ConnectionRecord], *, is_reconfiguration: bool = False
) -> None:
    """Have connections change to better plans together, which are sought one after another."""
    number = draft.new_id()
    plans = {record.id: None for record in records}
    draft.switchovers[number] = Switchover(
        number, plans, draft.now, is_reconfiguration=is_reconfiguration
    )
    first, *_ = [draft.put(record, switchover=number) for record in records]
    _seek_for(draft, first)


def found(draft: Draft, record: ConnectionRecord, event: ReplacementSought) -> None:
    """Note the better plan of a member; open all when each has one."""
    group = draft.switchovers.get(event.switchover)
    if group is None or record.switchover != group.id:
        return
    if event.plan is not None and draft.is_outdated(event.plan, event.candidates):
        _seek_for(draft, record)
        return
    members = {**group.members, record.id: event.plan}
    rivals = set[str]() if event.plan is None else draft.rivals(event.plan)
    if group.is_reconfiguration:
        if event.plan is None or _serves(draft, record, event.plan):
            del members[record.id]  # what it cannot go on with is replaced after the switchover
            draft.put(record, switchover=0)
        if event.plan is None and not _is_superseded(draft, record):
            draft.actions.append(Warn(record.id, f"stays where it is: {event.error}"))
    elif event.plan is None or names(event.plan) == names(record.placement.plan):
        abandon(draft, group, event.error or "its preferred components are gone again")
        return
    for identity in sorted(rivals - set(members)):
        for other in _with_whom(draft, identity):
            draft.put(drop_next(draft, draft.connections[other]), switchover=group.id)
            members[other] = None
    group = draft.switchovers[group.id] = evolve(group, members=members)
    for identity, plan in members.items():
        if plan is None:
            _seek_for(draft, draft.connections[identity])
            return
    if not members:
        del draft.switchovers[group.id]
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


def seek_outdated(draft: Draft) -> None:
    """Have plans sought anew that were found and not placed yet, with candidates that changed."""
    for group in draft.switchovers.values():
        if group.is_switching:  # nothing is sought any more, and members may have ended meanwhile
            continue
        members = {
            identity: None
            if plan is not None
            and draft.connections[identity].next is None
            and draft.is_outdated(plan, draft.candidates - 1)
            else plan
            for identity, plan in group.members.items()
        }
        draft.switchovers[group.id] = evolve(group, members=members)


def advance(draft: Draft, group: Switchover) -> None:
    """Have what is missing opened; let the inputs change hands when all is open."""
    if group.is_switching:
        return
    edges: list[int] = []
    is_open = True
    for identity in group.members:
        record = draft.connections[identity]
        if record.next is None:
            return
        lane = f"switchover {group.id}"
        is_open = draft.open(record, record.next, lane, is_heard=False) and is_open
        edges += record.next.edges
    if not is_open:
        return
    try:
        pairs = draft.switch_inputs(edges)
    except ResolutionError as error:
        abandon(draft, group, str(error))
        return
    draft.switchovers[group.id] = evolve(group, is_switching=True)
    draft.actions.append(SwitchInputs(f"switchover {group.id}", group.id, pairs))


def inputs_switched(draft: Draft, event: InputsSwitched) -> None:
    """Let the better plans be the ones that run; where that failed, look for any plan."""
    group = draft.switchovers.pop(event.switchover)
    for identity in group.members:
        record = draft.connections.get(identity)
        if record is None or record.next is None or not record.goes_on:
            continue
        failure = record.failure
        if event.error:
            what = "its move" if group.is_reconfiguration else "its return"
            cause = f"{what} failed: {event.error}"
            record = draft.put(drop_next(draft, record), switchover=0, available_since=None)
            failure = failure or ComponentFailure(group.began, cause, (), frozenset(), frozenset())
            seek(draft, draft.put(record, failure=failure))
            continue
        moves, cause = record.moves, _RECONFIGURED if group.is_reconfiguration else _RETURNED
        hand_over(draft, record, group.began, cause, is_planned=True)
        record = draft.connections[identity]
        if group.is_reconfiguration:  # what somebody asked for is no sign of trouble
            record = draft.put(record, moves=moves)
        ids = set(record.placement.components.values())
        if any(draft.components[id_].is_lost for id_ in ids):
            lost = tuple(id_ for id_ in ids if draft.components[id_].is_lost)
            dead = frozenset(draft.components[number].name for number in lost)
            cause = "its preferred components were lost again"
            failure = ComponentFailure(draft.now, cause, lost, dead, dead)
            seek(draft, draft.put(record, failure=failure))


def abandon(draft: Draft, group: Switchover, error: str) -> None:
    """Leave all where they are."""
    first = next(iter(group.members))
    draft.actions.append(Warn(first, f"stays where it is: {error}"))
    cancel_switchover(draft, group.id, is_vain=True)


def _seek_for(draft: Draft, record: ConnectionRecord) -> None:
    """Look for the better plan of a member."""
    record = draft.put(record, attempt=record.attempt + 1)
    is_reconfiguration = draft.switchovers[record.switchover].is_reconfiguration
    draft.actions.append(
        FindReplacement(
            lane=f"switchover {record.switchover}",
            connection=record.id,
            attempt=record.attempt,
            plan=record.placement.plan,
            output=record.output,
            excluded=frozenset(),
            failed=draft.failed_lately() if is_reconfiguration else (),
            avoided=recently(draft.avoided, draft.now),
            switchover=record.switchover,
        )
    )


def _with_whom(draft: Draft, identity: str) -> tuple[str, ...]:
    """Return who comes along with a connection: all with which it was about to return by itself.

    An input changes hands once, so that of two returns that share one, one must be left.
    """
    record = draft.connections.get(identity)
    if record is None:
        return ()
    group = draft.switchovers.get(record.switchover)
    if group is None:
        return (identity,) if may_move(record) else ()
    if group.is_switching or group.is_reconfiguration:
        return ()
    del draft.switchovers[group.id]
    return tuple(group.members)


def _serves(draft: Draft, record: ConnectionRecord, plan: Plan) -> bool:
    """Say whether the plan that runs is the one that was found, and all of it may go on."""
    is_same = names(plan) == names(record.placement.plan)
    return is_same and not _is_superseded(draft, record)


def _is_superseded(draft: Draft, record: ConnectionRecord) -> bool:
    """Say whether the plan that runs uses what the configuration has no more, or otherwise."""
    running = record.placement.components.values()
    return any(draft.components[number].is_superseded for number in running)


def may_move(record: ConnectionRecord) -> bool:
    """Say whether a connection runs undisturbed, so that it may change to a better plan."""
    return (
        record.state is ConnectionState.RUNNING
        and record.failure is None
        and not record.switchover
        and not record.finished
    )
