"""The topic of diagnostics, read as the health of the components that name an entry in it."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Mapping
from typing import Any

from attrs import define, field

from uoarm.errors import BridgeError, FailureReason
from uoarm.model import Health
from uoarm_ros2._diagnostic_entries import Allowance, EntryHealth, read_array
from uoarm_ros2._discovery import Ros2Graph, Topic
from uoarm_ros2._middleware import NodeRunner
from uoarm_ros2._qos import Policies, clashes
from uoarm_ros2._types import import_type

__all__ = ["DiagnosticsReader", "EntryLease"]

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
        runner: subscribes.
        graph: shows who publishes.
        topic: name of the topic, resolved.
        timeout: seconds within which an entry is expected again.
        report: takes that a refused component may be asked for again: health, cause, component.
        clock: seconds that only grow.
    """

    def __init__(
        self,
        runner: NodeRunner,
        graph: Ros2Graph,
        topic: str,
        timeout: float,
        report: Callable[[Health, str, str], None],
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self._runner, self._graph = runner, graph
        self._topic, self._timeout = Topic(topic, _TYPE), timeout
        self._report, self._clock = report, clock
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
        now = self._clock()
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
        now = self._clock()
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
        now = self._clock()
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
        now = self._clock()
        with self._lock:
            watched.users -= 1
            watched.asked = now
            if watched.health.says_error(now):
                watched.refused.add(component)
            self._forget_unused(now)

    def tick(self) -> None:
        """Look after what is read a few times a second, in the runner's thread."""
        now = self._clock()
        with self._lock:
            if self._subscription is None:
                return
            recovered = [
                component
                for watched in self._entries.values()
                if watched.refused and not watched.health.says_error(now)
                for component in watched.refused
            ]
            for watched in self._entries.values():
                if not watched.health.says_error(now):
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
        now = self._clock()
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
    """A channel's use of an entry.

    Attributes:
        name: of the entry.
    """

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
