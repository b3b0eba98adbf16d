"""A small exact validator for JSON Schema 2020-12: the judge in every test of the checker.

It exists beside ``jsonschema`` and ``jsonschema-rs``, since the first divides with floats and reads
patterns with Python's rules. Slow and direct on purpose; held to the official suite by a test.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterable, Iterator, Mapping
from fractions import Fraction
from urllib.parse import unquote

from tests.schema._ecma import compiled

Marks = tuple[set[str], set[int]]
"""The names and the positions that were evaluated."""

_ROOM = 20_000
_LISTS = frozenset({"const", "enum"})
_CONJUNCTS = frozenset({"$ref", "allOf", "dependentSchemas"})
_CHOICES = frozenset({"anyOf", "oneOf", "not", "if"})
_OF_ARRAYS = frozenset(
    {"minItems", "maxItems", "uniqueItems", "prefixItems", "items", "contains", "unevaluatedItems"}
)
_OF_OBJECTS = frozenset(
    {"minProperties", "maxProperties", "required", "dependentRequired", "propertyNames"}
    | {"properties", "patternProperties", "additionalProperties", "unevaluatedProperties"}
)
_OF_STRINGS = frozenset({"pattern", "minLength", "maxLength"})
_REMOTE = ("$dynamicRef", "$recursiveRef")


class UnsupportedSchemaError(ValueError):
    """The schema uses what this validator does not read: it has no verdict."""


def exact(number: float) -> Fraction:
    return Fraction(number) if isinstance(number, int) else Fraction(repr(number))


def is_number(value: object) -> bool:
    return isinstance(value, (int, float)) and not isinstance(value, bool)


def frozen(value: object) -> object:
    """A hashable form: equal exactly when the JSON values are."""
    if isinstance(value, bool) or value is None:
        return ("literal", str(value))
    if isinstance(value, (int, float)):
        return ("number", exact(value))
    if isinstance(value, str):
        return ("string", value)
    if isinstance(value, list):
        return ("array", tuple(frozen(item) for item in value))
    assert isinstance(value, Mapping)
    return ("object", frozenset((name, frozen(item)) for name, item in value.items()))


def type_of(value: object) -> str:
    if value is None:
        return "null"
    if isinstance(value, bool):
        return "boolean"
    if isinstance(value, (int, float)):
        return "number"
    if isinstance(value, str):
        return "string"
    return "array" if isinstance(value, list) else "object"


def _has_type(value: object, name: str) -> bool:
    if name == "integer":
        return is_number(value) and exact(value).denominator == 1  # type: ignore[arg-type] # a number, by is_number
    return type_of(value) == name


class Reference:
    """Validates against one document."""

    def __init__(self, schema: object) -> None:
        self._root = schema
        self._anchors: dict[str, object] = {}
        self._listings: dict[int, frozenset[object]] = {}
        for node in _schemas(schema):
            if "$id" in node and node is not schema:
                raise UnsupportedSchemaError("an embedded $id")
            for keyword in _REMOTE:
                if keyword in node:
                    raise UnsupportedSchemaError(keyword)
            for keyword in ("$anchor", "$dynamicAnchor"):
                if isinstance(anchor := node.get(keyword), str):
                    self._anchors[anchor] = node

    def accepts(self, value: object) -> bool:
        """Judge a value; recursive as it is, with room for the deepest pair of the tables."""
        before = sys.getrecursionlimit()
        sys.setrecursionlimit(max(before, _ROOM))
        try:
            return self._marks(self._root, value) is not None
        finally:
            sys.setrecursionlimit(before)

    def _ok(self, schema: object, value: object) -> bool:
        return self._marks(schema, value) is not None

    def _every(self, pairs: Iterable[tuple[object, object]]) -> bool:
        """Judge pairs of schema and value in a loop: `all` would use the C stack at each level."""
        for schema, value in pairs:  # noqa: SIM110 - a loop, for the reason above
            if not self._ok(schema, value):
                return False
        return True

    def _target(self, reference: str) -> object:
        document, _, fragment = reference.partition("#")
        if document:
            raise UnsupportedSchemaError(f"$ref {reference}")
        fragment = unquote(fragment)
        if not fragment:
            return self._root
        if not fragment.startswith("/"):
            if fragment not in self._anchors:
                raise UnsupportedSchemaError(f"$ref {reference}")
            return self._anchors[fragment]
        node = self._root
        for step in fragment[1:].split("/"):
            name = step.replace("~1", "/").replace("~0", "~")
            node = node[int(name)] if isinstance(node, list) else node[name]  # type: ignore[index] # a bad pointer is a bad test
        return node

    def _marks(self, schema: object, value: object) -> Marks | None:
        if isinstance(schema, bool):
            return (set(), set()) if schema else None
        assert isinstance(schema, Mapping)
        marks: Marks = (set(), set())
        lacks = schema.keys().isdisjoint  # of a group of keywords most schemas have none
        if not (lacks(_LISTS) or self._listed(schema, value)) or not _scalar_rules(schema, value):
            return None
        if not lacks(_CONJUNCTS):
            for part in self._conjuncts(schema, value):
                if not self._merge(marks, part, value):
                    return None
        if not (lacks(_CHOICES) or self._choices(schema, value, marks)):
            return None
        if isinstance(value, list):
            return marks if lacks(_OF_ARRAYS) or self._array(schema, value, marks) else None
        if isinstance(value, dict):
            return marks if lacks(_OF_OBJECTS) or self._object(schema, value, marks) else None
        return marks

    def _listed(self, schema: Mapping[str, object], value: object) -> bool:
        if "const" in schema and frozen(schema["const"]) != frozen(value):
            return False
        if "enum" not in schema:
            return True
        if id(schema) not in self._listings:  # which lives as long as this
            self._listings[id(schema)] = frozenset(map(frozen, _items(schema, "enum")))
        return frozen(value) in self._listings[id(schema)]

    def _merge(self, marks: Marks, schema: object, value: object) -> bool:
        found = self._marks(schema, value)
        if found is None:
            return False
        marks[0].update(found[0])
        marks[1].update(found[1])
        return True

    def _conjuncts(self, schema: Mapping[str, object], value: object) -> Iterator[object]:
        if "$ref" in schema:
            yield self._target(str(schema["$ref"]))
        yield from _items(schema, "allOf")
        if isinstance(value, dict):
            dependent = _pairs(schema, "dependentSchemas")
            yield from (dependent[name] for name in dependent if name in value)

    def _choices(self, schema: Mapping[str, object], value: object, marks: Marks) -> bool:
        if "anyOf" in schema:
            hits = [self._merge(marks, part, value) for part in _items(schema, "anyOf")]
            if not any(hits):
                return False
        if "oneOf" in schema:
            hits = [self._merge(marks, part, value) for part in _items(schema, "oneOf")]
            if hits.count(True) != 1:
                return False
        if "not" in schema and self._ok(schema["not"], value):
            return False
        if "if" in schema:
            branch = "then" if self._merge(marks, schema["if"], value) else "else"
            return self._merge(marks, schema.get(branch, True), value)
        return True

    def _array(self, schema: Mapping[str, object], value: list[object], marks: Marks) -> bool:
        if not _within(len(value), schema, "minItems", "maxItems"):
            return False
        if schema.get("uniqueItems") is True and len({frozen(v) for v in value}) < len(value):
            return False
        prefix = list(_items(schema, "prefixItems"))
        if not self._every(zip(prefix, value, strict=False)):
            return False
        marks[1].update(range(min(len(prefix), len(value))))
        if "items" in schema:
            rest = {id(item): item for item in value[len(prefix) :]}  # often a million times one
            if not self._every((schema["items"], item) for item in rest.values()):
                return False
            marks[1].update(range(len(value)))
        if "contains" in schema:
            hits = {n for n, item in enumerate(value) if self._ok(schema["contains"], item)}
            marks[1].update(hits)
            low = schema.get("minContains", 1)
            if not _within(len(hits), {**schema, "minContains": low}, "minContains", "maxContains"):
                return False
        if "unevaluatedItems" in schema:
            unmarked = [item for n, item in enumerate(value) if n not in marks[1]]
            if not self._every((schema["unevaluatedItems"], item) for item in unmarked):
                return False
            marks[1].update(range(len(value)))
        return True

    def _object(self, schema: Mapping[str, object], value: dict[str, object], marks: Marks) -> bool:
        if not _within(len(value), schema, "minProperties", "maxProperties"):
            return False
        if not all(name in value for name in _items(schema, "required")):
            return False
        needs = _pairs(schema, "dependentRequired")
        if any(n in value and not set(needs[n]) <= set(value) for n in needs):  # type: ignore[call-overload] # lists of names
            return False
        if "propertyNames" in schema and not self._every(
            (schema["propertyNames"], name) for name in value
        ):
            return False
        return self._members(schema, value, marks)

    def _members(
        self, schema: Mapping[str, object], value: dict[str, object], marks: Marks
    ) -> bool:
        named, patterned = _pairs(schema, "properties"), _pairs(schema, "patternProperties")
        local: set[str] = set()
        for name, item in value.items():
            rules = [part for text, part in patterned.items() if compiled(text).search(name)]
            rules += [named[name]] if name in named else []
            if not self._every((part, item) for part in rules):
                return False
            if rules:
                local.add(name)
        rest = set(value) - local
        if "additionalProperties" in schema:
            if not self._every((schema["additionalProperties"], value[name]) for name in rest):
                return False
            local |= rest
        marks[0].update(local)
        if "unevaluatedProperties" in schema:
            rest = set(value) - marks[0]
            if not self._every((schema["unevaluatedProperties"], value[name]) for name in rest):
                return False
            marks[0].update(value)
        return True


def _scalar_rules(schema: Mapping[str, object], value: object) -> bool:
    declared = schema.get("type")
    if declared is not None:
        names = declared if isinstance(declared, list) else [declared]
        if not any(_has_type(value, str(name)) for name in names):
            return False
    if isinstance(value, str):
        if schema.keys().isdisjoint(_OF_STRINGS):
            return True
        pattern = schema.get("pattern")
        if isinstance(pattern, str) and not compiled(pattern).search(value):
            return False
        return _within(len(value), schema, "minLength", "maxLength")
    if is_number(value):
        if schema.keys().isdisjoint(_NUMBER_RULES):
            return True
        number = exact(value)  # type: ignore[arg-type] # a number, by is_number
        return all(
            rule(number, exact(schema[keyword]))  # type: ignore[arg-type] # the metaschema says number
            for keyword, rule in _NUMBER_RULES.items()
            if keyword in schema
        )
    return True


_NUMBER_RULES: Mapping[str, Callable[[Fraction, Fraction], bool]] = {
    "minimum": lambda number, bound: number >= bound,
    "maximum": lambda number, bound: number <= bound,
    "exclusiveMinimum": lambda number, bound: number > bound,
    "exclusiveMaximum": lambda number, bound: number < bound,
    "multipleOf": lambda number, step: (number / step).denominator == 1,
}


def _within(count: int, schema: Mapping[str, object], least: str, most: str) -> bool:
    low, high = schema.get(least, 0), schema.get(most, count)
    return low <= count <= high  # type: ignore[operator] # the metaschema says number


def _items(schema: Mapping[str, object], keyword: str) -> list[object]:
    value = schema.get(keyword, [])
    assert isinstance(value, list)
    return value


def _pairs(schema: Mapping[str, object], keyword: str) -> Mapping[str, object]:
    value = schema.get(keyword, {})
    assert isinstance(value, Mapping)
    return value


def _schemas(root: object) -> Iterator[Mapping[str, object]]:
    """Every mapping of the document outside of const and enum."""
    waiting = [root]
    while waiting:
        node = waiting.pop()
        if isinstance(node, Mapping):
            yield node
            waiting.extend(v for k, v in node.items() if k not in {"const", "enum"})
        elif isinstance(node, list):
            waiting.extend(node)
