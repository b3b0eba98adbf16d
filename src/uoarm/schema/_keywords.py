"""Keywords read into the fields of a node."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any, TypeAlias

from uoarm.schema._node import Node
from uoarm.schema._values import Key, exact

__all__ = ["fill"]

Child: TypeAlias = Callable[[object], Node]
KeyOf: TypeAlias = Callable[[object], Key]

_NUMBERS = {
    "minimum": "minimum",
    "maximum": "maximum",
    "exclusiveMinimum": "above",
    "exclusiveMaximum": "below",
    "multipleOf": "multiple",
}
_COUNTS = {
    "minLength": "min_length",
    "maxLength": "max_length",
    "minItems": "min_items",
    "maxItems": "max_items",
    "minContains": "min_contains",
    "maxContains": "max_contains",
    "minProperties": "min_properties",
    "maxProperties": "max_properties",
}


_SINGLE = {
    "items": "items",
    "contains": "contains",
    "unevaluatedItems": "unevaluated_items",
    "additionalProperties": "additional",
    "unevaluatedProperties": "unevaluated_properties",
    "propertyNames": "names",
    "not": "negated",
    "if": "condition",
    "then": "then",
    "else": "otherwise",
}
_SEVERAL = {"prefixItems": "prefix", "allOf": "all_of", "anyOf": "any_of", "oneOf": "one_of"}
_NAMED = {"patternProperties": "patterns", "dependentSchemas": "dependent_schemas"}


def fill(node: Node, schema: Mapping[str, Any], child: Child, key_of: KeyOf) -> None:
    """Read every keyword of a schema but the references.

    `child` gives the nodes within it, `key_of` the keys of its values.
    """
    for keyword, value in schema.items():
        if keyword in _SINGLE:
            setattr(node, _SINGLE[keyword], child(value))
        elif keyword in _SEVERAL:
            setattr(node, _SEVERAL[keyword], tuple(child(one) for one in value))
        elif keyword in _NAMED:
            named = tuple((name, child(one)) for name, one in value.items())
            setattr(node, _NAMED[keyword], named)
        elif keyword in _NUMBERS:
            setattr(node, _NUMBERS[keyword], exact(value))
        elif keyword in _COUNTS:
            setattr(node, _COUNTS[keyword], int(value))
        else:
            _fill_other(node, keyword, value, child)
    if "const" in schema or "enum" in schema:
        _fill_values(node, schema, key_of)


def _fill_other(node: Node, keyword: str, value: Any, child: Child) -> None:
    if keyword == "type":
        names = value if isinstance(value, list) else [value]
        node.integer_only = "integer" in names and "number" not in names
        node.kinds = frozenset("number" if one == "integer" else one for one in names)
    elif keyword == "properties":
        node.properties = {name: child(one) for name, one in value.items()}
    elif keyword == "required":
        node.required = tuple(dict.fromkeys(value))
    elif keyword == "pattern":
        node.pattern = value
    elif keyword == "uniqueItems":
        node.unique = value
    elif keyword == "dependentRequired":
        node.dependent_required = tuple((name, tuple(names)) for name, names in value.items())


def _fill_values(node: Node, schema: Mapping[str, Any], key_of: KeyOf) -> None:
    if "const" in schema:
        node.values = {key_of(schema["const"]): schema["const"]}
    if "enum" in schema:
        values = {key_of(one): one for one in schema["enum"]}
        if node.values is not None:
            values = {key: one for key, one in values.items() if key in node.values}
        node.values = values
