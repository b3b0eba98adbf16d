"""Arrays of scalars on their way to the wire: buffers pass whole, lists are converted once."""

from __future__ import annotations

from array import array
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np

from uoarm.model import Message
from uoarm_rtm._scalars import CODES, IdlMismatch, Order, checker, shown
from uoarm_rtm._shape import INTEGERS, IdlScalar, IdlSequence

__all__ = ["blocks", "counted", "is_block", "item"]


def is_block(listing: IdlSequence) -> bool:
    """Whether the elements lie on the wire one after another as one block."""
    return isinstance(listing.element, IdlScalar) and listing.element.name in CODES


def counted(listing: IdlSequence) -> Callable[[Message], int]:
    """Return the function that counts an array's elements, or raises Misfit."""
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
def item(index: int) -> Iterator[None]:
    """Put the index before what a Misfit says."""
    try:
        yield
    except IdlMismatch as error:
        raise IdlMismatch(f"[{index}]{'' if str(error).startswith('[') else ' '}{error}") from error


def blocks(listing: IdlSequence, order: Order) -> Callable[[Message], tuple[int, Any]]:
    """Return the function that makes (number of elements, their bytes); it raises Misfit."""
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
        with item(index):
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
    """Return the numbers as an array of the native type, or raise Misfit."""
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
            with item(int(np.flatnonzero(given == number)[0])):
                check(number)
    return given.astype(native)
