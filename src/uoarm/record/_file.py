"""One MCAP file that is being written: whole up to the last chunk, whatever happens to it then.

Beside messages it has the plans, the configuration without secrets, and the lock.
"""

from __future__ import annotations

import os
import struct
import zlib
from collections import deque
from collections.abc import Callable, Iterator, Mapping
from contextlib import suppress
from itertools import count
from pathlib import Path
from typing import TYPE_CHECKING, Any

from attrs import evolve, frozen

from uoarm._origin import install_command
from uoarm._raised import reason_of
from uoarm._secrets import without_secrets
from uoarm._support.files import UnreadableFileError, lock_path, read_octets
from uoarm._version import __version__
from uoarm.errors import PluginError, UsageError
from uoarm.model import Plan, Robot, StatusEvent, to_json, write_json
from uoarm.record._forms import ChannelForm
from uoarm.record._options import Instant
from uoarm.record._records import HEAD, MAGIC

if TYPE_CHECKING:
    from mcap.records import McapRecord


_MESSAGE = struct.Struct("<BQHIQQ")
_MESSAGE_OCTETS = 22  # of a message's content before its data
_CHUNK = struct.Struct("<BQQQQI")
_INDEX = struct.Struct("<BQHI")
_FOOTER = struct.Struct("<BQQQ")
_NEW = os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_CLOEXEC
_OF_MESSAGE, _OF_CHUNK, _OF_INDEX, _OF_FOOTER = 5, 6, 7, 2
_MOST_BUFFERS = 512  # of one call of the system
_KEPT_OCTETS = 400
"""Of memory that a message in the ring takes beside its own, measured."""
_FAST = 1
"""Of zstandard: half the time of its usual level, and a tenth more octets."""


def require_mcap() -> None:
    """Raise PluginError, with what to do, where the packages of the extra are not here."""
    try:
        import mcap.writer  # noqa: F401, PLC0415 - an extra
        import numpy as np  # noqa: F401, PLC0415 - as above

        import uoarm._wire  # noqa: F401, PLC0415 - needs the extra's packages
    except ImportError as error:
        command = install_command("uoarm", "record")
        raise PluginError(f"recordings need: {command} ({error})") from error


def _create(path: Path) -> tuple[Path, int]:
    """Make a file where nothing is yet: at this path, or with the first number that is free.

    Raises:
        UsageError: none can be made there.
    """
    try:
        if path.exists() and not path.is_file():
            kind = "a folder" if path.is_dir() else "no regular file"
            raise UsageError(f"{path} is {kind}: name a file, such as run.mcap")
        for number in count():
            numbered = path.with_name(f"{path.stem}-{number}{path.suffix}") if number else path
            # Made at once: another recording may look for a free name, too.
            with suppress(FileExistsError):
                return numbered, os.open(numbered, _NEW, 0o666)
    except (OSError, ValueError) as error:  # the latter for names that no file may have
        raise UsageError(f"{path} cannot be made: {reason_of(error, path)}") from error
    raise AssertionError("numbers do not end")


def require_room(path: Path) -> None:
    """Make a file as it will be made later, and take it away.

    Raises:
        UsageError: none can be made there.
    """
    place, file = _create(path)
    os.close(file)
    place.unlink()


class _Output:
    """The file: nothing is kept back, and what is whole is known.

    A chunk that did not find room is taken back, so that the file ends with a whole record.

    Attributes:
        count: octets written.
        whole: octets up to the end of the last whole record.
    """

    def __init__(self, file: int) -> None:
        self._file = file
        self._is_open = True
        self.count = self.whole = 0

    def write(self, *parts: bytes | bytearray) -> None:
        rest = [memoryview(part) for part in parts if part]
        while rest:
            written = os.writev(self._file, rest[:_MOST_BUFFERS])
            self.count += written
            while rest and written >= len(rest[0]):
                written -= len(rest.pop(0))
            if written:
                rest[0] = rest[0][written:]
        self.whole = self.count

    def close(self) -> None:
        if self._is_open:
            self._is_open = False
            os.close(self._file)

    def take_back(self) -> None:
        """Cut off what is not whole."""
        if self.count > self.whole:
            os.ftruncate(self._file, self.whole)
            self.count = self.whole


class McapFile:
    """One file, for one thread.

    The package's records are written with the package, save messages, chunks and their indexes:
    its writer takes three times as long for a message, and keeps an object for each chunk.

    Args:
        path: of it; where something is already, a number is added.
        compression: `zstd`, `lz4` or `none`.
        chunk_octets: of messages that are written at once.

    Raises:
        UsageError: it cannot be made, or not be written.
    """

    def __init__(self, path: Path, compression: str, chunk_octets: int) -> None:
        self.path, file = _create(path)
        self._output = _Output(file)
        self._compression = "" if compression == "none" else compression
        self._compress = _compressor(self._compression)
        self._chunk_octets = chunk_octets
        self._channels: dict[ChannelForm, int] = {}
        self._definitions: list[bytes] = []  # of schemas, then channels
        self._counts: dict[int, int] = {}
        self._times: tuple[int, int] | None = None
        # What stands in the summary of chunks, attachments and metadata, as it is written there.
        self._indexes: dict[int, bytearray] = {}
        self._numbers: dict[int, int] = {}  # of them, by the opcode of their index
        # The chunk that is being filled, and of each channel times and places in turns. Messages
        # are copied at once: encoders give back small octets in large blocks, which would add up.
        self._chunk = bytearray()
        self._index: dict[int, list[int]] = {}
        # Before anything is opened: a full disk takes a file, and nothing in it.
        try:
            self._output.write(MAGIC)
        except OSError as error:
            self._output.close()
            self.path.unlink(missing_ok=True)
            raise UsageError(f"{path} cannot be written: {reason_of(error, path)}") from error

    def begin(self, profile: str) -> None:
        """Write the header; the profile is `ros2` where every channel is one of ROS 2."""
        from mcap.records import Header  # noqa: PLC0415 - an extra

        self._output.write(_written(Header(profile, f"uoarm {__version__}")))

    @property
    def octets(self) -> int:
        """What it holds, with what waits to be written."""
        return self._output.count + len(self._chunk)

    @property
    def has_channels(self) -> bool:
        return bool(self._channels)

    @property
    def has_waiting(self) -> bool:
        """Whether a chunk has been begun."""
        return bool(self._index)

    def add_channel(self, form: ChannelForm) -> None:
        from mcap.records import Channel, Schema  # noqa: PLC0415 - an extra

        number = len(self._channels) + 1
        self._channels[form] = number
        schema = Schema(number, form.schema_data, form.schema_encoding, form.schema_name)
        channel = Channel(number, form.topic, form.message_encoding, dict(form.metadata), number)
        definitions = [_written(schema), _written(channel)]
        self._definitions += definitions
        self._chunk += b"".join(definitions)

    def add_message(self, form: ChannelForm, time: int, data: bytes, sequence: int) -> None:
        """Add a message to the chunk that is being filled, which is written when it is full."""
        channel = self._channels[form]
        index = self._index.get(channel)
        if index is None:
            index = self._index[channel] = []
        chunk = self._chunk
        index += (time, len(chunk))
        octets, number = _MESSAGE_OCTETS + len(data), sequence & 0xFFFFFFFF
        chunk += _MESSAGE.pack(_OF_MESSAGE, octets, channel, number, time, time)
        chunk += data
        if len(chunk) >= self._chunk_octets:
            self.flush()

    def attach(self, name: str, content: bytes, media_type: str, time: int) -> None:
        from mcap.records import Attachment, AttachmentIndex  # noqa: PLC0415 - an extra

        record = _written(Attachment(time, time, name, media_type, content))
        index = AttachmentIndex(
            self._output.count, len(record), time, time, len(content), name, media_type
        )
        self._output.write(record)
        self._note(_written(index))

    def add_metadata(self, name: str, values: Mapping[str, str]) -> None:
        from mcap.records import Metadata, MetadataIndex  # noqa: PLC0415 - an extra

        record = _written(Metadata(name, dict(values)))
        index = MetadataIndex(self._output.count, len(record), name)
        self._output.write(record)
        self._note(_written(index))

    def flush(self) -> None:
        """Write the chunk that has been begun, where there is a message in it."""
        from mcap.records import ChunkIndex  # noqa: PLC0415 - an extra

        if not self._index:
            return
        data, indexes = self._chunk, self._index
        start = min(min(index[::2]) for index in indexes.values())
        end = max(max(index[::2]) for index in indexes.values())
        packed = self._compress(data)
        kind = self._compression.encode()
        tail = struct.pack(f"<I{len(kind)}sQ", len(kind), kind, len(packed))
        octets = _CHUNK.size - HEAD.size + len(tail) + len(packed)
        head = _CHUNK.pack(_OF_CHUNK, octets, start, end, len(data), zlib.crc32(data)) + tail
        at, length = self._output.count, len(head) + len(packed)
        offsets, records, place = {}, [], at + length
        for channel, index in indexes.items():
            content = struct.pack(f"<{len(index)}Q", *index)
            record = _INDEX.pack(_OF_INDEX, 6 + len(content), channel, len(content)) + content
            offsets[channel] = place
            place += len(record)
            records.append(record)
        self._output.write(head, packed, *records)
        self._chunk, self._index = bytearray(), {}
        for channel, index in indexes.items():
            self._counts[channel] = self._counts.get(channel, 0) + len(index) // 2
        first, last = self._times or (start, end)
        self._times = min(first, start), max(last, end)
        self._note(
            _written(
                ChunkIndex(
                    chunk_start_offset=at,
                    chunk_length=length,
                    message_start_time=start,
                    message_end_time=end,
                    message_index_offsets=offsets,
                    message_index_length=place - at - length,
                    compression=self._compression,
                    compressed_size=len(packed),
                    uncompressed_size=len(data),
                )
            )
        )

    def finish(self) -> None:
        """Write what waits and the index, and close it."""
        from mcap.opcode import Opcode  # noqa: PLC0415 - an extra
        from mcap.records import DataEnd, Statistics, SummaryOffset  # noqa: PLC0415 - an extra

        self.flush()
        self._output.write(_written(DataEnd(0)))
        start, end = self._times or (0, 0)
        statistics = Statistics(
            attachment_count=self._numbers.get(Opcode.ATTACHMENT_INDEX, 0),
            channel_count=len(self._channels),
            channel_message_counts=self._counts,
            chunk_count=self._numbers.get(Opcode.CHUNK_INDEX, 0),
            message_count=sum(self._counts.values()),
            message_start_time=start,
            message_end_time=end,
            metadata_count=self._numbers.get(Opcode.METADATA_INDEX, 0),
            schema_count=len(self._channels),
        )
        groups: dict[int, bytes | bytearray] = {
            Opcode.SCHEMA: b"".join(self._definitions[::2]),
            Opcode.CHANNEL: b"".join(self._definitions[1::2]),
            Opcode.STATISTICS: _written(statistics),
            **self._indexes,
        }
        begin = place = self._output.count
        offsets = b""
        for opcode, group in groups.items():
            if group:
                offsets += _written(SummaryOffset(opcode, place, len(group)))
                place += len(group)
        summary = b"".join((*groups.values(), offsets))
        footer = _FOOTER.pack(_OF_FOOTER, 20, begin, place)
        crc = zlib.crc32(footer, zlib.crc32(summary))
        self._output.write(summary, footer, crc.to_bytes(4, "little"), MAGIC)
        self._output.close()

    def unwritten(self, form: ChannelForm) -> int:
        """Return how many messages of a channel wait in the chunk."""
        return len(self._index.get(self._channels.get(form, 0), ())) // 2

    def abandon(self) -> None:
        """Close it as it is, without what is not whole."""
        self._index, self._chunk = {}, bytearray()
        try:
            self._output.take_back()
        finally:
            self._output.close()

    def _note(self, index: bytes) -> None:
        """Keep what the summary has of something that was written."""
        opcode = index[0]
        self._indexes.setdefault(opcode, bytearray()).extend(index)
        self._numbers[opcode] = self._numbers.get(opcode, 0) + 1


@frozen
class KeptMessage:
    """A message in the ring, in the form of the file."""

    form: ChannelForm
    at: Instant
    data: bytes
    sequence: int


class Ring:
    """The last seconds of a recording, in the form of the file; for one thread.

    Args:
        octets: that are kept at most, with what each message costs beside its own.
    """

    def __init__(self, seconds: float, octets: int) -> None:
        self._nanoseconds, self._most = int(seconds * 1e9), octets
        self._kept: deque[KeptMessage] = deque()
        self._octets = 0

    def __iter__(self) -> Iterator[KeptMessage]:
        return iter(self._kept)

    def has_other_than(self, form: ChannelForm) -> bool:
        """Say whether there is a message of another channel."""
        return any(kept.form is not form for kept in self._kept)

    def keep(self, kept: KeptMessage) -> None:
        """Take in what came last."""
        self._kept.append(kept)
        self._octets += _KEPT_OCTETS + len(kept.data)

    def trim(self, now: Instant) -> None:
        """Let go of what is too old or too much."""
        oldest, kept = now.steady - self._nanoseconds, self._kept
        while kept and (kept[0].at.steady < oldest or self._octets > self._most):
            self._octets -= _KEPT_OCTETS + len(kept.popleft().data)

    def clear(self) -> None:
        """Let go of everything."""
        self._kept.clear()
        self._octets = 0


def _written(record: McapRecord) -> bytes:
    from mcap.data_stream import RecordBuilder  # noqa: PLC0415 - an extra

    builder = RecordBuilder()
    record.write(builder)
    return bytes(builder.end())  # type: ignore[no-untyped-call]  # of mcap


def _compressor(compression: str) -> Callable[[bytearray], bytes | bytearray]:
    if compression == "zstd":
        import zstandard  # noqa: PLC0415 - of the extra

        return zstandard.ZstdCompressor(level=_FAST).compress
    if compression == "lz4":
        import lz4.frame  # noqa: PLC0415 - of the extra

        compress: Callable[[bytearray], bytes | bytearray] = lz4.frame.compress
        return compress
    return lambda data: data


_MOST_LOCK = 16 << 20


def documents(robot: Robot, plans: Mapping[str, Plan]) -> Iterator[tuple[str, bytes]]:
    """Yield the attachments of a file: name and content, JSON all of them.

    Args:
        robot: the configuration in force.
        plans: by the function that is recorded.
    """
    yield "configuration.json", _attachment(to_json(evolve(robot, text="")))
    for function, plan in plans.items():
        yield f"plan-{function}.json", _attachment(to_json(plan))
    if robot.origin:
        lock = lock_path(robot.origin)
        with suppress(UnreadableFileError):  # as a rule there is none
            yield lock.name, read_octets(lock, _MOST_LOCK)


def event_message(event: StatusEvent) -> dict[str, Any]:
    """Return what the channel of events has of a status event."""
    message: dict[str, Any] = without_secrets(to_json(event))
    return message


def gap_message(function: str, connection: str, gap: Any) -> dict[str, Any]:
    """Return what the channel of events has of a gap between two plans."""
    return {
        "subject": f"connection {connection}",
        "change": "gap",
        "cause": gap.cause,
        "function": function,
        "gap": without_secrets(to_json(gap)),
    }


def _attachment(value: Any) -> bytes:
    return write_json(without_secrets(value), indent=1).encode()
