"""What the fields of ROS 1 take: checks of single values, and arrays as octets of the wire.

Buffers of the field's own type pass whole; everything else is converted once, and checked.
"""

from __future__ import annotations

import math
import operator
from array import array
from collections.abc import Callable, Sized
from functools import lru_cache, partial
from typing import Any

import numpy as np

from uoarm.model import Message
from uoarm_ros1._definitions import NUMBERS, Listing, Scalar

__all__ = ["FLOAT32_MAX", "Misfit", "checker", "integer_range", "octets_of", "shown", "text_octets"]

FLOAT32_MAX = 340282346638528859811704183484516925440
_SHOWN = 60
_SIZES = {"b": 1, "h": 2, "i": 4, "q": 8}


class Misfit(Exception):  # noqa: N818 - never leaves the package: it becomes a MessageError
    """A value that its field cannot hold; the text says what was expected."""


def shown(value: object) -> str:
    """Return a short, safe rendering of a value for an error's sentence."""
    text = f"{type(value).__name__} {value!r}"
    return text if len(text) <= _SHOWN else f"{text[:_SHOWN]}..."


@lru_cache(maxsize=64)
def integer_range(name: str) -> tuple[int, int] | None:
    """Return the least and greatest value of an integer type, None for other scalars."""
    code = NUMBERS.get(name, "?")
    if code not in "bBhHiIqQ":
        return None
    bits = 8 * _SIZES[code.lower()]
    return (-(2 ** (bits - 1)), 2 ** (bits - 1) - 1) if code.islower() else (0, 2**bits - 1)


def checker(scalar: Scalar) -> Callable[[Message], Any]:
    """Return the function that makes a value fit for a scalar, or raises Misfit."""
    if scalar.name == "bool":
        return _truth
    limits = integer_range(scalar.name)
    if limits is None:
        return _float32 if scalar.name == "float32" else _float64
    return partial(_integer, scalar.name, *limits)


def _integer(name: str, least: int, greatest: int, value: Message) -> int:
    if isinstance(value, bool) or (isinstance(value, float) and not value.is_integer()):
        raise Misfit(f"expected an integer ({name}), got {shown(value)}")
    try:
        number = int(value) if isinstance(value, float) else operator.index(value)
    except (TypeError, OverflowError) as error:
        raise Misfit(f"expected an integer ({name}), got {shown(value)}") from error
    if not least <= number <= greatest:
        raise Misfit(f"expected {least} to {greatest} ({name}), got {shown(value)}")
    return number


def _truth(value: Message) -> bool:
    if isinstance(value, bool | np.bool_):
        return bool(value)
    raise Misfit(f"expected true or false, got {shown(value)}")


def _float64(value: Message) -> float:
    if isinstance(value, bool | str | bytes):
        raise Misfit(f"expected a number, got {shown(value)}")
    try:
        return float(value)
    except (TypeError, ValueError, OverflowError) as error:
        raise Misfit(f"expected a number (float64), got {shown(value)}") from error


def _float32(value: Message) -> float:
    number = _float64(value)
    if math.isfinite(number) and not -FLOAT32_MAX <= number <= FLOAT32_MAX:
        raise Misfit(f"expected at most 3.4028234663852886e38 in size (float32), got {number!r}")
    return number


def text_octets(value: Message) -> bytes:
    """Return a text as UTF-8, or raise Misfit."""
    if not isinstance(value, str):
        raise Misfit(f"expected a string, got {shown(value)}")
    try:
        return value.encode()
    except UnicodeEncodeError as error:
        text = f"expected a string of whole characters, got {shown(value)} ({error.reason})"
        raise Misfit(text) from error


@lru_cache(maxsize=256)
def octets_of(listing: Listing) -> Callable[[Message], tuple[int, Any]]:
    """Return what makes of an array of scalars how many they are, and their octets."""
    element, size = listing.element, listing.size
    assert isinstance(element, Scalar)
    if element.name == "bool":
        return partial(_truths, size)
    code = NUMBERS[element.name]
    dtype = np.dtype(f"<{code}")
    octets = code == "B"
    width = dtype.itemsize

    def take(value: Message) -> tuple[int, Any]:
        kind = type(value)
        if octets and (kind is bytes or kind is memoryview) and _is_plain(value):
            count, ready = len(value), value
        elif kind is np.ndarray and value.dtype == dtype and value.ndim == 1:
            count, ready = len(value), value.tobytes() if width > 1 else value.data
        else:
            given = _converted(value, element.name, dtype)
            count, ready = len(given), given.tobytes()
        _require_size(size, count)
        return count, ready

    return take


def _is_plain(value: bytes | memoryview) -> bool:
    return isinstance(value, bytes) or (
        value.format == "B" and value.ndim == 1 and value.contiguous
    )


def _require_size(size: int | None, count: int) -> None:
    if size is not None and count != size:
        raise Misfit(f"expected {size} elements, got {count}")


def _truths(size: int | None, value: Message) -> tuple[int, bytes]:
    if isinstance(value, str | bytes) or not isinstance(value, Sized):
        raise Misfit(f"expected an array, got {shown(value)}")
    _require_size(size, len(value))
    return len(value), bytes(_items(value, _truth))


def _items(value: Any, check: Callable[[Message], Any]) -> list[Any]:
    items = []
    for index, item in enumerate(value):
        try:
            items.append(check(item))
        except Misfit as error:
            raise Misfit(f"[{index}] {error}") from error
    return items


def _converted(value: Message, name: str, dtype: np.dtype[Any]) -> np.ndarray[Any, Any]:
    """Return an array of the field's element type that holds the same numbers."""
    if isinstance(value, bytes | bytearray | memoryview | array):
        view = memoryview(value)
        if isinstance(value, bytes | bytearray) and dtype != np.dtype("u1"):
            raise Misfit(f"expected an array of {name}, got octets")
        if view.ndim != 1:
            raise Misfit(f"expected an array of one dimension, got {view.ndim}")
        # memoryview(b"") of zero length has no address that numpy would take.
        return _fitted(np.asarray(view) if len(view) > 0 else np.empty(0, dtype), name, dtype)
    if isinstance(value, np.ndarray):
        if value.ndim != 1:
            raise Misfit(f"expected an array of one dimension, got {value.ndim}")
        return _fitted(value, name, dtype)
    if not isinstance(value, list | tuple):
        raise Misfit(f"expected an array of {name}, got {shown(value)}")
    if dtype == np.dtype("<f8") and set(map(type, value)) == {float}:
        return np.array(value, dtype)
    return np.array(_items(value, checker(Scalar(name))), dtype)


def _fitted(given: np.ndarray[Any, Any], name: str, dtype: np.dtype[Any]) -> np.ndarray[Any, Any]:
    if given.dtype == dtype:
        return given
    limits = integer_range(name)
    if given.dtype.kind not in ("iu" if limits is not None else "iuf"):
        raise Misfit(f"expected an array of {name}, got an array of {given.dtype}")
    least, greatest = limits or (-FLOAT32_MAX, FLOAT32_MAX)
    if given.size and (limits is not None or (name == "float32" and given.dtype.kind == "f")):
        finite = given[np.isfinite(given)] if given.dtype.kind == "f" else given
        if finite.size and not (least <= finite.min().item() and finite.max().item() <= greatest):
            index = next(
                index
                for index, item in enumerate(given.tolist())
                if math.isfinite(item) and not least <= item <= greatest
            )
            bad = given[index].item()
            raise Misfit(f"[{index}] expected {least} to {greatest} ({name}), got {bad!r}")
    return np.asarray(given, dtype)
