"""How much memory a message holds, for budgets: what it takes as objects, not as text."""

from __future__ import annotations

from collections.abc import Mapping
from sys import getsizeof
from typing import Any

from uoarm.model._values import Message

__all__ = ["message_octets"]

_FLAT = {int, float, bool, type(None), str, bytes}
_MANY = 32


def message_octets(message: Message, *, most: int | None = None) -> int:
    """Return how many octets of memory a message holds: its decoded values, with their containers.

    An estimate on the safe side: what several places share (a name, a small number) is counted at
    each; of an object beyond the data model only what it says of itself. Never raises, never
    recurses, linear in the number of values; a buffer is one value, and long lists of numbers or
    texts are counted at the speed of C.

    Args:
        message: any value of the data model, with octets and numeric buffers.
        most: counting stops when this is passed; the result is then some number above it.
    """
    octets = 0
    waiting: list[Any] = [message]
    while waiting:
        one = waiting.pop()
        kind = type(one)
        octets += getsizeof(one)
        if most is not None and octets > most:
            break  # before the values of a long list are even looked at
        if kind in _FLAT:
            continue
        if kind is dict or isinstance(one, Mapping):
            octets += sum(map(getsizeof, one))
            waiting.extend(one.values())
        elif isinstance(one, list | tuple):
            if len(one) > _MANY and set(map(type, one)) <= _FLAT:
                octets += sum(map(getsizeof, one))
            else:
                waiting.extend(one)
        elif isinstance(size := getattr(one, "nbytes", None), int):
            octets += max(size - getsizeof(one), 0)  # what a view or a numpy array stands for
    return octets
