"""Parts of schemas: followed by references, changed, put within other schemas, and taken out."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from typing import Any

# The keywords of 2020-12 whose values are a schema, a list of schemas, schemas by name.
SINGLES = (
    "items", "contains", "additionalProperties", "propertyNames", "not", "if", "then", "else",
    "unevaluatedItems", "unevaluatedProperties", "contentSchema",
)  # fmt: skip
LISTS = ("prefixItems", "allOf", "anyOf", "oneOf")
MAPS = ("properties", "patternProperties", "dependentSchemas", "$defs")
_OF_NAMES = frozenset({*MAPS, "definitions", "dependencies"})
_OTHERS = frozenset({*SINGLES, *LISTS, "additionalItems"})
_DEFINITIONS = ("$defs", "definitions")
_DEFINED = tuple(f"#/{keyword}/" for keyword in _DEFINITIONS)
_ANCHORS = ("$anchor", "$dynamicAnchor")
_REFERENCES = ("$ref", "$dynamicRef")
_OF_DOCUMENT = frozenset({"$schema", "$id"})
_MOST_STEPS = 32
_INDEX = re.compile("[0-9]{1,9}")


def follow(document: Any, reference: object) -> Any:
    """Return the schema that a reference leads to within a document; None where there is none.

    JSON pointers and anchors are known, alone or behind the address of the document. What stands
    below another address is part of another document: see `document_of`.

    Example:
        >>> follow({"$defs": {"a b": {"type": "null"}}}, "#/$defs/a%20b")
        {'type': 'null'}
    """
    if not isinstance(reference, str):
        return None
    base, _, fragment = reference.partition("#")
    if base not in {"", _address(document)}:
        return None
    if "%" in fragment:
        from urllib.parse import unquote  # noqa: PLC0415 - slow import, rarely needed

        fragment = unquote(fragment)
    if fragment and not fragment.startswith("/"):
        named = (part for part in _own_parts(document) if fragment in map(part.get, _ANCHORS))
        return next(named, None)
    found = document
    for step in fragment.split("/")[1:]:
        found = at_step(found, step)
        if document_of(found, document) is not document:
            return None
    return found if isinstance(found, Mapping | bool) else None


def at_step(part: Any, step: str) -> Any:
    """Return what a step of a JSON pointer leads to in a part; None where there is nothing."""
    name = step.replace("~1", "/").replace("~0", "~")
    if isinstance(part, Mapping):
        return part.get(name)
    is_place = isinstance(part, list | tuple) and _INDEX.fullmatch(name) and int(name) < len(part)
    return part[int(name)] if is_place else None


def document_of(schema: Any, document: Any) -> Any:
    """Return the document in which references of a schema are looked for.

    Args:
        schema: a part of the document; one with an address of its own is a document itself.
        document: what the parts around the schema refer to.
    """
    is_another = isinstance(schema, Mapping) and isinstance(schema.get("$id"), str)
    return schema if is_another else document


def change_parts(
    schema: Mapping[str, Any],
    change: Callable[[Any], Any],
    *,
    but: frozenset[str] = frozenset(),
) -> dict[str, Any]:
    """Return a schema in which each schema directly within it was changed.

    All keywords of drafts 7 to 2020-12 are known; values of `const`, `enum` and `default` stay.

    Args:
        schema: that is not changed itself.
        change: takes each part, a mapping or a bool, and returns what stands in its place.
        but: keywords whose schemas stay.
    """

    def changed(part: Any) -> Any:
        return change(part) if isinstance(part, Mapping | bool) else part

    made = dict(schema)
    for keyword, value in schema.items():
        if keyword in but:
            continue
        if keyword in _OF_NAMES and isinstance(value, Mapping):
            made[keyword] = {name: changed(part) for name, part in value.items()}
        elif keyword in _OTHERS:
            many = isinstance(value, list | tuple)
            made[keyword] = [changed(part) for part in value] if many else changed(value)
    return made


def portable(
    schema: Any, name: str = "message", *, whole: bool = False
) -> tuple[Any, dict[str, Any]]:
    """Return a schema for any place of another one, and the definitions that its root must have.

    References are seen from the root of a document. Where all are to definitions, these are what
    the root must have; else the whole schema is one, and references to places in it are changed.

    Args:
        schema: a mapping or a bool.
        name: of the definition.
        whole: make it one in any case, where names of its definitions may be others' there.
    """
    if not isinstance(schema, Mapping):
        return schema, {}
    inner = {keyword: value for keyword, value in schema.items() if keyword not in _OF_DOCUMENT}
    found = (part.get(keyword) for part in _own_parts(inner) for keyword in _REFERENCES)
    places = (place for place in found if isinstance(place, str))
    if not whole and all(place.startswith(_DEFINED) for place in places):
        hoisted = {keyword: inner.pop(keyword) for keyword in _DEFINITIONS if keyword in inner}
        return inner, hoisted
    moved = _moved(inner, _address(schema), f"#/$defs/{name}")
    return {"$ref": f"#/$defs/{name}"}, {"$defs": {name: moved}}


def enclose(
    schema: Any, around: Callable[[Any], Mapping[str, Any]], name: str = "message"
) -> dict[str, Any]:
    """Return a schema around another one, whose references mean there what they did alone.

    Args:
        schema: a mapping or a bool.
        around: takes what stands for the schema, and returns the one around it, which may have
            `$defs` of its own, under other names than the schema's.
        name: of the schema, where it becomes a definition.

    Example:
        >>> enclose({"$ref": "#/$defs/a", "$defs": {"a": {}}}, lambda inner: {"not": inner})
        {'not': {'$ref': '#/$defs/a'}, '$defs': {'a': {}}}
    """
    inner, hoisted = portable(schema, name)
    made = around(inner)
    return {
        **made,
        **{keyword: {**made.get(keyword, {}), **found} for keyword, found in hoisted.items()},
    }


def property_of(schema: Any, name: str) -> Any:
    """Return the schema of a property as one that stands alone; True where it is not described.

    Example:
        >>> schema = {"properties": {"a": {"$ref": "#/$defs/n"}}, "$defs": {"n": {}}}
        >>> property_of(schema, "a")
        {'$ref': '#/$defs/n', '$defs': {'n': {}}}
    """
    inner, hoisted = portable(schema)
    document = found = {**inner, **hoisted} if isinstance(inner, Mapping) else inner
    for _ in range(_MOST_STEPS):
        if not isinstance(found, Mapping):
            break
        if isinstance(known := found.get("properties"), Mapping) and name in known:
            part = known[name]
            is_alone = not isinstance(part, Mapping) or document_of(part, document) is part
            return part if is_alone else {**part, **hoisted}
        found = follow(document, found.get("$ref"))
    return True


def _own_parts(document: Any) -> list[Mapping[str, Any]]:
    """Return the schemas of a document, itself first, without those of documents within it."""
    found: list[Mapping[str, Any]] = []

    def collect(part: Any) -> Any:
        if isinstance(part, Mapping) and document_of(part, document) is document:
            found.append(part)
            change_parts(part, collect)
        return part

    collect(document)
    return found


def _moved(schema: Any, own: str, to: str) -> Any:
    """Return a schema whose references to the document, also by its own address, lead elsewhere."""
    if not isinstance(schema, Mapping) or "$id" in schema:
        return schema
    made = change_parts(schema, lambda part: _moved(part, own, to))
    for keyword in _REFERENCES:
        place = schema.get(keyword)
        if isinstance(place, str):
            if place == own or place.startswith(f"{own}#"):
                place = place[len(own) :] or "#"
            made[keyword] = f"{to}{place[1:]}" if place == "#" or place.startswith("#/") else place
    return made


def _address(document: Any) -> str:
    address = document.get("$id") if isinstance(document, Mapping) else None
    return address.removesuffix("#") if isinstance(address, str) else ""
