"""Rewrites of a schema whose effect on its meaning is known: none, narrower, wider."""

from __future__ import annotations

from typing import TYPE_CHECKING

from uoarm.testing._instances import Choices, chance

if TYPE_CHECKING:
    from collections.abc import Callable

Schema = dict[str, object]
Body = Schema | bool

_CONTEXTUAL = {
    "not", "oneOf", "if", "unevaluatedProperties", "unevaluatedItems", "maxContains", "$ref",
}  # fmt: skip
_WATCHERS = {"unevaluatedProperties", "unevaluatedItems"}
_SPLITTABLE = {
    "minimum", "maximum", "exclusiveMinimum", "exclusiveMaximum", "multipleOf", "pattern",
    "minLength", "maxLength", "required", "minItems", "maxItems", "uniqueItems", "enum", "const",
    "minProperties", "maxProperties", "dependentRequired", "propertyNames", "type", "not",
}  # fmt: skip


def equivalent(choices: Choices, schema: Body, rounds: int = 2) -> Body:
    """A schema with the same instances, written differently."""
    for _ in range(rounds):
        schema = _at_some_place(choices, schema, _same)
    return schema


def tightened(choices: Choices, schema: Body) -> Body:
    """A schema whose instances are some of those of ``schema``."""
    return _at_some_place(choices, schema, _narrow)


def loosened(choices: Choices, schema: Body) -> Body:
    """A schema whose instances include those of ``schema``."""
    return _at_some_place(choices, schema, _widen)


def negated(schema: Body) -> Body:
    """A schema whose instances are those that ``schema`` refuses."""
    if not isinstance(schema, dict):
        return not schema
    rest = {name: value for name, value in schema.items() if name != "$defs"}
    return {"not": rest} | ({"$defs": schema["$defs"]} if "$defs" in schema else {})


def keywords(schema: object) -> set[str]:
    """Every name in the document: a superset of the keywords used."""
    found: set[str] = set()
    waiting = [schema]
    while waiting:
        node = waiting.pop()
        if isinstance(node, dict):
            found |= set(node)
            waiting.extend(node.values())
        elif isinstance(node, list):
            waiting.extend(node)
    return found


def _at_some_place(
    choices: Choices, schema: Body, change: Callable[[Choices, Schema], Body]
) -> Body:
    if not isinstance(schema, dict):
        return {"allOf": [schema]}
    rest = {name: value for name, value in schema.items() if name != "$defs"}
    defs = {"$defs": schema["$defs"]} if "$defs" in schema else {}
    deep = not (keywords(schema) & _CONTEXTUAL)
    changed = _descend(choices, rest, change) if deep else change(choices, rest)
    return {**defs, **changed} if isinstance(changed, dict) else changed


def _descend(choices: Choices, schema: Body, change: Callable[[Choices, Schema], Body]) -> Body:
    """Apply ``change`` here or at one place below where meaning is monotone in the part."""
    if not isinstance(schema, dict):
        return schema
    places: list[tuple[str, str | int | None]] = [
        (keyword, None)
        for keyword in ("items", "additionalProperties", "contains")
        if isinstance(schema.get(keyword), dict)
    ]
    for keyword in ("properties", "patternProperties"):
        if isinstance(parts := schema.get(keyword), dict):
            places += [(keyword, name) for name in parts]
    for keyword in ("prefixItems", "anyOf", "allOf"):
        if isinstance(branches := schema.get(keyword), list):
            places += [(keyword, place) for place in range(len(branches))]
    if not places or chance(choices, 35):
        return change(choices, schema)
    keyword, key = choices.item(places)
    holder = schema[keyword]
    if key is None:
        return {**schema, keyword: _descend(choices, holder, change)}  # type: ignore[arg-type] # chosen for being a schema
    if isinstance(holder, dict):
        part = _descend(choices, holder[key], change)
        return {**schema, keyword: {**holder, key: part}}
    assert isinstance(holder, list)
    assert isinstance(key, int)
    branches = [*holder]
    branches[key] = _descend(choices, branches[key], change)
    return {**schema, keyword: branches}


def _same(choices: Choices, schema: Schema) -> Body:
    wraps: list[Callable[[], Schema]] = [
        lambda: dict(reversed(schema.items())),
        lambda: {"allOf": [schema]},
        lambda: {"allOf": [schema, True]},
        lambda: {"anyOf": [schema, schema]},
        lambda: {"anyOf": [False, schema]},
        lambda: {"oneOf": [schema]},
        lambda: {"not": {"not": schema}},
        lambda: {"if": schema, "else": False},
        lambda: {"if": schema, "then": True, "else": False},
        lambda: {"not": {"anyOf": [{"not": schema}]}},
        lambda: {"allOf": [schema, {"anyOf": [schema, {"type": "null"}]}]},
        lambda: _respelt(schema),
        lambda: _respelt(schema),
        lambda: _split(schema),
        lambda: _split(schema),
    ]
    return choices.item(wraps)()


def _respelt(schema: Schema) -> Schema:
    spelt = dict(schema)
    if "const" in spelt and "enum" not in spelt:
        spelt["enum"] = [spelt.pop("const")]
    elif isinstance(members := spelt.get("enum"), list) and "anyOf" not in spelt:
        del spelt["enum"]
        spelt["anyOf"] = [{"const": member} for member in members]
    kind = spelt.get("type")
    if kind == "integer" and "multipleOf" not in spelt:
        spelt |= {"type": "number", "multipleOf": 1}
    elif kind == "null" and "enum" not in spelt:
        del spelt["type"]
        spelt["enum"] = [None]
    elif kind == "boolean" and "enum" not in spelt:
        spelt["enum"] = [False, True]
    elif kind == "number":
        spelt["type"] = ["integer", "number"]
    elif isinstance(kind, list) and "anyOf" not in spelt:
        del spelt["type"]
        spelt["anyOf"] = [{"type": name} for name in kind]
    elif kind == "string" and "minLength" not in spelt:
        spelt["minLength"] = 0
    elif kind == "object" and spelt.get("additionalProperties") is False:
        spelt["additionalProperties"] = {"not": {}}
    return spelt


def _split(schema: Schema) -> Schema:
    moved = {name: value for name, value in schema.items() if name in _SPLITTABLE}
    kept = {name: value for name, value in schema.items() if name not in _SPLITTABLE}
    return (
        {**kept, "allOf": [{name: value} for name, value in moved.items()]}
        if (moved and "allOf" not in kept)
        else {"allOf": [schema]}
    )


def _narrow(choices: Choices, schema: Schema) -> Body:
    extra: list[Schema] = [
        {"required": ["a"]},
        {"maxProperties": 1},
        {"maximum": 1},
        {"exclusiveMinimum": 0},
        {"multipleOf": 2},
        {"maxLength": 1},
        {"pattern": "^a"},
        {"maxItems": 1},
        {"minItems": 1},
        {"uniqueItems": True},
        {"type": ["integer", "object", "string", "array"]},
        {"not": {"const": 1}},
        {"properties": {"a": {"type": "integer"}}},
        {"propertyNames": {"maxLength": 4}},
        {"contains": {"type": "integer"}},
    ]
    addition = choices.item(extra)
    (keyword,) = addition
    if keyword not in schema and keyword in _SPLITTABLE and chance(choices, 50):
        return {**schema, **addition}
    watched = bool(_WATCHERS & set(schema))
    branches = schema.get("anyOf")
    if isinstance(branches, list) and len(branches) > 1 and not watched:
        return {**schema, "anyOf": branches[1:]}
    if isinstance(members := schema.get("enum"), list) and len(members) > 1:
        return {**schema, "enum": members[1:]}
    return {"allOf": [schema, addition]}


def _widen(choices: Choices, schema: Schema) -> Body:
    droppable = [
        name
        for name in schema
        if name in _SPLITTABLE | {"properties", "anyOf", "items", "contains", "allOf"}
        and not (name in {"properties", "prefixItems"} and "additionalProperties" in schema)
        and not (name == "contains" and "minContains" in schema)
        and not (name == "patternProperties" and "additionalProperties" in schema)
    ]
    if droppable and not _WATCHERS & set(schema) and chance(choices, 50):
        gone = choices.item(droppable)
        return {name: value for name, value in schema.items() if name != gone}
    others: list[Body] = [
        {"type": "null"},
        {"const": {"a": 1}},
        {"type": "object"},
        {"enum": [1, "a", [True]]},
        {"type": "string", "maxLength": 2},
        {"type": "array", "items": {"type": "integer"}},
    ]
    return {"anyOf": [schema, choices.item(others)]}
