"""Documents: a whole schema turned into nodes, its references resolved when they are met.

One schema that is reached in two dynamic scopes is two nodes.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from contextlib import suppress
from functools import cached_property
from typing import Any, TypeAlias
from urllib.parse import urlsplit

from uoarm.schema._errors import OutOfScopeError, Pointer, SchemaError, write_pointer
from uoarm.schema._meter import Meter
from uoarm.schema._values import SCALARS, Keys
from uoarm.schema.read._dialects import DRAFT_2019, NEWEST, OLD_FORMS, dialect_of
from uoarm.schema.read._keywords import READERS
from uoarm.schema.read._node import Node, Reference
from uoarm.schema.read._resources import PLACING, POSITIONAL, REFERENCES, Resources
from uoarm.schema.read._scopes import Scope, Scopes
from uoarm.schema.read._shapes import ANNOTATIONS, LISTS, MAPS, SINGLES, check_keyword
from uoarm.schema.regex import UnsupportedPatternError, is_disputed

__all__ = ["Document", "Pool"]

_MAX_LEVELS = 10_000
_MAX_SCOPED = 5_000
_VALUES = frozenset({"const", "enum"})
_UNREAD = frozenset({"contentSchema", "$defs"})
_LEAF = 8
"""Keywords of a schema that is compared with others before it is read."""
Leaf: TypeAlias = "tuple[object, ...]"
_ONE, _MANY = frozenset(SINGLES), frozenset((*LISTS, *MAPS))


_OF_NODE = 1_500
"""About the octets of a node with its number."""


class Pool:
    """Numbers for contents: equal schemas of one check get equal numbers.

    Args:
        meter: what is left of the budget of the check.
    """

    def __init__(self, meter: Meter) -> None:
        self.meter = meter
        self._numbers: dict[object, int] = {}
        self.leaves: dict[Leaf, Node | None] = {}

    def number(self, content: object) -> int:
        """Return the number of a content, a new one when it was never seen."""
        return self._numbers.setdefault(content, len(self._numbers))


class Document:
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
        self._nodes: dict[tuple[int, Scope], Node] = {}
        self.disputed: dict[str, None] = {}
        self._views: dict[int, tuple[Mapping[str, Any], list[Any]]] = {}
        self._targets: dict[Reference, Node] = {}
        self._leaves: dict[int, Leaf] = {}
        self._dialect = dialect_of(schema) or NEWEST
        self._has_contains = self._dialect is DRAFT_2019 and _mentions(schema, "contains")
        self._placed = self._dialect is not NEWEST or dialect_of(schema) is None
        self._schema = schema
        self._check(schema)
        self._resources = Resources(schema, self._dialect, pool.meter, placed=self._placed)
        self._scopes = Scopes(self._resources)
        self._identity = self._identify(schema)

    @cached_property
    def root(self) -> Node:
        """The node of the whole, read when it is asked for.

        Raises:
            SchemaError: a value in it is none of JSON.
            OutOfScopeError: nothing of it is decided.
        """
        base = self._resources.base_in(self._schema)
        root = self._read(self._schema, self._scopes.enter((), base))
        if self._resources.refers and self._refers_in_place():
            root.unsupported = "the schema refers to itself without descending into the value"
        return root

    @property
    def refers(self) -> bool:
        """Whether there is any reference in it."""
        return self._resources.refers

    def resolve(self, reference: Reference) -> Node:
        """Return the node that a reference leads to; it says so where that is not decided."""
        found = self._targets.get(reference)
        if found is None:
            found = self._targets[reference] = self._find(reference)
        return found

    def either(self, nodes: Sequence[Node]) -> Node:
        """Return a node that holds where one of some nodes does."""
        if len(nodes) == 1:
            return nodes[0]
        number = self._pool.number(("either", frozenset(one.number for one in nodes)))
        return Node(number, {"anyOf": [one.raw for one in nodes]}, self, any_of=tuple(nodes))

    def _find(self, reference: Reference) -> Node:
        try:
            found = self._scopes.lead(*reference)
        except OutOfScopeError as error:
            content: tuple[object, ...] = ("not decided", self._identity, reference)
            return Node(self._pool.number(content), {}, self, unsupported=str(error))
        if found is not None:
            self._check(found[0])
            return self._read(*found)
        content = ("far", self._dialect.uri, reference.absolute)
        if self._resources.named or self._resources.dynamic or self._is_loose(reference.absolute):
            content = (*content, self._identity, reference.scope)
        cause = f"the reference {reference.absolute!r} leads out of the document"
        return Node(self._pool.number(content), {}, self, unsupported=cause)

    def _identify(self, schema: object) -> int:
        """Return what tells references of this document from those of another.

        Documents of equal content refer to the same schemas, unless a reference depends on where a
        document without a name came from. What lies outside may itself refer to any schema with a
        name, and to any dynamic anchor on the way, so that it is the same for two documents only
        where neither has such, or both are equal.
        """
        if not self._resources.refers:
            return 0
        if not any(self._is_loose(one) for one in self._resources.far):
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
        stack: list[tuple[Any, Pointer, bool]] = [(schema, None, False)]
        while stack:
            one, where, leaving = stack.pop()
            if leaving:
                entered.discard(id(one))
            elif id(one) in entered:
                raise SchemaError(write_pointer(where), "a finite schema (use $ref)", one)
            elif not isinstance(one, bool) and id(one) not in self._views:
                leaf = self._leaf(one)
                parts = [] if leaf in self._pool.leaves else self._parts(one, where)
                if leaf is not None and not parts:
                    self._pool.leaves.setdefault(leaf)
                    self._leaves[id(one)] = leaf
                    self._views.setdefault(id(one), (one, []))
                elif parts:
                    entered.add(id(one))
                    if len(entered) > _MAX_LEVELS:
                        raise OutOfScopeError("the schema is nested too deep")
                    stack.append((one, where, True))
                    stack.extend(parts)

    def _leaf(self, schema: Any) -> Leaf | None:
        """Return what equal schemas of scalars alone have in common; None for all others.

        A number, its text and a boolean may be equal to Python.
        """
        if len(schema) > _LEAF if isinstance(schema, dict) else True:
            return None
        values = schema.values()
        if self._dialect is not NEWEST or not all(one.__class__ in SCALARS for one in values):
            return None
        placed = not PLACING.isdisjoint(schema) or not OLD_FORMS.isdisjoint(schema)
        return None if placed else (*schema.items(), *map(type, values))

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
            if keyword in {"pattern", "patternProperties"}:
                self._dispute([value] if keyword == "pattern" else value)
            parts = unread if keyword in _UNREAD else found
            if keyword in _ONE:
                parts.append((value, at, False))
            elif keyword in _MANY:
                steps = enumerate(value) if isinstance(value, list) else value.items()
                parts.extend((one, (at, step), False) for step, one in steps)
        self.meter.spend(work)
        self._views[id(schema)] = view, [child for child, _, _ in found]
        return found + unread if unread else found

    def _dispute(self, patterns: Iterable[str]) -> None:
        for pattern in patterns:
            with suppress(UnsupportedPatternError):
                if is_disputed(pattern):
                    self.disputed[pattern] = None

    def _read(self, schema: object, scope: Scope) -> Node:
        """Read a schema in a scope, and all below it, children first, on an explicit stack."""
        if scope and len(self._nodes) > _MAX_SCOPED:
            raise OutOfScopeError("dynamic references lead to too many schemas")
        stack: list[tuple[Any, Scope, bool]] = [(schema, scope, False)]
        while stack:
            one, around, expanded = stack.pop()
            self.meter.spend()
            key = id(one), around
            if key in self._nodes:
                continue
            if isinstance(one, bool):
                self._nodes[key] = Node(self._pool.number(one), one, self, never=not one)
                continue
            inner = self._enter(one, around) if self._scopes.matter else around
            view, children = self._views[id(one)]
            if expanded or not children:
                self._nodes[key] = self._make(one, view, inner)
            else:
                stack.append((one, around, True))
                for child in children:
                    leaf = None if self._placed else self._leaves.get(id(child))
                    if leaf is None:
                        stack.append((child, inner, False))
                    elif (id(child), inner) not in self._nodes:
                        self.meter.spend()
                        self._nodes[id(child), inner] = self._read_leaf(child, leaf)
        return self._nodes[id(schema), scope]

    def _read_leaf(self, schema: Mapping[str, Any], leaf: Leaf) -> Node:
        node = self._pool.leaves[leaf]
        if node is None:
            node = self._pool.leaves[leaf] = self._make(schema, schema, ())
        return node

    def _enter(self, schema: Mapping[str, Any], scope: Scope) -> Scope:
        base = self._resources.inside(schema).base
        moved = base != self._resources.around(schema).base
        return self._scopes.enter(scope, base) if moved else scope

    def _make(self, schema: Mapping[str, Any], view: Mapping[str, Any], scope: Scope) -> Node:
        objection = self._resources.objection(schema) or self._dialect.objection(
            schema, beside_contains=self._has_contains
        )
        content: list[object] = [("not decided", objection)] if objection else []
        references = []
        node = Node(-1, schema, self, unsupported=objection)

        def child(one: object) -> Node:
            return self._nodes[id(one), scope]

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

    def _refer(self, node: Node, reference: Reference) -> None:
        if node.reference is None:
            node.reference = reference
        else:
            number = self._pool.number(frozenset([(self._identity, reference)]))
            raw = {reference.keyword: reference.absolute}
            node.all_of = (*node.all_of, Node(number, raw, self, reference=reference))

    def _refers_in_place(self) -> bool:
        """Say whether a schema applies itself to the same value, by references and logic alone.

        Everything that references lead to is read here.
        """
        done: set[int] = set()
        waiting = list(self._nodes.values())
        for root in waiting:
            path: set[int] = set()
            stack: list[tuple[Node, bool]] = [(root, False)]
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
                    stack.extend((one, False) for one in node.applied())
                    if len(self._nodes) > known:
                        waiting.extend(list(self._nodes.values())[known:])
        return False


def _mentions(document: object, keyword: str) -> bool:
    seen: set[int] = set()
    waiting = [document]
    while waiting:
        one = waiting.pop()
        if isinstance(one, Mapping | list) and id(one) not in seen:
            seen.add(id(one))
            if isinstance(one, Mapping) and keyword in one:
                return True
            waiting.extend(one.values() if isinstance(one, Mapping) else one)
    return False
