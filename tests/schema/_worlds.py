"""A second decision procedure: a finite world of values, a schema as a vector of bits over them.

A schema's bits say which values of the world it allows; logic is logic of bits, and a producer that
stays within the world is contained in a consumer exactly when no bit is set in the one and not in
the other. It shares no code and no idea with the checker, follows dynamic scopes as the standard
lists them as documents, and is given what lies behind references that lead out.
"""

from __future__ import annotations

import json
from collections.abc import Iterable, Iterator, Mapping
from functools import lru_cache
from itertools import product
from typing import Any
from urllib.parse import urljoin

from tests.schema._reference import frozen, is_number, type_of

SCALARS = (None, True, 0, 1, "a", "b")
NAMES = ("a", "k")
_SCHEMAS = (
    "items",
    "contains",
    "additionalProperties",
    "propertyNames",
    "not",
    "if",
    "then",
    "else",
)
_LISTS = ("prefixItems", "allOf", "anyOf", "oneOf")
_MAPS = ("properties", "dependentSchemas", "$defs")

Schema = Mapping[str, Any] | bool


class InPlaceError(ValueError):
    """A schema applies itself to the same value: it has no meaning."""


class World:
    """The values up to a depth, and the schema that allows exactly these."""

    def __init__(self, depth: int) -> None:
        self.values: list[Any] = [*SCALARS, [], {}]
        self.bound: dict[str, Any] = {"enum": list(self.values)}
        flat = self.values[: len(SCALARS)]
        enough = self.values
        for _ in range(depth):
            inner = self.bound
            rows = [list(row) for row in product(flat, repeat=2)] + [[item] for item in enough]
            members = [{"a": item, "k": other} for item, other in product(flat, repeat=2)]
            members += [{"k": item} for item in enough] + [{"a": item} for item in flat]
            enough = self.values = [*SCALARS, [], {}, *rows, *members]
            scalar = {"enum": list(SCALARS)}
            self.bound = {
                "anyOf": [
                    {"enum": list(SCALARS)},
                    {"type": "array", "maxItems": 2, "items": scalar},
                    {"type": "array", "maxItems": 1, "items": inner},
                    {
                        "type": "object",
                        "properties": {"a": scalar, "k": scalar},
                        "additionalProperties": False,
                    },
                    {"type": "object", "properties": {"k": inner}, "additionalProperties": False},
                ]
            }
        unique = {frozen(value): value for value in self.values}
        self.values = list(unique.values())
        self.place = {key: n for n, key in enumerate(unique)}
        self.depths = [_depth(value) for value in self.values]
        self.arrays = {
            n: [self.at(part) for part in value]
            for n, value in enumerate(self.values)
            if isinstance(value, list)
        }
        self.objects = {
            n: {name: self.at(part) for name, part in value.items()}
            for n, value in enumerate(self.values)
            if isinstance(value, dict)
        }
        self._plain: dict[str, int] = {}
        self.upto = [
            sum(1 << n for n, d in enumerate(self.depths) if d <= limit)
            for limit in range(max(self.depths) + 1)
        ]

    def at(self, value: object) -> int:
        return self.place[frozen(value)]

    def plain(self, keyword: str, said: object) -> int:
        """Return the bits of the values that a keyword without schemas in it allows."""
        key = f"{keyword} {json.dumps(said)}"
        if key not in self._plain:
            allowed = (n for n, value in enumerate(self.values) if _plain(keyword, said, value))
            self._plain[key] = sum(1 << n for n in allowed)
        return self._plain[key]


@lru_cache(maxsize=4)
def world(depth: int) -> World:
    return World(depth)


def _depth(value: Any) -> int:
    parts = value.values() if isinstance(value, dict) else value if isinstance(value, list) else ()
    return max((1 + _depth(part) for part in parts), default=0)


class Meaning:
    """What one document means in a world.

    Args:
        schema: the document.
        over: the world.
        far: what lies behind references that lead out, by absolute URI.
    """

    def __init__(
        self, schema: Schema, over: World, far: Mapping[str, Schema] | None = None
    ) -> None:
        self._world = over
        self._documents: dict[str, Schema] = {}
        self._anchors: dict[tuple[str, str], Schema] = {}
        self._dynamic: set[tuple[str, str]] = set()
        self._base: dict[int, str] = {}
        self._known: dict[tuple[int, tuple[str, ...], int], int | None] = {}
        self._kept = json.loads(json.dumps([schema, *(far or {}).values()]))
        for base, item in zip(["", *(far or {})], self._kept, strict=True):
            self._documents[base] = item
            self._index(item, base)
        self.bits = self._mask(self._kept[0], (), len(over.upto) - 1)

    def allows(self, value: object) -> bool:
        return bool(self.bits >> self._world.at(value) & 1)

    def _index(self, schema: Schema, base: str) -> None:
        if isinstance(schema, bool):
            return
        if "$id" in schema:
            base = urljoin(base, schema["$id"])
            self._documents[base] = schema
        self._base[id(schema)] = base
        for keyword in ("$anchor", "$dynamicAnchor"):
            if keyword in schema:
                self._anchors[base, schema[keyword]] = schema
                if keyword == "$dynamicAnchor":
                    self._dynamic.add((base, schema[keyword]))
        for item in _inner(schema):
            self._index(item, base)

    def _mask(self, schema: Schema, scope: tuple[str, ...], depth: int) -> int:
        if isinstance(schema, bool):
            return self._world.upto[depth] if schema else 0
        base = self._base[id(schema)]
        if base not in scope:
            scope = (*scope, base)
        key = id(schema), scope, depth
        if key in self._known:
            known = self._known[key]
            if known is None:
                raise InPlaceError
            return known
        self._known[key] = None
        everything = self._world.upto[depth]
        found = everything
        for keyword, value in schema.items():
            found &= self._keyword(schema, keyword, value, scope, depth)
        self._known[key] = found
        return found

    def _keyword(
        self,
        schema: Mapping[str, Any],
        keyword: str,
        value: Any,
        scope: tuple[str, ...],
        depth: int,
    ) -> int:
        everything = self._world.upto[depth]

        def inner(one: Schema) -> int:
            return self._mask(one, scope, depth)

        if keyword in {"$ref", "$dynamicRef", "$recursiveRef"}:
            return self._mask(
                *self._target(keyword, urljoin_(self._base[id(schema)], value), scope), depth
            )
        if keyword == "not":
            return everything & ~inner(value)
        if keyword in {"allOf", "anyOf", "oneOf"}:
            masks = [inner(item) for item in value]
            once = twice = 0
            for mask in masks:
                twice |= once & mask
                once |= mask
            if keyword == "allOf":
                return everything & ~_or(everything & ~mask for mask in masks)
            return once if keyword == "anyOf" else once & ~twice
        if keyword == "if":
            holds = inner(value)
            then, other = inner(schema.get("then", True)), inner(schema.get("else", True))
            return (holds & then) | (everything & ~holds & other)
        if keyword == "dependentSchemas":
            found = everything
            for name, item in value.items():
                found &= inner(item) | ~sum(
                    1 << n for n, v in self._world.objects.items() if name in v
                )
            return found
        if keyword in {"items", "prefixItems", "contains", "properties", "additionalProperties"}:
            return self._parts(schema, keyword, value, scope, depth)
        return everything & self._world.plain(keyword, value)

    def _parts(
        self,
        schema: Mapping[str, Any],
        keyword: str,
        value: Any,
        scope: tuple[str, ...],
        depth: int,
    ) -> int:
        def ok(subschema: Schema) -> int:
            return self._mask(subschema, scope, depth - 1) if depth else 0

        deep = self._world.depths
        arrays = {n: v for n, v in self._world.arrays.items() if deep[n] <= depth}
        objects = {n: v for n, v in self._world.objects.items() if deep[n] <= depth}
        failing: Iterable[int]
        if keyword == "items":
            bits, start = ok(value), len(schema.get("prefixItems", ()))
            failing = (
                n for n, v in arrays.items() if not all(bits >> number & 1 for number in v[start:])
            )
        elif keyword == "prefixItems":
            rules = [ok(item) for item in value]
            failing = (
                n
                for n, v in arrays.items()
                if not all(bits >> number & 1 for bits, number in zip(rules, v, strict=False))
            )
        elif keyword == "contains":
            bits = ok(value)
            failing = (n for n, v in arrays.items() if not any(bits >> number & 1 for number in v))
        else:
            known = schema.get("properties", {})
            named = {name: ok(item) for name, item in known.items()}
            rest = ok(value) if keyword == "additionalProperties" else 0
            failing = (
                n
                for n, v in objects.items()
                if not all(
                    (named[name] >> item & 1 if keyword == "properties" else True)
                    if name in named
                    else (rest >> item & 1 if keyword == "additionalProperties" else True)
                    for name, item in v.items()
                )
            )
        return self._world.upto[depth] & ~sum(1 << n for n in failing)

    def _target(
        self, keyword: str, absolute: str, scope: tuple[str, ...]
    ) -> tuple[Schema, tuple[str, ...]]:
        base, _, name = absolute.partition("#")
        if keyword == "$recursiveRef":
            if _recursive(self._documents[base]):
                base = next(text for text in scope if _recursive(self._documents[text]))
            return self._documents[base], scope
        if not name:
            return self._documents[base], scope
        if name.startswith("/"):
            at: Any = self._documents[base]
            for step in name[1:].split("/"):
                at = at[step]
            return at, (scope if base in scope else (*scope, base))
        if keyword == "$dynamicRef" and (base, name) in self._dynamic:
            base = next((text for text in scope if (text, name) in self._dynamic), base)
        return self._anchors[base, name], (scope if base in scope else (*scope, base))


def urljoin_(base: str, reference: str) -> str:
    target, _, fragment = reference.partition("#")
    return f"{urljoin(base, target) if target else base}#{fragment}"


def _recursive(document: Schema) -> bool:
    return isinstance(document, dict) and document.get("$recursiveAnchor") is True


def _or(masks: Iterator[int]) -> int:
    found = 0
    for mask in masks:
        found |= mask
    return found


def _inner(schema: Mapping[str, Any]) -> Iterator[Schema]:
    for keyword, value in schema.items():
        if keyword in _SCHEMAS:
            yield value
        elif keyword in _LISTS:
            yield from value
        elif keyword in _MAPS:
            yield from value.values()


def _plain(keyword: str, said: Any, value: Any) -> bool:
    kind = type_of(value)
    if keyword == "type":
        names = said if isinstance(said, list) else [said]
        return kind in names or (kind == "number" and "integer" in names and value == int(value))
    if keyword == "const":
        return frozen(value) == frozen(said)
    if keyword == "enum":
        return frozen(value) in {frozen(item) for item in said}
    if keyword == "minimum":
        return not is_number(value) or value >= said
    if keyword == "maximum":
        return not is_number(value) or value <= said
    if keyword == "minLength":
        return kind != "string" or len(value) >= said
    if keyword == "minItems":
        return kind != "array" or len(value) >= said
    if keyword == "maxItems":
        return kind != "array" or len(value) <= said
    if keyword == "uniqueItems":
        return kind != "array" or not said or len({frozen(item) for item in value}) == len(value)
    if keyword == "required":
        return kind != "object" or all(name in value for name in said)
    if keyword == "minProperties":
        return kind != "object" or len(value) >= said
    if keyword == "maxProperties":
        return kind != "object" or len(value) <= said
    if keyword == "dependentRequired":
        return kind != "object" or all(
            item in value for name, names in said.items() if name in value for item in names
        )
    known = {
        "then",
        "else",
        "$defs",
        "$id",
        "$schema",
        "$anchor",
        "$dynamicAnchor",
        "$recursiveAnchor",
    }
    assert keyword in known, keyword
    return True
