"""Fields of a catalogue as message structures: JSON Schema with exact ranges and units."""

from __future__ import annotations

from typing import Any

from uoarm.bridge import Description
from uoarm.model import MessageStructure
from uoarm_rocos._catalogue import Api, Kind
from uoarm_rocos._fields import (
    BooleanField,
    Field,
    Fields,
    IntegerField,
    ListField,
    NumberField,
    OctetsField,
    StringField,
)
from uoarm_rocos._messages import Direction

__all__ = ["describe", "structure_of"]

_OCTET = {"type": "integer", "minimum": 0, "maximum": 255}


def describe(api: Api, direction: Direction | None) -> Description:
    """Return the structures of an API: of one direction of a flow, or (None) of a service."""
    sides = {
        Direction.INPUT: structure_of(api.input, f"{api.name}.input"),
        Direction.OUTPUT: structure_of(api.output, f"{api.name}.output"),
    }
    if api.kind is Kind.FLOW and direction is not None:
        return Description(message=sides[direction])
    return Description(request=sides[Direction.INPUT], reply=sides[Direction.OUTPUT])


def structure_of(fields: Fields, native_type: str = "") -> MessageStructure:
    """Return the structure of a message with these fields: a closed object."""
    return MessageStructure(_object(fields), native_type=native_type)


def _object(fields: Fields) -> dict[str, Any]:
    return {
        "type": "object",
        "properties": {name: _schema(member.type) for name, member in fields.items()},
        "required": [name for name, member in fields.items() if member.required],
        "additionalProperties": False,
    }


def _schema(kind: Field) -> dict[str, Any]:
    if isinstance(kind, BooleanField):
        return {"type": "boolean"}
    if isinstance(kind, IntegerField):
        return _named(
            {"type": "integer", "minimum": kind.minimum, "maximum": kind.maximum},
            **{"x-unit": kind.unit or None},
        )
    if isinstance(kind, NumberField):
        return _named(
            {"type": "number"},
            minimum=kind.minimum,
            maximum=kind.maximum,
            **{"x-unit": kind.unit or None, "x-nonfinite": kind.nonfinite or None},
        )
    if isinstance(kind, StringField):
        choices = list(kind.choices) or None
        return _named({"type": "string"}, enum=choices, maxLength=kind.max_length)
    if isinstance(kind, OctetsField):
        octets = {"type": "array", "items": _OCTET, "x-octets": True}
        return _named(octets, maxItems=kind.max_length)
    if isinstance(kind, ListField):
        return _named(
            {"type": "array", "items": _schema(kind.items)},
            minItems=kind.min_items or None,
            maxItems=kind.max_items,
        )
    return _object(kind.members)


def _named(schema: dict[str, Any], **keywords: object) -> dict[str, Any]:
    schema.update({key: value for key, value in keywords.items() if value is not None})
    return schema
