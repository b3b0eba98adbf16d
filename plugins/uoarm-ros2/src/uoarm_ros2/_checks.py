"""What native scalars and texts take: the slow half of writing, met only off the common path."""

from __future__ import annotations

import math
import operator
from collections.abc import Callable
from functools import partial

from uoarm.model import Message
from uoarm_ros2._schema import FLOAT32_MAX, integer_range
from uoarm_ros2._shape import Scalar, Text

__all__ = ["Misfit", "checker", "shown"]

_SHOWN = 60


class Misfit(Exception):  # noqa: N818 - never leaves the package: it becomes a MessageError
    """A value that its native field cannot hold; the text says what was expected."""


def shown(value: object) -> str:
    """Return a short, safe rendering of a value for an error's sentence."""
    text = f"{type(value).__name__} {value!r}"
    return text if len(text) <= _SHOWN else f"{text[:_SHOWN]}..."


def checker(shape: Scalar | Text) -> Callable[[Message], object]:
    """Return the function that makes a value fit for a native scalar or text, or raises Misfit."""
    if isinstance(shape, Text):
        return partial(_wide_text if shape.wide else _text, shape.bound)
    if shape.name == "bool":
        return _truth
    limits = integer_range(shape.name)
    if limits is None:
        return _float32 if shape.name == "float32" else _float64
    if shape.name == "byte":
        return _byte
    return partial(_integer, shape.name, *limits)


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


def _byte(value: Message) -> bytes:
    return bytes((_integer("byte", 0, 255, value),))


def _truth(value: Message) -> bool:
    if isinstance(value, bool):
        return value
    if type(value).__name__ in {"bool_", "bool"}:  # numpy's
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


def _text(bound: int | None, value: Message) -> str:
    return _encodable(value, "utf-8", 1, bound)


def _wide_text(bound: int | None, value: Message) -> str:
    return _encodable(value, "utf-16-le", 2, bound)


def _encodable(value: Message, encoding: str, unit: int, bound: int | None) -> str:
    if not isinstance(value, str):
        raise Misfit(f"expected a string, got {shown(value)}")
    if "\0" in value:
        raise Misfit("expected a string without the character NUL, at which ROS 2 would cut it")
    try:
        length = len(value.encode(encoding)) // unit
    except UnicodeEncodeError as error:
        text = f"expected a string of whole characters, got {shown(value)} ({error.reason})"
        raise Misfit(text) from error
    if bound is not None and length > bound:
        raise Misfit(f"expected at most {bound} {encoding} code units, got {length}")
    return value
