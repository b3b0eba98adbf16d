"""Values as the contract has them in memory: octets as bytes, integers as int."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

from uoarm.model import Schema
from uoarm.testing._collector import plain

__all__ = ["find_other_type", "with_integers", "with_length", "with_octets"]

_BUFFERS = (bytes, bytearray, memoryview)
_LONG = 300
_SAMPLES: Mapping[str, Any] = {"boolean": True, "integer": 1, "number": 1.0, "string": "item"}
_RESTRICTIONS = frozenset(
    {"const", "contains", "enum", "format", "maxItems", "maxLength", "pattern", "uniqueItems"}
    | {"allOf", "anyOf", "dependentSchemas", "if", "multipleOf", "not", "oneOf", "prefixItems"}
    | {"exclusiveMaximum", "exclusiveMinimum", "minimum", "maximum", "unevaluatedItems"}
    | {"x-max-utf8", "x-max-utf16"}
)
_TYPES: Mapping[str, type] = {"integer": int, "boolean": bool, "string": str}


def with_octets(schema: Schema, message: Any) -> Any:
    """Return the message with lists of octets replaced by bytes, where the schema is plain.

    Follows `$ref`s to definitions, properties and items; leaves unions as they are.
    """
    return _convert(schema, schema, message, strictly=False)


def with_integers(schema: Schema, message: Any) -> Any:
    """Return the message as `with_octets` does, and 7.0 as 7 where an integer is wanted."""
    return _convert(schema, schema, message, strictly=True)


def with_length(schema: Schema, message: Any) -> Any:
    """Return the message with long texts and lists of scalars, where the schema is plain."""
    return _lengthen(schema, schema, message)


def find_other_type(schema: Schema, came: Any) -> str:
    """Say where a message has another type in memory than the contract says, "" where nowhere."""
    return next(_other_types(schema, schema, came, "the message"), "")


def _convert(root: Schema, schema: object, value: Any, *, strictly: bool) -> Any:
    schema = _resolved(root, schema)
    if not isinstance(schema, Mapping):
        return value
    if strictly and isinstance(value, float) and schema.get("type") == "integer":
        return int(value)
    if isinstance(value, list):
        if schema.get("x-octets"):
            return bytes(map(int, value))  # 7.0 is an integer in JSON Schema
        return [
            _convert(root, _item(schema, index), item, strictly=strictly)
            for index, item in enumerate(value)
        ]
    if isinstance(value, dict):
        properties = schema.get("properties", {})
        return {
            name: _convert(root, properties.get(name), item, strictly=strictly)
            for name, item in value.items()
        }
    return value


def _lengthen(root: Schema, schema: object, value: Any) -> Any:
    schema = _resolved(root, schema)
    if not isinstance(schema, Mapping) or _RESTRICTIONS & schema.keys():
        return value
    if isinstance(value, str):
        return ("long " * _LONG)[:_LONG]
    if isinstance(value, list):
        wanted: Any = schema.get("items")
        plain_item = isinstance(wanted, Mapping) and _one_type(wanted) in _SAMPLES
        if not plain_item or wanted.keys() & _RESTRICTIONS - {"minimum", "maximum"}:
            return value
        sample = _SAMPLES[wanted["type"]]
        fits = wanted.get("minimum", 0) <= 1 <= wanted.get("maximum", 1)
        return [sample] * _LONG if fits else value
    if isinstance(value, dict):
        properties = schema.get("properties", {})
        return {name: _lengthen(root, properties.get(name), item) for name, item in value.items()}
    return value


def _other_types(root: Schema, schema: object, value: Any, at: str) -> Iterator[str]:
    schema = _resolved(root, schema)
    if not isinstance(schema, Mapping):
        return
    wanted = _one_type(schema)
    if wanted in _TYPES and type(value) is not _TYPES[wanted]:
        yield f"{at} is {value!r}, a {type(value).__name__} where the structure says {wanted}"
    elif schema.get("x-octets"):
        if not isinstance(value, _BUFFERS):
            yield f"{at}: octets came as {type(value).__name__}, expected bytes"
    elif wanted == "array":
        for index, item in enumerate(plain(value)):
            yield from _other_types(root, _item(schema, index), item, f"{at}[{index}]")
    elif isinstance(value, Mapping):
        for name, property_ in schema.get("properties", {}).items():
            if name in value:
                yield from _other_types(root, property_, value[name], f"{at}.{name}")


def _one_type(schema: Mapping[str, Any]) -> str:
    """Return the type that a schema asks for, "" where it allows several or any."""
    wanted = schema.get("type")
    return wanted if isinstance(wanted, str) else ""


def _item(schema: Mapping[str, Any], index: int) -> object:
    first = schema.get("prefixItems", ())
    return first[index] if index < len(first) else schema.get("items")


def _resolved(root: Schema, schema: object) -> object:
    while isinstance(schema, Mapping) and "$ref" in schema and isinstance(root, Mapping):
        place = str(schema["$ref"])
        schema = root
        for key in place.removeprefix("#").split("/")[1:]:
            schema = schema[key] if isinstance(schema, Mapping) else None
    return schema
