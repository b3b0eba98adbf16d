"""When components die: which connections take another plan, which wait, and which end."""

from __future__ import annotations

from collections.abc import Container, Iterable, Mapping

from uoarm._control.engine import actions as act
from uoarm._control.engine import events as ev
from uoarm._control.engine.draft import Draft, InputInUseError
from uoarm._control.engine.leaving import (
    cancel_switchover,
    changes_lately,
    drop_next,
    end,
    finish_if_asked,
)
from uoarm._control.engine.move import Move, MovePhase, MoveReason, forget_earlier
from uoarm._control.engine.placement import (
    MESSAGES,
    ComponentHealth,
    ComponentRecord,
    LinkEnd,
    Placement,
)
from uoarm._control.engine.state import ConnectionRecord, oldest_first
from uoarm._support.ordered import OrderedMap
from uoarm.errors import ConnectionClosedError
from uoarm.model import ConnectionState, Health, Plan, Role

# Between two searches of a connection that waits: an eighth of what it has waited, within these.
_AGAIN_SECONDS = 0.1
_SELDOM_SECONDS = 5.0
_SHARE = 8


def health_reported(draft: Draft, event: ev.HealthReported) -> None:
    """Note the health of components; end what finished, replace what was lost."""
    concerned = _concerned(draft, event)
    is_lost = event.health is Health.LOST
    # Before anything is sought below: a search must ask anew, not use what was known before.
    draft.do(act.Forget(tuple(concerned)))
    if event.component is None:
        subject = f"bridge {event.bridge}"
        draft.do(act.Announce(subject, event.health.value, event.cause))
        # It is said once, and holds for what is opened later, too.
        draft.troubled = draft.troubled.discard(event.bridge)
        if event.health is Health.DEGRADED:
            draft.troubled = draft.troubled.insert(event.bridge, event.cause)
    lost: list[int] = []
    for name in concerned:
        number = draft.serving.get(name)
        if number is None and event.function:
            _judge_service(draft, name, event)
        # Spared are those that the next bridge of this name has opened already: the death of the
        # one before was reported late.
        if number is None or event.instance not in {0, number}:
            continue
        if number in event.spared:
            continue
        if _is_of_ended_link(draft, number, event):
            continue
        record = draft.note_health(number, event.part, event.health, event.cause)
        if event.health is Health.FINISHED:
            _finish(draft, record)
        elif is_lost:
            lost.append(number)
    # All that one bridge had dies at once: no plan that is sought from here on may have any of it.
    if lost:
        _lose(draft, lost, frozenset(concerned), event)
    # After the edges were stopped, as its closing may bring last messages.
    if is_lost and event.component is None:
        draft.do(act.RetireBridge(event.bridge))
        _forget_reports(draft, concerned)
    if event.health is Health.OK and not all(name in draft.serving for name in concerned):
        look_soon(draft)  # what is not open may be a candidate again


def _concerned(draft: Draft, event: ev.HealthReported) -> list[str]:
    """Return the names of the components that a report is about."""
    # Candidates may be open that were discovered once and are seen no more.
    name = event.component
    if name is not None:
        number = draft.serving.get(name)
        bridge = draft.bridges.get(name)
        if number is not None:
            bridge = draft.components[number].step.component.bridge
        return [name] if bridge == event.bridge else []
    serving = (draft.components[number] for number in sorted(draft.serving.values()))
    there = {record.name: record.step.component.bridge for record in serving}
    bridges = {**draft.bridges, **there}
    return [name for name, bridge in bridges.items() if bridge == event.bridge]


def _judge_service(draft: Draft, name: str, event: ev.HealthReported) -> None:
    """Note the health of a service, of which nothing is open: the next call finds its provider."""
    before = draft.services.get(name, ComponentHealth())
    health = before.noted(event.part, event.health, event.cause)
    # What raises too often again was given another chance since: then it is lost once more.
    is_same = (health.health, health.cause) == (before.health, before.cause)
    is_repeated = is_same and event.part != MESSAGES
    if not is_repeated and health.is_news(before, event.health, event.cause):
        subject = f"component {name}"
        draft.do(act.Announce(subject, health.health.value, health.cause, event.function))
    _keep_service(draft, name, health)
    if event.is_avoided:
        draft.avoided = forget_earlier(draft.avoided, draft.now).insert_last(name, draft.now)
    elif event.health is Health.OK and health.health is not Health.LOST:
        draft.avoided = draft.avoided.discard(name)


def _forget_reports(draft: Draft, names: Iterable[str]) -> None:
    """Forget what a bridge that is gone reported of services, but not what they raised."""
    for name in names:
        before = draft.services.get(name)
        if before is not None:
            raises = before.reported.get(MESSAGES, (Health.OK, ""))
            _keep_service(draft, name, ComponentHealth().noted(MESSAGES, *raises))


def _keep_service(draft: Draft, name: str, health: ComponentHealth) -> None:
    """Keep the health of a service that is not well, and of no other."""
    is_well = health.health is Health.OK
    services = draft.services
    draft.services = services.discard(name) if is_well else services.insert(name, health)


def _is_of_ended_link(draft: Draft, component: int, event: ev.HealthReported) -> bool:
    """Say whether a report is of a native link that has ended: it would stand for ever."""
    end = event.part
    if not isinstance(end, LinkEnd) or event.health in {Health.FINISHED, Health.LOST}:
        return False
    name = draft.components[component].name
    fed = (name, end.port) if end.role is Role.INPUT else (end.peer, end.peer_port)
    joined = draft.edges.get(draft.feeding.get(fed, 0))
    return joined is None or (component, end) not in joined.ends


def _finish(draft: Draft, component: ComponentRecord) -> None:
    """Have connections end when what is under way has arrived."""
    for identity in draft.using((component.id,)):
        record = draft.connections[identity]
        if not _uses(record.placement, (component.id,)) or record.finished:
            continue
        if record.state is ConnectionState.CLOSING:
            continue
        record = draft.put(record, finished=f"component {component.name!r} finished")
        # One that is still being opened drains when it is open (`step._run`): what has come by
        # then is for the application.
        if record.is_active:
            finish_if_asked(draft, record)


def _lose(
    draft: Draft, lost: list[int], concerned: frozenset[str], event: ev.HealthReported
) -> None:
    dead = [draft.components[number].name for number in lost]
    draft.failed = forget_earlier(draft.failed, draft.now)
    draft.avoided = forget_earlier(draft.avoided, draft.now)
    for name in dead:  # last, as the order is that of the times
        draft.failed = draft.failed.insert_last(name, draft.now)
        if event.is_avoided:
            draft.avoided = draft.avoided.insert_last(name, draft.now)
    # A bridge takes with it what other connections had, which this text is not to name.
    what = f"bridge {event.bridge!r}" if event.component is None else f"component {dead[0]!r}"
    cause = f"{what} was lost: {event.cause}"
    replace(draft, death(draft, cause, lost)._replace(dead=concerned, excluded=concerned))


def death(draft: Draft, cause: str, lost: Iterable[int]) -> Move:
    """Return the move that replaces what was lost."""
    lost = tuple(lost)
    dead = frozenset(draft.components[number].name for number in lost)
    return Move(MoveReason.DEATH, MovePhase.SEEKING, draft.now, cause, lost=lost, dead=dead)


def replace(draft: Draft, failure: Move) -> None:
    """Let no message through what was lost, and have the connections that use it do without."""
    # First all edges, then the connections: what one of them finds may not use another's dead.
    lost = {number: place for place, number in enumerate(failure.lost)}
    draft.do(act.Stop(draft.lose(failure.lost)))
    for identity in draft.using(lost):
        # Read anew: what was done for one before may have changed it, as members of a switchover.
        record = draft.connections[identity]
        if record.state is ConnectionState.CLOSING:
            continue
        if _uses(record.placement, lost):
            _lose_current(draft, record, failure, lost)
        elif _uses(record.next, lost):
            _lose_next(draft, record, failure)


def _lose_current(
    draft: Draft, record: ConnectionRecord, failure: Move, places: Mapping[int, int]
) -> None:
    """Replace the plan that runs, or end; one that is opened is replaced when all of it is open.

    Args:
        draft: the state.
        record: the connection.
        failure: what all connections lost.
        places: where in that each component stands.
    """
    # A second death while the first is being replaced adds to it: the gap counts from the first.
    before = record.move
    # Its own alone: a bridge may have died with thousands, and every plan counts what it lost.
    ids = set(record.placement.components.values())
    if record.next is not None:
        ids.update(record.next.components.values())
    lost = sorted((number for number in ids if number in places), key=places.__getitem__)
    move = failure._replace(lost=tuple(lost))
    if before is not None and before.has_lost:
        move = before._replace(
            lost=tuple(dict.fromkeys((*before.lost, *lost))),
            dead=before.dead | failure.dead,
            excluded=before.excluded | failure.excluded,
        )
    elif before is not None:
        # Its reason stays until it is known below whether the move can be left: a connection never
        # has a second one beside it.
        move = before._replace(
            since=move.since,
            cause=move.cause,
            lost=move.lost,
            dead=move.dead,
            excluded=move.excluded,
        )
    record = draft.put(record, move=move)
    if not draft.policy.enabled:
        end(draft, record, ConnectionState.FAILED, move.cause)
    elif move.reason is MoveReason.REQUEST:
        # `replace_lost` follows: whether a source raises before the last part is open or after it
        # is chance, and both come to the same (`failures.txt`).
        return
    elif move.phase is MovePhase.SWITCHING:
        return  # `inputs_switched` seeks for it, whatever the switch comes to
    elif move.group:
        cancel_switchover(draft, move.group)
        seek(draft, draft.put(draft.connections[record.id], move=move.as_death()))
    elif _uses(record.next, move.lost):
        seek(draft, drop_next(draft, record))
    elif record.next is None:
        seek(draft, record)


def replace_lost(draft: Draft, record: ConnectionRecord, opening: Move) -> None:
    """Replace what a connection lost while it was being opened, now that it runs or cannot."""
    # What could not be opened ends as a plan that runs does: what it had open passes, and closes.
    record = draft.put(record, current=record.placement, move=opening.as_death())
    if draft.policy.enabled:
        seek(draft, record)
    else:  # since a change of the configuration that came meanwhile
        end(draft, record, ConnectionState.FAILED, opening.cause)


def replace_unopened(
    draft: Draft, record: ConnectionRecord, component: str, error: BaseException
) -> None:
    """Open another plan for a request, without the component that could not be opened."""
    draft.do(act.Forget(record.placement.plan.names))
    opening = record.move
    assert opening is not None, "it was on its way to its first plan"
    if opening.lost:  # which is why, whatever the opening says of it
        replace_lost(draft, record, opening)
        return
    if not (draft.policy.enabled and _is_of_component(error)):
        end(draft, record, ConnectionState.FAILED, str(error), record.waiter, error=error)
        return
    number = record.placement.components[component]
    failure = death(draft, str(error), (number,))._replace(excluded=frozenset({component}))
    # One that runs for another connection goes on for it, and feeds what it feeds.
    if any(draft.connections[user].current is not None for user in draft.using((number,))):
        opening = failure._replace(lost=())
    else:
        replace(draft, failure)
        record = draft.connections[record.id]
        assert record.move is not None, "it moves on"
        opening = record.move
    replace_lost(draft, record, opening._replace(error=error))


def _is_of_component(error: BaseException) -> bool:
    """Say whether another component may do better, where one could not be opened."""
    # Not where the caller was interrupted, as by Ctrl-C, nor where it has given up the request.
    return isinstance(error, Exception) and not isinstance(error, ConnectionClosedError)


def _lose_next(draft: Draft, record: ConnectionRecord, failure: Move) -> None:
    """Do without the plan that was to take over."""
    move = record.move
    assert move is not None, "what comes next belongs to a move"
    if move.group:
        if move.phase is not MovePhase.SWITCHING:
            cancel_switchover(draft, move.group)
        return
    _seek_without(draft, drop_next(draft, record), failure.excluded)


def seek(draft: Draft, record: ConnectionRecord) -> None:
    """Look for a plan that can take over, unless it changed too often already."""
    failure = record.move
    assert failure is not None, "only what failed is replaced"
    # Components that die one after another would else be tried in turns for ever.
    if len(changes_lately(draft, record)) >= draft.policy.limit:
        text = f"its providers changed {draft.policy.limit} times within a minute"
        end(draft, record, ConnectionState.FAILED, f"{failure.cause}; nothing takes over: {text}")
        return
    seek_plan(draft, record)


def seek_plan(draft: Draft, record: ConnectionRecord) -> None:
    """Have the plan of a move sought; a search that is under way for it is for nothing."""
    assert record.move is not None, "only what moves needs a plan"
    # The number grows before the search is asked for, so that of two that are under way only the
    # later one is listened to. Without `retry_at`, or the timer would begin a third.
    move = record.move._replace(phase=MovePhase.SEEKING, retry_at=None)
    record = draft.put(record, attempt=record.attempt + 1, move=move)
    ids = record.placement.components
    # What died lately is tried last, but not what runs in a plan that lost something else: it is
    # well again.
    runs = (
        () if move.rule.is_beside else [name for name, id_ in ids.items() if id_ not in move.lost]
    )
    # A request seeks in the thread that waits for it: there may be no other.
    user = f"{record.id}#{record.attempt}"
    draft.do(
        act.FindReplacement(
            lane=f"switchover {move.group}" if move.group else record.waiter or user,
            connection=record.id,
            attempt=record.attempt,
            plan=record.placement.plan,
            output=record.output,
            excluded=move.excluded,
            failed=draft.failed_lately(but=runs) if move.rule.avoids_failed else OrderedMap(),
            avoided=draft.avoided_lately(),
            switchover=move.group,
        )
    )


def found(draft: Draft, record: ConnectionRecord, event: ev.ReplacementSought) -> None:
    """Open what was found; without anything, wait for what died to come back, or end."""
    move = record.move
    if move is None or move.reason is not MoveReason.DEATH:
        return
    # The search began before candidates changed, and found one that is gone or another by now.
    if event.plan is not None and draft.is_outdated(event.plan, event.candidates):
        seek(draft, record)
        return
    if event.plan is not None:
        try:
            placement = draft.place(record, event.plan, f"{record.id}#{record.attempt}")
        except InputInUseError as error:
            if draft.configurers:  # others move from what is in the way
                retry_at = draft.now + _AGAIN_SECONDS
                draft.put(record, move=move._replace(phase=MovePhase.WAITING, retry_at=retry_at))
                draft.do(act.WakeAt(retry_at))
                return
            draft.do(act.Warn(record.id, str(error)))
            # What feeds the input now may well do: that one producer is all that cannot be used.
            _seek_without(draft, record, frozenset({error.producer}))
            return
        move = move._replace(phase=MovePhase.OPENING, next=placement)
        draft.put(record, move=move)
        return
    until = move.since + move.rule.patience(draft.policy)
    # At the time itself, too: the timer may be exact, and would otherwise be asked for now. A
    # request that waits for its reply learns at once what it cannot have.
    if draft.now >= until or record.waiter:
        text = f"{move.cause}; nothing takes over: {event.error}"
        end(draft, record, ConnectionState.FAILED, text, record.waiter, error=move.error)
        return
    # Looking takes processor time and asks frameworks: who waits for long looks more seldom.
    pause = max(_AGAIN_SECONDS, min((draft.now - move.since) / _SHARE, _SELDOM_SECONDS))
    retry_at = min(draft.now + pause, until)
    # Nothing stays excluded: the dead are asked again, and what failed to open may do better.
    move = move._replace(phase=MovePhase.WAITING, excluded=frozenset(), retry_at=retry_at)
    # Before it is put as one that waits: listeners get that once (`waits.txt`).
    runs = record.state is ConnectionState.RUNNING
    record = draft.put(record, move=move, state=ConnectionState.WAITING, cause=move.cause)
    if runs:  # once, and not after each search
        draft.publish(record)
    function = record.placement.plan.function
    draft.actions += [act.Forget(move.dead, function), act.WakeAt(retry_at)]


def look_again(draft: Draft, record: ConnectionRecord) -> None:
    """Look again for what takes over, when it is time."""
    move = record.move
    if move is None or move.retry_at is None:
        return
    if move.retry_at <= draft.now:
        seek(draft, record)
    else:
        draft.do(act.WakeAt(move.retry_at))


def look_soon(draft: Draft) -> None:
    """Have connections that wait look for what takes over, now that something may."""
    # Not at once: where much comes back, each report of it calls this, and one search is enough.
    soon = draft.now + _AGAIN_SECONDS
    for record in oldest_first(draft.connections[identity] for identity in draft.timed):
        move = record.move
        if move is not None and move.retry_at is not None and move.retry_at > soon:
            draft.put(record, move=move._replace(retry_at=soon))
            draft.do(act.WakeAt(soon))


def try_another(draft: Draft, record: ConnectionRecord, error: str) -> None:
    """Do without a plan that could not be opened."""
    assert record.next is not None, "something could not be opened"
    unfit = _added(record, record.next.plan)
    draft.do(act.Warn(record.id, error))
    _seek_without(draft, drop_next(draft, record), unfit)


def _added(record: ConnectionRecord, plan: Plan) -> frozenset[str]:
    """Return what a plan would have added, or at least its provider."""
    unfit = plan.names
    return frozenset(unfit).difference(record.placement.plan.names) or frozenset(unfit[-1:])


def _seek_without(draft: Draft, record: ConnectionRecord, more: frozenset[str]) -> None:
    """Look for what takes over, and exclude more from now on."""
    move = record.move
    assert move is not None, "outside a return, what comes next replaces what failed"
    seek(draft, draft.put(record, move=move._replace(excluded=move.excluded | more)))


def _uses(placement: Placement | None, components: Container[int]) -> bool:
    return placement is not None and any(
        number in components for number in placement.components.values()
    )
