"""When each message of a recording is due: a timeline without a clock, and the wait for it."""

from __future__ import annotations

import math
import threading
import time
from collections.abc import Callable, Iterable
from enum import Enum
from threading import TIMEOUT_MAX
from typing import Any

from attrs import frozen

from uoarm._raised import Log
from uoarm.bridge import Bridge, ServiceStructures
from uoarm.errors import UsageError
from uoarm.model import Endpoint, MessageStructure, Role, closed_object
from uoarm.record.plugin import MOST_RATE, RATE

CONTROL = "@control"
"""The address of the service that pauses, steps and seeks."""

CONTROL_REQUEST: Any = {
    "type": "object",
    "properties": {
        "pause": {"type": "boolean", "description": "Stand, or go on."},
        "rate": {**RATE, "description": "Seconds of the recording in a second."},
        "seek": {"type": "number", "minimum": 0, "x-unit": "s"},
        "step": {"type": "boolean", "description": "Let the next message pass, and stand."},
    },
    "additionalProperties": False,
}
CONTROL_REPLY: Any = closed_object(
    {
        "position": {"type": "number", "x-unit": "s"},
        "duration": {"type": "number", "x-unit": "s"},
        "rate": {"type": ["number", "null"]},
        "is_paused": {"type": "boolean"},
        "began": {"type": "number", "x-unit": "s"},
        "file": {"type": "string"},
    }
)

_NANO = 1_000_000_000
_TOGETHER = _NANO
_STEP_SECONDS = 1.0
_LONG_SECONDS = 60.0
_log = Log("uoarm")


class Timeline:
    """Where a recording is, in nanoseconds from its first message on; loops go on counting.

    Args:
        rate: seconds of the recording in a second; None: as fast as messages are taken.
        begin: where it begins.
        is_paused: whether it stands.
    """

    def __init__(self, rate: float | None, begin: int = 0, *, is_paused: bool = False) -> None:
        self.rate, self.is_paused = rate, is_paused
        self._anchor = begin
        self._anchor_time: float | None = None
        # Whether what has the very time at which it stands is still to come.
        self._is_before = True

    def start(self, now: float) -> None:
        """It is played from now on, unless it stands; nothing where it began before."""
        if self._anchor_time is None:
            self._anchor_time = now

    def rewind(self, begin: int) -> None:
        """Begin anew, from somewhere, at the next `start`."""
        self._anchor, self._anchor_time, self._is_before = begin, None, True

    def position(self, now: float) -> int:
        """Return where it is. As fast as messages are taken, that is where the last one was."""
        if self.is_paused or self.rate is None or self._anchor_time is None:
            return self._anchor
        return self._anchor + int((now - self._anchor_time) * self.rate * _NANO)

    def wait(self, place: int, now: float) -> float | None:
        """Return the seconds until a message is due, 0 where it is; None: not as things are."""
        if self.is_paused:
            return None if self._lies_ahead(place) else 0.0
        if self.rate is None:
            return 0.0
        return max(0.0, (place - self.position(now)) / _NANO / self.rate)

    def passed(self, place: int) -> None:
        if self.rate is None and not self.is_paused:
            self._anchor = max(self._anchor, place)

    def pause(self, now: float) -> None:
        """Stand, where it is."""
        self._go_to(self.position(now), now)
        self._is_before &= self.is_paused
        self.is_paused = True

    def play(self, now: float) -> None:
        self._go_to(self.position(now), now)
        self.is_paused = False

    def set_rate(self, rate: float | None, now: float) -> None:
        """Go on at another rate from here."""
        self._go_to(self.position(now), now)
        self.rate = rate

    def seek(self, place: int, now: float) -> None:
        """Go somewhere else, before what has that time."""
        self._go_to(place, now)
        self._is_before = True

    def step(self, places: Iterable[int], now: float) -> bool:
        """Go to the nearest of these that lies ahead, and stand behind it; False: none does."""
        ahead = [place for place in places if self._lies_ahead(place)]
        if ahead:
            self._go_to(min(ahead), now)
            self._is_before = False
        return bool(ahead)

    def _lies_ahead(self, place: int) -> bool:
        """Say whether a message is still to come, where it stands."""
        return place > self._anchor or (self._is_before and place == self._anchor)

    def _go_to(self, place: int, now: float) -> None:
        self._anchor = place
        if self._anchor_time is not None:
            self._anchor_time = now


class PlaybackTurn(Enum):
    """What a reader does after it has waited for a message."""

    PLAY = "play"
    ELSEWHERE = "elsewhere"
    STOP = "stop"


@frozen
class PlaybackStatus:
    """Where a recording is.

    Attributes:
        position: seconds from its first message on.
        duration: seconds from the first to the last.
        rate: seconds of it in a second; None: as fast as messages are taken.
        is_paused: whether it stands.
        began: when its first message came, in seconds since the epoch.
        file: what is played.
    """

    position: float
    duration: float
    rate: float | None
    is_paused: bool
    began: float
    file: str = ""


class Playback:
    """One timeline for all readers of a recording, and the waits of their threads.

    Args:
        timeline: nothing else may use it.
        start: of the recording, in nanoseconds since the epoch.
        length: of it, in nanoseconds.
        clock: a monotonic clock, in seconds.
    """

    def __init__(
        self,
        timeline: Timeline,
        start: int,
        length: int,
        clock: Callable[[], float] = time.monotonic,
        *,
        file: str = "",
    ) -> None:
        self._timeline, self._clock, self._file = timeline, clock, file
        self.start, self.length = start, length
        self._begin = timeline.position(0.0)
        # Guards the timeline and all that follows, between the threads of readers and of callers;
        # readers wait at it, and look at the timeline again whenever it is moved.
        self._moved = threading.Condition()
        self._readers: set[object] = set()
        self._next: dict[object, int] = {}  # of the readers that wait: the time of their message
        self._noted_gap: int | None = None  # the time of the message behind it
        self._is_stepping = False
        self._steps = 0  # asked for while every reader was busy: the next message is not known yet
        self.generation = 0

    def join(self, reader: object, *, loops: bool = False) -> tuple[int, int, int]:
        """Return where a reader begins, in which turn of a loop, and the generation.

        Without other readers it begins anew. With them a reader joins where they are; what is
        opened together with them, within a second, begins where they did.
        """
        with self._moved:
            if not self._readers:
                self._timeline.rewind(self._begin)
                self._steps = 0
            self._readers.add(reader)
            place, begin, lap = self._timeline.position(self._clock()), self._begin, 0
            if self._timeline.rate is not None and place - begin > _TOGETHER:
                lap, begin = divmod(place, self.length) if loops and self.length else (0, place)
            return begin, lap, self.generation

    def begin(self) -> None:
        """Have it begin, where it has not, once the first message of a reader is at hand."""
        with self._moved:
            self._timeline.start(self._clock())

    def end(self, reader: object) -> None:
        """A reader has nothing more, or is closed."""
        with self._moved:
            self._readers.discard(reader)
            self._moved.notify_all()

    def wait(
        self, reader: object, place: int, generation: int, is_over: Callable[[], bool]
    ) -> PlaybackTurn:
        """Wait until a message is due."""
        with self._moved:
            self._next[reader] = place
            if self._is_stepping:
                self._moved.notify_all()
            try:
                while True:
                    if is_over():
                        return PlaybackTurn.STOP
                    if generation != self.generation:
                        return PlaybackTurn.ELSEWHERE
                    if self._steps and not self._is_stepping:
                        self._take_step()
                    seconds = self._timeline.wait(place, self._clock())
                    if seconds == 0:
                        self._timeline.passed(place)
                        return PlaybackTurn.PLAY
                    self._note_gap()
                    # A clock that was set late puts decades between two messages.
                    self._moved.wait(None if seconds is None else min(seconds, TIMEOUT_MAX))
            finally:
                self._next.pop(reader, None)

    def pause(self) -> None:
        self._move(lambda: self._timeline.pause(self._clock()))

    def play(self) -> None:
        def move() -> None:
            self._timeline.play(self._clock())
            self._steps = 0

        self._move(move)

    def set_rate(self, rate: float | None) -> None:
        self._move(lambda: self._timeline.set_rate(rate, self._clock()))

    def step(self) -> None:
        """Let the next message pass, and what has the same time; stand before and after.

        Waits a second at most for readers that have a message in hand: theirs may be the next one.
        Where all are busy for longer, what the first of them comes to then passes.
        """
        with self._moved:
            self._timeline.pause(self._clock())
            self._moved.notify_all()
            self._is_stepping = True
            self._moved.wait_for(self._is_still, _STEP_SECONDS)
            self._is_stepping = False
            if self._timeline.is_paused:  # and is not played since
                self._steps += 1
                self._take_step()

    def seek(self, seconds: float) -> None:
        """Go to so many seconds after the first message."""

        def move() -> None:
            self._begin = int(max(0.0, min(float(self.length), seconds * _NANO)))
            self._timeline.seek(self._begin, self._clock())
            self.generation += 1
            # Where readers waited says nothing of the next message: a step waits for them anew.
            self._next.clear()
            self._steps = 0

        self._move(move)

    def status(self) -> PlaybackStatus:
        """Return where it is now."""
        with self._moved:
            timeline, place = self._timeline, self._timeline.position(self._clock())
            if self.length:
                place = place % self.length if place > self.length else place
            return PlaybackStatus(
                round(place / _NANO, 6),
                self.length / _NANO,
                timeline.rate,
                timeline.is_paused,
                self.start / _NANO,
                self._file,
            )

    def _note_gap(self) -> None:
        """Log, once for each, a gap in which no reader has a message for long."""
        if self._next.keys() != self._readers:
            return
        place = min(self._next.values())
        seconds = self._timeline.wait(place, self._clock())
        if seconds is None or seconds <= _LONG_SECONDS or place == self._noted_gap:
            return
        self._noted_gap = place
        at = (place % self.length if place > self.length else place) / _NANO
        text = "recording %s: no message for %.0f s; `seek: %.3f`, or the option `from`, skips them"
        _log.warning(text, self._file, seconds, at)

    def _take_step(self) -> None:
        self._steps -= self._timeline.step(self._next.values(), self._clock())
        self._moved.notify_all()

    def _is_still(self) -> bool:
        """Say whether each reader waits for a message that lies ahead."""
        now = self._clock()
        return all(
            reader in self._next and self._timeline.wait(self._next[reader], now) is None
            for reader in self._readers
        )

    def _move(self, move: Callable[[], object]) -> None:
        with self._moved:
            move()
            self._moved.notify_all()


def ask_playback(
    find: Callable[[], Bridge],
    *,
    pause: bool | None = None,
    rate: float | str | None = None,
    seek: float | None = None,
    step: bool = False,
    timeout: float = 10.0,
) -> PlaybackStatus:
    """Move what a bridge `recording` plays, wherever it runs, and return where it is.

    Args:
        find: returns the bridge; called once the values are known to be right.
        pause: True: stand; False: go on.
        rate: seconds of the recording in a second, or `fast`.
        seek: go to so many seconds after its first message.
        step: let the next message pass, and stand.
        timeout: seconds.

    Raises:
        UsageError: a value is wrong.
        BridgeError: the bridge failed.
    """
    request: dict[str, Any] = {}
    if pause is not None:
        request["pause"] = pause
    if rate is not None:
        if rate != "fast" and not (isinstance(rate, int | float) and 0 < rate <= MOST_RATE):
            text = f"rate {rate!r:.100}: expected more than 0 and at most {MOST_RATE:,}, or 'fast'"
            raise UsageError(text)
        request["rate"] = rate
    if seek is not None:
        if not 0 <= seek < math.inf:
            raise UsageError(f"seek {seek!r}: expected seconds after the first message")
        request["seek"] = seek
    if step:
        request["step"] = True
    bridge = find()
    endpoint = Endpoint(bridge.name, "control", Role.SERVICE, (CONTROL,))
    structures = ServiceStructures(
        MessageStructure(CONTROL_REQUEST), MessageStructure(CONTROL_REPLY)
    )
    reply: Any = bridge.call(endpoint, request, structures, timeout=timeout)
    return PlaybackStatus(**reply)
