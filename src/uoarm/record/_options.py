"""What a recording is asked to do, what follows from it in time, and its status: pure values."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from enum import Enum
from typing import NamedTuple

from attrs import field, frozen
from attrs.validators import ge, gt, in_, optional

from uoarm.errors import UsageError
from uoarm.model import OverflowPolicy, QueuePolicy

COMPRESSIONS = ("zstd", "lz4", "none")
_UNITS = {"": 1, "k": 1000, "m": 1000**2, "g": 1000**3, "ki": 1024, "mi": 1024**2, "gi": 1024**3}
_SIZE = re.compile(r"(\d+(?:\.\d+)?)\s*([kmg]i?)?b?", re.IGNORECASE)
_SECONDS = re.compile(r"(\d+(?:\.\d+)?)\s*(s|min|h)", re.IGNORECASE)
_LENGTHS = {"s": 1.0, "min": 60.0, "h": 3600.0}
_STEP = 500_000_000  # nanoseconds between the clocks: beyond it the one of the day was set
_NANO = 1_000_000_000
_MOST_OCTETS = 2**63
_MOST_SECONDS = 1e9
_RING_SPLIT = "a ring has a file for each time that it is written: leave out ring or split"
_QUEUE = QueuePolicy(length=10_000, policy=OverflowPolicy.DROP_OLDEST)


def read_size(text: str | int) -> int:
    """Return octets of a number, or of a text such as `512MB` or `2GiB`.

    Raises:
        UsageError: it is none.
    """
    found = _SIZE.fullmatch(str(text).strip())
    octets = float(found[1]) * _UNITS[(found[2] or "").lower()] if found else 0.0
    if not 0 < octets < _MOST_OCTETS:
        raise UsageError(f"{text!r:.100} is no size: expected one such as 512MB or 2GiB")
    return max(1, int(octets))


def read_split(split: str | int | None) -> tuple[int | None, float | None]:
    """Return after how many octets, or else seconds, a new file begins.

    Raises:
        UsageError: it is neither a size nor a time.
    """
    if split is None:
        return None, None
    found = _SECONDS.fullmatch(str(split).strip())
    seconds = float(found[1]) * _LENGTHS[found[2].lower()] if found else 0.0
    if 0 < seconds <= _MOST_SECONDS:
        return None, seconds
    try:
        return read_size(split), None
    except UsageError:
        text = f"{split!r:.100} is neither a size nor a time: expected one such as 512MB or 10min"
        raise UsageError(text) from None


@frozen(kw_only=True)
class RecordOptions:
    """How a recording is made.

    Attributes:
        duration: seconds after which it ends; None: it does not by itself.
        max_size: octets of all its files after which it ends.
        split_size: octets after which a new file begins.
        split_seconds: seconds after which a new file begins.
        compression: of chunks: `zstd`, `lz4` or `none`.
        ring: seconds that are kept in memory, and written on a failure or on demand only; None:
            everything is written as it comes.
        ring_octets: octets that are kept so at most.
        queue: what waits for the writer, and what becomes of more; None: ten thousand messages,
            of which the oldest are dropped.
        chunk_octets: of messages that are written at once.
        chunk_seconds: after which they are written, however few there are.
    """

    duration: float | None = field(default=None, validator=optional(gt(0.0)))
    max_size: int | None = field(default=None, validator=optional(ge(1)))
    split_size: int | None = field(default=None, validator=optional(ge(1)))
    split_seconds: float | None = field(default=None, validator=optional(gt(0.0)))
    compression: str = field(default="zstd", validator=in_(COMPRESSIONS))
    ring: float | None = field(default=None, validator=optional(gt(0.0)))
    ring_octets: int = field(default=268_435_456, validator=ge(1))
    queue: QueuePolicy = _QUEUE
    chunk_octets: int = field(default=262_144, validator=ge(1))
    chunk_seconds: float = field(default=1.0, validator=gt(0.0))

    @classmethod
    def of(
        cls,
        *,
        duration: float | None = None,
        max_size: int | str | None = None,
        split: int | str | None = None,
        compression: str = "zstd",
        ring: float | None = None,
        queue: QueuePolicy | None = None,
    ) -> RecordOptions:
        """Read them as a program, a configuration or a command line gives them.

        Raises:
            UsageError: one of them is wrong; the text says which and what was expected.
        """
        if compression not in COMPRESSIONS:
            text = f"compression {compression!r}: expected one of {', '.join(COMPRESSIONS)}"
            raise UsageError(text)
        for name, seconds in (("duration", duration), ("ring", ring)):
            if seconds is not None and not 0 < seconds <= _MOST_SECONDS:
                text = f"{name} {seconds!r}: expected seconds, more than 0 and at most 1e9"
                raise UsageError(text)
        options = {"max_size": max_size, "split": split, "ring": ring}
        given = {name: value for name, value in options.items() if value is not None}
        for mistake in cls.mistakes(given):
            raise UsageError(": ".join(mistake))
        size, length = read_split(split)
        return cls(
            duration=duration,
            max_size=None if max_size is None else read_size(max_size),
            split_size=size,
            split_seconds=length,
            compression=compression,
            ring=ring,
            queue=queue or _QUEUE,
        )

    @staticmethod
    def mistakes(options: Mapping[str, object]) -> Iterator[tuple[str, str]]:
        """Yield options of a configuration that mean nothing, and why; their kinds were checked."""
        readers = (("max_size", read_size), ("split", read_split))
        for name, read in readers:
            value = options.get(name)
            if isinstance(value, str | int) and not isinstance(value, bool):
                try:
                    read(value)
                except UsageError as error:
                    yield name, str(error)
        if "ring" in options and "split" in options:
            yield "split", _RING_SPLIT


class Instant(NamedTuple):
    """One moment on two clocks, in nanoseconds; made for each message.

    Attributes:
        wall: since the epoch; that clock may be set.
        steady: of a clock that only goes on.
    """

    wall: int
    steady: int


class RecordingStep(Enum):
    """What is to be done at a moment."""

    NOTHING = "nothing"
    FLUSH = "flush"
    SPLIT = "split"
    END = "end"


class RecordingSchedule:
    """When a chunk is written, a new file begins, and the recording ends.

    Args:
        options: of the recording.
        now: when it begins.
    """

    def __init__(self, options: RecordOptions, now: Instant) -> None:
        self._options = options
        self._began = self._file_began = now
        self._offset = now.wall - now.steady
        self._flushed = now.steady
        self._quiet_until = self._quiet_octets = 0
        self.end_cause = self.split_cause = ""

    def is_quiet(self, wall: int, steady: int, file_octets: int) -> bool:
        """Say whether nothing is due at a moment, as far as that is seen at once: asked often."""
        step = wall - steady - self._offset
        if steady >= self._quiet_until or file_octets >= self._quiet_octets or abs(step) > _STEP:
            return False
        self._offset += step
        return True

    def due(
        self, now: Instant, *, file_octets: int, all_octets: int, waiting: bool
    ) -> RecordingStep:
        """Return what is to be done now, before anything that came now is written.

        Args:
            now: the moment.
            file_octets: what the open file holds, with what waits to be written into it.
            all_octets: the same of all files.
            waiting: whether a chunk has been begun.
        """
        options = self._options
        step = now.wall - now.steady - self._offset
        self._offset += step
        if not waiting:
            self._flushed = now.steady
        room = [_MOST_OCTETS]
        if options.split_size is not None:
            room.append(options.split_size)
        if options.max_size is not None:
            room.append(options.max_size - all_octets + file_octets)
        self._quiet_octets = min(room)
        self._quiet_until = min(self._ends(waiting=True))
        if options.duration is not None and self._since(self._began, now) >= options.duration:
            self.end_cause = f"it lasted {options.duration:g} s"
            return RecordingStep.END
        if options.max_size is not None and all_octets >= options.max_size:
            self.end_cause = f"its files have {options.max_size:,} octets"
            return RecordingStep.END
        if abs(step) > _STEP:
            self.split_cause = f"the clock was set by {step / _NANO:+.3f} s"
            return RecordingStep.SPLIT
        if options.split_size is not None and file_octets >= options.split_size:
            self.split_cause = f"the file has {options.split_size:,} octets"
            return RecordingStep.SPLIT
        seconds = options.split_seconds
        if seconds is not None and self._since(self._file_began, now) >= seconds:
            self.split_cause = f"the file has {seconds:g} s"
            return RecordingStep.SPLIT
        if waiting and now.steady - self._flushed >= options.chunk_seconds * _NANO:
            return RecordingStep.FLUSH
        return RecordingStep.NOTHING

    def file_begins(self, now: Instant) -> None:
        self._file_began = now
        self.flushed(now)

    def flushed(self, now: Instant) -> None:
        self._flushed = now.steady
        self._quiet_until = 0

    def wait(self, now: Instant, *, waiting: bool) -> float | None:
        """Return seconds until something may be due though nothing comes; None: nothing is."""
        ends = self._ends(waiting=waiting)
        return max(0.0, (min(ends) - now.steady) / _NANO) if ends else None

    def _ends(self, *, waiting: bool) -> list[int]:
        options, ends = self._options, []
        if waiting:
            ends.append(self._flushed + int(options.chunk_seconds * _NANO))
        if options.duration is not None:
            ends.append(self._began.steady + int(options.duration * _NANO))
        if options.split_seconds is not None:
            ends.append(self._file_began.steady + int(options.split_seconds * _NANO))
        return ends

    @staticmethod
    def _since(began: Instant, now: Instant) -> float:
        return (now.steady - began.steady) / _NANO


@frozen
class RecordedChannel:
    """One function of a recording.

    Attributes:
        function: as it was asked for.
        topic: of its channel.
        encoding: `cdr` or `json`.
        received: messages that came.
        recorded: those that were written, or wait in the chunk that is being filled; of a ring,
            those that came into it.
        unwritable: those that have no form in the file.
        failure: why its function failed; empty where it runs, or has come to an orderly end.
    """

    function: str
    topic: str
    encoding: str
    received: int
    recorded: int
    unwritable: int
    failure: str = ""


@frozen
class RecordingStatus:
    """A recording at one moment.

    Attributes:
        state: `recording`, `ended` or `failed`.
        cause: why it ended or failed; empty while it runs.
        files: the paths, oldest first.
        octets: of all files.
        channels: what came of each function.
        dropped: messages that were lost before the writer, by reason; as `events` status events.
        seconds: for which it has run.
    """

    state: str
    cause: str
    files: tuple[str, ...]
    octets: int
    channels: tuple[RecordedChannel, ...]
    dropped: Mapping[str, int] = field(factory=dict, hash=False)
    seconds: float = 0.0
