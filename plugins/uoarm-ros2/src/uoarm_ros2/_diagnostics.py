"""The topic of diagnostics, read as the health of the components that name an entry in it.

Entries are read from octets and judged without I/O; the reader takes them from the graph.
"""

from __future__ import annotations

import math
import struct
import threading
import time
from collections.abc import Callable, Collection, Mapping
from typing import Any

from attrs import define, field, frozen

from uoarm.bridge import did_you_mean
from uoarm.errors import BridgeError, FailureReason
from uoarm.model import Health
from uoarm_ros2._discovery import Ros2Graph, Topic
from uoarm_ros2._middleware import NodeRunner
from uoarm_ros2._qos import Policies, clashes
from uoarm_ros2._types import import_type

_TEXTS = 100_000  # a second: some 30 ms of work
_TEXT_SECONDS = 1.0  # a cause that changes on and on is reported no more often
_MESSAGE, _VALUE, _VALUES, _NAMES = 200, 60, 8, 32
_HEADER = 4
_ORDERS: Mapping[bytes, struct.Struct] = {
    b"\0\0": struct.Struct(">I"),
    b"\0\1": struct.Struct("<I"),
}
_LEVELS: Mapping[int, tuple[str, Health]] = {
    0: ("OK", Health.OK),
    1: ("WARN", Health.DEGRADED),
    2: ("ERROR", Health.LOST),
    3: ("STALE", Health.DEGRADED),
}


@frozen
class Entry:
    """One `DiagnosticStatus`: its texts are cut, its values the first few."""

    level: int
    message: str = ""
    values: tuple[tuple[str, str], ...] = ()

    @property
    def health(self) -> Health:
        """What the level means for the component; one that is not known is none of OK."""
        return _LEVELS.get(self.level, ("", Health.DEGRADED))[1]

    def __str__(self) -> str:
        level = _LEVELS.get(self.level, (f"level {self.level}",))[0]
        values = ", ".join(f"{key!r}: {value!r}" for key, value in self.values)
        return f"{level} {self.message!r}{f' ({values})' if values else ''}"


@define
class Allowance:
    """How many texts may still be passed over in this second."""

    _second: float = field(default=-math.inf, init=False)
    left: int = field(default=_TEXTS, init=False)

    def renew(self, now: float) -> None:
        """Begin another second where this one is over."""
        if now - self._second >= 1.0:
            self._second, self.left = now, _TEXTS


@frozen
class ArrayReading:
    """What was read of one array.

    Attributes:
        entries: those that were asked for, by name; of several with one name the last.
        names: the first few that are there.
        why_not: why it was not read to its end, empty where it was.
    """

    entries: Mapping[bytes, Entry]
    names: tuple[str, ...]
    why_not: str = ""


def read_array(octets: bytes, wanted: Collection[bytes], allowance: Allowance) -> ArrayReading:
    """Read the entries of some names in a serialised `DiagnosticArray`."""
    found: dict[bytes, Entry] = {}
    names: list[str] = []
    order = _ORDERS.get(octets[:2])
    if order is None:
        return ArrayReading(found, (), f"{octets[:2]!r} is no header of plain CDR")
    scan = _Scan(octets, order, allowance)
    try:
        scan.at += 8  # the time
        scan.text()
        for _ in range(scan.number()):
            level, scan.at = octets[scan.at], scan.at + 1
            name = scan.text()
            if len(names) < _NAMES:
                names.append(_cut(name, _VALUE))
            is_wanted = name in wanted
            message = scan.text()
            scan.text()
            values: list[tuple[str, str]] = []
            for _ in range(scan.number()):
                key, value = scan.text(), scan.text()
                if is_wanted and len(values) < _VALUES:
                    values.append((_cut(key, _VALUE), _cut(value, _VALUE)))
            if is_wanted:
                found[name] = Entry(level, _cut(message, _MESSAGE), tuple(values))
    except (struct.error, IndexError):
        return ArrayReading(found, tuple(names), f"it is cut short after {len(octets):,} bytes")
    except _SpentError:
        why = f"more than {_TEXTS:,} texts came within a second"
        return ArrayReading(found, tuple(names), why)
    return ArrayReading(found, tuple(names))


class _SpentError(Exception):
    """The allowance is used up."""


class _Scan:
    """A place in serialised octets, which goes from text to text."""

    def __init__(self, octets: bytes, order: struct.Struct, allowance: Allowance) -> None:
        self.at = _HEADER
        self._octets, self._allowance = octets, allowance
        self._read = order.unpack_from

    def number(self) -> int:
        at = (self.at + 3) & ~3
        self.at = at + 4
        number: int = self._read(self._octets, at)[0]
        return number

    def text(self) -> bytes:
        self._allowance.left -= 1
        if self._allowance.left < 0:
            raise _SpentError
        start = ((self.at + 3) & ~3) + 4
        self.at = start + self._read(self._octets, start - 4)[0]
        if self.at > len(self._octets):
            raise IndexError
        return self._octets[start : max(start, self.at - 1)]


def _cut(text: bytes, most: int) -> str:
    shown = text[: 4 * most].decode("utf-8", "replace")
    return shown if len(shown) <= most else f"{shown[:most]}..."


class EntryHealth:
    """How a component is by the entry that it names; times are in seconds of one clock.

    Args:
        timeout: seconds within which it is expected again.
    """

    def __init__(self, name: str, now: float, timeout: float) -> None:
        self._name, self._since, self._timeout = name, now, timeout
        self._last: Entry | None = None
        self._written: Entry | None = None  # which the cause has
        self._at = self._written_at = self._missing_at = -math.inf
        self._text = self._missing = ""
        self._names: tuple[str, ...] = ()

    def took(self, entry: Entry, now: float) -> None:
        """The entry came."""
        self._last, self._at = entry, now
        self._missing_at = -math.inf
        written = self._written
        is_other = written is None or written.level != entry.level
        # What changes with each array, as a temperature, is no news.
        is_reworded = written is None or written.message != entry.message
        if is_other or (is_reworded and now - self._written_at >= _TEXT_SECONDS):
            self._written, self._written_at = entry, now
            self._text = f"{self._name!r} says {entry}"

    def saw(self, names: tuple[str, ...]) -> None:
        """Note names of an array without the entry, as one of them may be meant."""
        self._names = names

    def is_awaited(self, now: float) -> bool:
        """Whether none came within the time in which it is expected."""
        return now - max(self._at, self._since) > self._timeout

    def says_error(self, now: float) -> bool:
        """Whether the component says that it does not work."""
        entry = self._last
        return entry is not None and entry.health is Health.LOST and not self.is_awaited(now)

    def verdict(self, now: float) -> tuple[Health, str] | None:
        """Return the health and its cause; None: it is not known yet."""
        if self.is_awaited(now):
            # Neither work nor a report each time that it is asked for, whatever arrays come.
            if now - self._missing_at > self._timeout:
                if self._last is None:
                    more = did_you_mean(self._name, self._names)
                else:
                    more = f"; the last: {self._last}"
                self._missing = f"no entry {self._name!r} for {self._timeout:g} s{more}"
                self._missing_at = now
            return Health.DEGRADED, self._missing
        return None if self._last is None else (self._last.health, self._text)


_TYPE = "diagnostic_msgs/msg/DiagnosticArray"
_IDLE_SECONDS = 60.0
_LOOK_SECONDS = 5.0
_MOST_REPORTS = 5
_POLICIES = Policies()


@define(eq=False)
class _Watched:
    """An entry, who uses it, and which components are refused while it says ERROR."""

    health: EntryHealth
    asked: float
    users: int = 0
    refused: set[str] = field(factory=set)


class DiagnosticsReader:
    """The entries that channels of one bridge name; any thread may ask, `tick` is the runner's.

    One subscription serves all. It is there while a channel is open that names an entry. An entry
    that said ERROR is read on without one, so that its component is a candidate again when it no
    longer does: as long as the component is asked for once a minute.

    Args:
        topic: name of the topic, resolved.
        timeout: seconds within which an entry is expected again.
        report: takes that a refused component may be asked for again: health, cause, component.
    """

    def __init__(
        self,
        runner: NodeRunner,
        graph: Ros2Graph,
        topic: str,
        timeout: float,
        report: Callable[[Health, str, str], None],
    ) -> None:
        self._runner, self._graph = runner, graph
        self._topic, self._timeout = Topic(topic, _TYPE), timeout
        self._report = report
        # Guards everything below, between channels that open and close and the runner's thread.
        # Nothing is reported under it.
        self._lock = threading.Lock()
        self._entries: dict[bytes, _Watched] = {}
        self._subscription: Any = None
        self._allowance = Allowance()
        self._arrays = self._unread = 0
        self._why_unread = self._why_none = ""
        self._look_due = 0.0

    def require_well(self, name: str, component: str) -> None:
        """Refuse a component whose entry says ERROR; "" names none.

        Raises:
            BridgeError: it does, or the package of the type is not installed.
        """
        if not name:
            return
        _native()
        now = time.monotonic()
        with self._lock:
            watched = self._entries.get(_key(name))
            if watched is None or not watched.health.says_error(now):
                return
            watched.refused.add(component)
            watched.asked = now
            verdict = watched.health.verdict(now)
        text = f"{self._topic.name}: {verdict[1] if verdict else ''}"
        raise BridgeError(text, FailureReason.UNAVAILABLE)

    def watch(self, name: str, component: str) -> EntryLease:
        """Read an entry until the lease is closed.

        Raises:
            BridgeError: the package of the type is not installed, or the bridge was closed.
        """
        now = time.monotonic()
        with self._lock:
            if self._subscription is None:
                self._subscription = self._runner.subscribe(
                    _native(), self._topic.name, _POLICIES, self._take, events={}
                )
            watched = self._entries.get(_key(name))
            if watched is None:
                watched = self._entries[_key(name)] = _Watched(
                    EntryHealth(name, now, self._timeout), now
                )
            watched.users += 1
            watched.refused.discard(component)
        return EntryLease(name, self, watched, component)

    def verdict(self, watched: _Watched) -> tuple[Health, str] | None:
        """Return how a component is by its entry, and why; None: it is not known yet."""
        now = time.monotonic()
        with self._lock:
            found = watched.health.verdict(now)
            is_unknown = found is not None and watched.health.is_awaited(now)
            why = self._why_none
        if found is None:
            return None
        return found[0], f"{self._topic.name}: {found[1]}{why if is_unknown else ''}"

    def facts(self) -> Mapping[str, object]:
        """Return how many arrays came, and how many of them were not read to their end."""
        return {"diagnostics": self._arrays, "diagnostics_unread": self._unread}

    def release(self, watched: _Watched, component: str) -> None:
        """End a lease; the subscription goes with the last, unless an entry says ERROR."""
        now = time.monotonic()
        with self._lock:
            watched.users -= 1
            watched.asked = now
            if watched.health.says_error(now):
                watched.refused.add(component)
            self._forget_unused(now)

    def tick(self) -> None:
        """Look after what is read a few times a second, in the runner's thread."""
        now = time.monotonic()
        with self._lock:
            if self._subscription is None:
                return
            recovered: list[str] = []
            for watched in self._entries.values():
                if not watched.health.says_error(now):
                    recovered += watched.refused
                    watched.refused.clear()
            is_awaited = any(watched.health.is_awaited(now) for watched in self._entries.values())
            self._forget_unused(now)
        if is_awaited and now >= self._look_due:
            self._look_due = now + _LOOK_SECONDS
            self._why_none = self._absence()
        for component in recovered:
            text = f"{self._topic.name}: its entry no longer says ERROR"
            self._report(Health.OK, text, component)

    def close(self) -> None:
        """Read nothing more."""
        with self._lock:
            self._entries.clear()
            self._unsubscribe()

    def _take(self, octets: bytes) -> None:
        now = time.monotonic()
        with self._lock:
            self._arrays += 1
            self._allowance.renew(now)
            read = read_array(octets, self._entries.keys(), self._allowance)
            if read.why_not:
                self._unread += 1
                self._why_unread = read.why_not
            for name, watched in self._entries.items():
                entry = read.entries.get(name)
                if entry is None:
                    watched.health.saw(read.names)
                else:
                    watched.health.took(entry, now)

    def _forget_unused(self, now: float) -> None:
        for name, watched in list(self._entries.items()):
            is_refused = watched.refused and watched.health.says_error(now)
            if not watched.users and not (is_refused and now - watched.asked < _IDLE_SECONDS):
                del self._entries[name]
        if not self._entries:
            self._unsubscribe()

    def _unsubscribe(self) -> None:
        made, self._subscription = self._subscription, None
        if made is not None:
            self._runner.discard(made)

    def _absence(self) -> str:
        """Say what of the topic may be why an entry does not come; mostly empty."""
        peers = self._runner.publishers(self._topic.name)
        ours = [peer for peer in peers if peer.type == _TYPE]
        reports = [] if ours else ["the topic has no publisher of its type"]
        others = self._graph.other_types(self._topic)
        reports += [f"it carries {others}"] if others else []
        for peer in ours:
            wrong = clashes(peer.policies, _POLICIES)
            reports += [f"{peer.node} is not received: {', '.join(wrong)}"] if wrong else []
        if self._unread:
            reports.append(f"arrays were not read whole, as {self._why_unread}")
        return "".join(f"; {report}" for report in reports[:_MOST_REPORTS])


@define(eq=False)
class EntryLease:
    """A channel's use of an entry."""

    name: str
    _diagnostics: DiagnosticsReader
    _watched: _Watched
    _component: str
    _is_closed: bool = field(default=False, init=False)

    def verdict(self) -> tuple[Health, str] | None:
        """Return how the component is by its entry, and why; None: it is not known yet."""
        return self._diagnostics.verdict(self._watched)

    def facts(self) -> Mapping[str, object]:
        """Return what was counted on the topic."""
        return self._diagnostics.facts()

    def close(self) -> None:
        """End the use; idempotent."""
        if not self._is_closed:
            self._is_closed = True
            self._diagnostics.release(self._watched, self._component)


def _key(name: str) -> bytes:
    """Return a name as arrays have it; one that is no text of UTF-8 is in none."""
    return name.encode("utf-8", "surrogatepass")


def _native() -> type:
    try:
        return import_type(_TYPE)
    except BridgeError as error:
        raise BridgeError(f"option diagnostics: {error}", error.reason) from error
