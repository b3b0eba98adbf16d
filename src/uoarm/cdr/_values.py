"""Values on their way to and from octets: single ones, texts, and arrays of numbers.

Values of the exact type pass at once, near ones are converted. Buffers pass whole, lists are
converted once.
"""

from __future__ import annotations

import operator
import struct
from array import array
from collections.abc import Callable, Iterable, Mapping
from itertools import islice
from typing import Any

import numpy as np

from uoarm import _encodable
from uoarm.cdr._layout import (
    FLOAT32_MAX,
    SIZES,
    ArrayLayout,
    BooleanLayout,
    ByteOrder,
    CharacterLayout,
    Encoding,
    EnumerationLayout,
    Layout,
    NumberLayout,
    TextLayout,
)
from uoarm.model import MOST_OCTETS, Message, elements_of

_SHOWN = 60
_LAST_OF_PLANE = 0xFFFF
_LAST_NARROW = 0xFF
_BIG_MARK, _LITTLE_MARK = b"\xfe\xff", b"\xff\xfe"


class UnfitValue(Exception):  # noqa: N818 - a part of a sentence, which gets a place and leaves as MessageError
    """A value does not fit; the text says what was expected and what came."""


def shown(value: object) -> str:
    """Return a short description of a value for an error's sentence."""
    return f"{type(value).__name__} {_encodable.shown(value, _SHOWN)}"


def checker(layout: NumberLayout | BooleanLayout | CharacterLayout) -> Callable[[Message], Any]:
    """Return the function that turns a value into what `struct` packs; it raises UnfitValue."""
    if isinstance(layout, BooleanLayout):
        return _boolean
    if isinstance(layout, CharacterLayout):
        return _character
    bounds = layout.bounds
    if bounds is None:
        return _float(layout.name, is_narrow=layout.code == "f")
    return _integer(layout.name, *bounds)


def _boolean(value: Message) -> bool:
    if not isinstance(value, bool | np.bool_):
        raise UnfitValue(f"expected true or false, got {shown(value)}")
    return bool(value)


def _character(value: Message) -> int:
    if not isinstance(value, str) or len(value) != 1 or ord(value) > _LAST_NARROW:
        raise UnfitValue(f"expected one character of Latin-1, got {shown(value)}")
    return ord(value)


def _integer(name: str, least: int, greatest: int) -> Callable[[Message], int]:
    def check(value: Message) -> int:
        if isinstance(value, float | np.floating) and value == value // 1:
            value = int(value)  # JSON knows no difference between 1 and 1.0
        if isinstance(value, bool | np.bool_) or not hasattr(value, "__index__"):
            raise UnfitValue(f"expected an integer ({name}), got {shown(value)}")
        number = operator.index(value)
        if not least <= number <= greatest:
            raise UnfitValue(f"expected {least} to {greatest} ({name}), got {number}")
        return number

    return check


def _float(name: str, *, is_narrow: bool) -> Callable[[Message], float]:
    def check(value: Message) -> float:
        if isinstance(value, bool) or not isinstance(value, int | float | np.number):
            raise UnfitValue(f"expected a number ({name}), got {shown(value)}")
        try:
            number = float(value)
        except (OverflowError, TypeError) as error:
            raise UnfitValue(f"expected a number ({name}), got {shown(value)}") from error
        if is_narrow and FLOAT32_MAX < abs(number) < float("inf"):
            raise UnfitValue(f"expected at most 3.4e38 in size ({name}), got {shown(value)}")
        return number

    return check


def boolean_of(value: int) -> bool:
    """Return the truth value of an octet, or raise UnfitValue."""
    if value > 1:
        raise UnfitValue(f"expected a boolean, 0 or 1, got {value}")
    return value == 1


def label_check(layout: EnumerationLayout) -> Callable[[Message], int]:
    """Return the function that makes a label its position; it raises UnfitValue."""
    positions = {label: index for index, label in enumerate(layout.labels)}

    def check(value: Message) -> int:
        if not isinstance(value, str) or value not in positions:
            raise UnfitValue(f"expected one of {', '.join(positions)}, got {shown(value)}")
        return positions[value]

    return check


def member_check(names: Iterable[str]) -> Callable[[Message], Any]:
    """Return the function that lets an object with just these members pass; raises UnfitValue."""
    names = tuple(names)

    def check(value: Message) -> Any:
        if not isinstance(value, Mapping):
            raise UnfitValue(f"expected an object, got {shown(value)}")
        if missing := [name for name in names if name not in value]:
            raise UnfitValue(f"field {missing[0]!r} is missing; the fields are {', '.join(names)}")
        # No further: one that is no dict may have names without an end.
        for name in islice(value, len(names) + 1):
            if name not in names:
                known = ", ".join(names)
                raise UnfitValue(
                    f"there is no field {_encodable.shown(name)}; the fields are {known}"
                )
        return value

    return check


def element_taker(layout: ArrayLayout) -> Callable[[Message], Any]:
    """Return the function that takes an array's elements as they are now; raises UnfitValue."""
    fitting = _fitting(layout)

    def take(value: Message) -> Any:
        if isinstance(value, str | bytes | Mapping) or not hasattr(value, "__len__"):
            raise UnfitValue(f"expected an array, got {shown(value)}")
        fitting(len(value))
        try:
            elements = elements_of(value)
        except ValueError as error:
            raise UnfitValue(str(error)) from error
        fitting(len(elements))
        return elements

    return take


def check_octets(count: int) -> None:
    """Raise UnfitValue where a message is longer than any may be."""
    if count > MOST_OCTETS:
        raise UnfitValue(
            f"the message has {count:,} octets up to here: {MOST_OCTETS:,} are allowed"
        )


def _fitting(layout: ArrayLayout) -> Callable[[int], int]:
    size, is_fixed = layout.size, layout.is_fixed

    def fitting(found: int) -> int:
        if size is not None and (found != size if is_fixed else found > size):
            raise UnfitValue(
                f"expected {'' if is_fixed else 'at most '}{size} elements, got {found}"
            )
        return found

    return fitting


def is_block(layout: Layout) -> bool:
    """Whether the elements of an array lie one after another as one block, without padding."""
    if isinstance(layout, CharacterLayout):
        return not layout.is_wide
    return isinstance(layout, NumberLayout | BooleanLayout)


_Block = Callable[[Message], "tuple[int, Any]"]


def array_writer(layout: ArrayLayout, order: ByteOrder) -> _Block:
    """Return the function that makes an array its length and its octets; it raises UnfitValue."""
    element, fitting = layout.element, _fitting(layout)
    if isinstance(element, NumberLayout):
        return _number_writer(element, order, fitting, layout)
    assert isinstance(element, BooleanLayout | CharacterLayout)
    check, take = checker(element), element_taker(layout)

    def write(value: Message) -> tuple[int, bytes]:
        octets = bytes(_checked(take(value), check))
        return len(octets), octets

    return write


def _number_writer(
    element: NumberLayout, order: ByteOrder, fitting: Callable[[int], int], layout: ArrayLayout
) -> _Block:
    code, size = element.code, SIZES[element.code]
    is_bound, fixed = layout.size is not None, layout.size if layout.is_fixed else None
    native = np.dtype(code)
    wire = native.newbyteorder(order)
    exact = int if element.bounds is not None else float
    is_octets, is_native, check = code == "B", wire == native, checker(element)
    is_machines = {code, *_SAME.get(code, ())}.__contains__

    def take(value: Message) -> tuple[int, Any]:
        kind = type(value)
        if kind is np.ndarray and value.dtype == wire and value.ndim == 1:
            count = len(value)
            if count != fixed and is_bound:
                fitting(count)
            if count * size < _SHORT:
                return count, value.tobytes()
            if not value.flags.c_contiguous:
                check_octets(count * size)
                return count, value.tobytes()
            return count, value.view(np.uint8).data
        if kind is list or kind is tuple:
            count = fitting(len(value))
            if [*map(type, value)].count(exact) == count:  # a set of them costs half more
                try:
                    return count, struct.pack(f"{order}{count}{code}", *value)
                except (struct.error, OverflowError):
                    pass  # the slow way names the element
            return count, struct.pack(f"{order}{count}{code}", *_checked(value, check))
        if is_octets and (kind is bytes or kind is bytearray):
            return fitting(len(value)), value
        if kind is memoryview and is_octets and value.format == "B" and value.ndim == 1:
            check_octets(value.nbytes)
            return fitting(len(value)), value if value.contiguous else value.tobytes()
        if kind is array and is_native and is_machines(value.typecode):
            return fitting(len(value)), memoryview(value).cast("B")
        given = _fitted(_as_array(value, element.name, native), element, check).astype(wire)
        return fitting(len(given)), given.tobytes()

    return take


# How `array` may call what `struct` calls so, where a `long` has eight octets, or four.
_SAME = {"q": "l", "Q": "L"} if array("l").itemsize == SIZES["q"] else {"i": "l", "I": "L"}
_SHORT = 4096  # octets of an array up to which a copy costs less than a view


def _checked(value: Iterable[Any], check: Callable[[Message], Any]) -> list[Any]:
    checked = []
    for index, element in enumerate(value):
        try:
            checked.append(check(element))
        except UnfitValue as error:
            raise UnfitValue(f"[{index}]: {error}") from error
    return checked


def _as_array(value: Message, name: str, native: np.dtype[Any]) -> np.ndarray[Any, Any]:
    if isinstance(value, bytes | bytearray):
        raise UnfitValue(f"expected an array of {name}, got octets")
    if not isinstance(value, array | memoryview | np.ndarray):
        raise UnfitValue(f"expected an array of {name}, got {shown(value)}")
    given: np.ndarray[Any, Any]
    if isinstance(value, np.ndarray):
        given = np.asarray(value)  # without the methods of a subclass
    else:
        view = memoryview(value)
        given = np.asarray(view) if view.nbytes else np.empty(0, native)
    check_octets(max(given.nbytes, given.size * native.itemsize))
    if given.ndim != 1:
        raise UnfitValue(f"expected an array of one dimension, got {given.ndim}")
    return given


def _fitted(
    given: np.ndarray[Any, Any], element: NumberLayout, check: Callable[[Message], Any]
) -> np.ndarray[Any, Any]:
    """Return the numbers as an array of the native type, or raise UnfitValue."""
    native = np.dtype(element.code)
    if given.dtype.newbyteorder("=") == native:
        return given
    if given.dtype.kind not in "iuf":
        raise UnfitValue(f"expected an array of {element.name}, got an array of {given.dtype}")
    if element.bounds is not None and given.dtype.kind == "f":
        # Floats that are whole are integers, as in a list. NaN equals nothing.
        for index in np.flatnonzero(~np.isfinite(given) | (given != np.trunc(given)))[:1]:
            raise UnfitValue(f"[{index}]: expected an integer ({element.name}), got {given[index]}")
    if not np.can_cast(given.dtype, native, "safe"):
        # Only the two ends need a look: NaN and infinities pass as floats.
        finite = given[np.isfinite(given)] if given.dtype.kind == "f" else given
        for index in () if not finite.size else (finite.argmin(), finite.argmax()):
            number = finite[index].item()
            try:
                check(number)
            except UnfitValue as error:
                place = int(np.flatnonzero(given == number)[0])
                raise UnfitValue(f"[{place}]: {error}") from error
    return given.astype(native)


def array_reader(
    layout: ArrayLayout, order: ByteOrder, encoding: Encoding
) -> Callable[[Any, int, int], Any]:
    """Return the function that makes so many elements of the octets from an offset on."""
    element = layout.element
    if isinstance(element, BooleanLayout):
        make = boolean_of if encoding.is_idl else bool
        return lambda octets, count, at: list(map(make, octets[at : at + count]))
    if isinstance(element, CharacterLayout):
        return lambda octets, count, at: list(str(octets[at : at + count], "latin-1"))
    assert isinstance(element, NumberLayout)
    if element.code == "B":
        return lambda octets, count, at: memoryview(octets)[at : at + count]
    native = np.dtype(element.code)
    wire, empty, numbers = native.newbyteorder(order), np.empty(0, native), np.frombuffer
    empty.flags.writeable = False
    if wire == native:

        def read(octets: Any, count: int, at: int) -> Any:
            return numbers(octets, native, count, at) if count else empty

    else:

        def read(octets: Any, count: int, at: int) -> Any:
            return numbers(octets, wire, count, at).astype(native) if count else empty

    return read


def text_writer(
    layout: TextLayout, encoding: Encoding, order: ByteOrder
) -> Callable[[Message], Any]:
    """Return the function that makes a text's octets, of a wide one its length too.

    It raises UnfitValue.
    """
    charset = "utf-16-le" if layout.is_wide else encoding.charset
    bound, unit = layout.bound, 2 if layout.is_wide else 1
    closing = b"\0" if encoding.is_aligned else b""

    def encoded(given: Message) -> bytes:
        if not isinstance(given, str):
            raise UnfitValue(f"expected a string, got {shown(given)}")
        value = str.__str__(given)  # without the methods of a subclass
        if closing and "\0" in value:
            raise UnfitValue("expected a string without the character NUL, which would end it")
        try:
            data = value.encode(charset)
        except UnicodeEncodeError as error:
            text = f"cannot be written as {charset}: {shown(value)} ({error.reason})"
            raise UnfitValue(text) from error
        if bound is not None and len(data) > bound * unit:
            number = len(data) // unit
            raise UnfitValue(f"expected at most {bound} characters, got {number} (as {charset})")
        return data if layout.is_wide else data + closing

    if not layout.is_wide:
        return encoded
    if encoding.is_idl:
        return lambda value: _marked(encoded(value))
    wide = np.dtype(f"{order}u4")

    def units(value: Message) -> tuple[int, bytes]:
        numbers = np.frombuffer(encoded(value), "<u2")
        return len(numbers), numbers.astype(wide).tobytes()

    return units


def _marked(data: bytes) -> tuple[int, bytes]:
    """Put the byte order mark in front, as omniORB's code sets of GIOP 1.2 have it."""
    data = _LITTLE_MARK + data if data else b""
    return len(data), data


def text_reader(
    layout: TextLayout, encoding: Encoding, order: ByteOrder
) -> Callable[[bytes], str] | None:
    """Return the function that makes a text of its octets; it raises UnfitValue.

    None: the text is whatever the octets are in the character set.
    """
    if not encoding.is_idl:
        return _wide_reader(order) if layout.is_wide else None
    bound, charset = layout.bound, encoding.charset

    def read(data: bytes) -> str:
        try:
            if layout.is_wide:
                value = _unmarked(data)
            elif not data or data[-1] != 0 or 0 in data[:-1]:
                raise UnfitValue("expected a string that ends with its only zero")
            else:
                value = str(data[:-1], charset)
        except UnicodeDecodeError as error:
            raise UnfitValue(f"not a text in {error.encoding}: {shown(bytes(data))}") from error
        if bound is not None and len(value) > bound:
            raise UnfitValue(f"expected at most {bound} characters, got {len(value)}")
        return value

    return read


def _wide_reader(order: ByteOrder) -> Callable[[bytes], str]:
    """Fast CDR gives each unit of UTF-16 four octets."""
    wide = np.dtype(f"{order}u4")

    def read(data: bytes) -> str:
        units = np.frombuffer(data, wide) if len(data) else np.empty(0, wide)
        return units.astype("<u2").tobytes().decode("utf-16-le", "replace")

    return read


def _unmarked(data: bytes) -> str:
    if data[:2] == _LITTLE_MARK:
        return str(data[2:], "utf-16-le")
    return str(data[2:] if data[:2] == _BIG_MARK else data, "utf-16-be")


def write_wide_character(value: Message) -> bytes:
    """Return the three octets of a wide character; it raises UnfitValue."""
    if not isinstance(value, str) or len(value) != 1 or ord(value) > _LAST_OF_PLANE:
        raise UnfitValue(f"expected one character of the basic plane, got {shown(value)}")
    try:
        return b"\x02" + value.encode("utf-16-be")
    except UnicodeEncodeError as error:
        raise UnfitValue(f"cannot be written as {error.encoding}: {shown(value)}") from error


def wide_character_of(data: bytes) -> str:
    """Return the wide character of three octets; it raises UnfitValue."""
    if data[0] != 2:  # noqa: PLR2004 - the length of one unit of UTF-16
        raise UnfitValue(f"expected a wide character of 2 octets, got {data[0]}")
    try:
        return str(data[1:], "utf-16-be")
    except UnicodeDecodeError as error:
        raise UnfitValue(f"not a character of UTF-16: {shown(bytes(data))}") from error
