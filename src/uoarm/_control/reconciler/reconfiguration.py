"""When the configuration changes: which connections go on with another plan, and how.

Those for which nothing changes notice nothing. The others change to their new plans together, as
they may share inputs: what is new opens beside what runs, and then takes its place. Where that
cannot be done, what the configuration has no more is closed first and replaced like what died.
"""

from __future__ import annotations

from attrs import evolve

from uoarm._control.reconciler.actions import Adopt, Announce, Release, Reply
from uoarm._control.reconciler.draft import Draft
from uoarm._control.reconciler.endings import cancel_switchover, drop_next
from uoarm._control.reconciler.events import CandidatesChanged, Configured
from uoarm._control.reconciler.failover import look_soon, replace, seek
from uoarm._control.reconciler.state import ComponentFailure, ConnectionRecord, listed
from uoarm._control.reconciler.switchover import begin, seek_outdated
from uoarm.model import ConnectionState

__all__ = ["candidates_changed", "configured", "go_on"]

_KNOWN_CHANGES = 16


def configured(draft: Draft, event: Configured) -> None:
    """Take a configuration over, and have every connection that it concerns look for its plan."""
    draft.revision, draft.policy, draft.bridges = event.revision, event.policy, event.bridges
    draft.candidates, draft.replaced = 0, ()
    draft.configurers = (*draft.configurers, event.waiter)
    draft.supersede(event.superseded)
    for name in event.superseded:
        draft.failed.pop(name, None)
        draft.avoided.pop(name, None)
    report = Announce("configuration", f"revision {event.revision}")
    draft.actions += [Adopt(event.revision), report]
    for identity in tuple(draft.connections):
        record = draft.connections[identity]
        if record.current is None or record.state is ConnectionState.CLOSING:
            continue
        if record.wanted.function in event.functions or _superseded(draft, record):
            _outdate(draft, record)


def candidates_changed(draft: Draft, event: CandidatesChanged) -> None:
    """Know the bridges of the components that plans may have from now on.

    A connection that waits for a candidate looks again, and one that runs goes back to a better
    candidate only where `failover.return_after` says so: what comes and goes moves nobody.
    A plan that is being sought, or was found and is not in use yet, must not have what is gone.
    """
    draft.bridges = event.bridges
    draft.candidates = event.number
    draft.replaced = (*draft.replaced, event.superseded)[-_KNOWN_CHANGES:]
    seek_outdated(draft)
    look_soon(draft)
    draft.actions.append(Announce("candidates", "changed", event.told))


def _outdate(draft: Draft, record: ConnectionRecord) -> None:
    if record.switchover and not draft.switchovers[record.switchover].is_switching:
        cancel_switchover(draft, record.switchover)
        record = draft.connections[record.id]
    record = draft.put(record, preferred=None, available_since=None, look_at=None)
    if record.failure is not None and record.goes_on and not record.switchover:
        failure = evolve(record.failure, excluded=frozenset())
        seek(draft, draft.put(drop_next(draft, record), failure=failure))
    else:
        draft.outdated |= {record.id}


def go_on(draft: Draft) -> None:
    """Do what a change of configuration still asks for, after whatever happened."""
    if not draft.configurers:
        return
    records = [
        draft.connections[connection]
        for connection in sorted(draft.outdated & set(draft.connections))
    ]
    records = [
        connection_record
        for connection_record in records
        if connection_record.state is not ConnectionState.CLOSING
    ]
    draft.outdated = frozenset(connection_record.id for connection_record in records)
    if _moves(draft) or any(
        connection_record.state is ConnectionState.OPENING or connection_record.switchover
        for connection_record in records
    ):
        return
    draft.outdated = frozenset()
    members = [
        connection_record
        for connection_record in records
        if connection_record.failure is None and not connection_record.finished
    ]
    if members:
        begin(draft, members, is_reconfiguration=True)
        return
    _replace_what_is_left(draft)
    for identity in draft.postponed:
        record = draft.connections.get(identity)
        if record is not None and record.current is None:
            draft.resolve(record)
    draft.actions += map(Reply, draft.configurers)
    draft.postponed, draft.configurers = (), ()


def _moves(draft: Draft) -> bool:
    return any(group.is_reconfiguration for group in draft.switchovers.values())


def _superseded(draft: Draft, record: ConnectionRecord) -> tuple[int, ...]:
    """Return what a connection uses that the configuration has no more."""
    placements = (record.current, record.next)
    ids = {
        component
        for placement in placements
        if placement is not None
        for component in placement.components.values()
    }
    return tuple(sorted(id_ for id_ in ids if draft.components[id_].is_superseded))


def _replace_what_is_left(draft: Draft) -> None:
    """Close what the configuration has no more, and let connections that use it look further."""
    left: set[int] = set()
    for record in draft.connections.values():
        if record.goes_on and record.failure is None and not record.finished:
            rest = _superseded(draft, record)
            left.update(rest)
            if rest:
                draft.actions.append(Release(f"{record.id}#{record.attempt + 1}", rest))
    lost = tuple(sorted(left))
    if lost:
        dead = frozenset(draft.components[number].name for number in lost)
        text = f"the configuration has {listed(sorted(dead))} no more, or otherwise"
        replace(draft, ComponentFailure(draft.now, text, lost, dead, frozenset()))
