"""Message structures as rosapi describes message types: fields, their types, array lengths."""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import Any

from uoarm.errors import MessageError
from uoarm.model import MessageStructure
from uoarm_rosbridge._basic import basic_type

__all__ = ["check_type", "full_text", "is_same_type", "type_name", "typedefs"]

_MOST = 200
_VARIABLE, _SINGLE = 0, -1
_RULE = "=" * 80
_ROS_TYPE = re.compile(r"[a-z][a-z0-9_]*/msg/[A-Z][A-Za-z0-9]*")


def type_name(structure: MessageStructure, function: str) -> str:
    """Return the native name of a type, or one made of the function's name."""
    return structure.native_type or f"uoarm/{function}"


def check_type(topic: str, stated: str, structure: MessageStructure) -> None:
    """Refuse another type than that of ROS 2; elsewhere clients call types what they like.

    Raises:
        MessageError: it is another one.
    """
    actual = structure.native_type
    if stated and _ROS_TYPE.fullmatch(actual) and not is_same_type(stated, actual):
        raise MessageError(f"topic {topic!r} has the type {actual!r}, not {stated!r:.100}")


def is_same_type(one: str, other: str) -> bool:
    """Say whether two names are of one type; ROS 1 clients leave the `/msg` out."""
    return one.replace("/msg/", "/") == other.replace("/msg/", "/")


def typedefs(structure: MessageStructure, function: str) -> list[dict[str, Any]]:
    """Return the definitions of a message type and the types within it, outermost first."""
    found: list[dict[str, Any]] = []
    waiting: list[tuple[str, object]] = [(type_name(structure, function), structure.schema)]
    while waiting and len(found) < _MOST:
        name, schema = waiting.pop(0)
        definition: dict[str, Any] = {
            "type": name,
            "fieldnames": [],
            "fieldtypes": [],
            "fieldarraylen": [],
            "examples": [],
            "constnames": [],
            "constvalues": [],
        }
        for field, inner in _properties(schema).items():
            kind, length, element = _field(f"{name}/{field}", inner)
            definition["fieldnames"].append(field)
            definition["fieldtypes"].append(kind)
            definition["fieldarraylen"].append(length)
            definition["examples"].append("[]" if length != _SINGLE else "{}")
            if _properties(element):
                waiting.append((kind, element))
        found.append(definition)
    return found


def full_text(definitions: list[dict[str, Any]]) -> str:
    """Return definitions as the text of a message file and, after rules, of those within it."""
    texts = []
    for one in definitions:
        lengths = ["" if n == _SINGLE else f"[{n or ''}]" for n in one["fieldarraylen"]]
        fields = zip(one["fieldtypes"], lengths, one["fieldnames"], strict=True)
        texts.append("".join(f"{kind}{length} {name}\n" for kind, length, name in fields))
    inner = zip(definitions[1:], texts[1:], strict=True)
    return "".join(texts[:1] + [f"{_RULE}\nMSG: {one['type']}\n{text}" for one, text in inner])


def _field(name: str, schema: object) -> tuple[str, int, object]:
    """Return the type of a field, its length as an array, and the schema of one element."""
    if not isinstance(schema, Mapping):
        return name, _SINGLE, schema
    if schema.get("type") == "array":
        fixed = schema.get("minItems")
        length = fixed if fixed == schema.get("maxItems") and isinstance(fixed, int) else _VARIABLE
        kind, _, element = _field(name, schema.get("items"))
        return kind, length, element
    native = schema.get("x-native-type")
    basic = basic_type(schema)
    return basic or (native if isinstance(native, str) else name), _SINGLE, schema


def _properties(schema: object) -> Mapping[str, object]:
    found = schema.get("properties") if isinstance(schema, Mapping) else None
    return found if isinstance(found, Mapping) else {}
