"""When the preferred plan of a connection was available for long enough, it returns to it."""

from __future__ import annotations

from uoarm._control.reconciler.actions import CheckPreferred, WakeAt
from uoarm._control.reconciler.draft import Draft
from uoarm._control.reconciler.endings import look_later
from uoarm._control.reconciler.events import PreferredChecked
from uoarm._control.reconciler.state import ConnectionRecord, recently
from uoarm._control.reconciler.switchover import begin, may_move

__all__ = ["checked", "look"]


def look(draft: Draft, record: ConnectionRecord) -> None:
    """Have somebody look for the preferred plan, when it is time."""
    if record.look_at is None or record.is_looking or record.preferred is None:
        return
    if record.look_at > draft.now:
        draft.actions.append(WakeAt(record.look_at))
        return
    if not may_move(record):
        look_later(draft, record)
        return
    draft.put(record, is_looking=True, look_at=None)
    lane = f"{record.id}?"
    draft.actions.append(
        CheckPreferred(lane, record.id, record.preferred, recently(draft.avoided, draft.now))
    )


def checked(draft: Draft, event: PreferredChecked) -> None:
    """Return when the preferred plan was available for long enough without a break."""
    record = draft.connections.get(event.connection)
    if record is None or record.preferred is None:
        return
    record = draft.put(record, is_looking=False)
    if not event.is_available or not may_move(record):
        look_later(draft, draft.put(record, available_since=None))
        return
    since = draft.now if record.available_since is None else record.available_since
    record = draft.put(record, available_since=since)
    if draft.now - since < (draft.policy.return_after or 0.0):
        look_later(draft, record)
        return
    begin(draft, [record])
