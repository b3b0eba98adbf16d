"""Octets of MCAP: records and what is in them, each length held against what is there."""

from __future__ import annotations

import struct
from collections.abc import Iterator
from typing import BinaryIO

MAGIC = b"\x89MCAP0\r\n"
HEAD = struct.Struct("<BQ")
MESSAGE = struct.Struct("<HIQQ")
MESSAGE_RECORD = 5
MOST_RECORD = 268_435_456


class DamageError(Exception):
    """Something that cannot be read; the text says what."""


def unpacked(compression: str, packed: bytes, size: int) -> bytes:
    """Return what was compressed; takes no more memory than for the size that is stated."""
    if compression == "":
        return packed
    if compression == "zstd":
        import zstandard  # noqa: PLC0415 - of the extra

        stated = zstandard.frame_content_size(packed)
        if stated > size:
            raise DamageError(f"has {stated:,} octets, not {size:,}")
        return zstandard.ZstdDecompressor().decompress(packed, max_output_size=size)
    if compression == "lz4":
        from lz4.frame import LZ4FrameDecompressor  # noqa: PLC0415 - of the extra

        data: bytes = LZ4FrameDecompressor().decompress(packed, max_length=size + 1)
        return data
    raise DamageError(f"is compressed by {compression[:40]!r}, which is not known")


def inner_records(data: memoryview, where: int) -> Iterator[tuple[int, memoryview]]:
    """Yield opcode and content of the records of a chunk."""
    at, end = 0, len(data)
    while at < end:
        if end - at < HEAD.size:
            raise DamageError(f"the chunk at {where:,} ends within a record")
        opcode, octets = HEAD.unpack_from(data, at)
        at += HEAD.size
        least = MESSAGE.size if opcode == MESSAGE_RECORD else 0
        if not least <= octets <= end - at:
            raise DamageError(f"the chunk at {where:,} has a record of {octets:,} octets")
        yield opcode, data[at : at + octets]
        at += octets


def read_content(file: BinaryIO, place: int, octets: int) -> bytes:
    if octets > MOST_RECORD:
        raise DamageError(f"a record at {place:,} has {octets:,} octets; {MOST_RECORD:,} are read")
    file.seek(place)
    content = file.read(octets)
    if len(content) < octets:
        raise DamageError(f"the record at {place:,} is cut short")
    return content


class RecordContent:
    """The content of one record, from its front on; raises DamageError where it is too short."""

    def __init__(self, content: bytes) -> None:
        self._content, self._at = content, 0

    @property
    def is_over(self) -> bool:
        return self._at >= len(self._content)

    def take(self, octets: int) -> bytes:
        taken = self._content[self._at : self._at + octets]
        if len(taken) < octets:
            raise DamageError("a record states more octets than it has")
        self._at += octets
        return taken

    def number(self, octets: int) -> int:
        return int.from_bytes(self.take(octets), "little")

    def octets(self, prefix: int) -> bytes:
        return self.take(self.number(prefix))

    def text(self) -> str:
        return self.octets(4).decode("utf-8", "replace")
