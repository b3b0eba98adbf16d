"""What certainly matches a JSON Schema, found without loading a validator.

Most configurations have no mistakes of shape. `certainly_matches` knows that of the keywords that
schemas of files and options use; of whatever else it is not certain, and the validator, which also
has the words for a mistake, is asked.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from typing import Any, TypeAlias

__all__ = ["certainly_matches"]

_LITERALS = frozenset({str, int, bool, type(None)})
_KINDS: Mapping[str, tuple[type, ...]] = {
    "object": (dict,),
    "array": (list,),
    "string": (str,),
    "integer": (int,),
    "number": (int, float),
    "boolean": (bool,),
    "null": (type(None),),
}
_PLAIN = frozenset({dict, list, str, int, float, bool, type(None)})
_SILENT = frozenset(
    {"$comment", "$defs", "$id", "$schema", "default", "description", "examples", "title"}
)
_DEPTH = 200


def certainly_matches(value: Any, schema: Any) -> bool:
    """Say whether a value of JSON certainly matches; False: it may not, or that is not known here.

    Args:
        value: made of plain dicts, lists, texts, numbers, booleans and None.
        schema: JSON Schema of draft 2020-12, its references all to `#/$defs/...`.
    """
    try:
        return _Check(schema).matches(value, schema, 0)
    except (TypeError, AttributeError, ValueError, re.error, RecursionError):  # no JSON Schema
        return False


class _Check:
    """One schema, whose references lead into itself."""

    def __init__(self, whole: Any) -> None:
        self._whole = whole

    def matches(self, value: Any, schema: Any, depth: int) -> bool:
        if schema is True:
            return True
        if not isinstance(schema, Mapping) or depth > _DEPTH or value.__class__ not in _PLAIN:
            return False
        for keyword, rule in schema.items():
            if keyword in _SILENT or keyword.startswith("x-"):
                continue
            simple = _SIMPLE.get(keyword)
            if simple is not None:
                if not simple(value, rule):
                    return False
            elif not self._holds(keyword, rule, value, schema, depth + 1):
                return False
        return True

    def _holds(
        self, keyword: str, rule: Any, value: Any, schema: Mapping[str, Any], depth: int
    ) -> bool:
        """Look at the keywords that apply schemas to a value or its parts; no other holds."""
        match keyword:
            case "$ref":
                place = self._whole.get("$defs", {}).get(rule.removeprefix("#/$defs/"))
                return place is not None and self.matches(value, place, depth)
            case "anyOf":
                return any(self.matches(value, branch, depth) for branch in rule)
            case "properties":
                return value.__class__ is not dict or all(
                    self.matches(value[name], part, depth)
                    for name, part in rule.items()
                    if name in value
                )
            case "additionalProperties":
                known = schema.get("properties", {})
                return value.__class__ is not dict or (
                    "patternProperties" not in schema
                    and all(
                        self.matches(item, rule, depth)
                        for name, item in value.items()
                        if name not in known
                    )
                )
            case "propertyNames":
                return value.__class__ is not dict or all(
                    self.matches(name, rule, depth) for name in value
                )
            case "items":
                return value.__class__ is not list or (
                    "prefixItems" not in schema
                    and all(self.matches(item, rule, depth) for item in value)
                )
        return False


def _is_of(value: Any, kinds: str | list[str]) -> bool:
    names = [kinds] if isinstance(kinds, str) else kinds
    return any(value.__class__ in _KINDS.get(name, ()) for name in names)


def _is_one_of(value: Any, allowed: list[Any]) -> bool:
    """Compare by class, too: 1 and True are equal to Python, and not to JSON Schema."""
    return value.__class__ in _LITERALS and any(
        value.__class__ is literal.__class__ and value == literal for literal in allowed
    )


def _are_unique(value: Any, unique: bool) -> bool:  # noqa: FBT001 - as all of them are called
    if value.__class__ is not list or not unique:
        return True
    return all(item.__class__ is str for item in value) and len(set(value)) == len(value)


def _sized(kind: Any) -> tuple[Callable[[Any, int], bool], Callable[[Any, int], bool]]:
    """Return the checks of a least and of a greatest length of values of a class."""
    return (
        lambda value, least: value.__class__ is not kind or len(value) >= least,
        lambda value, most: value.__class__ is not kind or len(value) <= most,
    )


def _bounded(holds: Callable[[Any, Any], bool]) -> Callable[[Any, Any], bool]:
    """Return the check of a bound; what is not a number has none, and NaN is within none."""
    numbers = _KINDS["number"]
    return lambda value, bound: value.__class__ not in numbers or holds(value, bound)


_Rule: TypeAlias = Callable[[Any, Any], bool]
_SIMPLE: Mapping[str, _Rule] = {
    "type": _is_of,
    "enum": _is_one_of,
    "const": lambda value, literal: _is_one_of(value, [literal]),
    "required": lambda value, names: value.__class__ is not dict or value.keys() >= {*names},
    "pattern": lambda value, pattern: (
        value.__class__ is not str or re.search(pattern, value) is not None
    ),
    "uniqueItems": _are_unique,
    "minimum": _bounded(lambda value, bound: value >= bound),
    "maximum": _bounded(lambda value, bound: value <= bound),
    "exclusiveMinimum": _bounded(lambda value, bound: value > bound),
    "exclusiveMaximum": _bounded(lambda value, bound: value < bound),
    **dict(zip(("minLength", "maxLength"), _sized(str), strict=True)),
    **dict(zip(("minItems", "maxItems"), _sized(list), strict=True)),
    **dict(zip(("minProperties", "maxProperties"), _sized(dict), strict=True)),
}
