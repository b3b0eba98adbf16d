"""Random documents of several documents: dynamic anchors, recursive anchors, far references."""

from __future__ import annotations

import json
from copy import deepcopy
from typing import TYPE_CHECKING, Any, NamedTuple

from uoarm.testing._instances import chance

if TYPE_CHECKING:
    from uoarm.testing._instances import Choices

DRAFT_2019 = "https://json-schema.org/draft/2019-09/schema"
ROOT = "http://robots.example/root"
BESIDE = "http://robots.example/other.json"
FAR = ("http://far.example/x", "http://far.example/y")
Schema = dict[str, Any]
Body = Schema | bool
Pair = tuple[Schema, Schema]

_LEAVES: tuple[Body, ...] = (
    {"type": "integer"}, {"type": "string"}, {"type": ["integer", "string"]}, {"const": 1},
    {"enum": [0, "a"]}, {"minimum": 1}, {"type": "array"}, {"type": "object"}, {"required": ["k"]},
    {"maxItems": 1}, {"minItems": 1}, {"type": "null"}, {"enum": [[], {}]}, {"uniqueItems": True},
    {"const": {"k": 1}}, {"maxProperties": 1}, {"dependentRequired": {"k": ["a"]}}, True, False,
)  # fmt: skip


class _Kind(NamedTuple):
    """What a generator may use."""

    recursive: bool = False
    dynamic: bool = False
    far: bool = False


def leaf(choices: Choices) -> Body:
    """A small schema without references."""
    return deepcopy(choices.item(_LEAVES))


class _Writer:
    def __init__(self, choices: Choices, kind: _Kind) -> None:
        self._choices = choices
        self._kind = kind
        self._count = choices.integer(1, 3)
        self._anchored = [chance(choices, 70) for _ in range(self._count + 1)]

    def document(self) -> dict[str, Any]:
        parts = {f"r{n}": self._resource(n) for n in range(1, self._count + 1)}
        root = self._resource(0)
        draft = {"$schema": DRAFT_2019} if self._kind.recursive else {}
        return {**draft, **root, "$id": ROOT, "$defs": {**root.get("$defs", {}), **parts}}

    def _resource(self, number: int) -> dict[str, Any]:
        choices = self._choices
        body: dict[str, Any] = {"allOf": [self._body(2, number, below=False)]}
        if chance(choices, 40):
            body |= {"items": self._body(1, number, below=True)}
        if chance(choices, 40):
            body |= {"properties": {"k": self._body(1, number, below=True)}}
        if self._kind.recursive and self._anchored[number]:
            body["$recursiveAnchor"] = True
        if self._kind.dynamic and self._anchored[number]:
            rule = self._body(1, number, below=False, plain=True)
            body["$defs"] = {"n": {"$dynamicAnchor": "T", "allOf": [rule]}}
        return {"$id": f"r{number}", **body}

    def _body(self, depth: int, number: int, *, below: bool, plain: bool = False) -> Body:
        choices = self._choices
        if chance(choices, 35) and not plain:
            return self._reference(number, below=below)
        if depth == 0 or chance(choices, 20):
            return leaf(choices)

        def inside() -> Body:
            return self._body(depth - 1, number, below=True)

        def here() -> Body:
            return self._body(depth - 1, number, below=below, plain=plain)

        kind = choices.integer(0, 8)
        if kind == 0:
            return {"not": here()}
        if kind in {1, 2, 3}:
            return {("anyOf", "oneOf", "allOf")[kind - 1]: [here(), here()]}
        if kind == 4:
            return {"if": here(), "then": here(), "else": here()}
        if kind == 5:
            return {"type": "array", choices.item(("items", "contains")): inside()}
        if kind == 6:
            return {"type": "array", "items": inside(), "minItems": 1}
        name = choices.item(("k", "k", "a"))
        more = {"required": [name]} if chance(choices, 40) else {}
        return {"type": "object", "properties": {name: inside()}, **more}

    def _reference(self, number: int, *, below: bool) -> Body:
        choices = self._choices
        first = 0 if below else number + 1  # in place only onwards, so that nothing goes round
        ways: list[Body] = [{"$ref": f"r{n}" if n else ROOT} for n in range(first, self._count + 1)]
        if self._kind.recursive:
            ways += [{"$recursiveRef": "#"}] * (3 if below else 0)
        if self._kind.dynamic:
            with_anchor = [n for n, has in enumerate(self._anchored) if has]
            ways += [{"$dynamicRef": f"{f'r{n}' if n else ROOT}#T"} for n in with_anchor]
            if self._anchored[number]:
                ways += [{"$dynamicRef": "#T"}, {"$dynamicRef": "#T"}, {"$ref": "#T"}]
        if self._kind.far:
            ways += [{"$ref": name} for name in (*FAR, "other.json")]
        return choices.item(ways) if ways else leaf(choices)


def dynamic_pair(choices: Choices) -> Pair:
    """Two documents with dynamic anchors; the second is often a variant of the first."""
    return _pair(choices, _Kind(dynamic=True))


def recursive_pair(choices: Choices) -> Pair:
    """Two documents of draft 2019-09 with recursive anchors."""
    return _pair(choices, _Kind(recursive=True))


def far_pair(choices: Choices) -> Pair:
    """Two documents that refer to what lies outside, with and without names and anchors."""
    producer, consumer = _pair(choices, _Kind(dynamic=chance(choices, 50), far=True))
    if chance(choices, 50):
        producer, consumer = _nameless(producer), _nameless(consumer)
    return producer, consumer


def far_document(choices: Choices) -> Body:
    """What may lie behind a far reference; it may refer back by name or by dynamic scope."""
    kind = choices.integer(0, 5)
    if kind == 0:
        return {
            "$dynamicRef": "#T",
            "$defs": {"n": {"$dynamicAnchor": "T", "allOf": [leaf(choices)]}},
        }
    if kind == 1:
        return {"items": {"$ref": ROOT}, "type": ["array", "integer"]}
    if kind == 2:
        return {"not": {"properties": {"k": leaf(choices)}}}
    return leaf(choices)


def _pair(choices: Choices, kind: _Kind) -> Pair:
    producer = _Writer(choices, kind).document()
    if chance(choices, 25):
        consumer = _Writer(choices, kind).document()
    else:
        consumer = deepcopy(producer)
        for _ in range(choices.integer(0, 2)):
            _change(choices, consumer)
    if chance(choices, 25):
        consumer["allOf"] = [
            {"anyOf": [{"not": item}, leaf(choices)]} for item in consumer["allOf"]
        ]
    return producer, consumer


def _change(choices: Choices, schema: dict[str, Any]) -> None:
    """Replace one schema within by a leaf, loosen it or narrow it."""
    places: list[tuple[Any, Any]] = []
    waiting: list[Any] = [schema]
    while waiting:
        one = waiting.pop()
        for keyword, value in one.items():
            if keyword in {"allOf", "anyOf", "oneOf"}:
                places += [(value, n) for n in range(len(value))]
                waiting += [inner for inner in value if isinstance(inner, dict)]
            elif keyword in {"items", "contains", "not", "if", "then", "else"}:
                places.append((one, keyword))
                waiting += [value] if isinstance(value, dict) else []
            elif keyword in {"properties", "$defs"}:
                places += [(value, name) for name in value] if keyword == "properties" else []
                waiting += [inner for inner in value.values() if isinstance(inner, dict)]
    holder, key = choices.item(places)
    way = choices.integer(0, 2)
    if way == 0:
        holder[key] = leaf(choices)
    else:
        holder[key] = {("anyOf", "allOf")[way - 1]: [holder[key], leaf(choices)]}


def _nameless(schema: Schema) -> Schema:
    """Take the root's identifier away; what names the root by it then says `#`."""
    text = json.dumps({name: value for name, value in schema.items() if name != "$id"})
    nameless: Schema = json.loads(text.replace(f'"{ROOT}"', '"#"').replace(f'"{ROOT}#', '"#'))
    return nameless
