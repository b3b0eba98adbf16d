"""How large the messages of a structure are when they are written: at least, and where it is known.

Only what certainly holds is said: that every message is as large, or that one is that may be
emitted. What nothing bounds may be of any size, and is measured when it is sent.
"""

from __future__ import annotations

import json
import math
from collections.abc import Iterable, Iterator, Mapping
from contextlib import suppress
from typing import Any, NamedTuple

from attrs import define, field

from uoarm.schema import document_of, follow

JSON_LIMIT, OCTETS_LIMIT = "x-max-json", "x-max-octets"
_MOST_DEPTH = 32
_MOST_PARTS = 20_000
_OF_REAL = 17
_MOST_DIGITS = 4300
_TYPES = ("object", "array", "string", "integer", "number", "boolean", "null")
_CHOICES = frozenset({"allOf", "anyOf", "oneOf", "$ref"})
_LOGIC = frozenset({"not", "if", "maxProperties", "dependentRequired", "dependentSchemas"})
_QUOTES = 2
_WIDEST = 4


class Sizes(NamedTuple):
    """Octets of the messages of a structure.

    Attributes:
        least: every message has as many.
        most: one that may be emitted has about as many; infinite where nothing bounds it, and as
            few as the least where nothing is known.
    """

    least: int
    most: float


_UNKNOWN = Sizes(1, 1)


def sizes_of(schema: Any, limit: str) -> Sizes:
    """Return the sizes of the messages of a schema.

    Args:
        schema: of what is emitted.
        limit: the keyword that says what is counted: JSON, or the octets of an array or a text.
    """
    return _Walk(schema, is_json=limit == JSON_LIMIT).of(schema, 0)


@define
class _Walk:
    root: Any
    is_json: bool
    parts: int = field(default=0, init=False)

    def of(self, schema: Any, depth: int) -> Sizes:
        """Return the sizes of what a schema allows."""
        self.parts += 1
        if not isinstance(schema, Mapping) or depth > _MOST_DEPTH or self.parts > _MOST_PARTS:
            return Sizes(1, math.inf) if schema is True else _UNKNOWN
        if document_of(schema, self.root) is not self.root:
            return _UNKNOWN
        found = list(self._demands(schema, depth))
        least = max(size.least for size in found)
        most = min(size.most for size in found)
        # Of demands together only those that bound nothing, or one alone, say what may come.
        is_known = len(found) == 1 or most == math.inf
        return Sizes(least, most if is_known and _LOGIC.isdisjoint(schema) else least)

    def _demands(self, schema: Mapping[str, Any], depth: int) -> Iterator[Sizes]:
        """Yield the sizes that hold together."""
        if "const" in schema:
            yield _either([self._written(schema["const"])])
        elif "enum" in schema:
            yield _either(map(self._written, schema["enum"]))
        elif "type" in schema or _CHOICES.isdisjoint(schema):
            kinds = schema.get("type", _TYPES)
            kinds = (kinds,) if isinstance(kinds, str) else kinds
            yield _either(self._kind(kind, schema, depth) for kind in kinds)
        for subschema in schema.get("allOf", ()):
            yield self.of(subschema, depth + 1)
        for union in ("anyOf", "oneOf"):
            if union in schema:
                yield _either(self.of(part, depth + 1) for part in schema[union])
        if "$ref" in schema:
            yield self.of(follow(self.root, schema["$ref"]), depth + 1)

    def _kind(self, kind: str, schema: Mapping[str, Any], depth: int) -> Sizes:
        if kind == "object":
            return self._object(schema, depth)
        if kind == "array":
            return self._array(schema, depth)
        if kind == "string":
            return self._string(schema)
        if kind in {"integer", "number"}:
            return _number(schema, is_whole=kind == "integer")
        return Sizes(4, 5) if kind == "boolean" else Sizes(4, 4)

    def _string(self, schema: Mapping[str, Any]) -> Sizes:
        around = _QUOTES if self.is_json else 0
        least = around + int(schema.get("minLength", 0))
        if not {"pattern", "format", "not"}.isdisjoint(schema):
            return Sizes(least, least)
        most = min(schema.get("x-max-utf8", math.inf), _WIDEST * schema.get("maxLength", math.inf))
        return Sizes(least, around + most)

    def _array(self, schema: Mapping[str, Any], depth: int) -> Sizes:
        low, high = int(schema.get("minItems", 0)), schema.get("maxItems", math.inf)
        if schema.get("x-octets") is True or not self.is_json:
            least = self._octets(low)
            return Sizes(min(least, 2 * low + 1) if self.is_json else least, self._octets(high))
        first = [self.of(part, depth + 1) for part in schema.get("prefixItems", ())]
        if schema.get("items") is False:
            high = min(high, len(first))
        rest = self.of(schema.get("items", True), depth + 1)
        is_free = {"contains", "uniqueItems", "unevaluatedItems"}.isdisjoint(schema)
        least = sum(item.least for item in first[:low]) + max(0, low - len(first)) * rest.least
        least += 1 + max(1, low)
        if not is_free:
            return Sizes(least, least)
        if high == math.inf:
            return Sizes(least, math.inf)
        most = sum(item.most for item in first[: int(high)])
        more = max(0, int(high) - len(first))
        return Sizes(least, most + (more * rest.most if more else 0) + 1 + max(1, int(high)))

    def _octets(self, count: float) -> Any:
        if not self.is_json or count == math.inf:
            return count
        return _QUOTES + 4 * -(-int(count) // 3)  # base64

    def _object(self, schema: Mapping[str, Any], depth: int) -> Sizes:
        required = set(schema.get("required", ()))
        names = dict.fromkeys((*schema.get("properties", {}), *sorted(required)))
        least = most = 0.0
        for name in names:
            size = self.of(schema.get("properties", {}).get(name, True), depth + 1)
            around = len(_json(name)) + _QUOTES  # the colon, and a comma or a brace
            most += around + size.most
            least += around + size.least if name in required else 0
        is_closed = schema.get("additionalProperties") is False
        if not is_closed or "patternProperties" in schema:
            most = math.inf
        return Sizes(max(int(least) + 1, 2), max(most + 1, 2))

    def _written(self, value: Any) -> Sizes:
        if self.is_json:
            most, least = _octets(value), _octets(_shortest(value))
        else:
            most = len(value.encode("utf-8", "surrogatepass")) if isinstance(value, str) else 1
            least = most
        return Sizes(int(min(least, _MOST_DIGITS)), most)


def _either(sizes: Iterable[Sizes]) -> Sizes:
    found = list(sizes) or [_UNKNOWN]
    return Sizes(min(least for least, _ in found), max(most for _, most in found))


def _number(schema: Mapping[str, Any], *, is_whole: bool) -> Sizes:
    low, high = schema.get("minimum"), schema.get("maximum")
    if not is_whole:
        return Sizes(1, _OF_REAL if "multipleOf" not in schema else 1)
    if low is None or high is None:
        return Sizes(1, math.inf)
    return Sizes(1, max(_octets(int(low)), _octets(int(high))))


def _shortest(value: Any) -> Any:
    """Return a value equal to this one, with each number in the shortest of its forms.

    A message with 1 or 1e+20 is equal to a `const` of 1.0 or of a one with twenty noughts.
    """
    if isinstance(value, dict):
        return {name: _shortest(part) for name, part in value.items()}
    if isinstance(value, list | tuple):
        return [_shortest(part) for part in value]
    if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value):
        return value
    with suppress(OverflowError):
        forms = [form for form in (int(value), float(value)) if form == value]
        return min(forms, key=_octets)
    return value


def _octets(value: Any) -> float:
    try:
        return len(_json(value).encode("utf-8", "surrogatepass"))
    except ValueError:  # Python writes whole numbers of 4,300 digits at most
        return math.inf


def _json(value: Any) -> str:
    return json.dumps(value, ensure_ascii=False, separators=(",", ":"), default=str)
