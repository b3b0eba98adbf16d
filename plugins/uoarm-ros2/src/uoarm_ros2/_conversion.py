"""Between native objects and messages: what ROS 2 serialises of the one, the codec of the other.

So a value means in a service what it means on a topic, and what does not fit is refused in the
same words.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from functools import lru_cache
from typing import Any

from uoarm.cdr import Codec
from uoarm.errors import MessageError
from uoarm.model import Message
from uoarm_ros2._middleware import deserialised, serialised
from uoarm_ros2._types import ArrayType, RecordType, ScalarType, Shape, structure_of

_CHARACTER = ScalarType("char")


@lru_cache(maxsize=1024)
def codec_of(record: RecordType) -> Codec:
    """Return what serialises and reads messages of a type."""
    return Codec(structure_of(record))


def reader(record: RecordType) -> Callable[[object], Message]:
    """Return the function that makes a message of a native object of this type."""
    decode = codec_of(record).decode
    return lambda native: decode(serialised(native))


def writer(record: RecordType) -> Callable[[Message], object]:
    """Return the function that makes a native object of a message.

    It raises MessageError with the path of the field that is missing, unknown or unfit.
    """
    codec, has_characters = codec_of(record), _has_characters(record)

    def write(message: Message) -> object:
        octets = codec.encode(message)
        if has_characters:
            for place, number in _characters(record, codec.decode(octets), "$"):
                # A char is a text in Python, of which ROS 2 sends the first octet of its UTF-8.
                if number > 127:  # noqa: PLR2004 - ASCII
                    why = f"expected 0 to 127 (char), got {number}"
                    raise MessageError(f"{record.name}: {place}: {why}")
        return deserialised(octets, record.native)

    return write


def _has_characters(shape: Shape) -> bool:
    if isinstance(shape, RecordType):
        return any(_has_characters(field.shape) for field in shape.fields)
    return _has_characters(shape.element) if isinstance(shape, ArrayType) else shape == _CHARACTER


def _characters(shape: Shape, value: Any, place: str) -> Iterator[tuple[str, int]]:
    if isinstance(shape, RecordType):
        for field in shape.fields:
            yield from _characters(field.shape, value[field.name], f"{place}.{field.name}")
    elif isinstance(shape, ArrayType):
        for index, element in enumerate(value):
            yield from _characters(shape.element, element, f"{place}[{index}]")
    elif shape == _CHARACTER:
        yield place, value
