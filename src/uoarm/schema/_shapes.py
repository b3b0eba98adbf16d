"""What each keyword must look like; anything else is one clear SchemaError."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

from uoarm.schema._errors import SchemaError
from uoarm.schema._nfa import MalformedPatternError, UnsupportedPatternError
from uoarm.schema._regex import compile_pattern

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
_SIZED = (dict, list, str, Mapping)
_TYPES = ("null", "boolean", "integer", "number", "string", "array", "object")


def check_keyword(keyword: str, value: object, pointer: str) -> int:
    """Check that the keyword's value has the right shape; return how much work it was.

    Raises:
        SchemaError: it has another.
    """
    work = len(value) // 16 if isinstance(value, _SIZED) else 0
    if keyword in SINGLES:
        _demand(isinstance(value, bool | Mapping), pointer, "a schema", value)
    elif keyword in LISTS:
        _demand(isinstance(value, list) and bool(value), pointer, "a list of schemas", value)
    elif keyword in MAPS:
        _demand(_is_map(value), pointer, "schemas by name", value)
        if keyword == "patternProperties":
            for pattern in value:  # type: ignore[attr-defined] # a map
                work += _demand_pattern(pattern, pointer)
    elif keyword in _COUNTS:
        _demand(_is_count(value), pointer, "a whole number, zero or more", value)
    elif keyword in _NUMBERS:
        _demand(_is_number(value), pointer, "a finite number", value)
        positive = keyword != "multipleOf" or value > 0  # type: ignore[operator] # it is a number
        _demand(positive, pointer, "a number above zero", value)
    elif keyword in _STRINGS:
        _demand(isinstance(value, str), pointer, "a string", value)
        if keyword == "pattern":
            work += _demand_pattern(value, pointer)
    elif keyword == "uniqueItems":
        _demand(isinstance(value, bool), pointer, "true or false", value)
    elif keyword == "enum":
        _demand(isinstance(value, list), pointer, "a list of values", value)
    elif keyword == "required":
        _demand(_is_names(value), pointer, "a list of names", value)
    elif keyword == "dependentRequired":
        whole = _is_map(value) and all(_is_names(one) for one in value.values())  # type: ignore[attr-defined] # a map
        _demand(whole, pointer, "lists of names by name", value)
    elif keyword == "type":
        names = value if isinstance(value, list) else [value]
        known = bool(names) and all(isinstance(n, str) and n in _TYPES for n in names)
        _demand(known, pointer, f"a type of {', '.join(_TYPES)}", value)
    return work


def _demand(holds: bool, pointer: str, expected: str, got: object) -> None:  # noqa: FBT001
    if not holds:
        raise SchemaError(pointer, expected, got)


def _demand_pattern(pattern: Any, pointer: str) -> int:
    """Compile a pattern; return how many states it has."""
    try:
        return len(compile_pattern(pattern).always)
    except MalformedPatternError as error:
        raise SchemaError(pointer, f"a regular expression ({error})", pattern) from error
    except UnsupportedPatternError:
        return 1


def _is_map(value: object) -> bool:
    return isinstance(value, Mapping) and all(isinstance(key, str) for key in value)


def _is_names(value: object) -> bool:
    return isinstance(value, list | tuple) and all(isinstance(one, str) for one in value)


def _is_number(value: object) -> bool:
    if isinstance(value, bool) or not isinstance(value, int | float):
        return False
    return isinstance(value, int) or math.isfinite(value)


def _is_count(value: object) -> bool:
    return _is_number(value) and value >= 0 and value == int(value)  # type: ignore[operator, call-overload] # a number
