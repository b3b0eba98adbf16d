"""One layout in both directions, and from which octets a message was read.

A bridge notes those octets around the delivery of a message; a recorder that takes that very
message, as the same object, in the same thread, writes them. What was adapted, or came through a
queue or another process, is another object: nothing is known of it, and it is serialised.
"""

from __future__ import annotations

import struct
import threading
from collections.abc import Callable, Sequence
from typing import Any

from uoarm._raised import contained, foreign, text_of
from uoarm.cdr._layout import DDS, NATIVE, ROS_1, ByteOrder, Encoding, Layout, layout_of
from uoarm.cdr._reading import reader
from uoarm.cdr._source import explain
from uoarm.cdr._values import UnfitValue
from uoarm.cdr._writing import HEADERS, Part, writer
from uoarm.errors import MessageError
from uoarm.model import Budget, Message, MessageStructure

_ORDERS: dict[bytes, ByteOrder] = {header[:2]: order for order, header in HEADERS.items()}
_PLAIN = Budget()
_HEADER = 2  # octets that say the byte order; the two behind them say nothing


class Codec:
    """Serialises the messages of one structure, and reads them; used from any thread.

    What is generated for a layout is generated once, when it is first needed.

    Args:
        structure: of the messages; every member is required, and no other is allowed.
        encoding: `DDS`, `CORBA`, `ROS_1`, or another of its kind.
        budget: of octets and of the elements of lists in one message; None: a list has no more
            elements than there are octets.
        name: of the type, in the texts of errors; empty: as the structure says.

    Raises:
        MessageError: the structure has no fixed layout; the text names the member.
    """

    def __init__(
        self,
        structure: MessageStructure,
        encoding: Encoding = DDS,
        budget: Budget | None = None,
        *,
        name: str = "",
    ) -> None:
        self.name = name or structure.native_type or "the message"
        self.encoding = encoding
        self._layout: Layout = layout_of(structure.schema, encoding)
        self._budget = budget
        self._is_encapsulated = encoding.is_encapsulated
        self._writers: dict[ByteOrder, Callable[[Message], Sequence[Part]]] = {}
        # By byte order, or by the octets of the header that say it.
        self._readers: dict[Any, Callable[[Any], Message]] = {}

    def encode(self, message: Message, order: ByteOrder = NATIVE) -> bytes:
        """Return a message serialised, header first where there is one; padding is zero.

        Raises:
            MessageError: the message does not fit, with the path of the member.
        """
        return b"".join(self.encode_parts(message, order))

    def encode_parts(self, message: Message, order: ByteOrder = NATIVE) -> Sequence[Part]:
        """Return what `encode` joins.

        Join it at once: parts may be the message's own memory.

        Raises:
            MessageError: the message does not fit, with the path of the member.
        """
        write = self._writers.get(order)
        if write is None:
            write = self._writers[order] = writer(self._layout, self.encoding, order)
        try:
            return write(message)
        except BaseException as error:  # of a value's own methods, or of one that changes meanwhile
            raised = contained(error)
            try:
                why = foreign(explain, error)
            except Exception:  # noqa: BLE001 - looked at again, it raises
                why = text_of(raised)
            raise MessageError(f"{self.name}: {why}") from error

    def decode(self, octets: bytes | bytearray | memoryview, order: ByteOrder = NATIVE) -> Message:
        """Return the message in octets, which end where the message does.

        Behind an encapsulated one there may be others, as Fast DDS leaves them.

        Arrays of numbers are read-only views into `octets` where their byte order is the machine's.

        Args:
            octets: not changed as long as the message is in use.
            order: of the octets of a number; where a header says it, that counts.

        Raises:
            MessageError: they hold no message of this structure, or more than the budget allows.
        """
        key: Any = octets[:_HEADER] if self._is_encapsulated else order
        if type(octets) is not bytes:
            octets = memoryview(octets).toreadonly()
            key = bytes(key) if self._is_encapsulated else order
        try:
            return self._readers[key](octets)
        except KeyError:
            self._readers[key] = self._new_reader(key)
        except (UnfitValue, struct.error, ValueError) as error:
            why = explain(error, f"it is cut short after {len(octets):,} octets")
            raise MessageError(f"{self.name}: cannot be read: {why}") from error
        return self.decode(octets, order)

    def _new_reader(self, key: Any) -> Callable[[Any], Message]:
        order = _ORDERS.get(key) if self._is_encapsulated else key
        if order is None:
            text = f"{self.name}: serialised in an unknown way, {key!r} is no header of plain CDR"
            raise MessageError(text)
        return reader(self._layout, self.encoding, order, self._budget)


def serialiser(structure: MessageStructure) -> Callable[[Message], Sequence[Part]]:
    """Return the function that serialises messages of a structure for ROS 2, as parts to join."""
    return Codec(structure).encode_parts


def deserialiser(
    structure: MessageStructure, *, budget: Budget = _PLAIN, is_packed: bool = False
) -> Callable[[bytes | bytearray | memoryview], Message]:
    """Return the function that makes messages of octets of ROS 2, or of ROS 1, which packs them."""
    return Codec(structure, ROS_1 if is_packed else DDS, budget).decode


_LITTLE_ENDIAN = b"\0\1"  # plain CDR, as everything here is written


class _LastWritten(threading.local):
    message: Message = None
    octets: bytes = b""
    definition: str = ""


_noted = _LastWritten()


def note_octets(message: Message, octets: bytes, definition: str) -> None:
    """Note of which octets, header first, a message was read that is about to be delivered.

    Args:
        message: that was read.
        octets: as ROS 2 serialises it.
        definition: the text of its type, as `definition_of` gives it.
    """
    _noted.message, _noted.octets, _noted.definition = message, octets, definition


def forget_octets() -> None:
    """Note that it was delivered."""
    _noted.message, _noted.octets = None, b""


def octets_of(message: Message, definition: str) -> bytes | None:
    """Return the octets of which a message of a type was read; None: they are not known here."""
    noted = _noted
    if (
        noted.message is message
        and message is not None
        and noted.definition == definition
        and noted.octets.startswith(_LITTLE_ENDIAN)
    ):
        return noted.octets
    return None
