"""An MCAP file that is read: by its index, or record by record where it has none.

Nothing in a file is believed: every length is held against what is there and against a bound before
memory is taken for it. What cannot be read is passed over and named; the rest is read.
"""

from __future__ import annotations

import heapq
import struct
import threading
import time
import zlib
from bisect import bisect_left
from collections import OrderedDict
from collections.abc import Callable, Iterable, Iterator, Mapping
from functools import partial
from operator import itemgetter
from pathlib import Path
from typing import BinaryIO, Protocol, TypeAlias

from attrs import define, field, frozen

from uoarm._support.files import open_regular
from uoarm.errors import BridgeError, FailureReason
from uoarm.record._records import (
    HEAD,
    MAGIC,
    MESSAGE,
    MESSAGE_RECORD,
    MOST_RECORD,
    DamageError,
    RecordContent,
    inner_records,
    read_content,
    unpacked,
)

_CHUNK = struct.Struct("<QQQI")
_FOOTER_OCTETS = HEAD.size + 20 + len(MAGIC)
_NO_TIME = 2**64
_FOOTER, _SCHEMA, _CHANNEL, _CHUNK_RECORD = 2, 3, 4, 6
_CHUNK_INDEX, _STATISTICS, _DATA_END = 8, 11, 15
_MOST_SUMMARY = 67_108_864
_MOST_DEFINITIONS = 67_108_864
_MOST_METADATA = 1000
_MOST_HELD = 268_435_456
_MOST_MESSAGES = 1_000_000
"""Of one part: what each takes in memory is ten times what it may have in a file."""
_MESSAGE_COST = 272
"""Octets of memory that a message which was read takes beside its data, measured."""
_LOOSE_OCTETS = 1 << 20
_MOST_NOTES = 20


@frozen
class FileChannel:
    """A channel of a file, as the file states it."""

    topic: str
    encoding: str
    schema_name: str = ""
    schema_encoding: str = ""
    schema_data: bytes = b""
    metadata: Mapping[str, str] = field(factory=dict, hash=False)

    def is_like(self, other: FileChannel | None) -> bool:
        """Say whether a channel has the same topic and messages, whichever publisher's it is.

        Files that were made of .bag files of ROS 1 have a channel for each publisher, which its
        metadata name.
        """
        return other is not None and self.kind == other.kind

    @property
    def kind(self) -> tuple[object, ...]:
        """What decides how its messages are read."""
        stated = self.metadata.get("uoarm.structure")
        schema = self.schema_name, self.schema_encoding, self.schema_data
        return self.topic, self.encoding, *schema, stated


@frozen
class StoredMessage:
    """A message as it stands in a file; the time in nanoseconds since the epoch."""

    time: int
    data: bytes | memoryview


class RecordedFile(Protocol):
    """A file that was opened: its channels by topic, its messages, and what cannot be read.

    Attributes:
        start: the time of the first message, in nanoseconds since the epoch; 0 where there is none.
        end: that of the last.
        notes: what cannot be read, and why.
    """

    start: int
    end: int
    notes: list[str]

    @property
    def channels(self) -> Mapping[str, FileChannel]: ...

    def messages(
        self, topic: str, since: int, on_damage: Callable[[str], object]
    ) -> Iterator[StoredMessage]:
        """Yield the messages of a topic from a time on, in the order of their times."""


@define
class _Part:
    """A chunk, or messages that stand outside of any, one after another.

    Attributes:
        at: where its records begin; of a chunk, the content of its record.
        octets: of them.
        is_chunk: which of the two it is.
        start: the time of its first message.
        end: that of its last.
    """

    at: int
    octets: int
    is_chunk: bool
    start: int
    end: int


_Timed: TypeAlias = "tuple[int, bytes | memoryview]"
_Found: TypeAlias = "tuple[Mapping[int, list[_Timed]], str]"
"""The messages of a part by the number of their channel, each list in order; what is damaged."""
_time_of: Callable[[_Timed], int] = itemgetter(0)


class McapReader:
    """One file, which may be read in several threads at a time.

    Args:
        follows: whether another process writes it still: there is no index then.

    Attributes:
        channels: by topic; more may come where it is followed.

    Raises:
        BridgeError: it is not there, or no MCAP file.
    """

    def __init__(self, path: Path, *, follows: bool = False) -> None:
        self.path, self._follows = path, follows
        self.channels: dict[str, FileChannel] = {}
        self.notes: list[str] = []
        self._ids: dict[int, FileChannel] = {}
        self._schemas: dict[int, tuple[str, str, bytes]] = {}
        self._parts: list[_Part] = []
        self._definitions = 0  # octets of those that were taken in
        self._has_schemas = True  # of all channels that say that they have one
        self._size, self._size_read = 0, len(MAGIC)
        self._cache = _PartCache(self._found_in)
        # Guards the place up to which a growing file was read, between sources that open.
        self._growing = threading.Lock()
        try:
            with open_regular(path) as file:
                if file.read(len(MAGIC)) != MAGIC:
                    raise BridgeError(f"{path} is no MCAP file", FailureReason.UNSUPPORTED)
                self._size = file.seek(0, 2)
                if follows or not self._read_summary(file):
                    self._scan(file, len(MAGIC))
        except OSError as error:
            text = f"{path} cannot be read: {error.strerror or error}"
            raise BridgeError(text, FailureReason.UNAVAILABLE) from error
        self._parts.sort(key=lambda part: part.start)
        self.start = min((part.start for part in self._parts), default=0)
        self.end = max((part.end for part in self._parts), default=0)

    def messages(
        self, topic: str, since: int, on_damage: Callable[[str], object]
    ) -> Iterator[StoredMessage]:
        """Yield the messages of a topic from a time on, in the order of their times.

        A part is read when its first message may be the next one. Of parts that overlap no more are
        held than find room: after that the order is that of the parts.
        """
        wanted = self.channels[topic]
        ids = {number for number, channel in self._ids.items() if channel.is_like(wanted)}
        # Of each part that was begun: its next message's time, its place, the message's, and all.
        begun: list[tuple[int, int, int, list[_Timed]]] = []
        parts = [part for part in self._parts if part.end >= since]
        place = held = 0
        while place < len(parts) or begun:
            while place < len(parts) and (
                not begun or (parts[place].start <= begun[0][0] and held < _MOST_HELD)
            ):
                found, damage = self._cache.get(parts[place])
                if place + 1 < len(parts):
                    self._cache.prepare(parts[place + 1])
                if damage:
                    on_damage(damage)
                messages = list(
                    heapq.merge(*(found.get(number, ()) for number in ids), key=_time_of)
                )
                first = bisect_left(messages, since, key=_time_of)
                if first < len(messages):
                    heapq.heappush(begun, (messages[first][0], place, first, messages))
                    held += _octets_of(messages)
                place += 1
            if begun:
                _, part, number, messages = begun[0]
                if number + 1 < len(messages):
                    heapq.heapreplace(begun, (messages[number + 1][0], part, number + 1, messages))
                else:
                    heapq.heappop(begun)
                    held -= _octets_of(messages)
                yield StoredMessage(*messages[number])

    def end_of_records(self) -> int:
        """Return where the last record that is whole now ends, and take in its definitions.

        Raises:
            OSError: the file cannot be read.
        """
        with self._growing, self.path.open("rb") as file:
            self._size = file.seek(0, 2)
            self._scan(file, self._size_read)
            return self._size_read

    def follow(
        self,
        topic: str,
        at: int,
        stop: Callable[[float], bool],
        on_damage: Callable[[str], object],
    ) -> Iterator[StoredMessage]:
        """Yield what comes into the file from a place on; `stop` waits, and says whether to end.

        Raises:
            BridgeError: the file is gone, or was cut.
        """
        with self.path.open("rb") as file:
            while True:
                size = file.seek(0, 2)
                if size < at or not self.path.exists():
                    text = f"{self.path} was cut or is gone"
                    raise BridgeError(text, FailureReason.UNAVAILABLE)
                for opcode, place, octets in self._records(file, at, size, note=False):
                    at = place + octets
                    if opcode in {_DATA_END, _FOOTER}:
                        return
                    try:
                        part = self._take_record(file, opcode, place, octets)
                        if part is None:
                            continue
                        wanted = self.channels.get(topic)
                        ids = {n for n, channel in self._ids.items() if channel.is_like(wanted)}
                        for time, data in self._messages_of(file, part, ids):
                            yield StoredMessage(time, data)
                    except DamageError as error:
                        on_damage(str(error))
                if stop(_POLL_SECONDS):
                    return

    # Reading the whole: the index, or all records.

    def _read_summary(self, file: BinaryIO) -> bool:
        """Read the summary; False where there is none that can be used."""
        if self._size < 2 * len(MAGIC) + _FOOTER_OCTETS:
            return False
        file.seek(self._size - _FOOTER_OCTETS)
        footer = file.read(_FOOTER_OCTETS)
        opcode, octets = HEAD.unpack_from(footer)
        if footer[-len(MAGIC) :] != MAGIC or (opcode, octets) != (_FOOTER, 20):
            return False
        start = int.from_bytes(footer[HEAD.size : HEAD.size + 8], "little")
        end = self._size - _FOOTER_OCTETS
        if not len(MAGIC) < start < end or end - start > _MOST_SUMMARY:
            return False
        file.seek(start)
        stated = int.from_bytes(footer[-len(MAGIC) - 4 : -len(MAGIC)], "little")
        if stated and zlib.crc32(file.read(end - start) + footer[: HEAD.size + 16]) != stated:
            return False
        chunks: int | None = None
        indexed, has_messages = 0, True
        try:
            for opcode, place, octets in self._records(file, start, end):
                if opcode in {_SCHEMA, _CHANNEL}:
                    self._take_record(file, opcode, place, octets)
                elif opcode == _CHUNK_INDEX:
                    indexed += 1
                    self._parts += self._indexed(file, place, octets)
                elif opcode == _STATISTICS:
                    content = RecordContent(read_content(file, place, octets))
                    has_messages = content.number(8) > 0
                    content.take(14)  # counts of schemas, channels, attachments and metadata
                    chunks = content.number(4)
        except (DamageError, struct.error):
            self._forget()
            return False
        # Messages outside of chunks have no index, and each part of a summary may be left out.
        is_whole = (
            bool(self._ids)
            and self._has_schemas
            and (bool(self._parts) or not has_messages)
            and chunks in {None, indexed}
            and not self.notes
        )
        if not is_whole:
            self._forget()
        return is_whole

    def _forget(self) -> None:
        self.channels, self._ids, self._schemas, self._parts = {}, {}, {}, []
        self._definitions, self._has_schemas = 0, True
        self.notes.clear()

    def _indexed(self, file: BinaryIO, place: int, octets: int) -> list[_Part]:
        start, end, at, length = struct.unpack_from("<QQQQ", read_content(file, place, octets))
        if not len(MAGIC) <= at < self._size or not HEAD.size < length <= self._size - at:
            raise DamageError("the index leads out of the file")
        if start == end == 0:  # as of a chunk without messages, which has no time
            part = self._take_record(file, _CHUNK_RECORD, at + HEAD.size, length - HEAD.size)
            return [] if part is None else [part]
        return [_Part(at + HEAD.size, length - HEAD.size, is_chunk=True, start=start, end=end)]

    def _scan(self, file: BinaryIO, start: int) -> None:
        """Read every record from a place on, one chunk at a time."""
        is_whole = False
        for opcode, place, octets in self._records(file, start, self._size):
            if opcode in {_DATA_END, _FOOTER}:
                is_whole = True
                self._note_what_follows(file, place - HEAD.size)
                break
            self._size_read = place + octets
            try:
                part = self._take_record(file, opcode, place, octets)
            except DamageError as error:
                self._note(str(error))
                continue
            if part is not None:
                self._add_part(part)
        if not is_whole and not self.notes and not self._follows:
            self._note(f"it has no end: {self._size_read:,} of {self._size:,} octets can be read")

    def _note_what_follows(self, file: BinaryIO, at: int) -> None:
        """Note what stands behind the end, such as another file."""
        records = self._records(file, at, self._size, note=False)
        ends = (place + octets for opcode, place, octets in records if opcode == _FOOTER)
        rest = self._size - next(ends, self._size) - len(MAGIC)
        if rest > 0:
            self._note(f"{rest:,} octets behind its end are not read")

    def _add_part(self, part: _Part) -> None:
        last = self._parts[-1] if self._parts else None
        if (
            last is not None
            and not (part.is_chunk or last.is_chunk)
            and last.at + last.octets + HEAD.size == part.at
            and last.octets < _LOOSE_OCTETS
        ):
            last.octets += HEAD.size + part.octets
            last.start, last.end = min(last.start, part.start), max(last.end, part.end)
            return
        self._parts.append(part)

    def _records(
        self, file: BinaryIO, start: int, end: int, *, note: bool = True
    ) -> Iterator[tuple[int, int, int]]:
        """Yield opcode, place and length of the content of each record that is whole."""
        at = start
        while at < end:
            file.seek(at)
            head = file.read(HEAD.size)
            if len(head) < HEAD.size:
                why = "ends within a record"
            else:
                opcode, octets = HEAD.unpack(head)
                place = at + HEAD.size
                if octets <= end - place:
                    yield opcode, place, octets
                    at = place + octets
                    continue
                why = f"ends within a record of {octets:,} octets"
            if note:
                self._note(f"it {why}: {at:,} of {self._size:,} octets can be read")
            return

    def _note(self, text: str) -> None:
        if len(self.notes) < _MOST_NOTES and text not in self.notes:
            self.notes.append(text)

    def _take_record(self, file: BinaryIO, opcode: int, place: int, octets: int) -> _Part | None:
        """Take in one record; returns what has messages."""
        if opcode in {_SCHEMA, _CHANNEL}:
            self._take_definition(opcode, read_content(file, place, octets))
        elif opcode == MESSAGE_RECORD:
            file.seek(place)
            head = file.read(MESSAGE.size)
            if octets < MESSAGE.size or len(head) < MESSAGE.size:
                raise DamageError(f"a message at {place:,} is too short")
            time = MESSAGE.unpack(head)[2]
            return _Part(
                place - HEAD.size, HEAD.size + octets, is_chunk=False, start=time, end=time
            )
        elif opcode == _CHUNK_RECORD:
            part = _Part(place, octets, is_chunk=True, start=_NO_TIME, end=-1)
            for inner, content in inner_records(self._chunk(file, part), place):
                if inner == MESSAGE_RECORD:
                    time = MESSAGE.unpack_from(content)[2]
                    part.start, part.end = min(part.start, time), max(part.end, time)
                elif inner in {_SCHEMA, _CHANNEL}:
                    try:
                        self._take_definition(inner, bytes(content))
                    except DamageError as error:  # the rest of the chunk may be well
                        self._note(str(error))
            return part if part.end >= 0 else None
        return None

    def _take_definition(self, opcode: int, octets: bytes) -> None:
        content = RecordContent(octets)
        number = content.number(2)
        if opcode == _CHANNEL and number in self._ids:
            content.number(2)
            if self._ids[number].topic != content.text():
                self._note(f"channel {number} is stated anew, as another: the first holds")
            return
        if opcode == _SCHEMA and number in self._schemas:
            return  # stated again, as some writers do in each chunk
        if self._definitions + len(octets) > _MOST_DEFINITIONS:
            text = f"its schemas and channels have more than {_MOST_DEFINITIONS:,} octets"
            raise DamageError(f"{text}: the rest of them is left out")
        if opcode == _CHANNEL:
            self._take_channel(number, content)
        else:
            self._schemas[number] = (content.text(), content.text(), content.octets(4))
        self._definitions += len(octets)

    def _take_channel(self, number: int, content: RecordContent) -> None:
        schema = content.number(2)
        topic, encoding = content.text(), content.text()
        inner = RecordContent(content.octets(4))
        metadata: dict[str, str] = {}
        while not inner.is_over:
            key = inner.text()
            metadata[key] = inner.text()
            if len(metadata) > _MOST_METADATA:
                raise DamageError(f"{topic:.100} has more than {_MOST_METADATA:,} metadata")
        self._has_schemas = self._has_schemas and (not schema or schema in self._schemas)
        name, kind, data = self._schemas.get(schema, ("", "", b""))
        channel = FileChannel(topic, encoding, name, kind, data, metadata)
        self._ids[number] = channel
        known = self.channels.setdefault(topic, channel)
        if not channel.is_like(known):
            self._note(f"{topic} has another channel of another kind, which is not read")

    def _messages_of(
        self, file: BinaryIO, part: _Part, ids: set[int]
    ) -> Iterator[tuple[int, memoryview]]:
        for opcode, content in inner_records(self._records_in(file, part), part.at):
            if opcode == MESSAGE_RECORD:
                number, _, time, _ = MESSAGE.unpack_from(content)
                if number in ids:
                    yield time, content[MESSAGE.size :]

    def _found_in(self, part: _Part, *, is_ahead: bool) -> _Found:
        """Read a whole part; ahead of its time it lets others go first, again and again."""
        found: dict[int, list[_Timed]] = {}
        damage, count = "", 0
        with self.path.open("rb") as file:
            try:
                for opcode, content in inner_records(self._records_in(file, part), part.at):
                    if opcode == MESSAGE_RECORD:
                        number, _, at, _ = MESSAGE.unpack_from(content)
                        found.setdefault(number, []).append((at, content[MESSAGE.size :]))
                    count += 1
                    if count > _MOST_MESSAGES:
                        where = f"the chunk at {part.at - HEAD.size:,}"
                        damage = f"{where} has more records than are read: {_MOST_MESSAGES:,}"
                        break
                    if is_ahead and not count % _TURN_RECORDS:
                        time.sleep(0)
            except DamageError as error:
                damage = str(error)
        for messages in found.values():
            messages.sort(key=_time_of)
        return found, damage

    def _records_in(self, file: BinaryIO, part: _Part) -> memoryview:
        if part.is_chunk:
            return self._chunk(file, part)
        return memoryview(read_content(file, part.at, part.octets))

    def _chunk(self, file: BinaryIO, part: _Part) -> memoryview:
        """Return the records of a chunk, unpacked."""
        content = RecordContent(read_content(file, part.at, part.octets))
        where = f"the chunk at {part.at - HEAD.size:,}"
        _, _, size, crc = _CHUNK.unpack(content.take(_CHUNK.size))
        compression = content.text()
        packed = content.octets(8)
        if size > MOST_RECORD:
            raise DamageError(f"{where} has {size:,} octets; {MOST_RECORD:,} are read")
        try:
            data = unpacked(compression, packed, size)
        except DamageError as error:
            raise DamageError(f"{where} {error}") from None
        except Exception as error:  # noqa: BLE001 - of libraries, each with errors of its own
            raise DamageError(f"{where} cannot be unpacked: {error}") from None
        if len(data) != size:
            raise DamageError(f"{where} has {len(data):,} octets, not {size:,}")
        if crc and zlib.crc32(data) != crc:
            raise DamageError(f"{where} has another checksum than it states")
        return memoryview(data)


_POLL_SECONDS = 0.05
_TURN_RECORDS = 256
_KEPT_OCTETS = 33_554_432
_KEPT_PARTS = 4
_AHEAD_OCTETS = 4_194_304


class _Loaded:
    """A part that is read, or is being read by another thread."""

    def __init__(self) -> None:
        self.is_read = threading.Event()
        self.found: _Found | None = None
        self.error: OSError | None = None
        self.octets = 0


class _PartCache:
    """The parts that the channels of a file are at, read once for all of them, and ahead.

    Reading a part takes longer than some messages are apart: what is read ahead keeps their times.
    """

    def __init__(self, read: Callable[..., _Found]) -> None:
        self._read = read
        self._kept: OrderedDict[int, _Loaded] = OrderedDict()
        # Guards what is kept, between the channels' threads.
        self._lock = threading.Lock()

    def get(self, part: _Part) -> _Found:
        """Return what is in a part; raises OSError."""
        loaded, is_new = self._find(part)
        if is_new:
            self._load(part, loaded, is_ahead=False)
        loaded.is_read.wait()
        if loaded.error is not None:
            raise loaded.error
        assert loaded.found is not None, "it is read"
        return loaded.found

    def prepare(self, part: _Part) -> None:
        """Have a part read that is wanted next, where it is not large."""
        if part.octets > _AHEAD_OCTETS:
            return
        loaded, is_new = self._find(part)
        if is_new:
            load = partial(self._load, part, loaded, is_ahead=True)
            try:
                threading.Thread(target=load, name="uoarm-recording-ahead", daemon=True).start()
            except RuntimeError:  # the system gives no more; who gets it waits until it is read
                load()

    def _find(self, part: _Part) -> tuple[_Loaded, bool]:
        with self._lock:
            loaded = self._kept.get(part.at)
            if loaded is not None:
                self._kept.move_to_end(part.at)
                return loaded, False
            loaded = self._kept[part.at] = _Loaded()
            return loaded, True

    def _load(self, part: _Part, loaded: _Loaded, *, is_ahead: bool) -> None:
        try:
            loaded.found = self._read(part, is_ahead=is_ahead)
            loaded.octets = sum(map(_octets_of, loaded.found[0].values()))
        except OSError as error:
            loaded.error = error
        finally:
            loaded.is_read.set()
        with self._lock:
            if loaded.error is not None:
                self._kept.pop(part.at, None)
            octets = sum(other.octets for other in self._kept.values())
            while octets > _KEPT_OCTETS or len(self._kept) > _KEPT_PARTS:
                octets -= self._kept.popitem(last=False)[1].octets


def _octets_of(messages: Iterable[_Timed]) -> int:
    return sum(_MESSAGE_COST + len(data) for _, data in messages)
