"""One MCAP file that is being written: whole up to the last chunk, whatever happens to it then."""

from __future__ import annotations

import io
import os
from collections.abc import Mapping
from itertools import count
from pathlib import Path
from typing import IO, TYPE_CHECKING, cast

from uoarm._origin import install_command
from uoarm._version import __version__
from uoarm.errors import PluginError, UsageError
from uoarm.record._forms import ChannelForm

if TYPE_CHECKING:
    from _typeshed import ReadableBuffer

__all__ = ["McapFile", "free_path", "require_mcap"]

_MESSAGE_OCTETS = 31  # of a message's record beside its data


def require_mcap() -> None:
    """Raise PluginError, with what to do, where the packages of the extra are not here."""
    try:
        import mcap.writer  # noqa: F401, PLC0415 - an extra

        import uoarm._wire  # noqa: F401, PLC0415 - needs the extra's packages
    except ImportError as error:
        command = install_command("uoarm", "record")
        raise PluginError(f"recordings need: {command} ({error})") from error


def free_path(path: Path) -> Path:
    """Return a path at which nothing is yet: this one, or it with the first number that is free."""
    if not path.exists():
        return path
    for number in count(1):
        numbered = path.with_name(f"{path.stem}-{number}{path.suffix}")
        if not numbered.exists():
            return numbered
    raise AssertionError("numbers do not end")


class _Output(io.BufferedIOBase):
    """The file as the writer of MCAP sees it: nothing is kept back, and what is whole is known.

    A chunk that did not find room is taken back, so that the file ends with a whole record.

    Attributes:
        count: octets written.
        whole: octets up to the end of the last whole record.
    """

    def __init__(self, path: Path) -> None:
        self._file = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_CLOEXEC, 0o666)
        self.count = self.whole = 0

    def write(self, octets: ReadableBuffer) -> int:
        rest = memoryview(octets)
        size = len(rest)
        while rest:
            written = os.write(self._file, rest)
            self.count += written
            rest = rest[written:]
        return size

    def seek(self, offset: int, whence: int = os.SEEK_SET) -> int:
        """Return where it is, which is at its end: nothing goes anywhere else."""
        if (offset, whence) != (0, os.SEEK_CUR):
            raise io.UnsupportedOperation("only appended to")
        return self.count

    def close(self) -> None:
        if not self.closed:
            super().close()
            os.close(self._file)

    def take_back(self) -> None:
        """Cut off what is not whole."""
        if self.count > self.whole:
            os.ftruncate(self._file, self.whole)
            self.count = self.whole


class McapFile:
    """One file, for one thread.

    Args:
        path: at which nothing is.
        compression: `zstd`, `lz4` or `none`.
        chunk_octets: of messages that are written at once.

    Raises:
        UsageError: it cannot be made.
    """

    def __init__(self, path: Path, compression: str, chunk_octets: int) -> None:
        from mcap.writer import CompressionType, Writer  # noqa: PLC0415 - an extra

        self.path = path
        try:
            self._output = _Output(path)
        except OSError as error:
            raise UsageError(f"{path} cannot be made: {error}") from error
        self._writer = Writer(
            cast("IO[bytes]", self._output),
            chunk_size=chunk_octets,
            compression=CompressionType[compression.upper()],
        )
        self._channels: dict[ChannelForm, int] = {}
        self._waiting = 0

    def begin(self, profile: str) -> None:
        """Write what stands before all else; `ros2` where every channel is one of ROS 2."""
        self._writer.start(profile, f"uoarm {__version__}")
        self._mark()

    @property
    def octets(self) -> int:
        """What it holds, with what waits to be written."""
        return self._output.count + self._waiting

    @property
    def has_channels(self) -> bool:
        """Whether channels were added."""
        return bool(self._channels)

    @property
    def has_waiting(self) -> bool:
        """Whether a chunk has been begun."""
        return self._waiting > 0

    def add_channel(self, form: ChannelForm) -> None:
        """Add a channel, and its schema."""
        schema = self._writer.register_schema(
            form.schema_name, form.schema_encoding, form.schema_data
        )
        metadata = dict(form.metadata)
        self._channels[form] = self._writer.register_channel(
            form.topic, form.message_encoding, schema, metadata
        )

    def add_message(self, form: ChannelForm, time: int, data: bytes, sequence: int) -> None:
        """Add a message to the chunk that is being filled, which is written when it is full."""
        before = self._output.count
        self._writer.add_message(self._channels[form], time, data, time, sequence & 0xFFFFFFFF)
        if self._output.count > before:
            self._mark()
        else:
            self._waiting += _MESSAGE_OCTETS + len(data)

    def attach(self, name: str, content: bytes, media_type: str, time: int) -> None:
        """Add an attachment."""
        self._writer.add_attachment(time, time, name, media_type, content)
        self._output.whole = self._output.count

    def add_metadata(self, name: str, values: Mapping[str, str]) -> None:
        """Add metadata."""
        self._writer.add_metadata(name, dict(values))
        self._output.whole = self._output.count

    def flush(self) -> None:
        """Write the chunk that has been begun."""
        self._writer.flush()  # type: ignore[no-untyped-call]  # of mcap
        self._mark()

    def finish(self) -> None:
        """Write what waits and the index, and close it."""
        self._writer.finish()  # type: ignore[no-untyped-call]  # of mcap
        self._mark()
        self._output.close()

    def abandon(self) -> None:
        """Close it as it is, without what is not whole."""
        try:
            self._output.take_back()
        finally:
            self._output.close()

    def _mark(self) -> None:
        self._output.whole = self._output.count
        self._waiting = 0
