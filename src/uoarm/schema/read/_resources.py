"""Where references lead, and what keywords are called in older drafts.

A schema with an `$id` is a document of its own inside the whole; references are read relative to
the innermost one around them. Nothing is ever fetched.

A schema of an older draft is read through a view of its keywords, as 2020-12 calls them. The parts
within it stay the very objects that they are in the document, so pointers lead where its author
meant. Facts: the change logs of drafts 06, 07, 2019-09 and 2020-12 on json-schema.org.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any, NamedTuple
from urllib.parse import unquote, urljoin

from attrs import frozen

from uoarm.schema._errors import Meter, OutOfScopeError, SchemaError
from uoarm.schema._parts import LISTS, MAPS, SINGLES, at_step
from uoarm.schema.read._node import ANNOTATIONS, Scope

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


REFERENCES = ("$ref", "$dynamicRef", "$recursiveRef")
RECURSIVE = ""
"""The name under which `$recursiveAnchor` stands among the dynamic anchors; no other has it."""

_OF_SCHEMA = 600
"""About the octets of what is known of a schema's place."""
POSITIONAL = frozenset({"$id", "$anchor", "$dynamicAnchor", "$recursiveAnchor", *REFERENCES})
_NAMING = frozenset({"$id", "id", "$schema"})
PLACING = POSITIONAL | {"$schema"}
"""Keywords that give a schema another place, or that depend on the place, in the newest draft."""


class BasePlace(NamedTuple):
    """What stands around a schema: the base of its references, and the draft that is named.

    The draft is None where it is none that is known.
    """

    base: str
    draft: Dialect | None


class Resources:
    """The identifiers and anchors of one schema, and of all schemas inside it that are reached.

    Attributes:
        dynamic: schemas that references find by the way to them, by name and by base.
        far: references that lead out.
        named: whether the whole or a schema inside has an identifier.

    Args:
        placed: whether any schema in it is placed by a keyword; all have one place otherwise.
    """

    def __init__(self, schema: object, dialect: Dialect, meter: Meter, *, placed: bool) -> None:
        self._dialect = dialect
        self._meter = meter
        self._placed = placed
        self._documents: dict[str, object] = {"": schema}
        self._places: dict[int, BasePlace] = {}
        self._inside: dict[int, BasePlace] = {}
        self._seen: set[tuple[int, str, int]] = set()
        self._anchors: dict[tuple[str, str], object] = {}
        self._references: dict[str, None] = {}
        self._misplaced: set[int] = set()
        self.dynamic: dict[str, dict[str, object]] = {}
        self.far: list[str] = []
        self.named = False
        if placed:
            self._walk(schema, BasePlace("", dialect_of(schema)))
            self._follow()

    @property
    def refers(self) -> bool:
        return bool(self._references)

    @property
    def aims(self) -> set[str]:
        """The fragments of all references."""
        return {reference.partition("#")[2] for reference in self._references}

    def absolute(self, schema: Mapping[str, Any], reference: str) -> str:
        """Return a reference of a schema in the form that `find` takes."""
        base = self.inside(schema).base
        target, _, fragment = reference.partition("#")
        return f"{_joined(base, target, '$ref') if target else base}#{fragment}"

    def inside(self, schema: Mapping[str, Any]) -> BasePlace:
        """Return what stands around the parts of a schema."""
        return self._inside[id(schema)]

    def base_in(self, schema: object) -> str:
        """Return the base of references within a schema, the empty one within true and false."""
        known = self._placed and isinstance(schema, Mapping)
        return self._inside[id(schema)].base if known else ""

    def around(self, schema: object) -> BasePlace:
        """Return what stands around a schema."""
        return self._places[id(schema)]

    def objection(self, schema: Mapping[str, Any]) -> str:
        """Return why a schema may mean several things where it stands; empty when it cannot."""
        if not self._placed:
            return ""
        if id(schema) in self._misplaced:
            return "$recursiveAnchor stands within a document"
        draft = self._inside[id(schema)].draft
        if draft is self._dialect:
            return ""
        if draft is None:
            return "the schema is of a draft that is not known"
        if self._dialect.agrees(draft, schema):
            return ""
        return f"the schema is of another draft, {draft.uri}, which reads it otherwise"

    def find(self, absolute: str) -> tuple[object, BasePlace] | None:
        """Return what a reference leads to and what stands around it; None when it leads out.

        Raises:
            SchemaError: the document is here, but has no such part.
        """
        base, _, fragment = absolute.partition("#")
        if base not in self._documents:
            return None
        at: Any = self._documents[base]
        if fragment and not fragment.startswith("/"):
            if (base, fragment) not in self._anchors:
                raise SchemaError("#/$ref", "a reference to a part of the document", absolute)
            at = self._anchors[base, fragment]
            return at, self._places[id(at)]
        around = self._places.get(id(at), BasePlace(base, self._dialect))
        for step in unquote(fragment).split("/")[1:]:
            if isinstance(at, Mapping):
                around = self._within(at, around)
            at = at_step(at, step)
            if at is None:
                raise SchemaError("#/$ref", "a reference to a part of the document", absolute)
        if not isinstance(at, bool | Mapping):
            raise SchemaError("#/$ref", "a reference to a schema", absolute)
        return at, around

    def _walk(self, schema: object, place: BasePlace) -> None:
        """Take in a schema that stands somewhere, and all within it."""
        waiting = [(schema, place)]
        while waiting:
            subschema, around = waiting.pop()
            key = id(subschema), around.base, id(around.draft)
            if not isinstance(subschema, Mapping) or key in self._seen:
                continue
            self._seen.add(key)
            self._meter.spend()
            self._meter.hold(_OF_SCHEMA)
            inner = self._within(subschema, around)
            view = self._view(subschema, inner)
            known = self._places.setdefault(id(subschema), around)
            placed = not POSITIONAL.isdisjoint(view)
            if known.base != around.base and placed:
                raise OutOfScopeError("one object with references stands in two documents")
            if known.draft is not around.draft:
                raise OutOfScopeError("one object stands in schemas of two drafts")
            self._inside[id(subschema)] = inner
            if placed:
                self._enter(subschema, view, inner)
            waiting.extend((child, inner) for child in _children(view))
            if inner.draft is not self._dialect:
                waiting.extend((child, inner) for child in _children(self._dialect.view(subschema)))

    def _follow(self) -> None:
        """Take in what references lead to, also where it stands under no keyword of schemas."""
        done = 0
        while done < len(self._references):
            for absolute in list(self._references)[done:]:
                done += 1
                found = self.find(absolute)
                if found is None:
                    self.far.append(absolute)
                elif isinstance(found[0], Mapping) and id(found[0]) not in self._places:
                    self._walk(*found)

    def _enter(self, schema: Mapping[str, Any], view: Mapping[str, Any], inner: BasePlace) -> None:
        base = inner.base
        if isinstance(view.get("$id"), str):
            self.named = True
            known = self._documents.setdefault(base, schema)
            if known is not schema:
                raise OutOfScopeError(f"two documents are called {base!r}")
        for keyword in ("$anchor", "$dynamicAnchor"):
            name = view.get(keyword)
            if isinstance(name, str):
                if self._anchors.setdefault((base, name), schema) is not schema:
                    raise OutOfScopeError(f"two places are called {name!r}")
                if keyword == "$dynamicAnchor":
                    self.dynamic.setdefault(name, {})[base] = schema
        if view.get("$recursiveAnchor") is True and inner.draft is DRAFT_2019:
            if self._documents.get(base) is schema:
                self.dynamic.setdefault(RECURSIVE, {})[base] = schema
            else:
                self._misplaced.add(id(schema))
        for keyword in REFERENCES:
            if isinstance(view.get(keyword), str):
                self._references[self.absolute(schema, view[keyword])] = None

    def _within(self, schema: Mapping[str, Any], around: BasePlace) -> BasePlace:
        if _NAMING.isdisjoint(schema):
            return around
        draft = around.draft
        if isinstance(schema.get("$schema"), str):
            draft = dialect_of(schema)
        named = self._view(schema, BasePlace(around.base, draft)).get("$id")
        if not isinstance(named, str):
            return BasePlace(around.base, draft)
        return BasePlace(_joined(around.base, named.partition("#")[0], "$id"), draft)

    def _view(self, schema: Mapping[str, Any], place: BasePlace) -> Mapping[str, Any]:
        return (place.draft or self._dialect).view(schema)


def _joined(base: str, target: str, keyword: str) -> str:
    try:
        return urljoin(base, target)
    except ValueError:
        raise SchemaError(f"#/{keyword}", "a URI reference", target) from None


def _children(schema: Mapping[str, Any]) -> Iterator[object]:
    for keyword, value in schema.items():
        if keyword in SINGLES:
            yield value
        elif keyword in LISTS and isinstance(value, list):
            yield from value
        elif keyword in MAPS and isinstance(value, Mapping):
            yield from value.values()


_RUN = "#"
"""No name of an anchor: the first of the documents, unbroken up to here, that set RECURSIVE."""


class Scopes:
    """The dynamic scopes of one document."""

    def __init__(self, resources: Resources) -> None:
        self._resources = resources
        aims = resources.aims
        # What lies outside of the document may refer to any name.
        self._names = {
            name
            for name, bases in resources.dynamic.items()
            if resources.far or (len(bases) > 1 and name in aims)
        }

    @property
    def matter(self) -> bool:
        """Whether there is more than one scope."""
        return bool(self._names)

    def enter(self, scope: Scope, base: str) -> Scope:
        """Return the scope within the document of a base."""
        if not self._names:
            return scope
        known = dict(scope)
        for name in self._names:
            if base in self._resources.dynamic[name]:
                known.setdefault(name, base)
        if RECURSIVE in self._names:
            if base in self._resources.dynamic[RECURSIVE]:
                known.setdefault(_RUN, base)
            else:
                known.pop(_RUN, None)
        return tuple(sorted(known.items()))

    def lead(self, keyword: str, absolute: str, scope: Scope) -> tuple[object, Scope] | None:
        """Return what a reference leads to, and the scope around that; None when it leads out.

        Raises:
            OutOfScopeError: implementations differ on where it leads.
        """
        found = self._resources.find(absolute)
        if found is None:
            return None
        base, _, name = absolute.partition("#")
        anchors = self._resources.dynamic.get(name, {})
        if keyword == "$recursiveRef" or (name and base in anchors):
            return self._lead_by_way(keyword, base, name, scope)
        if not name:
            return found[0], scope
        inner = self.enter(scope, base)
        if self._names and name.startswith("/"):
            self._check_pointer(found[0], found[1].base, base, moved=inner != scope)
        return found[0], inner

    def _lead_by_way(
        self, keyword: str, base: str, name: str, scope: Scope
    ) -> tuple[object, Scope]:
        anchors = self._resources.dynamic.get(name, {})
        known = dict(scope)
        chosen = known.get(name, base) if base in anchors else base
        if chosen != base and keyword == "$ref":
            raise OutOfScopeError("implementations differ on a $ref to a $dynamicAnchor set twice")
        if chosen != base and not chosen:
            raise OutOfScopeError(
                "implementations differ on dynamic anchors of a nameless document"
            )
        if keyword != "$recursiveRef":
            return anchors[chosen], self.enter(scope, chosen)
        if base in anchors and known.get(_RUN, base) != chosen:
            raise OutOfScopeError("implementations differ on where a $recursiveRef leads")
        found = self._resources.find(f"{chosen}#")
        assert found is not None
        return found[0], scope

    def _check_pointer(self, target: object, around: str, base: str, *, moved: bool) -> None:
        inner = self._resources.base_in(target)
        if around != base or (moved and inner != base):
            raise OutOfScopeError("a pointer leads into another document among dynamic anchors")
