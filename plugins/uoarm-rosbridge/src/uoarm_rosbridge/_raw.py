"""Publish messages of `compression: cbor-raw`: the message serialised, beside the time."""

from __future__ import annotations

import struct
from collections.abc import Callable

from uoarm.model import Message, MessageStructure
from uoarm.server.front_end import write_binary
from uoarm_rosbridge._cdr import Part, serialiser
from uoarm_rosbridge._wire import clock_now

__all__ = ["RawWriter"]

_head = struct.Struct(">BI").pack
_BYTE_STRING = 0x5A  # of CBOR, behind which its length is told in four octets


class RawWriter:
    """Writes a topic's messages for those who read the serialised form themselves.

    Args:
        topic: as the client named it.
        structure: tells what the messages are like now; a takeover may change it.
    """

    def __init__(self, topic: str, structure: Callable[[], MessageStructure]) -> None:
        self._topic = topic
        self._structure = structure
        self._known: MessageStructure | None = None
        self._serialise: Callable[[Message], list[Part]] | None = None

    def __call__(self, message: Message) -> bytes:
        """Return a publish message.

        Raises:
            MessageError: the message does not fit, or its structure has no fixed layout.
        """
        seconds, nanoseconds = clock_now()
        parts = self.prepare()(message)
        raw = {"secs": seconds, "nsecs": nanoseconds, "bytes": b""}
        before = write_binary({"op": "publish", "topic": self._topic, "msg": raw})
        length = sum(memoryview(part).nbytes for part in parts)
        return b"".join((before[:-1], _head(_BYTE_STRING, length), *parts))

    def prepare(self) -> Callable[[Message], list[Part]]:
        """Read the structure, unless it is known, and return what serialises its messages.

        Raises:
            MessageError: the structure has no fixed layout.
        """
        structure = self._structure()
        if self._serialise is None or structure is not self._known:
            self._serialise = serialiser(structure)
            self._known = structure
        return self._serialise
