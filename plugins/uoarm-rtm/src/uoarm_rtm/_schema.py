"""Message structures of IDL types: JSON Schema with exact ranges and the native facts."""

from __future__ import annotations

from typing import Any

from uoarm.model import MessageStructure
from uoarm_rtm._shape import (
    INTEGERS,
    Choice,
    Enumeration,
    Listing,
    Record,
    Scalar,
    Shape,
    Text,
    Variant,
)

__all__ = ["FLOAT_MAX", "SWITCH", "schema_of", "structure_of"]

FLOAT_MAX = 340282346638528859811704183484516925440
"""The greatest finite value of an IDL float."""

SWITCH = "switch"
"""Where a message keeps a union's discriminator: a reserved word of IDL, so never a member."""


def structure_of(shape: Shape) -> MessageStructure:
    """Return the structure of a shape; records are closed objects with every field required."""
    return MessageStructure(schema_of(shape), native_type=getattr(shape, "name", ""))


def schema_of(shape: Shape) -> dict[str, Any]:
    """Return the schema of a shape."""
    if isinstance(shape, Record):
        return _object({each.name: schema_of(each.shape) for each in shape.fields}, shape.name)
    if isinstance(shape, Listing):
        return _array(shape)
    if isinstance(shape, Choice):
        return {"oneOf": list(_variants(shape)), "x-native-type": shape.name}
    if isinstance(shape, Enumeration):
        return {"type": "string", "enum": list(shape.labels), "x-native-type": shape.name}
    if isinstance(shape, Text):
        schema: dict[str, Any] = {"type": "string"}
        if shape.bound is not None:
            schema["maxLength"] = shape.bound
        return {**schema, "x-native-type": "wstring"} if shape.wide else schema
    return _scalar(shape)


def _object(properties: dict[str, Any], name: str) -> dict[str, Any]:
    schema: dict[str, Any] = {
        "type": "object",
        "properties": properties,
        "required": list(properties),
        "additionalProperties": False,
    }
    return {**schema, "x-native-type": name} if name else schema


def _array(listing: Listing) -> dict[str, Any]:
    schema: dict[str, Any] = {"type": "array", "items": schema_of(listing.element)}
    if listing.size is not None:
        schema["maxItems"] = listing.size
    if listing.fixed:
        schema["minItems"] = listing.size
    if listing.element == Scalar("octet"):
        schema["x-octets"] = True
    return schema


def _scalar(scalar: Scalar) -> dict[str, Any]:
    name = scalar.name
    if name == "boolean":
        return {"type": "boolean"}
    if name in {"char", "wchar"}:
        last = "\\u00ff" if name == "char" else "\\uffff"
        one = {"minLength": 1, "maxLength": 1, "pattern": f"^[\\u0000-{last}]$"}
        return {"type": "string", **one, "x-native-type": name}
    if name in INTEGERS:
        low, high = INTEGERS[name]
        return {"type": "integer", "minimum": low, "maximum": high, "x-native-type": name}
    schema: dict[str, Any] = {"type": "number", "x-native-type": name, "x-nonfinite": True}
    if name == "float":
        schema["minimum"], schema["maximum"] = -FLOAT_MAX, FLOAT_MAX
    return schema


def _variants(choice: Choice) -> list[dict[str, Any]]:
    """Return one closed object for every member, and one for the values that have none."""
    schemas = []
    named = [label for each in choice.variants for label in each.labels]
    rest = _rest(choice.by, named)
    for each in choice.variants:
        labels: dict[str, Any] = {"enum": list(each.labels)}
        if not each.labels:
            labels = rest or {"enum": []}
        schemas.append(_variant(choice, each, labels))
    if rest is not None and all(each.labels for each in choice.variants):
        schemas.append(_object({SWITCH: rest}, choice.name))
    return schemas


def _variant(choice: Choice, variant: Variant, labels: dict[str, Any]) -> dict[str, Any]:
    return _object({SWITCH: labels, variant.name: schema_of(variant.shape)}, choice.name)


def _rest(by: Scalar | Enumeration, named: list[object]) -> dict[str, Any] | None:
    """Return the schema of the discriminator's other values, None when there are none."""
    if isinstance(by, Enumeration) or by.name == "boolean":
        every: tuple[object, ...] = (False, True) if isinstance(by, Scalar) else by.labels
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
