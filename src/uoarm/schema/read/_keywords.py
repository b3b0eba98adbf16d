"""Keywords read into the fields of a node."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from typing import Any, TypeAlias

from uoarm.schema._errors import Pointer, SchemaError, write_pointer
from uoarm.schema._values import Key, exact
from uoarm.schema.read._node import SchemaNode
from uoarm.schema.regex import MalformedPatternError, UnsupportedPatternError, compile_pattern

__all__ = ["ANNOTATIONS", "LISTS", "MAPS", "READERS", "SINGLES", "check_keyword"]

Child: TypeAlias = Callable[[object], SchemaNode]
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
    "x-max-utf8": "max_utf8",
    "x-max-utf16": "max_utf16",
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


Reader: TypeAlias = Callable[[SchemaNode, Any, Child, KeyOf], object]


def _single(field: str) -> Reader:
    def read(node: SchemaNode, value: Any, child: Child, _: KeyOf) -> object:
        one = child(value)
        setattr(node, field, one)
        return one.number

    return read


def _several(field: str) -> Reader:
    def read(node: SchemaNode, value: Any, child: Child, _: KeyOf) -> object:
        nodes = tuple(map(child, value))
        setattr(node, field, nodes)
        return tuple(subschema.number for subschema in nodes)

    return read


def _named(field: str) -> Reader:
    def read(node: SchemaNode, value: Any, child: Child, _: KeyOf) -> object:
        named = tuple((name, child(item)) for name, item in value.items())
        setattr(node, field, named)
        return frozenset((name, subschema.number) for name, subschema in named)

    return read


def _number(field: str) -> Reader:
    def read(node: SchemaNode, value: Any, _: Child, key_of: KeyOf) -> object:
        key = key_of(value)
        setattr(node, field, exact(value))
        return key

    return read


def _count(field: str) -> Reader:
    def read(node: SchemaNode, value: Any, _: Child, key_of: KeyOf) -> object:
        key = key_of(value)
        setattr(node, field, int(value))
        return key

    return read


def _plain(field: str) -> Reader:
    def read(node: SchemaNode, value: Any, _: Child, __: KeyOf) -> object:
        setattr(node, field, value)
        return value

    return read


_ALONE = {
    text: frozenset([text]) for text in ("null", "boolean", "number", "string", "array", "object")
}


def _type(node: SchemaNode, value: Any, _: Child, __: KeyOf) -> object:
    names = _ALONE.get(value) if isinstance(value, str) else frozenset(value)
    if names is not None and "integer" not in names:
        node.kinds = names
        return names
    names = names or frozenset([value])
    node.integer_only = "number" not in names
    node.kinds = names - {"integer"} | _ALONE["number"]
    return names


def _no_nul(node: SchemaNode, value: Any, _: Child, __: KeyOf) -> object:
    node.no_nul = value is False
    return value


def _properties(node: SchemaNode, value: Any, child: Child, _: KeyOf) -> object:
    node.properties = {name: child(item) for name, item in value.items()}
    return frozenset((name, property_.number) for name, property_ in node.properties.items())


def _required(node: SchemaNode, value: Any, _: Child, __: KeyOf) -> object:
    node.required = tuple(dict.fromkeys(value))
    return frozenset(value)


def _dependent_required(node: SchemaNode, value: Any, _: Child, key_of: KeyOf) -> object:
    node.dependent_required = tuple((name, tuple(names)) for name, names in value.items())
    return key_of(value)


def _values(node: SchemaNode, value: Any, _: Child, key_of: KeyOf) -> None:
    """Take in the values of `const` or `enum`; those that both have where both stand."""
    values = {key_of(item): item for item in value}
    if node.values is not None:
        values = {key: item for key, item in values.items() if key in node.values}
    node.values = values


def _const(node: SchemaNode, value: Any, child: Child, key_of: KeyOf) -> None:
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
    "x-nul": _no_nul,
    "uniqueItems": _plain("unique"),
    "dependentRequired": _dependent_required,
    "enum": _values,
    "const": _const,
}
"""What takes a keyword but a reference into a node; each returns what it means, to be compared.

It is given the node, the value, what gives the node of a schema within, and the key of a value.
What `const` and `enum` mean is told by the values of the node.
"""


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
_SHAPE_COUNTS = frozenset(
    {"minLength", "maxLength", "minItems", "maxItems", "minContains", "maxContains",
     "minProperties", "maxProperties", "x-max-utf8", "x-max-utf16"}
)  # fmt: skip
_SHAPE_NUMBERS = frozenset(
    {"minimum", "maximum", "exclusiveMinimum", "exclusiveMaximum", "multipleOf"}
)
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
    **dict.fromkeys(_SHAPE_COUNTS, (_is_count, "a whole number, zero or more")),
    **dict.fromkeys(_SHAPE_NUMBERS, (_is_number, "a finite number")),
    **dict.fromkeys(_STRINGS, (_is_a(str), "a string")),
    "uniqueItems": (_is_a(bool), "true or false"),
    "x-nul": (_is_a(bool), "true or false"),
    "enum": (_is_a(list), "a list of values"),
    "required": (_is_names, "a list of names"),
    "dependentRequired": (_is_lists_of_names, "lists of names by name"),
    "type": (_is_type, f"a type of {', '.join(_TYPES)}"),
}
