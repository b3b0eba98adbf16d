"""Message structures of IDL types: JSON Schema with exact ranges and the native facts."""

from __future__ import annotations

import re
from typing import Any

from uoarm.model import MessageStructure
from uoarm_rtm._shape import (
    INTEGERS,
    IdlEnum,
    IdlScalar,
    IdlSequence,
    IdlString,
    IdlStruct,
    IdlUnion,
    IdlUnionMember,
    Shape,
)
from uoarm_rtm._units import unit_of

__all__ = ["DERIVED", "FLOAT_MAX", "SWITCH", "schema_of", "structure_of"]

FLOAT_MAX = 340282346638528859811704183484516925440
"""The greatest finite value of an IDL float."""

DERIVED = "IDL:uoarm/"
"""How the names of types begin that we derive from structures."""

SWITCH = "switch"
"""Where a message keeps a union's discriminator: a reserved word of IDL, so never a member."""

_REPOSITORY_ID = re.compile(r"IDL:(.+):([0-9.]+)")


def structure_of(shape: Shape, encoding: str = "utf-8") -> MessageStructure:
    """Return the structure of a shape; records are closed objects with every field required."""
    return MessageStructure(schema_of(shape, encoding), native_type=getattr(shape, "name", ""))


def schema_of(shape: Shape, encoding: str = "utf-8", unit: str | None = None) -> dict[str, Any]:
    """Return the schema of a shape.

    Args:
        shape: of the messages.
        encoding: of narrow strings, whose bounds count what they are written in.
        unit: holds for the numbers in it that state none.
    """
    if isinstance(shape, IdlStruct):
        return _record(shape, encoding, unit)
    if isinstance(shape, IdlSequence):
        return _array(shape, encoding, unit)
    if isinstance(shape, IdlUnion):
        return {"oneOf": list(_variants(shape, encoding)), "x-native-type": shape.name}
    if isinstance(shape, IdlEnum):
        return {"type": "string", "enum": list(shape.labels), "x-native-type": shape.name}
    if isinstance(shape, IdlString):
        return _string(shape, encoding)
    return _scalar(shape, unit)


def _string(text: IdlString, encoding: str) -> dict[str, Any]:
    schema: dict[str, Any] = {"type": "string", "x-nul": False}
    if text.bound is not None:
        schema["maxLength"] = text.bound
        if text.wide:
            schema["x-max-utf16"] = text.bound
        elif encoding == "utf-8":
            schema["x-max-utf8"] = text.bound
    return {**schema, "x-native-type": "wstring"} if text.wide else schema


def _record(record: IdlStruct, encoding: str, unit: str | None) -> dict[str, Any]:
    members = {
        member.name: schema_of(member.shape, encoding, unit or unit_of(record.name, member.name))
        for member in record.fields
    }
    schema = _object(members, record.name)
    named = _REPOSITORY_ID.fullmatch(record.name)
    # A type that we derived is named after its port: it is whatever its messages are.
    if named is not None and not record.name.startswith(DERIVED):
        schema["x-type"] = {"name": named[1].replace("/", "::"), "version": named[2]}
    return schema


def _object(properties: dict[str, Any], name: str) -> dict[str, Any]:
    schema: dict[str, Any] = {
        "type": "object",
        "properties": properties,
        "required": list(properties),
        "additionalProperties": False,
    }
    return {**schema, "x-native-type": name} if name else schema


def _array(listing: IdlSequence, encoding: str, unit: str | None) -> dict[str, Any]:
    items = schema_of(listing.element, encoding, unit)
    schema: dict[str, Any] = {"type": "array", "items": items}
    if listing.size is not None:
        schema["maxItems"] = listing.size
    if listing.fixed:
        schema["minItems"] = listing.size
    if listing.element == IdlScalar("octet"):
        schema["x-octets"] = True
    return schema


def _scalar(scalar: IdlScalar, unit: str | None = None) -> dict[str, Any]:
    name = scalar.name
    if name == "boolean":
        return {"type": "boolean"}
    if name in {"char", "wchar"}:
        last = "\\u00ff" if name == "char" else "\\uffff"
        character = {"minLength": 1, "maxLength": 1, "pattern": f"^[\\u0000-{last}]$"}
        return {"type": "string", **character, "x-native-type": name}
    if name in INTEGERS:
        low, high = INTEGERS[name]
        schema: dict[str, Any] = {"type": "integer", "minimum": low, "maximum": high}
        schema["x-native-type"] = name
    else:
        schema = {"type": "number", "x-native-type": name, "x-nonfinite": True}
        if name == "float":
            schema["minimum"], schema["maximum"] = -FLOAT_MAX, FLOAT_MAX
    return schema if unit is None else {**schema, "x-unit": unit}


def _variants(choice: IdlUnion, encoding: str) -> list[dict[str, Any]]:
    """Return one closed object for every member, and one for the values that have none."""
    schemas = []
    named = [label for variant in choice.variants for label in variant.labels]
    rest = _rest(choice.by, named)
    for variant in choice.variants:
        labels: dict[str, Any] = {"enum": list(variant.labels)}
        if not variant.labels:
            labels = rest or {"enum": []}
        schemas.append(_variant(choice, variant, labels, encoding))
    if rest is not None and all(variant.labels for variant in choice.variants):
        schemas.append(_object({SWITCH: rest}, choice.name))
    return schemas


def _variant(
    choice: IdlUnion, variant: IdlUnionMember, labels: dict[str, Any], encoding: str
) -> dict[str, Any]:
    inner = schema_of(variant.shape, encoding)
    return _object({SWITCH: labels, variant.name: inner}, choice.name)


def _rest(by: IdlScalar | IdlEnum, named: list[object]) -> dict[str, Any] | None:
    """Return the schema of the discriminator's other values, None when there are none."""
    if isinstance(by, IdlEnum) or by.name == "boolean":
        every: tuple[object, ...] = (False, True) if isinstance(by, IdlScalar) else by.labels
        left = [label for label in every if label not in named]
        return {"enum": left} if left else None
    if by.name not in INTEGERS:
        return {**_scalar(by), "not": {"enum": list(named)}}
    low, high = INTEGERS[by.name]
    gaps = []
    for label in sorted(label for label in named if isinstance(label, int)):
        if low < label:
            gaps.append({"type": "integer", "minimum": low, "maximum": label - 1})
        low = label + 1
    if low <= high:
        gaps.append({"type": "integer", "minimum": low, "maximum": high})
    return {"anyOf": gaps} if gaps else None
