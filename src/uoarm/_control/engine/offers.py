"""What is on offer: wants of the manager's own, that one function each is open in a framework.

An offer is opened, closed and tried again here; what that means for a bridge is done in its lane.
What broke is opened again at once, and with pauses where it breaks again and again. What has
finished is closed and stays so: a source that ends is no failure, and is not played again.
"""

from __future__ import annotations

from uoarm._backoff import Backoff
from uoarm._control.engine import actions as act
from uoarm._control.engine import events as ev
from uoarm._control.engine.draft import Draft
from uoarm._control.engine.state import OfferRecord
from uoarm.model import Health, OfferState

_PAUSES = Backoff(first=1.0, most=30.0)
# Between two attempts, also where what is well again has it tried at once.
_LEAST_SECONDS = 0.1
# For so long what is new waits for what is offered no more, whose endpoints it may have.
_LEAVING_SECONDS = 5.0


def offers_wanted(draft: Draft, event: ev.OffersWanted) -> None:
    """Offer these, and close what is offered no more, or otherwise, before what is new opens."""
    wanted = frozenset(event.names)
    for _, record in sorted(draft.offers.items()):
        if record.name not in wanted or record.name in event.replaced:
            _settle(draft, record._replace(is_wanted=False, is_renewed=record.name in wanted))
        elif not record.is_wanted:
            _settle(draft, record._replace(is_renewed=True))  # it is wanted again as it closes
    for name in event.names:
        if name not in draft.offers:
            _settle(draft, _begun(draft, name))
    retry_offers(draft)


def offer_opened(draft: Draft, event: ev.OfferOpened) -> None:
    """Note what became of an opening; what has ended meanwhile is closed again."""
    record = draft.offers.get(event.name)
    # Each opening has a number: one that ends after its offer has gone, and come anew, changes
    # nothing.
    if record is None or record.number != event.number:
        return
    record = record._replace(is_busy=False, is_tried=True)
    if event.cause:
        record = record._replace(
            number=0, failures=record.failures + 1, state=OfferState.FAILED, cause=event.cause
        )
        record = record._replace(retry_at=draft.now + _PAUSES.pause(record.failures))
    else:
        record = record._replace(is_open=True, state=OfferState.OPEN, cause="")
    _settle(draft, record)


def offer_closed(draft: Draft, event: ev.OfferClosed) -> None:
    """Note that what was open is closed; open it again, unless it has finished."""
    record = draft.offers.get(event.name)
    if record is None or record.number != event.number:
        return
    record = record._replace(number=0, is_open=False, is_busy=False)
    if record.is_wanted and record.ended is not None and record.ended[0] is OfferState.FINISHED:
        state, cause = record.ended
        _settle(draft, record._replace(state=state, cause=cause))
    else:
        # What has lasted for as long as the longest pause begins with a clean record.
        lasted = draft.now - record.begun
        failures = record.failures + 1 if lasted < _PAUSES.most else 0
        pause = _PAUSES.pause(failures - 1) if failures > 1 else 0.0
        _settle(draft, record._replace(failures=failures, retry_at=draft.now + pause))


def offer_reported(draft: Draft, event: ev.OfferReported) -> None:
    """Note how the framework's side of an offer is, or what became of its connections."""
    record = draft.offers.get(event.name)
    # A report of what was open before says nothing of what is open now.
    if record is None or record.number != event.number:
        return
    if event.health in {Health.LOST, Health.FINISHED}:
        is_lost = event.health is Health.LOST
        state = OfferState.OPENING if is_lost else OfferState.FINISHED
        # The first report counts. While it opens, it is closed as soon as it has opened.
        _settle(draft, record._replace(ended=record.ended or (state, event.cause)))
        return
    draft.do(act.Announce(f"offer {record.name}", event.health.value, event.cause))
    if record.state is OfferState.OPEN:
        cause = event.cause if event.health is Health.DEGRADED else ""
        draft.offers = draft.offers.insert(record.name, record._replace(cause=cause))


def retry_offers(draft: Draft) -> None:
    """Try at once what failed and waits to be tried again, as something may be well by now."""
    for record in _due(draft):
        if record.retry_at is not None and record.is_tried:
            soon = max(draft.now, record.begun + _LEAST_SECONDS)
            _settle(draft, record._replace(retry_at=min(record.retry_at, soon)))


def settle_offers(draft: Draft) -> None:
    """Open what is due by now; what is not says again when it will be."""
    for record in _due(draft):
        _settle(draft, record)


def _due(draft: Draft) -> list[OfferRecord]:
    """Return the offers that wait for a time, by name."""
    return [draft.offers[name] for name in sorted(draft.due)]


def _begun(draft: Draft, name: str) -> OfferRecord:
    # What leaves may have the endpoint of what comes, which a framework gives once: it goes first,
    # but one that hangs as it closes holds up none for long.
    return OfferRecord(name, retry_at=draft.now + (_LEAVING_SECONDS if draft.leaving else 0.0))


def _settle(draft: Draft, record: OfferRecord) -> None:
    """Have done for an offer what may be done now, and keep it."""
    # One call at a time: the result of an opening, or of a closing, is waited for.
    if record.is_busy:
        pass
    elif record.is_open:
        ended = record.ended
        if ended is not None and ended[0] is OfferState.OPENING:
            record = record._replace(state=ended[0], cause=ended[1])
        if ended is not None or not record.is_wanted:
            record = record._replace(is_busy=True)
            draft.do(act.CloseOffer(f"offer {record.name}", record.name, record.number))
    elif not record.is_wanted:
        _leave(draft, record)
        return
    elif record.retry_at is not None and record.retry_at <= draft.now:
        # A number of its own, by which what is said of an earlier opening is known as such.
        record = record._replace(
            number=draft.new_id(), is_busy=True, begun=draft.now, ended=None, retry_at=None
        )
        draft.do(act.OpenOffer(f"offer {record.name}", record.name, record.number))
    elif record.retry_at is not None:
        draft.do(act.WakeAt(record.retry_at))
    _keep(draft, record)


def _leave(draft: Draft, record: OfferRecord) -> None:
    """Know an offer no more, or begin it anew; after the last of these what is new may open."""
    draft.offers = draft.offers.discard(record.name)
    draft.due = draft.due.discard(record.name)
    draft.leaving = draft.leaving.discard(record.name)
    draft.do(act.Announce(f"offer {record.name}", OfferState.CLOSED.value))
    if record.is_renewed:
        _settle(draft, _begun(draft, record.name))
    if not draft.leaving:
        for other in _due(draft):
            if not other.is_tried:
                _settle(draft, other._replace(retry_at=draft.now))


def _keep(draft: Draft, record: OfferRecord) -> None:
    before = draft.offers.get(record.name) or OfferRecord(record.name)
    draft.offers = draft.offers.insert(record.name, record)
    if record.retry_at != before.retry_at:
        waits = record.retry_at is not None
        draft.due = draft.due.insert(record.name) if waits else draft.due.discard(record.name)
    if not record.is_wanted:
        draft.leaving = draft.leaving.insert(record.name)
    if record.shown != before.shown:
        draft.do(act.Announce(f"offer {record.name}", *record.shown))
