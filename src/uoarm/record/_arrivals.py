"""What a recording takes from a manager, and what waits for its writer: bounded, without a lock.

A queue that looks at every message costs the source as much as the message did. So a source
appends and goes on; it looks at the bounds at every sixteenth of its messages, or at each that is
large. The writer gathers for a moment and takes all at once: each change between threads costs more
than a message does.
"""

from __future__ import annotations

import math
import threading
import time
from collections import deque
from collections.abc import Callable, Iterable
from typing import Any, Generic, Protocol, TypeVar

from attrs import define, frozen

from uoarm import cdr
from uoarm.model import (
    ConnectionState,
    Gap,
    Message,
    OverflowPolicy,
    Plan,
    QueuePolicy,
    Robot,
    StatusEvent,
    message_octets,
)
from uoarm.record._forms import ChannelForm

_GATHER_SECONDS = 0.05
_LARGE_OCTETS = 65_536
_LOOKS = 16
"""A source looks at the bounds at each message of this number."""
_EXACT_LENGTH = 256
"""Up to which a queue's length is held to exactly."""


class RecordedConnection(Protocol):
    """A connection, as far as a recording uses it."""

    id: str

    @property
    def plan(self) -> Plan: ...
    @property
    def output(self) -> str | None: ...
    @property
    def gaps(self) -> tuple[Gap, ...]: ...
    @property
    def state(self) -> ConnectionState: ...
    @property
    def cause(self) -> str: ...
    @property
    def ended(self) -> bool: ...
    def kill(self) -> None: ...


class RecordedRobot(Protocol):
    """A manager, as far as a recording uses it."""

    @property
    def config(self) -> Robot: ...
    def request(
        self, name: str, *, validate: str, on_message: Callable[[Any], None], timeout: float
    ) -> RecordedConnection: ...


class RecordedEvents(Protocol):
    """What a manager announces, as far as a recording uses it."""

    def post(self, subject: str, change: str, cause: str = ..., function: str = ...) -> None: ...
    def observe(self, observer: Callable[[StatusEvent], None]) -> Callable[[], None]: ...


class ArrivingTrack(Protocol):
    """One function, as far as its messages wait here.

    Attributes:
        received: messages that came; written by their thread alone.
        taken: of these, those that wait no more; written under the lock here.
        octets: that one of its last messages had.
        definition: of its type, where a message that was read of octets waits as `ReadOctets`.
    """

    received: int
    taken: int
    octets: int
    definition: str


@frozen
class ReadOctets:
    """What stands for a message of which its octets are known."""

    octets: bytes


T = TypeVar("T", bound=ArrivingTrack)


@define(eq=False)
class RecordedFunction:
    """One function: its connection and what came of it.

    `received` is written by the thread that brings its messages, of which there is one at a time;
    what follows it by the writer alone, save `taken` and what follows that: see `ArrivingTrack`.
    """

    function: str
    received: int = 0
    recorded: int = 0
    unwritable: int = 0
    gaps: int = 0
    last_gap: float = -math.inf
    taken: int = 0
    octets: int = 0
    definition: str = ""
    connection: RecordedConnection | None = None
    form: ChannelForm | None = None

    @property
    def failure(self) -> str:
        """Why the function failed; empty if it has not."""
        has_failed = self.connection and self.connection.state is ConnectionState.FAILED
        return self.connection.cause if self.connection and has_failed else ""

    def new_gaps(self) -> list[Gap]:
        """Return those since the last that was written. By time: a connection forgets old ones."""
        assert self.connection is not None, "it was opened"
        return [gap for gap in self.connection.gaps if gap.time > self.last_gap]


class Arrivals(Generic[T]):
    """Messages from the threads of any sources to one writer, in the order in which they came.

    Each with its function, the moment on the clock of the day and on the steady one, its number.

    Args:
        policy: how many may wait, and what becomes of more.
        on_drop: called with the reason for each message that is lost; must not block.
    """

    def __init__(
        self, policy: QueuePolicy, tracks: Iterable[T], on_drop: Callable[[str], None]
    ) -> None:
        self._policy, self._tracks, self._on_drop = policy, tuple(tracks), on_drop
        self._length = 1 if policy.policy is OverflowPolicy.LATEST else policy.length
        # Appended to by sources without the lock, as that is one step; taken from under it.
        self._items: deque[tuple[T, int, int, Message, int]] = deque()
        # Guards what is taken out and counted as taken, between the writer and sources that make
        # room.
        self._lock = threading.Lock()
        self._room = threading.Condition(self._lock)
        self._pressing = threading.Event()
        # Set before the writer looks a last time and waits, and read after a message was appended:
        # one of both sees the other.
        self._is_idle = False
        self._is_closed = False

    def __len__(self) -> int:
        return len(self._items)

    def taker(self, track: T, clock: Callable[[], tuple[int, int]]) -> Callable[[Message], None]:
        """Return what takes in the messages of a function, in the thread in which they arrive."""
        append = self._items.append
        looks = 1 if self._length < _EXACT_LENGTH else _LOOKS

        def take(message: Message) -> None:
            number = track.received = track.received + 1
            if (not (number - 1) % looks or track.octets > _LARGE_OCTETS) and not self._admits(
                track, message
            ):
                return
            if track.definition:
                octets = cdr.octets_of(message, track.definition)
                if octets is not None:
                    message = ReadOctets(octets)
            wall, steady = clock()
            append((track, wall, steady, message, number))
            if self._is_idle:
                self.press()

        return take

    def press(self) -> None:
        """Have the writer look at once: much waits, or something happened."""
        self._is_idle = False
        self._pressing.set()

    def wait(self, seconds: float) -> None:
        """Wait, as the writer, until something has come, and a moment for more, or it presses."""
        pressing = self._pressing
        if not self._items:
            self._is_idle = True
            if not self._items and not self._is_closed:
                pressing.wait(seconds)
            self._is_idle = False
            if self._items:
                pressing.clear()
        if self._items and not self._is_closed:
            pressing.wait(_GATHER_SECONDS)
        pressing.clear()

    def take_waiting(self) -> list[tuple[T, int, int, Message, int]]:
        """Return what came; waits for nothing."""
        with self._lock:
            take = self._items.popleft  # one by one, as sources append meanwhile
            items = [take() for _ in range(len(self._items))]
            if len(self._tracks) == 1:
                self._tracks[0].taken += len(items)
            else:
                for item in items:
                    item[0].taken += 1
            self._room.notify_all()
        return items

    @property
    def is_closed(self) -> bool:
        """Whether nothing more is taken in."""
        return self._is_closed

    def close(self) -> None:
        """Take in nothing more; what waits can be taken still. Idempotent."""
        with self._lock:
            self._is_closed = True
            self._room.notify_all()
        self.press()

    def _admits(self, track: T, message: Message) -> bool:
        """Look at the bounds; False where a message finds no room."""
        octets = track.octets = message_octets(message)
        if octets > _LARGE_OCTETS or 2 * len(self._items) >= self._length:
            self._pressing.set()
        if self._is_closed:
            self._lose("closed", track)
            return False
        if self._has_room():
            return True
        if self._policy.policy is OverflowPolicy.BLOCK:
            return self._waits_for_room(track)
        is_latest = self._policy.policy is OverflowPolicy.LATEST
        with self._lock:
            while self._items and not self._has_room():
                full = "queue-full" if len(self._items) >= self._length else "queue-octets"
                self._items.popleft()[0].taken += 1
                self._on_drop("replaced" if is_latest else full)
        return True

    def _waits_for_room(self, track: T) -> bool:
        end = time.monotonic() + self._policy.timeout
        with self._room:
            while not self._has_room() and not self._is_closed:
                left = end - time.monotonic()
                if left <= 0:
                    break
                self._room.wait(left)
            else:
                if not self._is_closed:
                    return True
        self._lose("closed" if self._is_closed else "blocked-too-long", track)
        return False

    def _has_room(self) -> bool:
        """Say whether the message that has just come may wait; one of any size may, alone."""
        items = len(self._items)
        if not items:
            return True
        waiting = sum((track.received - track.taken) * track.octets for track in self._tracks)
        return items < self._length and waiting <= self._policy.octets

    def _lose(self, reason: str, track: T) -> None:
        with self._lock:
            track.taken += 1
        self._on_drop(reason)
