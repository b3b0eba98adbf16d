"""Files that are broken on purpose: memory stays bounded, and what can be read is read."""

from __future__ import annotations

import struct
from pathlib import Path

import pytest
import zstandard

from uoarm.record import _reading
from uoarm.record._reading import McapReader
from uoarm.record._records import MAGIC


def text(value: str | bytes) -> bytes:
    octets = value.encode() if isinstance(value, str) else value
    return struct.pack("<I", len(octets)) + octets


def record(opcode: int, content: bytes) -> bytes:
    return struct.pack("<BQ", opcode, len(content)) + content


def channel(number: int, topic: str, metadata: bytes = b"") -> bytes:
    content = struct.pack("<HH", number, 0) + text(topic) + text("json") + text(metadata)
    return record(4, content)


def message(number: int, time: int, data: bytes = b"1") -> bytes:
    return record(5, struct.pack("<HIQQ", number, 0, time, time) + data)


def chunk(records: bytes) -> bytes:
    packed = zstandard.ZstdCompressor().compress(records)
    head = struct.pack("<QQQI", 0, 0, len(records), 0) + text("zstd")
    return record(6, head + struct.pack("<Q", len(packed)) + packed)


def hostile(path: Path, *records: bytes) -> McapReader:
    octets = b"".join((MAGIC, record(1, text("") + text("")), *records, record(15, bytes(4))))
    path.write_bytes(octets)
    return McapReader(path)


def times(reader: McapReader, topic: str, damages: list[str] | None = None) -> list[int]:
    note = pytest.fail if damages is None else damages.append
    return [message.time for message in reader.messages(topic, 0, note)]


def test_a_small_file_takes_little_memory_whatever_is_in_its_chunks(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(_reading, "_MOST_MESSAGES", 1000)
    monkeypatch.setattr(_reading, "_KEPT_OCTETS", 2_000_000)
    many = b"".join(message(1, 5, b"") for _ in range(5000))
    reader = hostile(tmp_path / "x.mcap", *(chunk(channel(1, "/x") + many) for _ in range(8)))
    damages: list[str] = []
    assert len(times(reader, "/x", damages)) == 8 * 1000
    assert all("more records than are read: 1,000" in damage for damage in damages)
    # Each message costs more than its data, of which there is none here.
    kept = reader._cache._kept.values()
    assert sum(loaded.octets for loaded in kept) > 1000 * len(kept) * 200


def test_definitions_have_a_budget_and_leave_the_rest_readable(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(_reading, "_MOST_DEFINITIONS", 100_000)

    def schema(number: int) -> bytes:
        stated = text("S") + text("jsonschema") + text(bytes(60_000))
        return record(3, struct.pack("<H", number) + stated)

    reader = hostile(
        tmp_path / "x.mcap",
        chunk(channel(1, "/x") + message(1, 5)),
        *(chunk(schema(number)) for number in range(1, 50)),
        chunk(channel(1, "/x") + message(1, 6)),
    )
    assert len(reader._schemas) == 1
    assert times(reader, "/x") == [5, 6]
    assert reader.notes == [
        "its schemas and channels have more than 100,000 octets: the rest of them is left out"
    ]


def test_a_broken_definition_costs_itself_only(tmp_path: Path) -> None:
    entries = b"".join(text(f"key{number}") + text("") for number in range(2000))
    reader = hostile(
        tmp_path / "x.mcap",
        chunk(
            channel(1, "/x")
            + message(1, 5)
            + record(4, b"zz")
            + channel(2, "/many", entries)
            + channel(1, "/other")
            + message(1, 6)
        ),
    )
    assert list(reader.channels) == ["/x"]
    assert times(reader, "/x") == [5, 6]
    notes = " | ".join(reader.notes)
    assert "/many has more than 1,000 metadata" in notes
    assert "channel 1 is stated anew" in notes


def test_as_many_channels_as_numbers_are_read(tmp_path: Path) -> None:
    channels = b"".join(channel(number, f"/c{number}") for number in range(1, 2**16))
    reader = hostile(tmp_path / "x.mcap", chunk(channels + message(2**16 - 1, 7)))
    assert len(reader.channels) == 2**16 - 1
    assert times(reader, "/c65535") == [7]
    assert reader.notes == []
