"""Keywords read into the fields of a node."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, TypeAlias

from uoarm.schema._values import Key, exact
from uoarm.schema.read._node import Node

__all__ = ["READERS"]

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


Reader: TypeAlias = Callable[[Node, Any, Child, KeyOf], object]


def _single(field: str) -> Reader:
    def read(node: Node, value: Any, child: Child, _: KeyOf) -> object:
        one = child(value)
        setattr(node, field, one)
        return one.number

    return read


def _several(field: str) -> Reader:
    def read(node: Node, value: Any, child: Child, _: KeyOf) -> object:
        nodes = tuple(map(child, value))
        setattr(node, field, nodes)
        return tuple(subschema.number for subschema in nodes)

    return read


def _named(field: str) -> Reader:
    def read(node: Node, value: Any, child: Child, _: KeyOf) -> object:
        named = tuple((name, child(item)) for name, item in value.items())
        setattr(node, field, named)
        return frozenset((name, subschema.number) for name, subschema in named)

    return read


def _number(field: str) -> Reader:
    def read(node: Node, value: Any, _: Child, key_of: KeyOf) -> object:
        key = key_of(value)
        setattr(node, field, exact(value))
        return key

    return read


def _count(field: str) -> Reader:
    def read(node: Node, value: Any, _: Child, key_of: KeyOf) -> object:
        key = key_of(value)
        setattr(node, field, int(value))
        return key

    return read


def _plain(field: str) -> Reader:
    def read(node: Node, value: Any, _: Child, __: KeyOf) -> object:
        setattr(node, field, value)
        return value

    return read


_ALONE = {
    text: frozenset([text]) for text in ("null", "boolean", "number", "string", "array", "object")
}


def _type(node: Node, value: Any, _: Child, __: KeyOf) -> object:
    names = _ALONE.get(value) if isinstance(value, str) else frozenset(value)
    if names is not None and "integer" not in names:
        node.kinds = names
        return names
    names = names or frozenset([value])
    node.integer_only = "number" not in names
    node.kinds = names - {"integer"} | _ALONE["number"]
    return names


def _properties(node: Node, value: Any, child: Child, _: KeyOf) -> object:
    node.properties = {name: child(item) for name, item in value.items()}
    return frozenset((name, property_.number) for name, property_ in node.properties.items())


def _required(node: Node, value: Any, _: Child, __: KeyOf) -> object:
    node.required = tuple(dict.fromkeys(value))
    return frozenset(value)


def _dependent_required(node: Node, value: Any, _: Child, key_of: KeyOf) -> object:
    node.dependent_required = tuple((name, tuple(names)) for name, names in value.items())
    return key_of(value)


def _values(node: Node, value: Any, _: Child, key_of: KeyOf) -> None:
    """Take in the values of `const` or `enum`; those that both have where both stand."""
    values = {key_of(item): item for item in value}
    if node.values is not None:
        values = {key: item for key, item in values.items() if key in node.values}
    node.values = values


def _const(node: Node, value: Any, child: Child, key_of: KeyOf) -> None:
    _values(node, [value], child, key_of)


READERS: dict[str, Reader] = {
    **{keyword: _single(field) for keyword, field in _SINGLE.items()},
    **{keyword: _several(field) for keyword, field in _SEVERAL.items()},
    **{keyword: _named(field) for keyword, field in _NAMED.items()},
    **{keyword: _number(field) for keyword, field in _NUMBERS.items()},
    **{keyword: _count(field) for keyword, field in _COUNTS.items()},
    "type": _type,
    "properties": _properties,
    "required": _required,
    "pattern": _plain("pattern"),
    "uniqueItems": _plain("unique"),
    "dependentRequired": _dependent_required,
    "enum": _values,
    "const": _const,
}
"""What takes a keyword but a reference into a node; each returns what it means, to be compared.

It is given the node, the value, what gives the node of a schema within, and the key of a value.
What `const` and `enum` mean is told by the values of the node.
"""
