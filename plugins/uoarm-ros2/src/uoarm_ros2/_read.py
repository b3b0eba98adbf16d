"""From native objects to messages: one generated function per type, no dispatch when it runs.

The function is one expression over the native object's attributes, nested records written out in
place. Numeric sequences pass as the buffers they are, octets as a read-only view of theirs.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache
from itertools import count

from uoarm.model import Message
from uoarm_ros2._generate import Source
from uoarm_ros2._shape import Listing, Record, Scalar, Shape

__all__ = ["reader"]


@lru_cache(maxsize=1024)
def reader(record: Record) -> Callable[[object], Message]:
    """Return the function that makes a message of a native object of this type."""
    source = Source("read", "native")
    fresh = count()
    source.line(f"return {_record(record, 'native', source, fresh)}")
    return source.function()


def _record(record: Record, holder: str, source: Source, fresh: count[int]) -> str:
    members = (
        f"{field.name!r}: {_value(field.shape, f'{holder}.{field.attribute}', source, fresh)}"
        for field in record.fields
    )
    return "{" + ", ".join(members) + "}"


def _value(shape: Shape, place: str, source: Source, fresh: count[int]) -> str:
    if isinstance(shape, Record):
        holder = f"r{next(fresh)}"
        source.line(f"{holder} = {place}")
        return _record(shape, holder, source, fresh)
    if isinstance(shape, Listing):
        return _listing(shape, place, source)
    if shape == Scalar("byte"):
        return f"{place}[0]"
    return place


def _listing(listing: Listing, place: str, source: Source) -> str:
    if isinstance(listing.element, Record):
        return f"[{source.constant(reader(listing.element))}(each) for each in {place}]"
    if listing.element == Scalar("byte"):
        return f"b''.join({place})"
    if listing.element == Scalar("uint8"):
        return f"memoryview({place}).toreadonly()"
    return place
