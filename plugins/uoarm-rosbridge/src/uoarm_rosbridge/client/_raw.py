"""Messages as ROS itself serialises them, as `cbor-raw` brings them: read by their types.

ROS 1 packs everything, little-endian. ROS 2 has CDR, version 1 of its plain encoding: an
encapsulation header, then each number at a multiple of its size. What enters has a budget: no array
is made of more elements than its octets, and the budget, hold.
"""

from __future__ import annotations

import struct
from collections.abc import Callable
from functools import lru_cache
from typing import Any

import numpy as np
from attrs import define

from uoarm.errors import MessageError
from uoarm.model import Message
from uoarm_rosbridge.client._types import FORMATS, ArrayOf, Primitive, RosShape, RosType

__all__ = ["raw_reader"]

_HEADER = 4
_ENDIAN = {b"\0\0": ">", b"\0\1": "<"}
_MOST_PADDING = 3
_CHARACTER = 4  # octets of a character of a wide text, as Fast CDR writes it


@define
class _Frame:
    """What is read of one message.

    Attributes:
        octets: without the header.
        order: of octets, as `struct` says it.
        left: elements of arrays that may still be made.
    """

    octets: memoryview
    order: str
    left: int


_Part = Callable[[_Frame, int], tuple[Any, int]]


def raw_reader(made: RosType, elements: int) -> Callable[[Any], Message]:
    """Return the function that makes a message of what `cbor-raw` brought.

    It raises MessageError for what is cut short, too long, of another encoding, or holds more
    elements of arrays than `elements`.
    """
    part, is_packed, name = _part(made, is_packed=made.is_of_ros_1), made.is_of_ros_1, made.name
    padding = 0 if is_packed else _MOST_PADDING

    def read(came: Any) -> Message:
        octets = came.get("bytes") if isinstance(came, dict) else None
        if not isinstance(octets, bytes | bytearray | memoryview):
            raise MessageError(
                f"{name}: expected the octets of cbor-raw, got {type(came).__name__}"
            )
        frame = _Frame(memoryview(octets), "<", elements)
        if not is_packed:
            order = _ENDIAN.get(bytes(octets[:2]))
            if order is None or len(octets) < _HEADER:
                raise MessageError(f"{name}: {bytes(octets[:4])!r} is no header of plain CDR")
            frame = _Frame(frame.octets[_HEADER:], order, elements)
        try:
            message, end = part(frame, 0)
        except (struct.error, ValueError) as error:
            raise MessageError(f"{name}: cannot be read: {error}") from error
        if not 0 <= len(frame.octets) - end <= padding:
            raise MessageError(f"{name}: {len(frame.octets):,} octets came, {end:,} were expected")
        return message

    return read


@lru_cache(maxsize=1024)
def _part(shape: RosShape, *, is_packed: bool) -> _Part:
    """Return the function that reads a value from an offset on, and where it ends."""
    if isinstance(shape, RosType):
        return _record(shape, is_packed=is_packed)
    if isinstance(shape, ArrayOf):
        return _array(shape, is_packed=is_packed)
    if shape.kind == "string":
        return _wide_text if shape.is_wide else _text(is_packed=is_packed)
    return _number("?" if shape.kind == "bool" else FORMATS[shape.kind], is_packed=is_packed)


def _record(shape: RosType, *, is_packed: bool) -> _Part:
    parts = [(name, _part(inner, is_packed=is_packed)) for name, inner in shape.fields.items()]

    def read(frame: _Frame, at: int) -> tuple[Any, int]:
        message = {}
        for name, part in parts:
            message[name], at = part(frame, at)
        # A type without fields has one octet in ROS 2.
        return message, at + (not parts and not is_packed)

    return read


def _number(code: str, *, is_packed: bool) -> _Part:
    formats = {order: struct.Struct(order + code) for order in "<>"}
    size = formats["<"].size

    def read(frame: _Frame, at: int) -> tuple[Any, int]:
        if not is_packed:
            at = -(-at // size) * size
        return formats[frame.order].unpack_from(frame.octets, at)[0], at + size

    return read


@lru_cache(maxsize=2)
def _length(*, is_packed: bool) -> _Part:
    return _number("I", is_packed=is_packed)


def _text(*, is_packed: bool) -> _Part:
    length = _length(is_packed=is_packed)

    def read(frame: _Frame, at: int) -> tuple[Any, int]:
        size, at = length(frame, at)
        octets = _taken(frame, at, size)
        if not is_packed:  # its last octet is a zero
            octets = octets[: max(0, size - 1)]
        return bytes(octets).decode(errors="replace"), at + size

    return read


def _wide_text(frame: _Frame, at: int) -> tuple[Any, int]:
    count, at = _length(is_packed=False)(frame, at)
    octets = _taken(frame, at, count * _CHARACTER)
    units = np.frombuffer(octets, f"{frame.order}u{_CHARACTER}").astype("<u2")
    return units.tobytes().decode("utf-16-le", errors="replace"), at + len(octets)


def _array(shape: ArrayOf, *, is_packed: bool) -> _Part:
    length, element, fixed = _length(is_packed=is_packed), shape.element, shape.size
    is_numeric = isinstance(element, Primitive) and element.kind in FORMATS
    code = FORMATS[element.kind] if is_numeric and isinstance(element, Primitive) else ""
    size, part = struct.calcsize(f"<{code}"), _part(element, is_packed=is_packed)

    def read(frame: _Frame, at: int) -> tuple[Any, int]:
        count = fixed
        if count is None:
            count, at = length(frame, at)
        if code:
            if count and not is_packed:
                at = -(-at // size) * size
            octets = _taken(frame, at, count * size)
            if code == "B":
                return bytes(octets), at + len(octets)
            numbers = np.frombuffer(octets, np.dtype(f"{frame.order}{code}"))
            return numbers.astype(numbers.dtype.newbyteorder("="), copy=False), at + len(octets)
        frame.left -= count
        if frame.left < 0 or count > len(frame.octets):
            raise ValueError(f"an array of {count:,} elements is longer than the budget")
        items = []
        for _ in range(count):
            item, at = part(frame, at)
            items.append(item)
        return items, at

    return read


def _taken(frame: _Frame, at: int, size: int) -> memoryview:
    if at + size > len(frame.octets):
        raise ValueError(f"{size:,} octets from {at:,} on, and {len(frame.octets):,} there are")
    return frame.octets[at : at + size]
