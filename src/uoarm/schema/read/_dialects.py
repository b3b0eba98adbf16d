"""Older drafts: what a schema's keywords are called in the draft that is decided, 2020-12.

A schema is read through a view of its keywords. The parts within it stay the very objects that
they are in the document, so pointers lead where its author meant.

Facts: the change logs of drafts 06, 07, 2019-09 and 2020-12 on json-schema.org.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from attrs import frozen

from uoarm.schema.read._node import ANNOTATIONS

__all__ = ["DRAFT_2019", "NEWEST", "OLD_FORMS", "Dialect", "dialect_of"]

_NEW_IN_2020 = frozenset({"prefixItems", "$dynamicRef", "$dynamicAnchor"})
_NEW_IN_2019 = frozenset(
    {"dependentRequired", "dependentSchemas", "unevaluatedItems", "unevaluatedProperties",
     "minContains", "maxContains", "$anchor", "$recursiveRef", "$recursiveAnchor", "$defs"}
)  # fmt: skip
_NEW_IN_7 = frozenset({"if", "then", "else"})
_NEW_IN_6 = frozenset({"const", "contains", "propertyNames", "$id"})
_BESIDE_REFERENCE = frozenset({"$ref", "$schema", "definitions"})
_NEW_DEPENDENCIES = frozenset({"dependentRequired", "dependentSchemas"})
OLD_FORMS = frozenset({"dependencies", "items", "exclusiveMinimum", "exclusiveMaximum"})
_LIMITS = {"exclusiveMinimum": "minimum", "exclusiveMaximum": "maximum"}


@frozen
class Dialect:
    """One draft.

    `unknown` are the keywords that mean nothing in it. `alone` says that a `$ref` makes everything
    beside it mean nothing. `named` is the keyword of identifiers.
    """

    uri: str
    unknown: frozenset[str] = frozenset()
    alone: bool = False
    named: str = "$id"

    def view(self, schema: Mapping[str, Any]) -> Mapping[str, Any]:
        """Return a schema's keywords as 2020-12 has them; itself where they are so already.

        Forms of older drafts that 2020-12 gives no meaning keep their old one without `$schema`
        too: `items` as a list, `dependencies`, and limits that are exclusive by true or false.
        """
        if not self.unknown and not _is_old(schema):
            return schema
        seen = {name: value for name, value in schema.items() if name not in self.unknown}
        if self.alone and "$ref" in seen:
            seen = {name: seen[name] for name in seen if name in _BESIDE_REFERENCE}
        if self.alone:
            _identifiers(seen, self.named)
        _lists(seen)
        _dependencies(seen)
        _limits(seen)
        return seen

    def spelled(self, schema: Mapping[str, Any], keyword: str) -> str:
        """Return what the author of a schema calls a keyword of its view."""
        old = {"prefixItems": "items", "items": "additionalItems", "$defs": "definitions"}
        if keyword.startswith("dependent") and keyword not in schema:
            return "dependencies"
        if isinstance(schema.get("items"), list) or keyword == "$defs":
            return old.get(keyword, keyword) if old.get(keyword) in schema else keyword
        return keyword

    def objection(self, schema: Mapping[str, Any], *, beside_contains: bool) -> str:
        """Return why a schema of a document in this draft is not decided; empty when it is.

        `beside_contains` says that `contains` stands somewhere in the document.
        """
        if "$recursiveRef" in schema and self is NEWEST:
            return "$recursiveRef is of draft 2019-09, and the schema does not say so"
        if "dependencies" in schema and _NEW_DEPENDENCIES & schema.keys() - self.unknown:
            return "dependencies stands beside the keywords that took its place"
        if self is DRAFT_2019 and beside_contains and "unevaluatedItems" in schema:
            return "unevaluatedItems has its meaning of draft 2019-09, which passes over `contains`"
        return ""

    def agrees(self, other: Dialect, schema: Mapping[str, Any]) -> bool:
        """Say whether a schema, but for those within it, means the same in another draft."""
        view, its = self.view(schema), other.view(schema)
        return _meaning(view) == _meaning(its) and not other.objection(schema, beside_contains=True)


def _plain(uri: str) -> str:
    """Return a draft's URI without what its spellings differ in."""
    return uri.removesuffix("#").removesuffix("/").replace("https:", "http:", 1)


NEWEST = Dialect("https://json-schema.org/draft/2020-12/schema")
DRAFT_2019 = Dialect("https://json-schema.org/draft/2019-09/schema", _NEW_IN_2020)
_BEFORE_2019 = _NEW_IN_2020 | _NEW_IN_2019
_DRAFT_7 = Dialect("http://json-schema.org/draft-07/schema", _BEFORE_2019, alone=True)
_DRAFT_6 = Dialect("http://json-schema.org/draft-06/schema", _BEFORE_2019 | _NEW_IN_7, alone=True)
_DRAFT_4 = Dialect(
    "http://json-schema.org/draft-04/schema",
    _BEFORE_2019 | _NEW_IN_7 | _NEW_IN_6,
    alone=True,
    named="id",
)
_KNOWN = {
    _plain(dialect.uri): dialect for dialect in (NEWEST, DRAFT_2019, _DRAFT_7, _DRAFT_6, _DRAFT_4)
}


def dialect_of(schema: object) -> Dialect | None:
    """Return the draft that a schema names, 2020-12 where it names none; None for any other."""
    named = schema.get("$schema", NEWEST.uri) if isinstance(schema, Mapping) else NEWEST.uri
    return _KNOWN.get(_plain(named)) if isinstance(named, str) else None


def _meaning(view: Mapping[str, Any]) -> dict[str, int]:
    return {name: id(value) for name, value in view.items() if name not in ANNOTATIONS}


def _is_old(schema: Mapping[str, Any]) -> bool:
    return not OLD_FORMS.isdisjoint(schema) and (
        "dependencies" in schema
        or isinstance(schema.get("items"), list)
        or isinstance(schema.get("exclusiveMinimum"), bool)
        or isinstance(schema.get("exclusiveMaximum"), bool)
    )


def _identifiers(seen: dict[str, Any], named: str) -> None:
    """Turn an identifier that is only a fragment into an anchor, and `definitions` into `$defs`."""
    name = seen.pop(named, None)
    if isinstance(name, str) and name.startswith("#"):
        seen["$anchor"] = name[1:]
    elif name is not None:
        seen["$id"] = name
    if "definitions" in seen:
        seen["$defs"] = seen.pop("definitions")


def _lists(seen: dict[str, Any]) -> None:
    if "prefixItems" in seen:
        return
    more = seen.pop("additionalItems", None)
    if isinstance(seen.get("items"), list):
        first = seen.pop("items")
        if first:
            seen["prefixItems"] = first
        if more is not None:
            seen["items"] = more


def _dependencies(seen: dict[str, Any]) -> None:
    if "dependencies" not in seen:
        return
    found = seen.pop("dependencies")
    if not isinstance(found, Mapping):
        seen["dependentSchemas"] = found
        return
    named = {name: value for name, value in found.items() if isinstance(value, list)}
    others = {name: value for name, value in found.items() if name not in named}
    seen |= {"dependentRequired": named} if named else {}
    seen |= {"dependentSchemas": others} if others else {}


def _limits(seen: dict[str, Any]) -> None:
    for exclusive, inclusive in _LIMITS.items():
        if isinstance(seen.get(exclusive), bool) and seen.pop(exclusive) and inclusive in seen:
            seen[exclusive] = seen.pop(inclusive)
