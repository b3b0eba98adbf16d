"""Types that are installed nowhere here, from the description that a node gives of them.

A description is what `type_description_interfaces/srv/GetTypeDescription` replies, as a message.
It comes from another process: names are checked before they reach generated code, and sizes before
work.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import Any

from uoarm.errors import BridgeError, FailureReason
from uoarm.model import Message
from uoarm_ros2._middleware import untyped_class
from uoarm_ros2._shape import Field, Listing, Record, Scalar, Shape, Text
from uoarm_ros2._type_hash import BOUNDED_TEXTS, EMPTY, KINDS, NESTED, SCALARS, TEXTS
from uoarm_ros2._types import type_mistake

__all__ = ["described_type"]

_FIELD = re.compile(r"[A-Za-z][A-Za-z0-9_]{0,254}")
_MOST_TYPES = 256
_MOST_FIELDS = 4096
_MOST_DEPTH = 32


def described_type(description: Message, name: str, definition: str) -> type:
    """Return a class for a type of which there is only a description.

    Args:
        description: a `TypeDescription` as a message.
        name: of the type that was asked for.
        definition: the hash of its definition.

    Raises:
        BridgeError: the description is none of this type, or is more than is taken.
    """
    reading = _Reading(description, name)
    return reading.record(name, definition, 0).native


class _Reading:
    """One description; the types that it refers to are read where they are used."""

    def __init__(self, description: Message, name: str) -> None:
        self._name = name
        referenced = description["referenced_type_descriptions"]
        if len(referenced) > _MOST_TYPES:
            raise self._refused(f"it refers to {len(referenced)} types, more than {_MOST_TYPES}")
        own = description["type_description"]
        self._types = {item["type_name"]: item["fields"] for item in (*referenced, own)}
        self._left = _MOST_FIELDS

    def record(self, name: str, definition: str, depth: int) -> Record:
        """Return the shape of one of the types."""
        fields = self._types.get(name)
        if fields is None:
            raise self._refused(f"{name} is not in it")
        if type_mistake(name):
            raise self._refused(type_mistake(name))
        if depth > _MOST_DEPTH:
            raise self._refused(f"nested more than {_MOST_DEPTH} deep")
        self._left -= len(fields)
        if self._left < 0:
            raise self._refused(f"more than {_MOST_FIELDS} fields")
        read = tuple(self._field(field, depth) for field in fields if field["name"] != EMPTY)
        slots = tuple(field.attribute for field in read)
        if len(set(slots)) != len(slots):
            raise self._refused(f"{name} has two fields of one name")
        native: Any = untyped_class(name, definition, {"__slots__": slots})
        record = Record(name, native, read, {}, slots)
        native.described = record
        return record

    def _field(self, field: Mapping[str, Any], depth: int) -> Field:
        name = field["name"]
        if not _FIELD.fullmatch(name):
            raise self._refused(f"a field is called {name!r:.60}")
        return Field(name, f"_{name}", self._shape(field["type"], depth))

    def _shape(self, kind: Mapping[str, Any], depth: int) -> Shape:
        many, number = divmod(kind["type_id"] - 1, KINDS)
        element = self._element(number + 1, kind, depth)
        if many == 0:
            return element
        if many == 1:
            return Listing(element, kind["capacity"], fixed=True)
        return Listing(element, kind["capacity"] if many == 2 else None)  # noqa: PLR2004 - bounded

    def _element(self, number: int, kind: Mapping[str, Any], depth: int) -> Scalar | Text | Record:
        if number == NESTED:
            return self.record(kind["nested_type_name"], "", depth + 1)
        if number in TEXTS:
            bound = kind["string_capacity"] if number in BOUNDED_TEXTS else None
            return Text(wide=TEXTS[number], bound=bound)
        if number in SCALARS:
            return Scalar(SCALARS[number])
        raise self._refused(f"there is a field of the type number {kind['type_id']}")

    def _refused(self, why: str) -> BridgeError:
        text = f"the description of {self._name} that its node gives cannot be used: {why}"
        return BridgeError(text, FailureReason.UNSUPPORTED)
