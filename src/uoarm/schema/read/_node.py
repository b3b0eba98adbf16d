"""Nodes: schemas read once, with every keyword of the vocabulary as a typed field."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from collections.abc import Set as AbstractSet
from fractions import Fraction
from typing import Any, NamedTuple, Protocol, TypeAlias

from attrs import define, field

from uoarm.schema._errors import Meter, Pointer, SchemaError, write_pointer
from uoarm.schema._parts import LISTS, MAPS, SINGLES
from uoarm.schema._values import Key, exact
from uoarm.schema.regex import (
    CodeUnits,
    MalformedPatternError,
    UnsupportedPatternError,
    compile_pattern,
)

Scope: TypeAlias = "tuple[tuple[str, str], ...]"
"""Names of dynamic anchors, each with the base of the document that has set it."""


class NodeReader(Protocol):
    """What nodes ask of the document that they were read from."""

    @property
    def meter(self) -> Meter:
        """The budget that work on the document is spent from."""

    def resolve(self, reference: Reference) -> SchemaNode:
        """Return the node that a reference leads to."""

    def either(self, nodes: Sequence[SchemaNode]) -> SchemaNode:
        """Return a node that accepts what one of some nodes accepts."""


class Reference(NamedTuple):
    """A reference: its keyword, where it points to, and the dynamic scope that it stands in."""

    keyword: str
    absolute: str
    scope: Scope


@define(eq=False)
class SchemaNode:
    """One schema. Equal content has the same `number`, so that comparing is comparing integers.

    A node that holds something out of scope says so in `unsupported`. `never` is `false`. `tags`
    are found when first asked for, by `_tags`.
    """

    number: int
    raw: object
    document: NodeReader
    never: bool = False
    unsupported: str = ""
    kinds: frozenset[str] | None = None
    integer_only: bool = False
    values: dict[Key, object] | None = None
    minimum: Fraction | None = None
    maximum: Fraction | None = None
    above: Fraction | None = None
    below: Fraction | None = None
    multiple: Fraction | None = None
    min_length: int = 0
    max_length: int | None = None
    max_utf8: int | None = None
    max_utf16: int | None = None
    no_nul: bool = False
    pattern: str | None = None
    prefix: tuple[SchemaNode, ...] = ()
    items: SchemaNode | None = None
    min_items: int = 0
    max_items: int | None = None
    contains: SchemaNode | None = None
    min_contains: int = 1
    max_contains: int | None = None
    unique: bool = False
    unevaluated_items: SchemaNode | None = None
    properties: dict[str, SchemaNode] = field(factory=dict)
    patterns: tuple[tuple[str, SchemaNode], ...] = ()
    additional: SchemaNode | None = None
    unevaluated_properties: SchemaNode | None = None
    names: SchemaNode | None = None
    required: tuple[str, ...] = ()
    min_properties: int = 0
    max_properties: int | None = None
    dependent_required: tuple[tuple[str, tuple[str, ...]], ...] = ()
    dependent_schemas: tuple[tuple[str, SchemaNode], ...] = ()
    all_of: tuple[SchemaNode, ...] = ()
    any_of: tuple[SchemaNode, ...] | None = None
    one_of: tuple[SchemaNode, ...] | None = None
    negated: SchemaNode | None = None
    condition: SchemaNode | None = None
    then: SchemaNode | None = None
    otherwise: SchemaNode | None = None
    reference: Reference | None = None
    tags: Mapping[str, AbstractSet[Key]] | None = None

    def target(self) -> SchemaNode:
        """Return the node that the reference leads to."""
        assert self.reference is not None
        return self.document.resolve(self.reference)

    @property
    def texts(self) -> list[str | CodeUnits]:
        """What a text must be found to be: of a pattern, of so many code units."""
        texts: list[str | CodeUnits] = [] if self.pattern is None else [self.pattern]
        if self.max_utf8 is not None:
            texts.append(CodeUnits(4, self.max_utf8))
        if self.max_utf16 is not None:
            texts.append(CodeUnits(2, self.max_utf16))
        return texts

    def applied(self) -> list[SchemaNode]:
        """Return the schemas that this one applies to the same value."""
        single = [self.negated, self.condition, self.then, self.otherwise]
        found = [node for node in single if node is not None]
        found += [*self.all_of, *(self.any_of or ()), *(self.one_of or ())]
        found += [node for _, node in self.dependent_schemas]
        return found if self.reference is None else [*found, self.target()]


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
        made = child(value)
        setattr(node, field, made)
        return made.number

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


def _number(field: str, convert: Callable[[Any], object]) -> Reader:
    def read(node: SchemaNode, value: Any, _: Child, key_of: KeyOf) -> object:
        key = key_of(value)
        setattr(node, field, convert(value))
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


READERS: dict[str, Reader] = {
    **{keyword: _single(field) for keyword, field in _SINGLE.items()},
    **{keyword: _several(field) for keyword, field in _SEVERAL.items()},
    **{keyword: _named(field) for keyword, field in _NAMED.items()},
    **{keyword: _number(field, exact) for keyword, field in _NUMBERS.items()},
    **{keyword: _number(field, int) for keyword, field in _COUNTS.items()},
    "type": _type,
    "properties": _properties,
    "required": _required,
    "pattern": _plain("pattern"),
    "x-nul": _no_nul,
    "uniqueItems": _plain("unique"),
    "dependentRequired": _dependent_required,
    "enum": _values,
    "const": lambda node, value, child, key_of: _values(node, [value], child, key_of),
}
"""What takes a keyword but a reference into a node; each returns what it means, to be compared.

It is given the node, the value, what gives the node of a schema within, and the key of a value.
What `const` and `enum` mean is in the values of the node.
"""


ANNOTATIONS = frozenset(
    {"$comment", "title", "description", "default", "examples", "deprecated", "readOnly",
     "writeOnly", "format", "contentEncoding", "contentMediaType", "contentSchema", "$defs",
     "$anchor", "$dynamicAnchor", "$schema", "$vocabulary", "$id", "definitions"}
)  # fmt: skip
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
    names = [value] if isinstance(value, str) else value
    return isinstance(names, list) and bool(names) and all(name in _TYPES for name in names)


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
    "x-nul": (_is_a(bool), "true or false"),
    "enum": (_is_a(list), "a list of values"),
    "required": (_is_names, "a list of names"),
    "dependentRequired": (_is_lists_of_names, "lists of names by name"),
    "type": (_is_type, f"a type of {', '.join(_TYPES)}"),
}
