"""JSON text around octets: a small skeleton from the encoder, and base64 put in beside it.

The encoder never sees the octets' text, so it is neither copied nor searched.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import orjson
from pybase64 import b64encode

__all__ = ["dump_parts", "is_octets"]

# No JSON text holds this character as it is: in a string it is written as an escape.
_GAP = b"\0"
_PLACE = orjson.Fragment(b'"' + _GAP + b'"')


def dump_parts(
    message: Any, other: Callable[[Any], Any], option: int = 0
) -> tuple[bytes, list[bytes]]:
    """Return the skeleton of a message and the parts of its whole text, to be joined.

    Args:
        message: what to write.
        other: returns what the encoder can write for anything but octets.
        option: of orjson.

    Raises:
        TypeError: a value in it has no form.
    """
    octets: list[bytes] = []

    def write(value: Any) -> Any:
        if is_octets(value):
            octets.append(b64encode(_in_one_piece(value)))
            return _PLACE
        return other(value)

    skeleton = orjson.dumps(message, default=write, option=option)
    if not octets:
        return skeleton, [skeleton]
    pieces = skeleton.split(_GAP)
    parts = [pieces[0]]
    for text, piece in zip(octets, pieces[1:], strict=True):
        parts += (text, piece)
    return skeleton, parts


def is_octets(value: Any) -> bool:
    """Say whether a value stands for octets: a buffer of bytes in one dimension."""
    if isinstance(value, bytes | bytearray | memoryview):
        return True
    return hasattr(value, "__array_interface__") and value.dtype == "uint8" and value.ndim == 1


def _in_one_piece(value: Any) -> Any:
    view = memoryview(value)
    return value if view.c_contiguous else view.tobytes()
