"""Messages as CBOR (RFC 8949) with typed arrays (RFC 8746): octets and numbers stay buffers."""

from __future__ import annotations

import re
import struct
import sys
from array import array
from collections import OrderedDict, defaultdict
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import is_dataclass
from datetime import date, datetime, time
from decimal import Decimal
from enum import Enum
from fractions import Fraction
from io import BytesIO
from ipaddress import (
    IPv4Address,
    IPv4Interface,
    IPv4Network,
    IPv6Address,
    IPv6Interface,
    IPv6Network,
)
from typing import Any, TypeAlias
from uuid import UUID

import cbor2
import orjson

from uoarm._raised import contained, sentence_of
from uoarm._wire._text import buffer_octets
from uoarm.errors import ControlMessageError, MessageError
from uoarm.model import Budget, BudgetUse, Message, elements_of, items_of

Octets: TypeAlias = "bytes | bytearray"
LARGEST = Budget(octets=268_435_456, elements=2_000_000, depth=512, dimensions=32)
"""What clients take of a server. One message that is more ends the connection."""
WRITTEN = Budget(octets=268_400_000, elements=1_999_000, depth=256, dimensions=32)
"""What is written at most: less by what stands around a message, and no deeper than JSON is."""
# Runs of items without anything behind their heads but an argument of one size, by group: no
# argument, 1, 2, 4 and 8 octets. Long lists of numbers are counted at the speed of C.
_RUNS = re.compile(
    rb"([\x00-\x17\x20-\x37\x40\x60\x80-\x97\xa0-\xb7\xc0-\xd7\xe0-\xf7]{1,4096})"
    rb"|((?:[\x18\x38\x98\xb8\xd8\xf8].){1,4096})"
    rb"|((?:[\x19\x39\x99\xb9\xd9\xf9]..){1,4096})"
    rb"|((?:[\x1a\x3a\x9a\xba\xda\xfa].{4}){1,4096})"
    rb"|((?:[\x1b\x3b\x9b\xbb\xdb\xfb].{8}){1,4096})",
    re.DOTALL,
)
_WIDTHS = (0, 1, 2, 3, 5, 9)
_OCTETS, _TEXT, _TAG = 2, 3, 6
_SMALL, _LARGEST = 24, 27
_FEW, _COPIED = 512, 128
_CUT_OCTETS, _CUT_LEAST = 65_536, 4096  # of data, and of what is cut out of it
_CUT_TAG = 0x756F_6172  # no registered one
_CUT_HEAD = struct.pack("!BI", 0xDA, _CUT_TAG)


def scan_cbor(data: Octets, spending: BudgetUse) -> None:
    """Refuse data with more items than its budget allows; the heads of tags count as items.

    Raises:
        ControlMessageError: it holds too much.
    """
    spending.add(_items(data, spending.budget.elements - spending.elements))


def decoding_octets(data: Octets) -> int:
    """Return how much of CBOR takes time to decode: octets in few items are only copied."""
    if len(data) < _LARGE or _items(data, _FEW) > _FEW:
        return len(data)
    return len(data) // _COPIED


def _items(data: Octets, most: int) -> int:
    """Count the items of CBOR; stops with the one that is too many.

    Walks over the heads, and jumps over texts and octets. What is no CBOR is left to the decoder,
    whose first mistake is where this loses its way.
    """
    place, end, items = 0, len(data), 0
    while place < end and items <= most:
        run = _RUNS.match(data, place)
        if run is not None:
            assert run.lastindex is not None, "each branch is a group"
            items += (run.end() - place) // _WIDTHS[run.lastindex]
            place = run.end()
            continue
        items += 1
        major, more = data[place] >> 5, data[place] & 31
        place += 1
        if more > _LARGEST:  # begins or ends an item of unknown length
            continue
        length = more
        if more >= _SMALL:
            size = 1 << (more - _SMALL)
            length = int.from_bytes(data[place : place + size], "big")
            place += size
        if major in {_OCTETS, _TEXT}:
            place += length
    return items


_LARGE = 4096
_PARTED = 64  # levels in which large parts are looked for
_PLAIN = (
    orjson.OPT_PASSTHROUGH_SUBCLASS
    | orjson.OPT_PASSTHROUGH_DATACLASS
    | orjson.OPT_PASSTHROUGH_DATETIME
)
_MAX_BITS = 3072
_MULTIPLE_DIMENSIONS = 40
_HALF = 2  # octets of a float
_ID = b"\x62id"
_LONGEST_ID = 600  # octets of 128 characters, and of what stands before them
_UUID_HEAD = b"\xd8\x25\x50"
_AS_TEXT = datetime, date, UUID, time, Enum
# Tag to (typecode, big-endian): the numbers of RFC 8746, section 2.1, of sizes that `array` has.
_TYPED = {
    64: ("B", False), 65: ("H", True), 66: ("I", True), 67: ("Q", True), 68: ("B", False),
    69: ("H", False), 70: ("I", False), 71: ("Q", False), 72: ("b", False), 73: ("h", True),
    74: ("i", True), 75: ("q", True), 77: ("h", False), 78: ("i", False), 79: ("q", False),
    81: ("f", True), 82: ("d", True), 85: ("f", False), 86: ("d", False),
}  # fmt: skip
_LITTLE_TAGS = {
    ("u", 1): 64, ("u", 2): 69, ("u", 4): 70, ("u", 8): 71, ("i", 1): 72, ("i", 2): 77,
    ("i", 4): 78, ("i", 8): 79, ("f", 4): 85, ("f", 8): 86,
}  # fmt: skip
_SIGNS = {"B": "u", "H": "u", "I": "u", "L": "u", "Q": "u", "f": "f", "d": "f"}
_SCALARS = {type(None), bool, int, float, str}
_CONTAINERS = {list, dict}
_KINDS = {*_SCALARS, bytes, array, *_CONTAINERS}
# Tags that the library would turn into dates, fractions, sets, references: no message has them.
_FOREIGN = (0, 1, 4, 5, 25, 28, 29, 30, 35, 36, 37, 52, 54, 100, 256, 258, 260, 261, 1004, 43000)


def write_binary(message: Message) -> bytes:
    """Return a message as CBOR.

    Raises:
        MessageError: a value in it has no form here, and the text says which type; or it is more
            than `WRITTEN`.
    """
    try:
        if type(message) is dict and _has_large(message, _PARTED):
            parts: list[Any] = []
            _write_parts(message, parts, _PARTED)
            made = b"".join(parts)
        else:
            made = _dumps(message)
        if len(made) > WRITTEN.elements:  # what has no more octets than that has no more values
            spending = BudgetUse(WRITTEN)
            spending.octets(len(made))
            if not _is_few(message):
                scan_cbor(made, spending)
    except BaseException as error:  # of a value's own methods, or of one that changes meanwhile
        why = sentence_of(contained(error))
        raise MessageError(f"the message has no form as CBOR: {why}") from error
    return made


def read_binary(data: Octets, spending: BudgetUse, *, with_numpy: bool = False) -> Message:
    """Return the value that CBOR stands for; numeric arrays come as `array.array`.

    Args:
        data: the CBOR.
        spending: what it may cost.
        with_numpy: whether arrays of several dimensions are numpy's, read-only, where that is
            installed, in place of lists in lists. Such an array counts as one value. Where it is
            not, and lists would be too many values, the array comes as it is, in one dimension.

    Raises:
        ControlMessageError: it is not CBOR, holds a tag or a simple value that no message has, or
            costs more than its budget.
    """
    spending.octets(len(data))
    made = _ItemDecoders(BudgetUse(spending.budget), with_numpy=with_numpy)
    if len(data) > spending.budget.elements:  # else each octet may be an item
        scan_cbor(data, BudgetUse(spending.budget))
    rest, cut = _cut(data) if len(data) >= _CUT_OCTETS else (data, {})
    stream = _Octets(rest)
    try:
        value = cbor2.CBORDecoder(
            stream,
            semantic_decoders={**_DECODERS, **made.decoders, **cut},
            max_depth=spending.budget.depth,
            allow_duplicate_keys=False,
            strict_hashable_types=True,
        ).decode()
    except (cbor2.CBORError, ValueError, OverflowError, RecursionError) as error:
        cause = error.__cause__ or error
        if isinstance(cause, ControlMessageError):
            raise cause from None
        raise ControlMessageError(f"not CBOR as messages have it: {str(cause)[:200]}") from error
    if more := len(rest) - stream.tell():
        raise ControlMessageError(f"more follows the message of {len(data) - more:,} bytes")
    _examine(value, spending, made.kinds)
    return value


def _cut(data: Octets) -> tuple[Octets, dict[int, Any]]:
    """Take large octets out of CBOR, for each of which the library makes several copies.

    Returns:
        What is left, with a tag of ours for each of them; and what decodes that. The data as it
        is, and nothing, where there are none, or many items, or it has that tag itself.
    """
    place, end, items = 0, len(data), 0
    view, parts, octets = memoryview(data), list[bytes | memoryview](), list[memoryview]()
    kept = 0  # from where on nothing was put into `parts`
    while place < end:
        items += 1
        head, major, more = place, data[place] >> 5, data[place] & 31
        length, place = more, place + 1
        if items > _FEW or more > _LARGEST:  # of unknown length, whose pieces stay together
            return data, {}
        if more >= _SMALL:
            size = 1 << (more - _SMALL)
            length = int.from_bytes(data[place : place + size], "big")
            place += size
        if major == _TAG and length == _CUT_TAG:
            return data, {}
        if major not in {_OCTETS, _TEXT}:
            continue
        place += length
        if major == _OCTETS and length >= _CUT_LEAST and place <= end:
            parts += (view[kept:head], _CUT_HEAD, _head(0, len(octets)))
            octets.append(view[place - length : place])
            kept = place
    if not octets:
        return data, {}
    parts.append(view[kept:])
    return b"".join(parts), {_CUT_TAG: lambda number, _: bytes(octets[number])}


def last_id(data: Octets) -> str | None:
    """Return the `id` with which a message ends that cannot be read; None: it ends otherwise."""
    place = data.rfind(_ID, max(0, len(data) - _LONGEST_ID))
    if place < 0:
        return None
    try:
        identity = read_binary(data[place + len(_ID) :], BudgetUse(Budget()))
    except ControlMessageError:
        return None
    return identity if isinstance(identity, str) else None


def join_list(parts: Sequence[bytes]) -> bytes:
    """Return a list of values that are written already."""
    return b"".join((_head(4, len(parts)), *parts))


def join_map(parts: Mapping[str, bytes]) -> bytes:
    """Return a mapping whose values are written already."""
    pieces = [_head(5, len(parts))]
    for name, part in parts.items():
        pieces += (cbor2.dumps(name), part)
    return b"".join(pieces)


class _Octets(BytesIO):
    """Read through Python, some thousand octets at a time: there other threads have their turn."""

    def read(self, size: int | None = -1) -> bytes:
        return super().read(size)


def _dumps(value: Any) -> bytes:
    # With encoders of ours the library takes four times as long, for each value that is none of
    # theirs. Whether there is one of theirs a writer of JSON says in a fifth of its time; without
    # them the library would take a buffer for a list.
    others: list[Any] = []
    is_plain = False  # neither deeper nor wider than that writer takes, which no reader refuses
    with suppress(TypeError, cbor2.CBOREncodeError):
        orjson.dumps(value, others.append, _PLAIN)
        if not others:
            made = cbor2.dumps(value)
            if _UUID_HEAD not in made:  # of what that writer takes, all else that no message has
                return made
        is_plain = all(map(_is_flat, others))
    if is_plain:
        BudgetUse(WRITTEN).octets(sum(map(buffer_octets, others)))
    else:
        value = _own(value)
    made = cbor2.dumps(value, encoders=_ENCODERS, default=_encode_other)
    if not is_plain:
        read_binary(made, BudgetUse(WRITTEN), with_numpy=True)
    return made


def _own(message: Message) -> Message:
    """Return a message whose lists and mappings are Python's own, within what may be written.

    Of others the library would take elements without an end; and it follows lists within lists
    until the stack is full, which ends the process.
    """
    spending, octets = BudgetUse(WRITTEN), 0

    def own(value: Any, depth: int) -> Any:
        nonlocal octets
        octets += buffer_octets(value)
        spending.octets(octets)
        if getattr(getattr(value, "dtype", None), "kind", "") == "O":
            value = value.tolist()
        if not isinstance(value, Mapping | list | tuple):
            return value
        if depth == WRITTEN.depth:
            raise MessageError(f"it is nested more than {depth} levels deep")
        if isinstance(value, Mapping):
            items = items_of(value)
            spending.add(2 * len(items))
            return {key: own(part, depth + 1) for key, part in items.items()}
        elements = elements_of(value)
        spending.add(len(elements))
        return [own(part, depth + 1) for part in elements]

    return own(message, 0)


def _is_few(message: Message) -> bool:
    """Say quickly whether a message surely holds no more than may be written."""
    left = WRITTEN.elements
    waiting: list[Any] = [message]
    for item in waiting:
        if isinstance(item, bytes | bytearray | memoryview | array):
            continue
        if item.__class__ not in {dict, list, tuple}:  # it may be written as any number of values
            return False
        left -= 2 * len(item)
        if left < 0:
            return False
        values = item.values() if isinstance(item, dict) else item
        waiting += [value for value in values if value.__class__ not in _SCALARS]
    return True


def _is_flat(value: Any) -> bool:
    """Say whether there is nothing in a value that could be nested, or a wide integer."""
    if isinstance(value, bytes | bytearray | memoryview | array | str | float | date):
        return True
    return getattr(getattr(value, "dtype", None), "kind", "O") != "O"


def _has_large(message: Mapping[str, Any], levels: int) -> bool:
    for value in message.values():
        if type(value) in {bytes, bytearray, memoryview, list}:
            if len(value) >= _LARGE:
                return True
        elif type(value) is dict and levels and _has_large(value, levels - 1):
            return True
    return False


def _write_parts(message: Mapping[str, Any], parts: list[Any], levels: int) -> int:
    """Write large buffers without the encoder's copies, and long lists a piece at a time.

    The encoder keeps the interpreter's lock from its first value to its last; between two pieces
    other threads have their turn. Returns about how many octets it wrote.
    """
    spending, octets = BudgetUse(WRITTEN), 0
    message = items_of(message)
    parts.append(_head(5, len(message)))
    for key, value in message.items():
        spending.octets(octets)
        if not isinstance(key, str):
            raise TypeError("names must be strings")
        parts.append(_dumps(key))
        if type(value) in {bytes, bytearray, memoryview} and len(value) >= _LARGE:
            spending.octets(buffer_octets(value))
            whole = value
            if isinstance(value, memoryview):
                whole = value.cast("B") if value.c_contiguous else value.tobytes()
            octets += len(whole)
            parts += (_head(2, len(whole)), whole)
        elif type(value) is dict and levels:
            octets += _write_parts(value, parts, levels - 1)
        elif type(value) is list and len(value) >= _LARGE:
            elements = elements_of(value)
            parts.append(_head(4, len(elements)))
            for start in range(0, len(elements), _LARGE):
                piece = elements[start : start + _LARGE]
                parts.append(_dumps(piece)[len(_head(4, len(piece))) :])
                octets += len(parts[-1])
                spending.octets(octets)
        else:
            parts.append(_dumps(value))
            octets += len(parts[-1])
    spending.octets(octets)
    return octets


def _head(major: int, count: int) -> bytes:
    """Return the first bytes of an item: major type and length (RFC 8949, section 3)."""
    if count < 24:  # noqa: PLR2004 - the RFC's own bound for a length in the first byte
        return bytes([major << 5 | count])
    for more, size in ((24, 1), (25, 2), (26, 4)):
        if count < 1 << 8 * size:
            return bytes([major << 5 | more]) + count.to_bytes(size, "big")
    return bytes([major << 5 | 27]) + count.to_bytes(8, "big")


def _encode_map(encoder: cbor2.CBOREncoder, value: Mapping[Any, Any]) -> None:
    if not set(map(type, value)) <= {str} and not all(isinstance(name, str) for name in value):
        raise MessageError("names must be strings")
    encoder.encode_map(value)


def _encode_foreign(encoder: cbor2.CBOREncoder, value: Any) -> None:
    del encoder
    raise MessageError(f"a value of type {type(value).__name__}")


def _encode_as_text(encoder: cbor2.CBOREncoder, value: Any) -> None:
    encoder.encode(orjson.loads(orjson.dumps(value, option=orjson.OPT_SERIALIZE_NUMPY)))


def _encode_array(encoder: cbor2.CBOREncoder, value: array[Any]) -> None:
    kind = _SIGNS.get(value.typecode, "i")
    _encode_typed(encoder, kind, value.itemsize, _little(value).tobytes())


def _encode_other(encoder: cbor2.CBOREncoder, value: Any) -> None:
    if isinstance(value, _AS_TEXT) or (is_dataclass(value) and not isinstance(value, type)):
        _encode_as_text(encoder, value)
        return
    if not hasattr(value, "__array_interface__"):
        raise MessageError(f"a value of type {type(value).__name__}")
    if value.ndim == 0:
        encoder.encode(value.item())
    elif value.dtype == "uint8" and value.ndim == 1:
        encoder.encode(value.tobytes())
    elif value.dtype.kind == "f" and value.dtype.itemsize == _HALF:  # which browsers do not have
        _encode_other(encoder, value.astype("float32"))
    elif value.dtype.kind == "M":
        _encode_as_text(encoder, value)
    elif (
        (value.dtype.kind, value.dtype.itemsize) not in _LITTLE_TAGS
        or 0 in value.shape[1:]  # rows of nothing, which nothing would stand for
        or value.ndim > WRITTEN.dimensions
    ):
        encoder.encode(value.tolist())
    elif value.ndim == 1:
        octets = value.astype(value.dtype.newbyteorder("<"), copy=False).tobytes()
        _encode_typed(encoder, value.dtype.kind, value.dtype.itemsize, octets)
    else:
        encoder.encode_semantic(_MULTIPLE_DIMENSIONS, [list(value.shape), value.ravel()])


def _encode_typed(encoder: cbor2.CBOREncoder, kind: str, size: int, octets: bytes) -> None:
    encoder.encode_semantic(_LITTLE_TAGS[kind, size], octets)


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


class _ItemDecoders:
    """Decoders of what stands for more values than it has items, for one message."""

    def __init__(self, spending: BudgetUse, *, with_numpy: bool) -> None:
        self._spending = spending
        self._with_numpy = with_numpy
        self.kinds = _KINDS
        self.decoders = {
            80: self._half(">"),
            84: self._half("<"),
            _MULTIPLE_DIMENSIONS: self._rows,
        }

    def _half(self, order: str) -> Callable[[Any, bool], list[float]]:
        def read(octets: Any, immutable: bool) -> list[float]:  # noqa: FBT001 - the library's signature
            del immutable
            count = len(octets) // 2
            self._spending.add(count)
            return list(struct.unpack(f"{order}{count}e", octets))

        return read

    def _rows(self, value: Any, immutable: bool) -> Any:  # noqa: FBT001 - the library's signature
        """Return rows in lists, or in an array (RFC 8746, section 3.1.1)."""
        del immutable
        sizes, items = value
        if not (isinstance(sizes, list) and isinstance(items, list | array | bytes)):
            raise ControlMessageError("an array of several dimensions: expected sizes and items")
        rows = self._spending.dimensions(sizes, len(items))
        if self._with_numpy and not isinstance(items, list):
            try:
                import numpy as np  # noqa: PLC0415 - only where a message needs it
            except ImportError:
                pass
            else:
                code = items.typecode if isinstance(items, array) else "B"
                matrix = np.frombuffer(items, code).reshape(sizes)
                matrix.flags.writeable = False
                self.kinds = {*_KINDS, np.ndarray}
                return matrix
        try:
            self._spending.add(rows + len(items))
        except ControlMessageError as error:
            if self._with_numpy:
                return items
            to_do = "send one without dimensions, or octets, which count as one value"
            text = f"{error}, as each of an array of {len(sizes)} dimensions counts: {to_do}"
            raise ControlMessageError(text) from None
        for size in reversed(sizes[1:]):
            items = [list(items[at : at + size]) for at in range(0, len(items), size)]
        return items


def _read_integer(octets: Any, *, negative: bool) -> int:
    if len(octets) > _MAX_BITS // 8:
        raise ControlMessageError(f"an integer of more than {_MAX_BITS:,} bits")
    number = int.from_bytes(octets, "big")
    return -1 - number if negative else number


def _refuse(value: Any, immutable: bool) -> Any:  # noqa: FBT001 - the library's signature
    del value, immutable
    raise ControlMessageError("a tag that no message has")


def _examine(value: Any, spending: BudgetUse, allowed: set[type]) -> None:
    """Count what was made, one level of nesting after the other, and refuse what JSON lacks."""
    depth, level = 0, [value]
    while level:
        spending.add(len(level))
        kinds = set(map(type, level))
        if not kinds <= allowed:
            strange = ", ".join(sorted(kind.__name__ for kind in kinds - allowed))
            raise ControlMessageError(f"a value of type {strange} is no message")
        inner: list[Any] = []
        if not kinds.isdisjoint(_CONTAINERS):
            depth += 1
            spending.depth(depth)
        for item in level if dict in kinds or list in kinds else ():
            if type(item) is list:
                inner += item
            elif type(item) is dict:
                if not set(map(type, item)) <= {str}:
                    raise ControlMessageError("expected names to be strings, got octets")
                spending.add(len(item))
                inner += item.values()
        level = inner


# What the library would write, and no reader of messages takes.
_FOREIGN_TYPES = (
    set, frozenset, complex, Decimal, Fraction, re.Pattern,
    IPv4Address, IPv6Address, IPv4Network, IPv6Network, IPv4Interface, IPv6Interface,
    cbor2.CBORTag, cbor2.CBORSimpleValue, type(cbor2.undefined),
)  # fmt: skip
_ENCODERS: dict[Any, Any] = {
    **dict.fromkeys(_FOREIGN_TYPES, _encode_foreign),
    **dict.fromkeys((datetime, date, UUID), _encode_as_text),
    **dict.fromkeys((dict, defaultdict, OrderedDict), _encode_map),
    memoryview: lambda encoder, value: encoder.encode(value.tobytes()),
    array: _encode_array,
}
_DECODERS: dict[int, Any] = {
    **dict.fromkeys(_FOREIGN, _refuse),
    **{tag: _typed_reader(code, big=big) for tag, (code, big) in _TYPED.items()},
    2: lambda octets, _: _read_integer(octets, negative=False),
    3: lambda octets, _: _read_integer(octets, negative=True),
}
