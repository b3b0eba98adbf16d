"""Messages and errors to octets and back: a msgpack tree, with numeric buffers raw behind it.

A frame is four octets with the length of the tree (little-endian), the tree, then each buffer,
padded to eight octets. Numeric arrays leave as they lie in memory and arrive as read-only views
of the frame; octets arrive as `bytes`, tuples as lists.
"""

from __future__ import annotations

import math
import re
import struct
import sys
from array import array
from collections.abc import Callable, Mapping
from typing import Any, TypeAlias

import msgpack

from uoarm import errors
from uoarm._raised import contained, text_of
from uoarm.errors import BridgeError, BridgeTimeoutError, FailureReason, MessageError, UoarmError
from uoarm.model import MOST_OCTETS, Message, elements_of, items_of

Frame: TypeAlias = bytes | bytearray
"""What `unpack` reads; the caller changes it no more."""

_LENGTH = struct.Struct("<I")
_BUFFER, _BIG = 1, 2
_TYPE = re.compile(r"[<>|][biuf](1|2|4|8|16)")
_MAX_DIMENSIONS = 32
_WIDEST = 64  # bits
_STEP = 8
_FILL = bytes(_STEP)
_LITTLE = sys.byteorder == "little"
_KINDS = {"b": "i", "h": "i", "i": "i", "l": "i", "q": "i", "f": "f", "d": "f"}
# Below this, the longest claims nested as deep as the decoder goes take some ten megabytes.
_SMALL = 4096
_HARMLESS = 1_000_000
_FEW = 128
# Runs of items that hold no others, or 15 at most, and no texts: by what follows their heads.
_RUN = re.compile(
    rb"[\x00-\xa0\xc0\xc2\xc3\xe0-\xff]{1,4096}"
    rb"|(?:[\xcc\xd0].){1,4096}"
    rb"|(?:[\xcd\xd1]..){1,4096}"
    rb"|(?:[\xca\xce\xd2].{4}){1,4096}"
    rb"|(?:[\xcb\xcf\xd3].{8}){1,4096}",
    re.DOTALL,
)
_SHORT_TEXT, _FIXED_EXTENSION = 0xA0, 0xD4
# Octets of the length, by head: binary, extensions (with their type behind it), texts.
_SIZED = {0xC4: 1, 0xC5: 2, 0xC6: 4, 0xC7: 1, 0xC8: 2, 0xC9: 4, 0xD9: 1, 0xDA: 2, 0xDB: 4}
_EXTENSIONS = {0xC7, 0xC8, 0xC9}
_CONTAINERS = {0xDC: 2, 0xDD: 4, 0xDE: 2, 0xDF: 4}
_MAPS = {0xDE, 0xDF}
_ERRORS: dict[str, type[UoarmError]] = {
    kind.__name__: kind
    for kind in vars(errors).values()
    if isinstance(kind, type) and issubclass(kind, UoarmError)
}


def pack(message: Message) -> bytes:
    """Return a message as one frame.

    Raises:
        MessageError: it holds a value that is neither JSON, octets nor a numeric buffer.
    """
    buffers: list[Any] = []
    left = MOST_OCTETS

    def other(value: Any) -> Any:
        nonlocal left
        left -= getattr(value, "nbytes", 0)
        if left < 0:  # their values repeat, perhaps
            raise MessageError(f"the arrays of a message have more than {MOST_OCTETS:,} octets")
        if isinstance(value, array):
            return _outside(buffers, value, _array_type(value), (len(value),))
        numpy: Any = sys.modules.get("numpy")
        # Without a class of that name another thread is importing it at this moment.
        scalar: Any = getattr(numpy, "generic", ())
        several: Any = getattr(numpy, "ndarray", ())
        if isinstance(value, scalar) and value.dtype.kind in "biuf":
            return value.item()
        if isinstance(value, several) and value.dtype.kind in "biuf":
            whole = numpy.ascontiguousarray(value)
            return _outside(buffers, whole.reshape(-1).view("u1"), value.dtype.str, value.shape)
        for kind, own in _OWN:
            if isinstance(value, kind):
                return own(value)
        raise MessageError(
            f"a message cannot carry a {type(value).__name__}: expected values of JSON, octets, "
            "or numeric buffers (numpy, array)"
        )

    try:
        tree: bytes = msgpack.packb(
            message, default=other, strict_types=True, unicode_errors="surrogatepass"
        )
    except MessageError:
        raise
    except BaseException as error:  # of a value's own methods, or of one that changes meanwhile
        text = f"a message cannot be written: {text_of(contained(error))}"
        raise MessageError(text) from error
    if not buffers:
        return _LENGTH.pack(len(tree)) + tree
    parts = [_LENGTH.pack(len(tree)), tree, _FILL[: -(len(tree) + _LENGTH.size) % _STEP]]
    for buffer in buffers:
        parts += (buffer, _FILL[: -memoryview(buffer).nbytes % _STEP])
    return b"".join(parts)


def _integer(value: int) -> Any:
    number = int.__index__(value)
    if number.bit_length() < _WIDEST:
        return number
    octets = number.to_bytes(number.bit_length() // 8 + 1, "big", signed=True)
    return msgpack.ExtType(_BIG, octets)


# What one of a subclass holds: its own methods may give elements without an end.
_OWN: tuple[tuple[type, Callable[[Any], Any]], ...] = (
    (list, elements_of),
    (tuple, lambda value: list(elements_of(value))),
    (dict, items_of),
    (int, _integer),
    (float, float.__float__),
    (str, str.__str__),
    (bytes, lambda value: memoryview(value).tobytes()),
    (bytearray, lambda value: memoryview(value).tobytes()),
)


def unpack(frame: Frame) -> Message:
    """Return the message of a frame that `pack` made.

    Raises:
        MessageError: the frame is cut or was made by something else.
    """
    try:
        return _read(frame)
    except MessageError:
        raise
    except (ValueError, TypeError, OverflowError, msgpack.UnpackException) as error:
        raise MessageError(f"a frame cannot be read: {text_of(error)}") from error


def _read(frame: Frame) -> Message:
    end = _LENGTH.size + int.from_bytes(frame[: _LENGTH.size], "little")
    if len(frame) < max(end, _LENGTH.size + 1):
        raise MessageError(f"a frame of {len(frame)} octets says that its tree ends at {end}")
    place = end + -end % _STEP

    def read(code: int, data: bytes) -> Any:
        nonlocal place
        if code == _BIG:
            return int.from_bytes(data, "big", signed=True)
        if code != _BUFFER:
            raise MessageError(f"a frame holds an unknown extension {code}")
        kind, shape, size = _buffer(data)
        # Read-only, as all routes that get the message share the frame. `pack` wrote the buffers in
        # the order in which the decoder comes to them, so that no place need be said.
        view = memoryview(frame).toreadonly()[place : place + size]
        if len(view) != size:
            raise MessageError(f"a frame ends within a buffer of {size} octets")
        place += size + -size % _STEP
        return _numbers(view, kind, shape)

    check_claims(frame, _LENGTH.size, end)
    tree = memoryview(frame)[_LENGTH.size : end]
    return msgpack.unpackb(tree, ext_hook=read, unicode_errors="surrogatepass")


def _buffer(data: bytes) -> tuple[str, list[int], int]:
    """Return the item type, the shape and the octets of a buffer; they fit one another.

    Numpy would take far more for a type than `pack` writes, even Python code in commas.
    """
    kind, shape, size = msgpack.unpackb(data)
    known = _TYPE.fullmatch(kind) if isinstance(kind, str) else None
    if known is None:
        raise MessageError(f"a frame holds a buffer of an unknown type {str(kind)[:40]!r}")
    if not (isinstance(shape, list) and len(shape) <= _MAX_DIMENSIONS):
        raise MessageError(f"a frame holds a buffer of more than {_MAX_DIMENSIONS} dimensions")
    if not all(type(item) is int and item >= 0 for item in shape):
        raise MessageError("a frame holds a buffer of a shape that is no list of sizes")
    if math.prod(shape) * int(known[1]) != size:
        raise MessageError(
            f"a frame holds a buffer whose shape does not fit its {size!r:.40} octets"
        )
    return kind, shape, size


def _outside(buffers: list[Any], value: Any, kind: str, shape: tuple[int, ...]) -> Any:
    buffers.append(value)
    size = memoryview(value).nbytes
    return msgpack.ExtType(_BUFFER, msgpack.packb((kind, shape, size)))


def _array_type(value: array[Any]) -> str:
    """Return numpy's name of an array's item type: byte order, kind, octets."""
    code = value.typecode
    if code in "uw":
        raise MessageError("a message cannot carry an array of characters: expected numbers")
    return f"{'<' if _LITTLE else '>'}{_KINDS.get(code, 'u')}{value.itemsize}"


def _numbers(view: memoryview, kind: str, shape: list[int]) -> Any:
    """Return numpy's view of a buffer; where numpy is missing, a copy as `array`, if it is flat."""
    try:
        import numpy as np  # noqa: PLC0415 - only where a message needs it, and may be missing
    except ImportError:
        return _flat(view, kind, shape)
    return np.frombuffer(view, dtype=kind).reshape(shape)


def _flat(view: memoryview, kind: str, shape: list[int]) -> Any:
    for code in "bBhHiIlLqQfd":
        found = array(code)
        if len(shape) == 1 and f"|{_KINDS.get(code, 'u')}1" == kind and found.itemsize == 1:
            found.frombytes(view)
            return found
        if len(shape) == 1 and _array_type(found) == kind:
            found.frombytes(view)
            return found
    raise MessageError(
        f"a buffer of type {kind!r} and shape {shape} needs numpy, which is not installed here"
    )


def check_claims(frame: Frame, start: int, end: int) -> None:
    """Refuse a tree whose lists and maps claim more items than it has octets.

    The decoder makes a list as long as it claims to be before it reads the first item, so nested
    claims that nothing stands behind would cost a thousand times the frame. Most long trees are
    octets with a few heads before them, which are walked over, head by head. Of others a few passes
    in C show that their claims cannot matter; only what is left is walked over as a whole.

    Raises:
        MessageError: it claims too much.
    """
    size = end - start
    if size <= _SMALL:
        return
    claimed, place = _walk(frame, start, end, size, 0, _FEW)
    if place >= end:
        return
    worst = claimed + sum(
        frame.count(head, place, end) * min(1 << 8 * width, size)
        for head, width in _CONTAINERS.items()
    )
    if worst > _HARMLESS:
        _walk(frame, place, end, size, claimed, size)


def _walk(
    frame: Frame, place: int, end: int, size: int, claimed: int, steps: int
) -> tuple[int, int]:
    """Walk over some heads of a tree; return how many items were claimed so far, and where it is.

    Raises:
        MessageError: more items are claimed than the tree's `size` in octets.
    """
    for _ in range(steps):
        if place >= end:
            break
        run = _RUN.match(frame, place, end)
        if run is not None:
            place = run.end()
            continue
        head = frame[place]
        place += 1
        if head in _CONTAINERS:
            width = _CONTAINERS[head]
            count = int.from_bytes(frame[place : place + width], "big")
            place += width
            claimed += 2 * count if head in _MAPS else count
            if claimed > size:
                raise MessageError(f"a frame of {size:,} octets claims to hold {claimed:,} values")
        elif head in _SIZED:
            width = _SIZED[head]
            place += width + int.from_bytes(frame[place : place + width], "big")
            place += head in _EXTENSIONS
        elif head >= _FIXED_EXTENSION:
            place += (1 << (head - _FIXED_EXTENSION)) + 1
        else:
            place += head - _SHORT_TEXT
    return claimed, place


def to_failure(error: BaseException) -> dict[str, str]:
    """Return an error as plain values; a foreign one becomes a BridgeError that names it."""
    if isinstance(error, BridgeError):
        return {"kind": type(error).__name__, "text": str(error), "reason": error.reason.value}
    if isinstance(error, UoarmError):
        return {"kind": type(error).__name__, "text": str(error)}
    text = f"the bridge host failed: {text_of(error)}"
    return {"kind": "BridgeError", "text": text, "reason": FailureReason.RAISED.value}


def from_failure(failure: Mapping[str, Any]) -> UoarmError:
    """Return the error that `to_failure` described; an unknown kind becomes a BridgeError."""
    text = str(failure.get("text"))
    # By name among our own: nothing that the other end names is imported, or called.
    kind = _ERRORS.get(str(failure.get("kind")), BridgeError)
    if issubclass(kind, BridgeTimeoutError):
        return BridgeTimeoutError(text)
    if issubclass(kind, BridgeError):
        try:
            return BridgeError(text, FailureReason(failure.get("reason")))
        except ValueError:
            return BridgeError(text)
    return kind(text)
