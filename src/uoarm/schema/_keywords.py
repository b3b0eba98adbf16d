"""Keywords read into the fields of a node."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from typing import Any, TypeAlias

from uoarm.schema._node import Node
from uoarm.schema._values import exact, key_of

__all__ = ["fill"]

Child: TypeAlias = Callable[[object], Node]

_NUMBERS = {
    "minimum": "minimum",
    "maximum": "maximum",
    "above": "exclusiveMinimum",
    "below": "exclusiveMaximum",
    "multiple": "multipleOf",
}
_COUNTS = {
    "min_length": "minLength",
    "max_length": "maxLength",
    "min_items": "minItems",
    "max_items": "maxItems",
    "min_contains": "minContains",
    "max_contains": "maxContains",
    "min_properties": "minProperties",
    "max_properties": "maxProperties",
}


def fill(node: Node, schema: Mapping[str, Any], child: Child) -> None:
    """Read every keyword of a schema but the references; `child` gives the nodes within it."""
    _fill_scalars(node, schema)
    _fill_array(node, schema, child)
    _fill_object(node, schema, child)
    _fill_logic(node, schema, child)


def _fill_scalars(node: Node, schema: Mapping[str, Any]) -> None:
    if "type" in schema:
        names = schema["type"] if isinstance(schema["type"], list) else [schema["type"]]
        node.integer_only = "integer" in names and "number" not in names
        node.kinds = frozenset("number" if one == "integer" else one for one in names)
    if "const" in schema:
        node.values = {key_of(schema["const"]): schema["const"]}
    if "enum" in schema:
        values = {key_of(one): one for one in schema["enum"]}
        if node.values is not None:
            values = {key: one for key, one in values.items() if key in node.values}
        node.values = values
    for name, keyword in _NUMBERS.items():
        if keyword in schema:
            setattr(node, name, exact(schema[keyword]))
    for name, keyword in _COUNTS.items():
        if keyword in schema:
            setattr(node, name, int(schema[keyword]))
    node.pattern = schema.get("pattern")


def _fill_array(node: Node, schema: Mapping[str, Any], child: Child) -> None:
    node.prefix = _many(child, schema.get("prefixItems", ()))
    node.items = _one(child, schema, "items")
    node.contains = _one(child, schema, "contains")
    node.unevaluated_items = _one(child, schema, "unevaluatedItems")
    node.unique = schema.get("uniqueItems", False)


def _fill_object(node: Node, schema: Mapping[str, Any], child: Child) -> None:
    node.properties = dict(_named(child, schema.get("properties", {})))
    node.patterns = _named(child, schema.get("patternProperties", {}))
    node.additional = _one(child, schema, "additionalProperties")
    node.unevaluated_properties = _one(child, schema, "unevaluatedProperties")
    node.names = _one(child, schema, "propertyNames")
    node.required = tuple(dict.fromkeys(schema.get("required", ())))
    node.dependent_required = tuple(
        (name, tuple(names)) for name, names in schema.get("dependentRequired", {}).items()
    )
    node.dependent_schemas = _named(child, schema.get("dependentSchemas", {}))


def _fill_logic(node: Node, schema: Mapping[str, Any], child: Child) -> None:
    node.all_of = _many(child, schema.get("allOf", ()))
    node.any_of = _many(child, schema["anyOf"]) if "anyOf" in schema else None
    node.one_of = _many(child, schema["oneOf"]) if "oneOf" in schema else None
    node.negated = _one(child, schema, "not")
    node.condition = _one(child, schema, "if")
    node.then = _one(child, schema, "then")
    node.otherwise = _one(child, schema, "else")


def _one(child: Child, schema: Mapping[str, Any], keyword: str) -> Node | None:
    return child(schema[keyword]) if keyword in schema else None


def _many(child: Child, schemas: Iterable[object]) -> tuple[Node, ...]:
    return tuple(child(one) for one in schemas)


def _named(child: Child, schemas: Mapping[str, object]) -> tuple[tuple[str, Node], ...]:
    return tuple((name, child(one)) for name, one in schemas.items())
