"""Changing to better plans while all goes well: all connections that share an input at once.

What is new opens beside what runs; when all of it is open, the inputs change hands. The return to a
preferred plan begins one, and so does a change of configuration: those for which nothing changes
notice nothing, the others move together, as they may share inputs. Where that cannot be done, what
the configuration has no more is closed first and replaced like what died.
"""

from __future__ import annotations

from collections.abc import Sequence

from attrs import evolve
from rpds import HashTrieMap, HashTrieSet

from uoarm._control.engine import actions as act
from uoarm._control.engine import events as ev
from uoarm._control.engine.draft import Draft, connection_of
from uoarm._control.engine.failover import death, look_soon, replace, seek, seek_plan
from uoarm._control.engine.leaving import cancel_switchover, drop_next, hand_over, look_later
from uoarm._control.engine.move import RULES, Move, MovePhase, MoveReason
from uoarm._control.engine.placement import EdgeRecord
from uoarm._control.engine.state import ConnectionRecord, Switchover, listed, oldest_first
from uoarm._support.ordered import OrderedMap
from uoarm.errors import ResolutionError
from uoarm.model import ConnectionState, Plan

_KNOWN_CHANGES = 16


def begin(draft: Draft, records: Sequence[ConnectionRecord], reason: MoveReason) -> None:
    """Have connections change to better plans together, which are sought one after another."""
    # Its own lane for all that it has done: searches, openings and the switching come one after
    # another, whatever other lanes do.
    number = draft.new_id()
    unsought = OrderedMap((record.id, None) for record in records)
    group = Switchover(
        number,
        OrderedMap((record.id, None) for record in records),
        unsought,
        draft.now,
        reason,
    )
    draft.switchovers = draft.switchovers.insert(number, group)
    # One search at a time, all in the lane of the switchover: what the plan of one member moves
    # along may be members itself, of which the search for the next must know.
    first, *_ = [draft.put(record, move=_move_in(group)) for record in records]
    seek_plan(draft, first)


def found(draft: Draft, record: ConnectionRecord, event: ev.ReplacementSought) -> None:
    """Note the better plan of a member; open all when each has one."""
    # Cancelled meanwhile, or this one was moved into another group.
    group = draft.switchovers.get(event.switchover)
    if group is None or record.move is None or record.move.group != group.id:
        return
    if event.plan is not None and draft.is_outdated(event.plan, event.candidates):
        seek_plan(draft, record)
        return
    members, unsought = group.members.insert(record.id, event.plan), group.unsought
    unsought = unsought.discard(record.id)
    rivals = {} if event.plan is None else draft.rivals(event.plan)
    joined = group.joined
    if group.rule.may_stay:
        if event.plan is None or _serves(draft, record, event.plan):
            members = members.discard(record.id)  # what must go is replaced after the switchover
            # An edge that it uses has a user now that is no member: none counts as known any more.
            joined = HashTrieMap()
            draft.put(record, move=None)
        if event.plan is None and not _superseded(draft, record):
            draft.do(act.Warn(record.id, f"stays where it is: {event.error}"))
    elif event.plan is None or event.plan.names == record.placement.plan.names:
        abandon(draft, group, event.error or "its preferred components are gone again")
        return
    # An input that this plan takes from another connection would stop that one's messages; so it
    # moves, too, where it may. Where it may not, `switch_inputs` refuses in the end, and all stay.
    new = {number: edge.users for number, edge in rivals.items() if not _is_known(group, edge)}
    users = {connection_of(user) for users in new.values() for user in users}
    for identity in sorted(user for user in users if user not in members):
        for member in _joining_with(draft, identity):
            draft.put(drop_next(draft, draft.connections[member]), move=_move_in(group))
            members, unsought = members.insert(member, None), unsought.insert(member, None)
    if all(user in members for user in users):
        joined = joined.update(new)
    if not members:
        draft.switchovers = draft.switchovers.remove(group.id)
        return
    group = _put(draft, evolve(group, members=members, unsought=unsought, joined=joined))
    if unsought:
        seek_plan(draft, draft.connections[unsought.first()])
        return
    # Nothing of any member is placed before each has its plan: until then a death costs nothing.
    for identity, plan in members.items():
        record = draft.connections[identity]
        assert plan is not None, "every member has one"
        user = f"{identity}#{record.attempt}"
        try:
            placement = draft.place(record, plan, user, beside=True)
        except ResolutionError as error:
            abandon(draft, group, str(error))
            return
        assert record.move is not None, "a member moves"
        draft.put(record, move=record.move._replace(phase=MovePhase.OPENING, next=placement))
    _put(draft, evolve(group, unopened=HashTrieSet(members)))


def seek_outdated(draft: Draft) -> None:
    """Have plans sought anew that were found and not placed yet, with candidates that changed."""
    for _, group in sorted(draft.switchovers.items()):
        if group.is_switching:  # nothing is sought any more, and members may have ended meanwhile
            continue
        members = OrderedMap(
            (
                identity,
                None
                if plan is not None
                and draft.connections[identity].next is None
                and draft.is_outdated(plan, draft.candidates - 1)
                else plan,
            )
            for identity, plan in group.members.items()
        )
        unsought = OrderedMap((name, None) for name, plan in members.items() if plan is None)
        _put(draft, evolve(group, members=members, unsought=unsought))


def arrive(draft: Draft, record: ConnectionRecord, *, is_last: bool) -> None:
    """Note that all of a member's plan is open; switch the inputs after the last one."""
    assert record.move is not None, "a member moves"
    group = draft.switchovers[record.move.group]
    group = _put(draft, evolve(group, unopened=group.unopened.discard(record.id)))
    if not is_last:
        return
    plans = (draft.connections[identity].next for identity in group.members)
    edges = [edge for plan in plans if plan is not None for edge in plan.edges]
    try:
        pairs = draft.switch_inputs(edges)
    except ResolutionError as error:
        abandon(draft, group, str(error))
        return
    # From here on to `InputsSwitched` nothing takes this back: see `Switchover.is_switching`.
    # Each member has the phase, too: a death finds connections by what they use, and no group.
    for identity in group.members:
        record = draft.connections[identity]
        assert record.move is not None, "a member moves"
        draft.put(record, move=record.move._replace(phase=MovePhase.SWITCHING))
    _put(draft, evolve(group, is_switching=True))
    draft.do(act.SwitchInputs(f"switchover {group.id}", group.id, pairs))


def inputs_switched(draft: Draft, event: ev.InputsSwitched) -> None:
    """Let the better plans be the ones that run; where that failed, look for any plan."""
    group = draft.switchovers[event.switchover]
    draft.switchovers = draft.switchovers.remove(event.switchover)
    for identity in group.members:
        # Killed, or ended, while the inputs changed hands.
        record = draft.connections.get(identity)
        move = None if record is None else record.move
        if record is None or move is None or move.next is None or not record.is_active:
            continue
        if event.error:
            # Some inputs may have been switched and others not: it is a failure like a death, after
            # which any plan that can be had is taken, the one so far included.
            cause = move.cause if move.lost else f"{group.rule.called} failed: {event.error}"
            record = draft.put(
                drop_next(draft, record),
                preferred=record.preferred and record.preferred._replace(available_since=None),
            )
            seek(draft, draft.put(record, move=move.as_death()._replace(cause=cause)))
            continue
        # What died meanwhile has set a later time; the plan before was counted up to this one.
        # One member after another in one step: no event sees some of them on the new plans only.
        hand_over(draft, draft.put(record, move=move._replace(since=group.began)))
        record = draft.connections[identity]
        # Deaths that came while the inputs changed hands were left for this moment.
        ids = set(record.placement.components.values())
        if lost := tuple(id_ for id_ in ids if draft.components[id_].is_lost):
            cause = "its preferred components were lost again"
            failure = death(draft, cause, lost)
            seek(draft, draft.put(record, move=failure._replace(excluded=failure.dead)))


def _put(draft: Draft, group: Switchover) -> Switchover:
    draft.switchovers = draft.switchovers.insert(group.id, group)
    return group


def _is_known(group: Switchover, edge: EdgeRecord) -> bool:
    """Say whether all who use an edge are members; they are the same users, as that is one map."""
    return group.joined.get(edge.id) is edge.users


def abandon(draft: Draft, group: Switchover, error: str) -> None:
    """Leave all where they are."""
    first = next(iter(group.members))
    # Of what the configuration has no more nothing stays: it is closed, and replaced where it can.
    goes = _superseded(draft, draft.connections[first])
    stays = "cannot move beside what it has" if goes else "stays where it is"
    draft.do(act.Warn(first, f"{stays}: {error}"))
    cancel_switchover(draft, group.id, is_abandoned=True)


def _move_in(group: Switchover) -> Move:
    """Return the move of a member whose plan is to be sought."""
    # Since the group began, also for one that joins later: all change hands, and are counted, at
    # once.
    return Move(group.reason, MovePhase.SEEKING, group.began, group.rule.cause, group=group.id)


def _joining_with(draft: Draft, identity: str) -> tuple[str, ...]:
    """Return the members that join with a connection: all with which it was about to return.

    An input changes hands once, so that of two returns that share one, one must be left.
    """
    record = draft.connections.get(identity)
    if record is None:
        return ()
    group = None if record.move is None else draft.switchovers.get(record.move.group)
    if group is None:
        return (identity,) if may_move(record) else ()
    if group.is_switching or not group.rule.is_shared:
        return ()
    draft.switchovers = draft.switchovers.remove(group.id)
    return tuple(group.members)


def _serves(draft: Draft, record: ConnectionRecord, plan: Plan) -> bool:
    """Say whether the plan that runs is the one that was found, and all of it may stay."""
    return plan.names == record.placement.plan.names and not _superseded(draft, record)


def may_move(record: ConnectionRecord) -> bool:
    """Say whether a connection runs undisturbed, so that it may change to a better plan."""
    return record.state is ConnectionState.RUNNING and record.move is None and not record.finished


def look_for_preferred(draft: Draft, record: ConnectionRecord) -> None:
    """Have it checked whether the preferred plan is available, when it is time."""
    preferred = record.preferred
    if preferred is None or preferred.look_at is None or preferred.is_looking:
        return
    if preferred.look_at > draft.now:
        draft.do(act.WakeAt(preferred.look_at))
        return
    if not may_move(record):
        look_later(draft, record)
        return
    # One look at a time: a bridge that hangs in it holds up no other connection's.
    draft.put(record, preferred=preferred._replace(is_looking=True, look_at=None))
    lane = f"{record.id}?"
    draft.do(act.CheckPreferred(lane, record.id, preferred.plan, draft.avoided_lately()))


def preferred_checked(draft: Draft, event: ev.PreferredChecked) -> None:
    """Return when the preferred plan was available for long enough without a break."""
    record = draft.connections.get(event.connection)
    if record is None or record.preferred is None:
        return
    # A look that was under way as the connection moved says nothing of the time since.
    # Taken back in any case, or no look would ever follow.
    preferred = record.preferred._replace(is_looking=False)
    if not event.is_available or not may_move(record):
        preferred = preferred._replace(available_since=None)
        look_later(draft, draft.put(record, preferred=preferred))
        return
    since = draft.now if preferred.available_since is None else preferred.available_since
    record = draft.put(record, preferred=preferred._replace(available_since=since))
    if draft.now - since < RULES[MoveReason.RETURN].patience(draft.policy):
        look_later(draft, record)
        return
    begin(draft, [record], MoveReason.RETURN)


def configured(draft: Draft, event: ev.Configured) -> None:
    """Take a configuration over, and have every connection that it concerns look for its plan."""
    draft.revision, draft.policy, draft.bridges = event.revision, event.policy, event.bridges
    draft.candidates, draft.replaced = 0, ()
    draft.configurers = (*draft.configurers, event.waiter)
    # Before any connection is looked at: what is placed from here on shares nothing old.
    draft.supersede(event.superseded)
    for name in event.superseded:
        draft.failed = draft.failed.discard(name)
        draft.avoided = draft.avoided.discard(name)
        draft.services = draft.services.discard(name)
    # Before the searches that follow, which are to be made in this revision.
    report = act.Announce("configuration", f"revision {event.revision}")
    draft.actions += [act.Adopt(event.revision), report]
    for item in oldest_first(draft.connections.values()):
        record = draft.connections[item.id]
        if not record.has_plan or record.state is ConnectionState.CLOSING:
            continue
        if record.wanted.function in event.functions or _superseded(draft, record):
            _outdate(draft, record)


def candidates_changed(draft: Draft, event: ev.CandidatesChanged) -> None:
    """Know the bridges of the components that plans may have from now on.

    A connection that waits for a candidate looks again, and one that runs goes back to a better
    candidate only where `failover.return_after` says so: what comes and goes moves no connection.
    A plan that is being sought, or was found and is not in use yet, must not have what is gone.
    """
    draft.bridges = event.bridges
    draft.candidates = event.number
    # Of searches that began longer ago than these, every result counts as outdated.
    draft.replaced = (*draft.replaced, event.superseded)[-_KNOWN_CHANGES:]
    for name in event.superseded:
        draft.services = draft.services.discard(name)
    seek_outdated(draft)
    look_soon(draft)
    draft.do(act.Announce("candidates", "changed", event.summary))


def _outdate(draft: Draft, record: ConnectionRecord) -> None:
    move = record.move
    if move is not None and move.group and move.phase is not MovePhase.SWITCHING:
        cancel_switchover(draft, move.group)
        record = draft.connections[record.id]
    # It was preferred in a configuration that is none any more (`configured_at_the_end.txt`).
    record = draft.put(record, preferred=None)
    # One that needs a replacement anyway seeks it in the new configuration, and needs no move.
    if move is not None and move.reason is MoveReason.DEATH:
        # What could not be opened as it was configured before may be another now
        # (`configured_searches.txt`).
        move = move._replace(excluded=frozenset(), next=None)
        seek(draft, draft.put(drop_next(draft, record), move=move))
    else:
        draft.outdated = draft.outdated.insert(record.id)


def continue_reconfiguration(draft: Draft) -> None:
    """Do what a change of configuration still asks for, while a caller waits for one."""
    records = [
        record
        for identity in sorted(draft.outdated)
        if (record := draft.connections.get(identity)) is not None
        and record.state is not ConnectionState.CLOSING
    ]
    draft.outdated = HashTrieSet(record.id for record in records)
    # All move at once or not at all, so that what is opening or switching now is waited for. Each
    # of these ends with an event, after which this is called again.
    if any(group.rule.is_owed for group in draft.switchovers.values()) or any(
        record.reason not in {None, MoveReason.DEATH} for record in records
    ):
        return
    draft.outdated = HashTrieSet()
    members = [record for record in records if record.move is None and not record.finished]
    if members:
        begin(draft, members, MoveReason.CONFIGURATION)
        return
    # What could not move by now is closed first. Then the requests that were in the way of moves,
    # with plans that are sought anew: those that they had may be in the way still.
    _replace_what_is_left(draft)
    for record in oldest_first(draft.connections.values()):
        move = record.move
        if (
            move is not None
            and move.reason is MoveReason.REQUEST
            and move.phase is MovePhase.WAITING
        ):
            draft.resolve(draft.put(record, move=move._replace(phase=MovePhase.SEEKING)))
    draft.actions += map(act.Reply, draft.configurers)
    draft.configurers = ()


def _superseded(draft: Draft, record: ConnectionRecord) -> tuple[int, ...]:
    """Return what a connection uses that the configuration has no more."""
    ids = {id_ for placement in record.plans for id_ in placement.components.values()}
    return tuple(sorted(id_ for id_ in ids if draft.components[id_].is_superseded))


def _replace_what_is_left(draft: Draft) -> None:
    """Close what the configuration has no more, and let connections that use it look further."""
    left: set[int] = set()
    for record in oldest_first(draft.connections.values()):
        is_replaced = record.move is not None and record.move.has_lost
        if record.is_active and not is_replaced and not record.finished:
            # In the lane in which `replace` has the next plan sought and opened: a device that can
            # be open once is free by then.
            rest = _superseded(draft, record)
            left.update(rest)
            if rest:
                draft.do(act.Release(f"{record.id}#{record.attempt + 1}", rest))
    if left:
        names = frozenset(draft.components[number].name for number in left)
        replace(draft, death(draft, _cause(draft, names), sorted(left)))


def _cause(draft: Draft, superseded: frozenset[str]) -> str:
    """Say what another configuration means for components that it has superseded."""
    changed = sorted(superseded & draft.bridges.keys())
    gone = sorted(superseded - draft.bridges.keys())
    parts = [f"changed {listed(changed)}"] if changed else []
    parts += [f"no longer has {listed(gone)}"] if gone else []
    return f"the configuration {' and '.join(parts)}"
