"""Arrays on their way into native fields: buffers pass whole, everything else is converted once.

A native sequence of numbers takes any contiguous buffer of its own element type, a native fixed
array takes a numpy array. Both are recognised in two comparisons and passed without a copy.
"""

from __future__ import annotations

import math
from array import array
from collections.abc import Callable
from contextlib import suppress
from typing import Any

import numpy as np
import numpy.typing as npt

from uoarm.model import Message
from uoarm_ros2._checks import Misfit, checker, shown
from uoarm_ros2._schema import FLOAT32_MAX, integer_range
from uoarm_ros2._shape import NUMBER_CODES, Listing, Scalar, Text

__all__ = ["is_buffer", "taker"]


def is_buffer(listing: Listing) -> bool:
    """Whether the native field is one block of numbers."""
    return isinstance(listing.element, Scalar) and listing.element.name in NUMBER_CODES


def taker(listing: Listing) -> Callable[[Message], object]:
    """Return the function that makes a value fit for a native array, or raises Misfit.

    The listing's elements are scalars or texts.
    """
    counted = _counter(listing)
    if isinstance(listing.element, Scalar) and listing.element.name in NUMBER_CODES:
        return _buffers(listing.element.name, counted, fixed=listing.fixed)
    if isinstance(listing.element, Scalar) and listing.element.name == "byte":
        octets = _buffers("uint8", counted, fixed=False)
        return lambda value: [bytes((number,)) for number in memoryview(octets(value))]  # type: ignore[arg-type]  # a buffer
    assert isinstance(listing.element, Scalar | Text)
    return _items(listing.element, counted)


def _counter(listing: Listing) -> Callable[[int], None]:
    size, fixed = listing.size, listing.fixed

    def counted(count: int) -> None:
        if size is not None and (count != size if fixed else count > size):
            raise Misfit(f"expected {'' if fixed else 'at most '}{size} elements, got {count}")

    return counted


def _items(element: Scalar | Text, counted: Callable[[int], None]) -> Callable[[Message], object]:
    check = checker(element)

    def take(value: Message) -> object:
        if isinstance(value, str | bytes) or not hasattr(value, "__len__"):
            raise Misfit(f"expected an array, got {shown(value)}")
        counted(len(value))
        items = []
        for index, item in enumerate(value):
            try:
                items.append(check(item))
            except Misfit as error:
                raise Misfit(f"[{index}] {error}") from error
        return items

    return take


def _buffers(
    name: str, counted: Callable[[int], None], *, fixed: bool
) -> Callable[[Message], object]:
    dtype, code = np.dtype(name), NUMBER_CODES[name]
    octets = name == "uint8"

    def take(value: Message) -> object:
        kind = type(value)
        if kind is np.ndarray:
            ready = value.dtype == dtype and value.ndim == 1 and value.flags.c_contiguous
        elif kind is array:
            ready = not fixed and value.typecode == code
        else:
            ready = kind is bytes and octets and not fixed
        if not ready:
            value = _converted(value, name, dtype, code)
        counted(len(value))
        return value

    return take


def _converted(value: Message, name: str, dtype: np.dtype[np.generic], code: str) -> Message:
    """Return a numpy array of the field's element type that holds the same numbers."""
    if isinstance(value, bytes | bytearray | memoryview | array):
        view = memoryview(value)
        if isinstance(value, bytes | bytearray) and name != "uint8":
            raise Misfit(f"expected an array of {name}, got octets")
        if view.ndim != 1:
            raise Misfit(f"expected an array of one dimension, got {view.ndim}")
        # memoryview(b"") of zero length has no address that numpy would take.
        given = np.asarray(view) if len(view) > 0 else np.empty(0, dtype)
    elif isinstance(value, np.ndarray):
        if value.ndim != 1:
            raise Misfit(f"expected an array of one dimension, got {value.ndim}")
        given = value
    elif isinstance(value, list | tuple):
        return _listed(value, name, dtype, code)
    else:
        raise Misfit(f"expected an array of {name}, got {shown(value)}")
    return _fitted(given, name, dtype)


def _listed(
    value: list[Message] | tuple[Message, ...], name: str, dtype: np.dtype[np.generic], code: str
) -> npt.NDArray[np.generic]:
    if not value:
        return np.empty(0, dtype)
    kinds = set(map(type, value))
    if code in "fd" and kinds == {float}:
        return _fitted(np.array(value, np.float64), name, dtype)
    if code not in "fd" and kinds == {int}:
        with suppress(OverflowError):
            return np.frombuffer(array(code, value), dtype)
    check = checker(Scalar(name))
    items = []
    for index, item in enumerate(value):
        try:
            items.append(check(item))
        except Misfit as error:
            raise Misfit(f"[{index}] {error}") from error
    return np.array(items, dtype)


def _fitted(
    given: npt.NDArray[np.generic], name: str, dtype: np.dtype[np.generic]
) -> npt.NDArray[np.generic]:
    if given.dtype == dtype:
        return np.ascontiguousarray(given)
    limits = integer_range(name)
    wanted = "iu" if limits is not None else "iuf"
    if given.dtype.kind not in wanted:
        raise Misfit(f"expected an array of {name}, got an array of {given.dtype}")
    least, greatest = limits or (-FLOAT32_MAX, FLOAT32_MAX)
    if given.size and (limits is not None or (name == "float32" and given.dtype.kind == "f")):
        _within(given, name, least, greatest)
    return np.ascontiguousarray(given, dtype)


def _within(given: npt.NDArray[np.generic], name: str, least: int, greatest: int) -> None:
    """Raise Misfit naming the first element out of range; NaN and infinities pass as floats."""
    numbers: npt.NDArray[Any] = given
    finite = numbers[np.isfinite(numbers)] if numbers.dtype.kind == "f" else numbers
    if not finite.size or (least <= finite.min().item() and finite.max().item() <= greatest):
        return
    for index, item in enumerate(numbers.tolist()):
        if math.isfinite(item) and not least <= item <= greatest:
            raise Misfit(f"[{index}] expected {least} to {greatest} ({name}), got {item!r}")
