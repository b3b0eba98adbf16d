"""The status map as each role sees it, in numbered versions: whole, or what has changed since."""

from __future__ import annotations

import secrets
import time
from collections import Counter, OrderedDict, deque
from collections.abc import Callable, Collection, Iterable, Mapping
from typing import Any

from attrs import define, evolve, field, fields, frozen

from uoarm._dataplane import Clock
from uoarm._wire import Form
from uoarm.model import RouteStatus, StatusEvent, StatusMap, to_json
from uoarm.server.access import Role, RoleView, RoleViews
from uoarm.server.session._view import visible_status
from uoarm.server.streams import shown_event

__all__ = ["StatusAnswer", "StatusQuestion", "StatusViews"]

_ROLES = 32
_VERSIONS = 256
_FORGOTTEN = 10_000
_KEYS: Mapping[str, Callable[[Any], Any]] = {
    "components": lambda component: component.name,
    "connections": lambda connection: connection.id,
    "routes": lambda route: [route.producer, route.consumer],
}
"""What the entries of the large parts are known by; the other parts are told as a whole."""


@frozen
class StatusQuestion:
    """What a client asks.

    Attributes:
        role: its role.
        form: in which it wants the answer.
        since: the version that it has; None: it wants the whole map.
        past: whether it wants the last changes, too.
    """

    role: Role
    form: Form
    since: int | None = None
    past: bool = False


@frozen
class StatusAnswer:
    """The answer, but for what is the client's own.

    Attributes:
        fields: of the message, each as it is written.
        number: of the last change that it has in `past`.
    """

    fields: Mapping[str, bytes]
    number: int


class StatusViews:
    """Answers from one look at the robot, whatever is asked; for one thread.

    Args:
        status: returns the whole status map.
        past: returns the last changes, and how many seconds ago they were.
        views: of roles.
        clock: seconds.
    """

    def __init__(
        self,
        status: Callable[[], StatusMap],
        past: Callable[[], list[tuple[float, StatusEvent]]],
        views: RoleViews,
        clock: Clock = time.monotonic,
    ) -> None:
        self._status = status
        self._past = past
        self._views = views
        self._clock = clock
        self._boards: OrderedDict[Role, _Board] = OrderedDict()

    def make(self, questions: Collection[StatusQuestion]) -> dict[StatusQuestion, StatusAnswer]:
        """Return the answers."""
        # What changes after this is told to who watches; the map may have it already.
        past = self._past()
        number = past[-1][1].number if past else 0
        status, now = self._status(), self._clock()
        views = {
            role: self._views.of(role)
            for role in {status_question.role for status_question in questions}
        }
        for role, view in views.items():
            self._board(role).look(visible_status(status, view), now)
        answers = {}
        for question in questions:
            reports = self._boards[question.role].told(question.form, question.since)
            if question.past:
                shown = _shown_past(past, views[question.role])
                reports["past"] = question.form.write(shown)
            answers[question] = StatusAnswer(reports, number)
        return answers

    def _board(self, role: Role) -> _Board:
        board = self._boards.setdefault(role, _Board())
        self._boards.move_to_end(role)
        if len(self._boards) > _ROLES:
            self._boards.popitem(last=False)
        return board


@define(eq=False)
class _Entry:
    """A value of the map, since which version it is so, and how it is written."""

    value: Any
    version: int
    written: dict[str, bytes] = field(factory=dict)

    def told(self, form: Form) -> bytes:
        if form.name not in self.written:
            self.written[form.name] = form.write(to_json(self.value))
        return self.written[form.name]


@define(eq=False)
class _Part:
    """The entries of a large part of the map, by key.

    Attributes:
        gone: keys that were there, with the version that was the first without them.
        whole: the version up to which what has changed is not known by keys.
    """

    key: Callable[[Any], Any]
    entries: dict[Any, _Entry] = field(factory=dict)
    gone: deque[tuple[int, Any]] = field(factory=deque)
    whole: int = 0
    had_twins: bool = False

    def look(self, values: Iterable[Any], version: int) -> None:
        former, self.entries = self.entries, {}
        seen: Counter[Any] = Counter()
        for value in values:
            key = self.key(value)
            name = tuple(key) if isinstance(key, list) else key
            place = name, seen[name]  # a component that was replaced may run beside the new one
            seen[name] += 1
            entry = former.pop(place, None)
            if entry is None or not _is_same(entry.value, value):
                entry = _Entry(value, version)
            elif entry.value != value:  # only the clock has gone on
                entry.value = value
                entry.written.clear()
            self.entries[place] = entry
        has_twins = any(count > 1 for count in seen.values())
        if has_twins or self.had_twins:
            self.whole = version
        self.had_twins = has_twins
        self.gone.extend((version, name) for name, _ in former if name not in seen)
        while len(self.gone) > _FORGOTTEN:
            self.whole = max(self.whole, self.gone.popleft()[0])

    def told(self, form: Form) -> bytes:
        return form.list_of([entry.told(form) for entry in self.entries.values()])

    def told_since(self, form: Form, since: int) -> bytes | None:
        """Return what has changed; None: nothing has."""
        if since < self.whole:
            return self.told(form)
        changed = [entry.told(form) for entry in self.entries.values() if entry.version > since]
        gone = [
            list(name) if isinstance(name, tuple) else name
            for version, name in self.gone
            if version > since and (name, 0) not in self.entries
        ]
        if not changed and not gone:
            return None
        return form.map_of({"changed": form.list_of(changed), "gone": form.write(gone)})


class _Board:
    """The map as one role sees it, and since which version each part of it is as it is."""

    def __init__(self) -> None:
        # A number that no other server begins with: what a client has of another is not of this.
        self._version = secrets.randbits(40)
        self._times: OrderedDict[int, float] = OrderedDict()
        self._parts = {name: _Part(key) for name, key in _KEYS.items()}
        self._small: dict[str, _Entry] = {}

    def look(self, status: StatusMap, now: float) -> None:
        self._version += 1
        self._times[self._version] = now
        if len(self._times) > _VERSIONS:
            self._times.popitem(last=False)
        for name in (attribute.name for attribute in fields(StatusMap)):
            value = getattr(status, name)
            if name in self._parts:
                self._parts[name].look(value, self._version)
            elif name not in self._small or self._small[name].value != value:
                self._small[name] = _Entry(value, self._version)

    def told(self, form: Form, since: int | None) -> dict[str, bytes]:
        """Return the fields of the whole map, or those that have changed since a known version."""
        parts = {"version": form.write(self._version)}
        known = None if since is None else self._times.get(since)
        if since is None or known is None:
            parts |= {name: entry.told(form) for name, entry in self._small.items()}
            return parts | {name: part.told(form) for name, part in self._parts.items()}
        elapsed = self._times[self._version] - known
        parts |= {"since": form.write(since), "elapsed": form.write(elapsed)}
        parts |= {
            name: entry.told(form) for name, entry in self._small.items() if entry.version > since
        }
        for name, part in self._parts.items():
            report = part.told_since(form, since)
            if report is not None:
                parts[name] = report
        return parts


def _is_same(former: Any, value: Any) -> bool:
    """Say whether nothing has changed but the age of a route's last message, which grows."""
    if former == value:
        return True
    return (
        isinstance(value, RouteStatus)
        and None not in (former.age, value.age)
        and former.received == value.received
        and evolve(former, age=value.age) == value
    )


def _shown_past(past: list[tuple[float, StatusEvent]], view: RoleView) -> list[dict[str, Any]]:
    shown = ((age, shown_event(event, view)) for age, event in past)
    return [{**reports, "age": age} for age, reports in shown if reports is not None]
