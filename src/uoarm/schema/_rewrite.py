"""Schemas made of others: with other parts, or within another schema."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

from uoarm.schema.read import LISTS, MAPS, SINGLES

_OF_NAMES = frozenset({*MAPS, "definitions", "dependencies"})
_OTHERS = frozenset({*SINGLES, *LISTS, "additionalItems"})
_DEFINITIONS = ("$defs", "definitions")
_DEFINED = tuple(f"#/{keyword}/" for keyword in _DEFINITIONS)
_OF_DOCUMENT = frozenset({"$schema", "$id"})


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


def enclose(
    schema: Any, around: Callable[[Any], Mapping[str, Any]], name: str = "message"
) -> dict[str, Any]:
    """Return a schema around another one, whose references mean there what they did alone.

    References are seen from the root of a document. Where all are to definitions, these move to the
    root; else the whole schema becomes a definition, and references to places in it are changed.

    Args:
        schema: a mapping or a bool.
        around: takes what stands for the schema, and returns the one around it, which may have
            `$defs` of its own.
        name: of the definition.

    Example:
        >>> enclose({"$ref": "#/$defs/a", "$defs": {"a": {}}}, lambda inner: {"not": inner})
        {'not': {'$ref': '#/$defs/a'}, '$defs': {'a': {}}}
    """
    if not isinstance(schema, Mapping):
        return dict(around(schema))
    inner = {keyword: value for keyword, value in schema.items() if keyword not in _OF_DOCUMENT}
    if all(place.startswith(_DEFINED) for place in _references(inner)):
        hoisted = {keyword: inner.pop(keyword) for keyword in _DEFINITIONS if keyword in inner}
        made = around(inner)
    else:
        own = str(schema.get("$id", "")).removesuffix("#")
        hoisted = {"$defs": {name: _moved(inner, own, f"#/$defs/{name}")}}
        made = around({"$ref": f"#/$defs/{name}"})
    return {
        **made,
        **{keyword: {**made.get(keyword, {}), **found} for keyword, found in hoisted.items()},
    }


def _references(schema: Mapping[str, Any]) -> set[str]:
    """Return the references in a document, without those of documents within it."""
    found: set[str] = set()

    def collect(part: Any) -> Any:
        if isinstance(part, Mapping) and "$id" not in part:
            if isinstance(place := part.get("$ref"), str):
                found.add(place)
            change_parts(part, collect)
        return part

    collect(schema)
    return found


def _moved(schema: Any, own: str, to: str) -> Any:
    """Return a schema whose references to the document, also by its own address, lead elsewhere."""
    if not isinstance(schema, Mapping) or "$id" in schema:
        return schema
    made = change_parts(schema, lambda part: _moved(part, own, to))
    place = schema.get("$ref")
    if isinstance(place, str):
        if place == own or place.startswith(f"{own}#"):
            place = place[len(own) :] or "#"
        made["$ref"] = f"{to}{place[1:]}" if place == "#" or place.startswith("#/") else place
    return made
