"""What each keyword must look like; anything else is one clear SchemaError."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from typing import Any

from uoarm.schema._errors import Pointer, SchemaError, write_pointer
from uoarm.schema.regex import MalformedPatternError, UnsupportedPatternError, compile_pattern

__all__ = ["ANNOTATIONS", "LISTS", "MAPS", "SINGLES", "check_keyword"]

SINGLES = (
    "items", "contains", "additionalProperties", "propertyNames", "not", "if", "then", "else",
    "unevaluatedItems", "unevaluatedProperties", "contentSchema",
)  # fmt: skip
LISTS = ("prefixItems", "allOf", "anyOf", "oneOf")
MAPS = ("properties", "patternProperties", "dependentSchemas", "$defs")
ANNOTATIONS = frozenset(
    {"$comment", "title", "description", "default", "examples", "deprecated", "readOnly",
     "writeOnly", "format", "contentEncoding", "contentMediaType", "contentSchema", "$defs",
     "$anchor", "$dynamicAnchor", "$schema", "$vocabulary", "$id", "definitions"}
)  # fmt: skip
_COUNTS = frozenset(
    {"minLength", "maxLength", "minItems", "maxItems", "minContains", "maxContains",
     "minProperties", "maxProperties"}
)  # fmt: skip
_NUMBERS = frozenset({"minimum", "maximum", "exclusiveMinimum", "exclusiveMaximum", "multipleOf"})
_STRINGS = frozenset({"$ref", "$anchor", "$dynamicRef", "$dynamicAnchor", "$id", "pattern"})
_PATTERNED = frozenset({"pattern", "patternProperties"})
_SIZED = (dict, list, str, Mapping)
_SMALL = frozenset({int, float, bool, type(None)})
_NAMES = frozenset({str})
_TYPES = ("null", "boolean", "integer", "number", "string", "array", "object")


def check_keyword(keyword: str, value: object, pointer: Pointer) -> int:
    """Check that the keyword's value has the right shape; return how much work it was.

    Raises:
        SchemaError: it has another.
    """
    rule = _SHAPES.get(keyword)
    if rule is not None:
        holds, expected = rule
        if not holds(value):
            raise SchemaError(write_pointer(pointer), expected, value)
        if keyword == "multipleOf" and value <= 0:  # type: ignore[operator] # it is a number
            raise SchemaError(write_pointer(pointer), "a number above zero", value)
        if keyword in _PATTERNED:
            patterns: Any = [value] if keyword == "pattern" else value
            return sum(
                _demand_pattern(pattern, pointer) + len(pattern) // 16 for pattern in patterns
            )
    small = value.__class__ in _SMALL or not isinstance(value, _SIZED)
    return 0 if small else len(value) // 16  # type: ignore[arg-type] # it has a size


def _demand_pattern(pattern: Any, pointer: Pointer) -> int:
    """Compile a pattern; return how many states it has."""
    try:
        return len(compile_pattern(pattern).always)
    except MalformedPatternError as error:
        raise SchemaError(
            write_pointer(pointer), f"a regular expression ({error})", pattern
        ) from error
    except UnsupportedPatternError:
        return 1


def _is_map(value: object) -> bool:
    if not (value.__class__ is dict or isinstance(value, Mapping)):
        return False
    return _NAMES.issuperset(map(type, value)) or all(isinstance(key, str) for key in value)


def _is_names(value: object) -> bool:
    if not isinstance(value, (list, tuple)):
        return False
    return _NAMES.issuperset(map(type, value)) or all(isinstance(item, str) for item in value)


def _is_number(value: object) -> bool:
    if isinstance(value, bool) or not isinstance(value, int | float):
        return False
    return isinstance(value, int) or math.isfinite(value)


def _is_count(value: object) -> bool:
    return _is_number(value) and value >= 0 and value == int(value)  # type: ignore[operator, call-overload] # a number


def _is_schema(value: object) -> bool:
    return value.__class__ is dict or isinstance(value, (bool, Mapping))


def _is_schemas(value: object) -> bool:
    return isinstance(value, list) and bool(value)


def _is_lists_of_names(value: object) -> bool:
    return _is_map(value) and all(_is_names(item) for item in value.values())  # type: ignore[attr-defined] # a map


def _is_type(value: object) -> bool:
    if isinstance(value, str):
        return value in _TYPES
    return (
        isinstance(value, list)
        and bool(value)
        and all(isinstance(item, str) and item in _TYPES for item in value)
    )


def _is_a(kind: type) -> Callable[[object], bool]:
    return lambda value: isinstance(value, kind)


_SHAPES: dict[str, tuple[Callable[[object], bool], str]] = {
    **dict.fromkeys(SINGLES, (_is_schema, "a schema")),
    **dict.fromkeys(LISTS, (_is_schemas, "a list of schemas")),
    **dict.fromkeys(MAPS, (_is_map, "schemas by name")),
    **dict.fromkeys(_COUNTS, (_is_count, "a whole number, zero or more")),
    **dict.fromkeys(_NUMBERS, (_is_number, "a finite number")),
    **dict.fromkeys(_STRINGS, (_is_a(str), "a string")),
    "uniqueItems": (_is_a(bool), "true or false"),
    "enum": (_is_a(list), "a list of values"),
    "required": (_is_names, "a list of names"),
    "dependentRequired": (_is_lists_of_names, "lists of names by name"),
    "type": (_is_type, f"a type of {', '.join(_TYPES)}"),
}
