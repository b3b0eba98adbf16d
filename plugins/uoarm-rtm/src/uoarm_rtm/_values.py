"""Values on their way to and from the wire: scalars, arrays of scalars, strings.

Scalars of the exact type pass at once, near ones are converted. Buffers pass whole, lists are
converted once. A string is a length, the characters, and for narrow ones a closing zero; wide
strings are UTF-16 with a byte order mark, as omniORB's GIOP 1.2 code sets write them.
"""

from __future__ import annotations

import operator
from array import array
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from struct import Struct
from typing import Any, Literal, TypeAlias

import numpy as np

from uoarm.model import Message
from uoarm_rtm._shape import FLOAT_MAX, INTEGERS, IdlScalar, IdlSequence, IdlString

__all__ = [
    "CODES",
    "SIZES",
    "IdlMismatch",
    "Order",
    "blocks",
    "checker",
    "counted",
    "indexed",
    "is_block",
    "shown",
    "text_of",
    "wchar_of",
    "write_text",
    "write_wchar",
]

Order: TypeAlias = Literal["<", ">"]
"""Little-endian or big-endian, as the struct module and numpy write it."""

CODES = {
    "octet": "B",
    "boolean": "B",
    "char": "B",
    "short": "h",
    "unsigned short": "H",
    "long": "i",
    "unsigned long": "I",
    "long long": "q",
    "unsigned long long": "Q",
    "float": "f",
    "double": "d",
}
"""Codes of the struct module, the same in numpy, for all scalars but `wchar`."""

SIZES = {"B": 1, "h": 2, "H": 2, "i": 4, "I": 4, "q": 8, "Q": 8, "f": 4, "d": 8}
"""Bytes of each code, which are its alignment in CDR too."""


class IdlMismatch(Exception):  # noqa: N818 - a sentence for `_codec.fit`, which adds the path
    """A value does not fit; the text says what was expected and what came."""


def shown(value: object) -> str:
    """Return a short description of a value for an error's sentence."""
    text = repr(value)
    if len(text) > 60:  # noqa: PLR2004 - what fits in a sentence
        text = f"{text[:57]}..."
    return f"{type(value).__name__} {text}"


def checker(name: str) -> Callable[[Message], Any]:
    """Return the function that turns a value into what `struct` packs for a scalar.

    It raises IdlMismatch. `wchar` has none: it is written as text.
    """
    if name == "boolean":
        return _boolean
    if name == "char":
        return _char
    if name in INTEGERS:
        return _integer(name)
    return _number(name)


def _boolean(value: Message) -> bool:
    if not isinstance(value, bool | np.bool_):
        raise IdlMismatch(f"expected true or false, got {shown(value)}")
    return bool(value)


def _char(value: Message) -> int:
    if not isinstance(value, str) or len(value) != 1 or ord(value) > 255:  # noqa: PLR2004 - a byte
        raise IdlMismatch(f"expected one character of Latin-1, got {shown(value)}")
    return ord(value)


def _integer(name: str) -> Callable[[Message], int]:
    low, high = INTEGERS[name]

    def check(value: Message) -> int:
        if isinstance(value, float | np.floating) and value == value // 1:
            value = int(value)  # JSON knows no difference between 1 and 1.0
        if isinstance(value, bool | np.bool_) or not hasattr(value, "__index__"):
            raise IdlMismatch(f"expected an integer ({name}), got {shown(value)}")
        number = operator.index(value)
        if not low <= number <= high:
            raise IdlMismatch(f"expected {low} to {high} ({name}), got {number}")
        return number

    return check


def _number(name: str) -> Callable[[Message], float]:
    def check(value: Message) -> float:
        if isinstance(value, bool) or not isinstance(value, int | float | np.number):
            raise IdlMismatch(f"expected a number ({name}), got {shown(value)}")
        try:
            number = float(value)
        except (OverflowError, TypeError) as error:
            raise IdlMismatch(f"expected a number ({name}), got {shown(value)}") from error
        if name == "float" and abs(number) > FLOAT_MAX and abs(number) != float("inf"):
            raise IdlMismatch(f"expected at most 3.4e38 in size (float), got {shown(value)}")
        return number

    return check


def is_block(listing: IdlSequence) -> bool:
    """Whether the elements lie on the wire one after another as one block."""
    return isinstance(listing.element, IdlScalar) and listing.element.name in CODES


def counted(listing: IdlSequence) -> Callable[[Message], int]:
    """Return the function that counts an array's elements, or raises IdlMismatch."""
    size, fixed = listing.size, listing.fixed

    def count(value: Message) -> int:
        if isinstance(value, str | bytes | dict) or not hasattr(value, "__len__"):
            raise IdlMismatch(f"expected an array, got {shown(value)}")
        found = len(value)
        if size is not None and (found != size if fixed else found > size):
            raise IdlMismatch(f"expected {'' if fixed else 'at most '}{size} elements, got {found}")
        return found

    return count


@contextmanager
def indexed(index: int) -> Iterator[None]:
    """Put the index before what a IdlMismatch says."""
    try:
        yield
    except IdlMismatch as error:
        raise IdlMismatch(f"[{index}]{'' if str(error).startswith('[') else ' '}{error}") from error


def blocks(listing: IdlSequence, order: Order) -> Callable[[Message], tuple[int, Any]]:
    """Return the function that makes (number of elements, their bytes); it raises IdlMismatch."""
    assert isinstance(listing.element, IdlScalar)
    name = listing.element.name
    count = counted(IdlSequence(listing.element, listing.size, fixed=listing.fixed))
    if name in {"boolean", "char"}:
        return lambda value: (count(value), bytes(_checked(value, name)))
    native = np.dtype(CODES[name])
    wire = native.newbyteorder(order)
    octets = name == "octet"

    def make(value: Message) -> tuple[int, Any]:
        if octets and isinstance(value, bytes | bytearray):
            count(memoryview(value))
            return len(value), value
        ready = value if isinstance(value, np.ndarray) else _array(value, name, native)
        if ready.dtype != wire or ready.ndim != 1 or not ready.flags.c_contiguous:
            ready = _fitted(ready, name, native).astype(wire)
        number = count(ready)
        return number, ready.view(np.uint8).data if number else b""

    return make


def _checked(value: Message, name: str) -> list[Any]:
    check = checker(name)
    checked = []
    for index, element in enumerate(value):
        with indexed(index):
            checked.append(check(element))
    return checked


def _array(value: Message, name: str, native: np.dtype[Any]) -> np.ndarray[Any, Any]:
    if isinstance(value, bytes | bytearray):
        raise IdlMismatch(f"expected an array of {name}, got octets")
    if isinstance(value, array | memoryview):
        view = memoryview(value)
        return np.asarray(view) if view.nbytes else np.empty(0, native)
    if not isinstance(value, list | tuple):
        raise IdlMismatch(f"expected an array of {name}, got {shown(value)}")
    kinds = set(map(type, value))
    exact = {int} if name in INTEGERS else {float}
    if kinds == exact and name != "float":
        try:
            return np.array(value, native)
        except OverflowError:
            pass  # the slow way names the element
    return np.array(_checked(value, name), native)


def _fitted(given: np.ndarray[Any, Any], name: str, native: np.dtype[Any]) -> np.ndarray[Any, Any]:
    """Return the numbers as an array of the native type, or raise IdlMismatch."""
    if given.ndim != 1:
        raise IdlMismatch(f"expected an array of one dimension, got {given.ndim}")
    if given.dtype.newbyteorder("=") == native:
        return given
    if given.dtype.kind not in ("iu" if name in INTEGERS else "iuf"):
        raise IdlMismatch(f"expected an array of {name}, got an array of {given.dtype}")
    if not np.can_cast(given.dtype, native, "safe"):
        check = checker(name)
        # Only the two ends need a look: NaN and infinities pass as floats.
        finite = given[np.isfinite(given)] if given.dtype.kind == "f" else given
        for index in () if not finite.size else (finite.argmin(), finite.argmax()):
            number = finite[index].item()
            with indexed(int(np.flatnonzero(given == number)[0])):
                check(number)
    return given.astype(native)


_LAST_OF_PLANE = 0xFFFF
_BIG_MARK, _LITTLE_MARK = b"\xfe\xff", b"\xff\xfe"


def write_text(text: IdlString, order: str, encoding: str) -> Callable[[Message], bytes]:
    """Return the function that makes a string's bytes, length included; it raises IdlMismatch."""
    length = Struct(f"{order}I").pack
    bound, wide = text.bound, text.wide

    def write(value: Message) -> bytes:
        if not isinstance(value, str):
            raise IdlMismatch(f"expected a string, got {shown(value)}")
        if "\0" in value:
            raise IdlMismatch("a string cannot hold a zero character in CORBA")
        try:
            data = value.encode("utf-16-le" if wide else encoding)
        except UnicodeEncodeError as error:
            raise IdlMismatch(f"cannot be written as {error.encoding}: {shown(value)}") from error
        units = len(data) // 2 if wide else len(data)
        if bound is not None and units > bound:
            raise IdlMismatch(f"expected at most {bound} characters, got {units} (as {encoding})")
        if wide:
            data = _LITTLE_MARK + data if data else b""
            return length(len(data)) + data
        return length(len(data) + 1) + data + b"\0"

    return write


def text_of(data: bytes, text: IdlString, encoding: str) -> str:
    """Return the string in the bytes after the length; raises IdlMismatch."""
    try:
        if text.wide:
            value = _wide(data)
        elif not data or data[-1] != 0 or 0 in data[:-1]:
            raise IdlMismatch("expected a string that ends with its only zero")
        else:
            value = data[:-1].decode(encoding)
    except UnicodeDecodeError as error:
        raise IdlMismatch(f"not a text in {error.encoding}: {shown(data)}") from error
    if text.bound is not None and len(value) > text.bound:
        raise IdlMismatch(f"expected at most {text.bound} characters, got {len(value)}")
    return value


def _wide(data: bytes) -> str:
    if data[:2] == _LITTLE_MARK:
        return data[2:].decode("utf-16-le")
    return data.removeprefix(_BIG_MARK).decode("utf-16-be")


def write_wchar(value: Message) -> bytes:
    """Return the three bytes of a wide character; raises IdlMismatch."""
    if not isinstance(value, str) or len(value) != 1 or ord(value) > _LAST_OF_PLANE:
        raise IdlMismatch(f"expected one character of the basic plane, got {shown(value)}")
    try:
        return b"\x02" + value.encode("utf-16-be")
    except UnicodeEncodeError as error:
        raise IdlMismatch(f"cannot be written as {error.encoding}: {shown(value)}") from error


def wchar_of(data: bytes) -> str:
    """Return the wide character in three bytes; raises IdlMismatch."""
    if data[0] != 2:  # noqa: PLR2004 - the length of one unit of UTF-16
        raise IdlMismatch(f"expected a wide character of 2 octets, got {data[0]}")
    try:
        return data[1:].decode("utf-16-be")
    except UnicodeDecodeError as error:
        raise IdlMismatch(f"not a character of UTF-16: {shown(data)}") from error
