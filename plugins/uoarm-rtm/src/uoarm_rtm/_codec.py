"""One IDL type in both directions: messages to CDR and back, in either byte order."""

from __future__ import annotations

import struct
from collections.abc import Callable
from functools import lru_cache

from uoarm.errors import MessageError
from uoarm.model import Message
from uoarm_rtm._explain import ExplainCursor, fit, read_slowly
from uoarm_rtm._read import reader
from uoarm_rtm._scalars import IdlMismatch, Order
from uoarm_rtm._shape import Shape
from uoarm_rtm._write import writer

__all__ = ["BIG", "LITTLE", "CdrCodec", "codec_of"]

LITTLE: Order = "<"
BIG: Order = ">"

_UNFIT = (IdlMismatch, KeyError, IndexError, TypeError, ValueError, AttributeError, OverflowError)


class CdrCodec:
    """Marshals the messages of one type; made once a type, used from any thread.

    CDR here is what OpenRTM's data ports carry: the body alone, aligned from its first byte.

    Args:
        shape: the type.
        encoding: of narrow strings, `utf-8` or `latin-1`.
        name: what errors call the type.
    """

    def __init__(self, shape: Shape, encoding: str, name: str) -> None:
        self.shape = shape
        self._encoding = encoding
        self.name = name
        self._writers: dict[Order, Callable[[Message], bytes]] = {}
        self._readers: dict[Order, Callable[[bytes], Message]] = {}

    def encode(self, message: Message, order: Order = LITTLE) -> bytes:
        """Return the CDR of a message; padding is zero.

        Raises:
            MessageError: the message does not fit, with the path of the field.
        """
        write = self._writers.get(order)
        if write is None:
            write = self._writers[order] = writer(self.shape, order, self._encoding)
        try:
            return write(message)
        except (*_UNFIT, struct.error) as error:
            raise self._unfit(message, error) from None

    def decode(self, data: bytes, order: Order = LITTLE) -> Message:
        """Return the message in a buffer, which must end where the message does.

        Arrays of numbers are read-only views into `data` where its order is the machine's.

        Raises:
            MessageError: the buffer does not hold this type, with the path of the field.
        """
        read = self._readers.get(order)
        if read is None:
            read = self._readers[order] = reader(self.shape, order, self._encoding)
        try:
            return read(data)
        except (IdlMismatch, struct.error) as error:
            raise self._unreadable(data, order, error) from None

    def _unfit(self, message: Message, error: Exception) -> MessageError:
        try:
            fit(self.shape, message, self._encoding)
        except IdlMismatch as misfit:
            return MessageError(f"message of type {self.name}: {misfit}")
        return MessageError(f"message of type {self.name} does not fit: {error!r}")

    def _unreadable(self, data: bytes, order: Order, error: Exception) -> MessageError:
        kind = "little" if order == LITTLE else "big"
        what = f"{len(data)} bytes received as {self.name} ({kind}-endian) are something else"
        cursor = ExplainCursor(data, order, self._encoding)
        try:
            read_slowly(self.shape, cursor)
        except IdlMismatch as misfit:
            return MessageError(f"{what}: {misfit}")
        if cursor.at != len(data):
            return MessageError(f"{what}: the message ends after {cursor.at} bytes")
        return MessageError(f"{what}: {error}")


@lru_cache(maxsize=1024)
def codec_of(shape: Shape, encoding: str = "utf-8") -> CdrCodec:
    """Return the codec of a type, made once."""
    return CdrCodec(shape, encoding, getattr(shape, "name", type(shape).__name__))
