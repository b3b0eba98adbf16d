"""Messages as CBOR (RFC 8949) with typed arrays (RFC 8746): octets and numbers stay buffers."""

from __future__ import annotations

import struct
import sys
from array import array
from collections.abc import Callable, Mapping
from io import BytesIO
from typing import Any

import cbor2

from uoarm.errors import ControlMessageError, MessageError
from uoarm.model import Message

__all__ = ["read_binary", "write_binary"]

_LARGE = 4096
_MAX_BITS = 3072
_MULTIPLE_DIMENSIONS = 40
_HALF = {80: ">", 84: "<"}
# Tag to (typecode, big-endian): the numbers of RFC 8746, section 2.1, of sizes that `array` has.
_TYPED = {
    64: ("B", False), 65: ("H", True), 66: ("I", True), 67: ("Q", True), 68: ("B", False),
    69: ("H", False), 70: ("I", False), 71: ("Q", False), 72: ("b", False), 73: ("h", True),
    74: ("i", True), 75: ("q", True), 77: ("h", False), 78: ("i", False), 79: ("q", False),
    81: ("f", True), 82: ("d", True), 85: ("f", False), 86: ("d", False),
}  # fmt: skip
_LITTLE_TAGS = {
    ("u", 1): 64, ("u", 2): 69, ("u", 4): 70, ("u", 8): 71, ("i", 1): 72, ("i", 2): 77,
    ("i", 4): 78, ("i", 8): 79, ("f", 2): 84, ("f", 4): 85, ("f", 8): 86,
}  # fmt: skip
_KINDS = {"B": "u", "H": "u", "I": "u", "L": "u", "Q": "u", "f": "f", "d": "f"}
# Tags that the library would turn into dates, fractions, sets, references: no message has them.
_FOREIGN = (0, 1, 4, 5, 25, 28, 29, 30, 35, 36, 37, 52, 54, 100, 256, 258, 260, 261, 1004, 43000)


def write_binary(message: Message) -> bytes:
    """Return a message as CBOR.

    Raises:
        MessageError: a value in it has no form here; the text says which type.
    """
    try:
        if isinstance(message, dict) and _has_large(message):
            parts: list[Any] = []
            _write_parts(message, parts)
            return b"".join(parts)
        return _dumps(message)
    except (cbor2.CBOREncodeError, TypeError, ValueError, RecursionError) as error:
        raise MessageError(f"the message has no form as CBOR: {error}") from error


def read_binary(data: bytes, *, depth: int) -> Message:
    """Return the value that CBOR stands for; numeric arrays come as `array.array`.

    Raises:
        ControlMessageError: it is not CBOR, is nested deeper than `depth`, or holds a tag or a
            simple value that no message has.
    """
    stream = BytesIO(data)
    try:
        decoder = cbor2.CBORDecoder(
            stream,
            semantic_decoders=_DECODERS,
            max_depth=depth,
            allow_duplicate_keys=False,
            strict_hashable_types=True,
        )
        value = decoder.decode()
    except (cbor2.CBORError, ValueError, OverflowError, RecursionError) as error:
        cause = error.__cause__ if isinstance(error.__cause__, MessageError) else error
        raise ControlMessageError(f"not CBOR as messages have it: {str(cause)[:200]}") from error
    if stream.tell() != len(data):
        raise ControlMessageError(f"more follows the message of {stream.tell():,} bytes")
    _refuse_strange(value)
    return value


def _dumps(value: Any) -> bytes:
    return cbor2.dumps(value, encoders=_ENCODERS, default=_encode_other)


def _has_large(message: Mapping[str, Any]) -> bool:
    for value in message.values():
        if isinstance(value, bytes | bytearray | memoryview):
            if len(value) >= _LARGE:
                return True
        elif isinstance(value, dict) and _has_large(value):
            return True
    return False


def _write_parts(message: Mapping[str, Any], parts: list[Any]) -> None:
    """Write large buffers as they are, without the copies that the encoder makes."""
    parts.append(_head(5, len(message)))
    for key, value in message.items():
        parts.append(_dumps(key))
        if isinstance(value, bytes | bytearray | memoryview) and len(value) >= _LARGE:
            octets = value
            if isinstance(value, memoryview):
                octets = value.cast("B") if value.c_contiguous else value.tobytes()
            parts += (_head(2, len(octets)), octets)
        elif isinstance(value, dict):
            _write_parts(value, parts)
        else:
            parts.append(_dumps(value))


def _head(major: int, count: int) -> bytes:
    """Return the first bytes of an item: major type and length (RFC 8949, section 3)."""
    if count < 24:  # noqa: PLR2004 - the RFC's own bound for a length in the first byte
        return bytes([major << 5 | count])
    for more, size in ((24, 1), (25, 2), (26, 4)):
        if count < 1 << 8 * size:
            return bytes([major << 5 | more]) + count.to_bytes(size, "big")
    return bytes([major << 5 | 27]) + count.to_bytes(8, "big")


def _encode_octets(encoder: cbor2.CBOREncoder, value: Any) -> None:
    encoder.encode(value.tobytes())


def _encode_array(encoder: cbor2.CBOREncoder, value: array[Any]) -> None:
    kind = _KINDS.get(value.typecode, "i")
    _encode_typed(encoder, kind, value.itemsize, _little(value).tobytes())


def _encode_other(encoder: cbor2.CBOREncoder, value: Any) -> None:
    if not hasattr(value, "__array_interface__"):
        raise MessageError(f"a value of type {type(value).__name__}")
    if value.ndim == 0:
        encoder.encode(value.item())
    elif value.dtype == "uint8" and value.ndim == 1:
        encoder.encode(value.tobytes())
    elif (value.dtype.kind, value.dtype.itemsize) not in _LITTLE_TAGS:
        encoder.encode(value.tolist())
    elif value.ndim == 1:
        octets = value.astype(value.dtype.newbyteorder("<"), copy=False).tobytes()
        _encode_typed(encoder, value.dtype.kind, value.dtype.itemsize, octets)
    else:
        encoder.encode(cbor2.CBORTag(_MULTIPLE_DIMENSIONS, [list(value.shape), value.ravel()]))


def _encode_typed(encoder: cbor2.CBOREncoder, kind: str, size: int, octets: bytes) -> None:
    encoder.encode(cbor2.CBORTag(_LITTLE_TAGS[kind, size], octets))


def _little(value: array[Any]) -> array[Any]:
    if sys.byteorder == "big":
        value = value[:]
        value.byteswap()
    return value


def _typed_reader(typecode: str, *, big: bool) -> Callable[[Any, bool], array[Any]]:
    def read(octets: Any, immutable: bool) -> array[Any]:  # noqa: FBT001 - the library's signature
        del immutable
        numbers: array[Any] = array(typecode)
        numbers.frombytes(octets)
        if big != (sys.byteorder == "big"):
            numbers.byteswap()
        return numbers

    return read


def _half_reader(order: str) -> Callable[[Any, bool], list[float]]:
    def read(octets: Any, immutable: bool) -> list[float]:  # noqa: FBT001 - the library's signature
        del immutable
        return list(struct.unpack(f"{order}{len(octets) // 2}e", octets))

    return read


def _read_rows(value: Any, immutable: bool) -> Any:  # noqa: FBT001 - the library's signature
    """Return rows as lists of lists (RFC 8746, section 3.1.1)."""
    del immutable
    sizes, items = value
    count = 1
    for size in sizes:
        if type(size) is not int or size < 1:
            raise ValueError(f"dimensions {sizes!r}: expected positive integers")
        count *= size
    if count != len(items):
        raise ValueError(f"dimensions {sizes!r} do not hold {len(items)} items")
    for size in reversed(sizes[1:]):
        items = [list(items[at : at + size]) for at in range(0, len(items), size)]
    return items


def _refuse(value: Any, immutable: bool) -> Any:  # noqa: FBT001 - the library's signature
    del value, immutable
    raise MessageError("a tag that no message has")


def _refuse_strange(value: Any) -> None:
    """Refuse what CBOR knows and the JSON data model does not."""
    waiting = [value]
    while waiting:
        one = waiting.pop()
        if isinstance(one, dict):
            waiting.extend(one.values())
            for key in one:
                if not isinstance(key, str):
                    raise ControlMessageError(f"expected names to be strings, got {key!r:.60}")
        elif isinstance(one, list):
            waiting.extend(one)
        elif isinstance(one, int) and one.bit_length() > _MAX_BITS:
            raise ControlMessageError(f"an integer of more than {_MAX_BITS:,} bits")
        elif not (one is None or isinstance(one, str | int | float | bytes | array)):
            raise ControlMessageError(f"a value of type {type(one).__name__} is no message")


_ENCODERS: dict[Any, Any] = {memoryview: _encode_octets, array: _encode_array}
_DECODERS: dict[int, Any] = {
    **dict.fromkeys(_FOREIGN, _refuse),
    **{tag: _typed_reader(code, big=big) for tag, (code, big) in _TYPED.items()},
    **{tag: _half_reader(order) for tag, order in _HALF.items()},
    _MULTIPLE_DIMENSIONS: _read_rows,
}
