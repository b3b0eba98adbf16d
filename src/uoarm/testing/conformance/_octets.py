"""Octets as the contract has them in memory: bytes where a structure says `x-octets`."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from uoarm.model import Schema

__all__ = ["with_octets"]


def with_octets(schema: Schema, message: Any) -> Any:
    """Return the message with lists of octets replaced by bytes, where the schema is plain.

    Follows `$ref`s to definitions, properties and items; leaves unions as they are.
    """
    return _convert(schema, schema, message)


def _convert(root: Schema, schema: object, value: Any) -> Any:
    schema = _resolved(root, schema)
    if not isinstance(schema, Mapping):
        return value
    if isinstance(value, list):
        if schema.get("x-octets"):
            return bytes(map(int, value))  # 7.0 is an integer in JSON Schema
        first = schema.get("prefixItems", ())
        rest = schema.get("items")
        return [
            _convert(root, first[index] if index < len(first) else rest, each)
            for index, each in enumerate(value)
        ]
    if isinstance(value, dict):
        properties = schema.get("properties", {})
        return {name: _convert(root, properties.get(name), each) for name, each in value.items()}
    return value


def _resolved(root: Schema, schema: object) -> object:
    while isinstance(schema, Mapping) and "$ref" in schema and isinstance(root, Mapping):
        place = str(schema["$ref"])
        schema = root
        for key in place.removeprefix("#").split("/")[1:]:
            schema = schema[key] if isinstance(schema, Mapping) else None
    return schema
