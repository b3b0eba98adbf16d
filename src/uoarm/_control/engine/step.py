"""The engine: one event and the state before it give the state after it, and what to do.

What should be open, and what remains to be done for it, are functions of the state alone. `step`
applies an event, and takes of what remains what may be done now. Which plan is wanted is found
outside, by a search whose result is an event. `step` touches no thread, clock, lock, log or bridge.
Requests, openings and kills are here; `failover` has what happens when components die, `switchover`
how connections change to better plans and to another configuration, `leaving` how they leave one.
"""

from __future__ import annotations

from collections.abc import Callable
from itertools import filterfalse
from typing import Any, NamedTuple

from rpds import HashTrieSet

from uoarm._control.engine import actions as act
from uoarm._control.engine import events as ev
from uoarm._control.engine import failover, offers, switchover
from uoarm._control.engine.draft import Draft, InputInUseError, by_age, connection_of
from uoarm._control.engine.leaving import end, finish_if_asked, hand_over
from uoarm._control.engine.move import RULES, Move, MovePhase, MoveReason, OnOpenFailure
from uoarm._control.engine.placement import Batch, Part, Placement
from uoarm._control.engine.state import ConnectionRecord, State, oldest_first
from uoarm.errors import (
    BridgeError,
    ConnectionClosedError,
    FailureReason,
    ResolutionError,
    UsageError,
)
from uoarm.model import ConnectionState, Health, Plan, PortRef

_CLOSED = "the robot manager is closed"


class Remaining(NamedTuple):
    """A phase that a connection has before it; it comes after the one before it in the difference.

    Attributes:
        phase: what is to be done.
        parts: of an opening: what nothing has open yet, in the order in which it opens.
        batches: of an opening: those that open some of it for others, and come before it.
        members: of a switching: the others whose plans are not open, which come before it.
        is_begun: whether its result is awaited, which is an event.
    """

    phase: MovePhase
    parts: tuple[Part, ...] = ()
    batches: tuple[int, ...] = ()
    members: HashTrieSet[str] = HashTrieSet()
    is_begun: bool = False


def difference(state: State, record: ConnectionRecord) -> tuple[Remaining, ...]:
    """Return what a connection has before it until it is as it should be; empty: it is.

    The order is partial over all connections: those of one connection follow one another, and what
    stands first waits for the batches and the members that it names.
    """
    move = record.move
    if move is None:
        return ()
    phases = move.rule.phases
    if move.next is None:
        # A plan is being sought, will be when it is time, or is not wanted any more.
        begun = Remaining(move.phase, is_begun=True)
        return (begun, *map(Remaining, phases[1:]))
    parts, batches = _missing(state, move.next.parts)
    opening = (Remaining(MovePhase.OPENING, parts, batches),) if parts else ()
    # Of one that moves alone nothing is switched: after a death its inputs feed nothing, and a
    # request has none yet.
    if not move.group:
        return (*opening, Remaining(MovePhase.TAKING_OVER))
    group = state.switchovers[move.group]
    # A persistent set, as a group may have thousands of members that come here one after another.
    others, is_begun = group.unopened.discard(record.id), group.is_switching
    switching = Remaining(MovePhase.SWITCHING, members=others, is_begun=is_begun)
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


def step(state: State, event: ev.Event, now: float) -> tuple[State, tuple[act.Action, ...]]:
    """Return the state after an event, and the actions that follow from it.

    Args:
        state: before the event.
        event: what happened.
        now: when, in seconds of the manager's monotonic clock.
    """
    draft = Draft.of(state, now)
    _HANDLERS[type(event)](draft, event)
    # After the whole event: what it placed for one connection may be what another waits for.
    _proceed(draft)
    # Whatever happened may have been the last thing that a change of configuration waited for.
    if draft.configurers:
        switchover.continue_reconfiguration(draft)
    return draft.finished(), tuple(draft.actions)


def _proceed(draft: Draft) -> None:
    """Take of what remains for the connections concerned what may be done now."""
    for identity in draft.concerned:
        # Read anew: what was done for one may have ended another, or all that move with it.
        record = draft.connections.get(identity)
        remaining = () if record is None else difference(draft, record)
        if record is None or not remaining or remaining[0].is_begun:
            continue
        first = remaining[0]
        if first.phase is MovePhase.SWITCHING:
            switchover.arrive(draft, record, is_last=not first.members)
        elif first.batches:
            draft.await_batches(record, first.batches)
        elif first.phase is MovePhase.OPENING:
            draft.open(record, first.parts)
        elif record.reason is MoveReason.REQUEST:
            _run(draft, record)
        else:
            hand_over(draft, record)


def _requested(draft: Draft, event: ev.Requested) -> None:
    if draft.is_closing:
        draft.do(act.Reply(event.waiter, ConnectionClosedError(_CLOSED)))
        return
    draft.requests += 1
    record = ConnectionRecord(
        event.connection,
        event.wanted,
        event.validate,
        event.waiter,
        has_callback=event.has_callback,
        number=draft.requests,
    )
    # The plan was found in the caller's thread, before the event: the configuration, or a
    # candidate, may have changed in between. Then it is only sought once more.
    if event.plan is None or _is_outdated(draft, event):
        draft.resolve(draft.put(record, move=_request(draft, MovePhase.SEEKING)))
    else:
        _begin(draft, record, event.plan)


def _request(draft: Draft, phase: MovePhase, placement: Placement | None = None) -> Move:
    """Return the move of a request to its first plan."""
    # Without `retry_at`: one that waits does so for others to move away, and not for a time. Its
    # patience is its caller's, who gives it up by a kill.
    return Move(MoveReason.REQUEST, phase, draft.now, next=placement)


def _resolved(draft: Draft, event: ev.Resolved) -> None:
    # The request was given up meanwhile, or has a plan: this is the answer of a search before.
    record = draft.connections.get(event.connection)
    if record is None or record.has_plan:
        return
    if _is_outdated(draft, event):
        draft.resolve(record)
    elif event.plan is None:
        _refuse(draft, record, event.error)
    else:
        _begin(draft, record, event.plan)


def _is_outdated(draft: Draft, event: ev.Requested | ev.Resolved) -> bool:
    """Say whether the configuration changed meanwhile, or a candidate that was found."""
    return event.revision != draft.revision or (
        event.plan is not None and draft.is_outdated(event.plan, event.candidates)
    )


def _begin(draft: Draft, record: ConnectionRecord, plan: Plan) -> None:
    """Open a connection's first plan."""
    try:
        output = output_of(plan, record.wanted)
    except UsageError as error:
        _refuse(draft, record, error)
        return
    if output is None and record.has_callback:
        text = f"function {plan.function!r} has no output to read"
        _refuse(draft, record, UsageError(text))
        return
    record = record._replace(output=output)
    try:
        placement = draft.place(record, plan, record.id)
    except InputInUseError as error:
        # Connections that move to the new configuration may leave what is in the way. To ask the
        # caller to try again would be to let a race of ours fail its request.
        if draft.configurers:
            draft.put(record, move=_request(draft, MovePhase.WAITING))
        else:
            _refuse(draft, record, ResolutionError(str(error)))
        return
    # Published before anything opens: the objects that open read the plan's mode of checking, and
    # the inbox, from the record that was published last.
    record = draft.put(record, move=_request(draft, MovePhase.OPENING, placement))
    draft.publish(record)


def _refuse(draft: Draft, record: ConnectionRecord, error: BaseException | None) -> None:
    """Answer a request of which nothing was opened."""
    # No end to be waited for, and nothing was published: the record just goes.
    draft.remove(record)
    draft.do(act.Reply(record.waiter, error))


def output_of(plan: Plan, wanted: PortRef) -> str | None:
    """Return the name of the output that the application receives, None where it has none.

    Raises:
        UsageError: it has no such one.
    """
    component = plan.provider.component
    if not component.outputs and wanted.port is None:
        return None
    output = component.output(wanted.port)
    if output is None:
        has = ", ".join(f"{wanted.function}.{output.name}" for output in component.outputs)
        raise UsageError(f"say which output of {wanted.function!r} is meant: {has or 'none'}")
    return output.name


def _run(draft: Draft, record: ConnectionRecord) -> None:
    # Published before the reply: who has the handle finds it running.
    waiter, move = record.waiter, record.move
    assert move is not None, "it was on its way to its first plan"
    record = draft.put(
        record, state=ConnectionState.RUNNING, waiter="", current=record.next, move=None
    )
    draft.do(act.Publish(record))
    draft.announce(record, RULES[MoveReason.REQUEST].announced)
    draft.do(act.Reply(waiter))
    finish_if_asked(draft, record)
    if move.lost:
        failover.replace_lost(draft, record, move)


def _opened(draft: Draft, event: ev.Opened) -> None:
    batch = draft.batches[event.batch]
    # From here on its parts count as open; those that were not done are taken out by `settle`.
    draft.batches = draft.batches.remove(event.batch)
    connection = connection_of(batch.user)
    record = draft.connections.get(connection)
    late = draft.settle(record, batch, event.done)
    if late:
        # With the connection that they were opened for: messages may have been lost in them.
        draft.do(act.Close(f"late {event.batch}", connection, late))
    if event.error is not None and record is not None:
        _failed_to_open(draft, record, batch, event)
    # Its own, and those that shared some of it: what has failed they have opened in a batch of
    # their own, and fail by themselves where it fails again.
    draft.concerned += by_age((connection, *batch.waiting)) if batch.waiting else (connection,)


def _failed_to_open(draft: Draft, record: ConnectionRecord, batch: Batch, event: ev.Opened) -> None:
    """Do without the plan that could not be opened, unless the connection has left it already."""
    move, error = record.move, event.error
    assert error is not None, "something could not be opened"
    # By the user of the parts: a batch of an attempt that was given up says nothing of the next.
    if move is None or batch.user not in {placement.user for placement in record.plans}:
        return
    match move.rule.failing:
        case OnOpenFailure.STAYS:
            switchover.abandon(draft, draft.switchovers[move.group], str(error))
        case OnOpenFailure.SEEKS if record.current is None:
            part = next((part for part in batch.parts if part not in event.done), batch.parts[-1])
            component = draft.component_of(record.placement, part)
            failover.replace_unopened(draft, record, component, error)
        case OnOpenFailure.SEEKS:
            # Without a next plan the batch was the first one's, which runs: nothing is given up.
            if move.next is not None:
                failover.try_another(draft, record, str(error))
        case OnOpenFailure.CLOSES:
            pass


def _killed(draft: Draft, event: ev.Killed) -> None:
    # Idempotent: what has ended, or is ending, is answered at once. The caller of the first kill
    # closes; a second one does not wait for it.
    record = draft.connections.get(event.connection)
    if record is None or not record.has_plan:
        if record is not None:
            _refuse(draft, record, ConnectionClosedError(event.cause or "the request was given up"))
        draft.do(act.Reply(event.waiter))
        return
    if record.state is ConnectionState.CLOSING:
        draft.do(act.Reply(event.waiter))
        return
    # A request that is given up while parts open for it: what opens late comes back as `Opened` and
    # is closed.
    outcome = ConnectionState.FAILED if event.is_failure else ConnectionState.CLOSED
    if event.is_failure:
        draft.do(act.Forget(record.placement.plan.names))
    end(draft, record, outcome, event.cause, event.waiter, killer=event.waiter)


def _drained(draft: Draft, event: ev.Drained) -> None:
    record = draft.connections.get(event.connection)
    if record is not None and record.finished:
        end(draft, record, ConnectionState.CLOSED, record.finished)


def _ran_out(draft: Draft, event: ev.RanOut) -> None:
    # Only now it is known which of its components another plan uses by this time.
    ended, parts = draft.end_draining(event.user)
    lane = f"ran out {event.user}"
    draft.do(act.Close(lane, ended.connection, parts, ended.placement, ended.lost))


def _ended(draft: Draft, event: ev.Ended) -> None:
    # In no list any more when the caller's thread goes on, and published before that.
    record = draft.connections[event.connection]
    draft.remove(record)
    # How it ends was settled as the end began: what died while it closed changes nothing.
    move = record.move
    assert move is not None, "it was on its way to its end"
    error = move.error
    if error is None and record.waiter:
        text = f"connection {record.id} ended while it was being opened: {record.cause or 'kill'}"
        error = ConnectionClosedError(text)
        if move.outcome is ConnectionState.FAILED and not move.killer:
            error = BridgeError(text, FailureReason.UNAVAILABLE)
    record = record._replace(state=move.outcome)
    draft.publish(record)
    draft.actions += [act.Reply(record.waiter, error)] if record.waiter else []
    draft.actions += [act.Reply(move.killer)] if move.killer else []
    _reply_when_closed(draft)


def _stopped(draft: Draft, event: ev.Stopped) -> None:
    # First, so that nothing that is asked from here on begins anew.
    draft.is_closing, draft.closers = True, (*draft.closers, event.waiter)
    for item in oldest_first(draft.connections.values()):
        record = draft.connections[item.id]  # an end may change others, with which it returns
        if not record.has_plan:
            _refuse(draft, record, ConnectionClosedError(_CLOSED))
        else:
            cause = "the robot manager was closed"
            end(draft, record, ConnectionState.CLOSED, cause, lane=event.waiter)
    _reply_when_closed(draft)


def _configured(draft: Draft, event: ev.Configured) -> None:
    # Its bridges would be in force after the others were closed, and stay open.
    if draft.is_closing:
        draft.do(act.Reply(event.waiter, ConnectionClosedError(_CLOSED)))
    else:
        switchover.configured(draft, event)


def _reply_when_closed(draft: Draft) -> None:
    if not draft.connections:
        draft.actions += map(act.Reply, draft.closers)
        draft.closers = ()


def _health_reported(draft: Draft, event: ev.HealthReported) -> None:
    failover.health_reported(draft, event)
    # What an offer failed for may be well now, and mostly is this.
    is_news = any(isinstance(action, act.Announce) for action in draft.actions)
    if event.health is Health.OK and is_news:
        offers.retry_offers(draft)


def _time_reached(draft: Draft, event: ev.TimeReached) -> None:
    # The timer keeps one time only, the earliest. So all that waits is looked at; each says anew
    # when it is due where that is not yet, and times that lie close together are one event.
    del event
    for record in oldest_first(draft.connections[identity] for identity in draft.timed):
        failover.look_again(draft, draft.connections[record.id])
        switchover.look_for_preferred(draft, draft.connections[record.id])
    offers.settle_offers(draft)


def _replacement_sought(draft: Draft, event: ev.ReplacementSought) -> None:
    # A death, a kill or a change since the search began has begun another, or none.
    record = draft.connections.get(event.connection)
    if record is None or record.attempt != event.attempt:
        return
    if event.switchover:
        switchover.found(draft, record, event)
    else:
        failover.found(draft, record, event)


_HANDLERS: dict[type[Any], Callable[[Draft, Any], None]] = {
    ev.Requested: _requested,
    ev.Resolved: _resolved,
    ev.Killed: _killed,
    ev.Opened: _opened,
    ev.HealthReported: _health_reported,
    ev.Drained: _drained,
    ev.RanOut: _ran_out,
    ev.Ended: _ended,
    ev.ReplacementSought: _replacement_sought,
    ev.PreferredChecked: switchover.preferred_checked,
    ev.InputsSwitched: switchover.inputs_switched,
    ev.OffersWanted: offers.offers_wanted,
    ev.OfferOpened: offers.offer_opened,
    ev.OfferClosed: offers.offer_closed,
    ev.OfferReported: offers.offer_reported,
    ev.TimeReached: _time_reached,
    ev.Stopped: _stopped,
    ev.Configured: _configured,
    ev.CandidatesChanged: switchover.candidates_changed,
}
