"""Documents: a whole schema turned into nodes, its references resolved when they are met.

One schema that is reached in two dynamic scopes is two nodes.
"""

from __future__ import annotations

import marshal
from collections.abc import Iterable, Mapping, Sequence
from contextlib import suppress
from functools import cached_property
from math import isfinite
from typing import Any, TypeAlias
from urllib.parse import urlsplit

from uoarm.schema._errors import Meter, OutOfScopeError, Pointer, SchemaError, write_pointer
from uoarm.schema._parts import LISTS, MAPS, SINGLES
from uoarm.schema._values import SCALARS, Keys
from uoarm.schema.read._node import (
    ANNOTATIONS,
    READERS,
    Reference,
    SchemaNode,
    Scope,
    check_keyword,
)
from uoarm.schema.read._resources import (
    DRAFT_2019,
    NEWEST,
    PLACING,
    POSITIONAL,
    REFERENCES,
    Resources,
    Scopes,
    dialect_of,
)
from uoarm.schema.regex import UnsupportedPatternError, is_disputed

_MAX_PARTS = 50_000
_MAX_TEXT_LEVELS = 40
_NAMES = frozenset({str})
_ALWAYS = SCALARS - {float}
_OF_TEXT = 200
"""About the octets that a text takes besides its own."""


def is_plain(schema: object, meter: Meter) -> bool:
    """Say whether a whole schema is plain, looking at each of its parts once."""
    level: list[Any] = [schema]
    parts = 0
    placing = POSITIONAL  # the draft that the whole names is known already
    for _ in range(_MAX_TEXT_LEVELS):
        below: list[Any] = []
        meter.spend(len(level) // 32)
        for item in level:
            kind = item.__class__
            if kind in _ALWAYS:
                continue
            if kind is dict:
                if not (placing.isdisjoint(item) and _NAMES.issuperset(map(type, item))):
                    return False
                within = item.values()
            elif kind is list:
                within = item
            elif kind is float and isfinite(item):
                continue
            else:
                return False
            parts += len(within)
            if parts > _MAX_PARTS:
                return False
            if not _ALWAYS.issuperset(map(type, within)):
                below.extend(within)
        if not below:
            return True
        level, placing = below, PLACING
    return False


_OF_STEP = 2_000
"""Octets of a text that take a step's time."""


class SchemaTexts:
    """The first schema of each text that was met in the plain documents of one check."""

    def __init__(self, meter: Meter) -> None:
        self._meter = meter
        self._first: dict[bytes, dict[str, Any]] = {}

    def first(self, schema: dict[str, Any]) -> dict[str, Any]:
        """Return the first schema of the same text, itself where it is that; part of a plain one.

        Numbers and booleans, and floats and integers, differ in it; it has the order of names.
        """
        text = marshal.dumps(schema, 0)
        found = self._first.setdefault(text, schema)
        if found is schema:
            self._meter.hold(_OF_TEXT + len(text))
            self._meter.spend(1 + len(text) // _OF_STEP)
        return found


_MAX_LEVELS = 10_000
_MAX_SCOPED = 5_000
_VALUES = frozenset({"const", "enum"})
_PATTERNS = frozenset({"pattern", "patternProperties"})
_UNREAD = frozenset({"contentSchema", "$defs"})
View: TypeAlias = "tuple[Mapping[str, Any], list[Any]]"
"""The keywords of a schema as 2020-12 has them, and the schemas in it."""
_ONE, _MANY = frozenset(SINGLES), frozenset((*LISTS, *MAPS))


_OF_NODE = 1_500
"""About the octets of a node with its number."""


class Pool:
    """Numbers for contents: equal schemas of one check get equal numbers.

    `texts`, `views` and `nodes` are those of plain documents, which share what is equal in them.

    Args:
        meter: what is left of the budget of the check.
    """

    def __init__(self, meter: Meter) -> None:
        self.meter = meter
        self._numbers: dict[object, int] = {}
        self.texts = SchemaTexts(meter)
        self.views: dict[int, View] = {}
        self.nodes: dict[tuple[int, Scope], SchemaNode] = {}
        self.documents: list[SchemaDocument] = []

    def close(self) -> None:
        """Let go of what nodes and documents know of each other, which no check needs any more.

        They would else be left to the collector of garbage, which stops everything for a while.
        """
        for document in self.documents:
            document.close()
        self.documents.clear()

    def number(self, content: object) -> int:
        """Return the number of a content, a new one when it was never seen."""
        return self._numbers.setdefault(content, len(self._numbers))


class SchemaDocument:
    """One schema with everything it refers to; `disputed` has the patterns in it that are.

    Raises:
        SchemaError: something in it is malformed.
        OutOfScopeError: nothing of it is decided.
    """

    def __init__(self, schema: object, pool: Pool) -> None:
        if not isinstance(schema, bool | Mapping):
            raise SchemaError("", "a schema (an object, true or false)", schema)
        self._pool = pool
        self.meter = pool.meter
        self._keys = Keys(pool.meter.spend)
        self.disputed: dict[str, None] = {}
        self._targets: dict[Reference, SchemaNode] = {}
        self._dialect = dialect_of(schema) or NEWEST
        self._has_contains = self._dialect is DRAFT_2019 and _mentions(schema, "contains")
        self._placed = self._dialect is not NEWEST or dialect_of(schema) is None
        self._schema = schema
        self._is_plain = not self._placed and is_plain(schema, pool.meter)
        self._views = pool.views if self._is_plain else {}
        self._nodes = pool.nodes if self._is_plain else {}
        self._equal: dict[int, Any] = {}  # in a plain one: the first of those equal to a schema
        self._checked: list[Any] = []  # those that were not before, each after those in it
        self._check(schema)
        self._resources = Resources(schema, self._dialect, pool.meter, placed=self._placed)
        self._scopes = Scopes(self._resources)
        self._identity = self._identify(schema)
        pool.documents.append(self)

    @cached_property
    def root(self) -> SchemaNode:
        """The node of the whole, read when it is asked for.

        Raises:
            SchemaError: a value in it is none of JSON.
            OutOfScopeError: nothing of it is decided.
        """
        if self._is_plain:
            for item in self._checked:
                self._read_one(item)
            return self._nodes[id(self._first(self._schema)), ()]
        base = self._resources.base_in(self._schema)
        root = self._read(self._schema, self._scopes.enter((), base))
        if self._resources.refers and self._refers_in_place():
            root.unsupported = "the schema refers to itself without descending into the value"
        return root

    def close(self) -> None:
        """Let go of the nodes."""
        self._nodes.clear()
        self._targets.clear()
        self.__dict__.pop("root", None)

    def has_text_of(self, other: SchemaDocument) -> bool:
        """Say whether both are plain and of the same text, so that they mean the same."""
        return self._is_plain and other._first(other._schema) is self._schema

    def resolve(self, reference: Reference) -> SchemaNode:
        """Return the node that a reference leads to; it says so where that is not decided."""
        found = self._targets.get(reference)
        if found is None:
            found = self._targets[reference] = self._find(reference)
        return found

    def either(self, nodes: Sequence[SchemaNode]) -> SchemaNode:
        """Return a node that holds where one of some nodes does."""
        if len(nodes) == 1:
            return nodes[0]
        number = self._pool.number(("either", frozenset(node.number for node in nodes)))
        return SchemaNode(
            number, {"anyOf": [node.raw for node in nodes]}, self, any_of=tuple(nodes)
        )

    def _find(self, reference: Reference) -> SchemaNode:
        try:
            found = self._scopes.lead(*reference)
        except OutOfScopeError as error:
            content: tuple[object, ...] = ("not decided", self._identity, reference)
            return SchemaNode(self._pool.number(content), {}, self, unsupported=str(error))
        if found is not None:
            self._check(found[0])
            return self._read(*found)
        content = ("far", self._dialect.uri, reference.absolute)
        if self._resources.named or self._resources.dynamic or self._is_loose(reference.absolute):
            content = (*content, self._identity, reference.scope)
        cause = f"the reference {reference.absolute!r} leads out of the document"
        return SchemaNode(self._pool.number(content), {}, self, unsupported=cause)

    def _identify(self, schema: object) -> int:
        """Return what distinguishes references of this document from those of another.

        Documents of equal content refer to the same schemas, unless a reference depends on where a
        document without a name came from. What lies outside may itself refer to any schema with a
        name, and to any dynamic anchor on the way, so that it is the same for two documents only
        where neither has such, or both are equal.
        """
        if not self._resources.refers:
            return 0
        if not any(self._is_loose(name) for name in self._resources.far):
            try:
                return self._pool.number(("document", self._keys.of(schema)))
            except (OutOfScopeError, SchemaError):
                pass
        return self._pool.number(("document", object()))

    @staticmethod
    def _is_loose(absolute: str) -> bool:
        """Say whether a reference that leads out may mean something else elsewhere."""
        try:
            return urlsplit(absolute).scheme in {"", "file"}
        except ValueError:
            return True

    def _check(self, schema: object) -> None:
        """Check the shape of a schema and all below it, on an explicit stack; once each."""
        entered: set[int] = set()
        stack: list[tuple[Any, Pointer, bool]] = [(self._first(schema), None, False)]
        while stack:
            subschema, where, leaving = stack.pop()
            if leaving:
                entered.discard(id(subschema))
                self._checked.append(subschema)
            elif id(subschema) in entered:
                raise SchemaError(write_pointer(where), "a finite schema (use $ref)", subschema)
            elif isinstance(subschema, bool):
                self._checked.append(subschema)
            elif id(subschema) not in self._views:
                parts = self._parts(subschema, where)
                if not parts:
                    self._checked.append(subschema)
                    continue
                entered.add(id(subschema))
                if len(entered) > _MAX_LEVELS:
                    raise OutOfScopeError("the schema is nested too deep")
                stack.append((subschema, where, True))
                stack.extend(parts)

    def _first(self, schema: Any) -> Any:
        """Return the schema that was read for one, and for all that are equal to it."""
        if not self._is_plain or schema.__class__ is not dict:
            return schema
        found = self._equal.get(id(schema))
        if found is None:
            found = self._equal[id(schema)] = self._pool.texts.first(schema)
        return found

    def _parts(self, schema: Any, where: Pointer) -> list[tuple[object, Pointer, bool]]:
        """Check a schema itself; return the schemas in it, as `_check` keeps them."""
        if not isinstance(schema, Mapping):
            raise SchemaError(write_pointer(where), "a schema (an object, true or false)", schema)
        # The draft that the whole names is known already.
        placing = POSITIONAL if schema is self._schema else PLACING
        self._placed = self._placed or not placing.isdisjoint(schema)
        view = self._dialect.view(schema)
        found: list[tuple[object, Pointer, bool]] = []
        unread: list[tuple[object, Pointer, bool]] = []
        work = 1
        for keyword, value in view.items():
            spelled = keyword if view is schema else self._dialect.spelled(schema, keyword)
            at = where, spelled
            work += check_keyword(keyword, value, at)
            if keyword in _ONE:
                parts = unread if keyword in _UNREAD else found
                parts.append((self._first(value), at, False))
            elif keyword in _MANY:
                parts = unread if keyword in _UNREAD else found
                steps = enumerate(value) if isinstance(value, list) else value.items()
                parts.extend([(self._first(item), (at, step), False) for step, item in steps])
            if keyword in _PATTERNS:
                self._dispute([value] if keyword == "pattern" else value)
        self.meter.spend(work)
        self._views[id(schema)] = view, [child for child, _, _ in found]
        return found + unread if unread else found

    def _dispute(self, patterns: Iterable[str]) -> None:
        for pattern in patterns:
            with suppress(UnsupportedPatternError):
                if is_disputed(pattern):
                    self.disputed[pattern] = None

    def _read(self, schema: object, scope: Scope) -> SchemaNode:
        """Read a schema in a scope, and all below it, children first, on an explicit stack."""
        if scope and len(self._nodes) > _MAX_SCOPED:
            raise OutOfScopeError("dynamic references lead to too many schemas")
        stack: list[tuple[Any, Scope, bool]] = [(schema, scope, False)]
        while stack:
            subschema, around, expanded = stack.pop()
            self.meter.spend()
            key = id(subschema), around
            if key in self._nodes:
                continue
            if isinstance(subschema, bool):
                self._nodes[key] = self._make_bool(subschema)
                continue
            inner = self._enter(subschema, around) if self._scopes.matter else around
            view, children = self._views[id(subschema)]
            if expanded or not children:
                self._nodes[key] = self._make(subschema, view, inner)
            else:
                stack.append((subschema, around, True))
                stack.extend((child, inner, False) for child in children)
        return self._nodes[id(schema), scope]

    def _read_one(self, schema: Any) -> None:
        """Read a schema of a plain document, of which those in it have been read."""
        self.meter.spend()
        key = id(schema), ()
        if key in self._nodes:
            return
        if isinstance(schema, bool):
            self._nodes[key] = self._make_bool(schema)
        else:
            self._nodes[key] = self._make(schema, self._views[id(schema)][0], ())

    def _make_bool(self, schema: bool) -> SchemaNode:  # noqa: FBT001 - a schema
        return SchemaNode(self._pool.number(schema), schema, self, never=not schema)

    def _enter(self, schema: Mapping[str, Any], scope: Scope) -> Scope:
        base = self._resources.inside(schema).base
        moved = base != self._resources.around(schema).base
        return self._scopes.enter(scope, base) if moved else scope

    def _make(self, schema: Mapping[str, Any], view: Mapping[str, Any], scope: Scope) -> SchemaNode:
        objection = self._resources.objection(schema) or self._dialect.objection(
            schema, beside_contains=self._has_contains
        )
        content: list[object] = [("not decided", objection)] if objection else []
        references = []
        node = SchemaNode(-1, schema, self, unsupported=objection)

        nodes, equal = self._nodes, self._equal

        def child(subschema: object) -> SchemaNode:
            return nodes[id(equal.get(id(subschema), subschema)), scope]

        for keyword, value in view.items():
            reader = READERS.get(keyword)
            if reader is not None:
                meaning = reader(node, value, child, self._keys.of)
                if keyword not in _VALUES:
                    content.append((keyword, meaning))
            elif keyword in REFERENCES:
                absolute = self._resources.absolute(schema, value)
                references.append(Reference(keyword, absolute, scope))
                content.append((self._identity, references[-1]))
            elif not isinstance(keyword, str):
                raise SchemaError("", "keywords that are text", keyword)
            elif keyword not in ANNOTATIONS and not keyword.startswith("x-"):
                content.append((keyword, self._keys.of(value)))
        if node.values is not None:
            content.append(("values", frozenset(node.values)))
        node.number = self._pool.number(frozenset(content))
        kept = len(node.values or ()) + len(node.required) + len(node.properties)
        self.meter.hold(_OF_NODE + 200 * kept)
        for reference in references:
            self._refer(node, reference)
        return node

    def _refer(self, node: SchemaNode, reference: Reference) -> None:
        if node.reference is None:
            node.reference = reference
        else:
            number = self._pool.number(frozenset([(self._identity, reference)]))
            raw = {reference.keyword: reference.absolute}
            node.all_of = (*node.all_of, SchemaNode(number, raw, self, reference=reference))

    def _refers_in_place(self) -> bool:
        """Say whether a schema applies itself to the same value, by references and logic alone.

        Everything that references lead to is read here.
        """
        done: set[int] = set()
        waiting = list(self._nodes.values())
        for root in waiting:
            path: set[int] = set()
            stack: list[tuple[SchemaNode, bool]] = [(root, False)]
            while stack:
                node, leaving = stack.pop()
                self.meter.spend()
                if leaving:
                    path.discard(id(node))
                    done.add(id(node))
                elif id(node) in path:
                    return True
                elif id(node) not in done:
                    path.add(id(node))
                    stack.append((node, True))
                    known = len(self._nodes)
                    stack.extend((subschema, False) for subschema in node.applied())
                    if len(self._nodes) > known:
                        waiting.extend(list(self._nodes.values())[known:])
        return False


def _mentions(document: object, keyword: str) -> bool:
    seen: set[int] = set()
    waiting = [document]
    while waiting:
        schema = waiting.pop()
        if isinstance(schema, Mapping | list) and id(schema) not in seen:
            seen.add(id(schema))
            if isinstance(schema, Mapping) and keyword in schema:
                return True
            waiting.extend(schema.values() if isinstance(schema, Mapping) else schema)
    return False
