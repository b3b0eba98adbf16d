"""What `/diagnostics` says of a component: entries read from octets, and judged; no I/O.

An array may hold thousands of entries of other nodes. Of these nothing but lengths is read, and
`Allowance` bounds how many texts a second are passed over.
"""

from __future__ import annotations

import math
import struct
from collections.abc import Collection, Mapping
from difflib import get_close_matches

from attrs import define, field, frozen

from uoarm.model import Health

__all__ = ["Allowance", "ArrayReading", "Entry", "EntryHealth", "read_array"]

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
        name: of the entry.
        now: the time.
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
                said = f"; the last: {self._last}" if self._last is not None else self._near()
                self._missing = f"no entry {self._name!r} for {self._timeout:g} s{said}"
                self._missing_at = now
            return Health.DEGRADED, self._missing
        return None if self._last is None else (self._last.health, self._text)

    def _near(self) -> str:
        near = get_close_matches(self._name, self._names, n=1)
        return f"; did you mean {near[0]!r}?" if near else ""
