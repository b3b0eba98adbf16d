"""Documents: a whole schema turned into nodes, its references resolved when they are met."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

from uoarm.schema._dialects import DRAFT_2019, NEWEST, dialect_of
from uoarm.schema._errors import OutOfScopeError, SchemaError
from uoarm.schema._keywords import fill
from uoarm.schema._node import Node
from uoarm.schema._resources import Resources
from uoarm.schema._shapes import ANNOTATIONS, LISTS, MAPS, SINGLES, check_keyword
from uoarm.schema._values import key_of

__all__ = ["Document", "Pool"]

_MAX_POINTER = 20_000


class Pool:
    """Numbers for contents: equal schemas of one check get equal numbers."""

    def __init__(self) -> None:
        self._numbers: dict[object, int] = {}
        self.nodes: list[Node] = []

    def number(self, content: object) -> int:
        """Return the number of a content, a new one when it was never seen."""
        return self._numbers.setdefault(content, len(self._numbers))


class Document:
    """One schema with everything it refers to.

    Raises:
        SchemaError: something in it is malformed.
    """

    def __init__(self, schema: object, pool: Pool) -> None:
        if not isinstance(schema, bool | Mapping):
            raise SchemaError("", "a schema (an object, true or false)", schema)
        self._pool = pool
        self._nodes: dict[int, Node] = {}
        self._by_reference: dict[str, Node] = {}
        self._dialect = dialect_of(schema) or NEWEST
        self._has_contains = self._dialect is DRAFT_2019 and _mentions(schema, "contains")
        self._resources = Resources(schema, self._dialect)
        refers = self._resources.refers
        self._identity = pool.number(("document", id(schema))) if refers else 0
        self._references: list[str] = []
        self._dynamic: list[tuple[Node, str]] = []
        self.root = self._read(schema, "#")
        for reference in self._references:
            self.resolve(reference)
        for node, reference in self._dynamic:
            if not self._resources.is_static(reference):
                node.unsupported = "where a $dynamicRef leads depends on the way to it"
        if self._references and _refers_in_place(self._nodes.values()):
            self.root.unsupported = "the schema refers to itself without descending into the value"

    def resolve(self, reference: str) -> Node:
        """Return the node that an absolute reference points to.

        It is an unsupported one when that is elsewhere.
        """
        found = self._by_reference.get(reference)
        if found is None:
            found = self._by_reference[reference] = self._find(reference)
        return found

    def either(self, nodes: Sequence[Node]) -> Node:
        """Return a node that holds where one of some nodes does."""
        if len(nodes) == 1:
            return nodes[0]
        number = self._pool.number(("either", frozenset(one.number for one in nodes)))
        return Node(number, {"anyOf": [one.raw for one in nodes]}, self, any_of=tuple(nodes))

    def _find(self, reference: str) -> Node:
        found = self._resources.find(reference)
        if found is None:
            return self._strange(f"the reference {reference!r} leads out of the document")
        schema, base = found
        if id(schema) not in self._nodes:
            self._resources.walk(schema, base)
            self._read(schema, "#")
        return self._nodes[id(schema)]

    def _strange(self, cause: str) -> Node:
        return Node(self._pool.number(("strange", cause)), {}, self, unsupported=cause)

    def _read(self, schema: object, pointer: str) -> Node:
        """Read a schema and all below it, children first, with an explicit stack."""
        entered: set[int] = set()
        stack: list[tuple[object, str, bool]] = [(schema, pointer, False)]
        while stack:
            one, where, expanded = stack.pop()
            if expanded or isinstance(one, bool):
                self._nodes[id(one)] = self._make(one)
            elif id(one) not in self._nodes:
                if id(one) in entered:
                    raise SchemaError(where, "a finite schema (use $ref)", "an object in itself")
                entered.add(id(one))
                stack.append((one, where, True))
                stack.extend((child, at, False) for child, at in self._children(one, where))
        return self._nodes[id(schema)]

    def _children(self, schema: Any, pointer: str) -> list[tuple[object, str]]:
        if len(pointer) > _MAX_POINTER:
            raise OutOfScopeError("the schema is nested too deep")
        if not isinstance(schema, Mapping):
            raise SchemaError(pointer, "a schema (an object, true or false)", schema)
        found: list[tuple[object, str]] = []
        for keyword, value in self._dialect.view(schema).items():
            at = f"{pointer}/{self._dialect.spelled(schema, keyword)}"
            check_keyword(keyword, value, at)
            if keyword in SINGLES:
                found.append((value, at))
            elif keyword in LISTS:
                found.extend((one, f"{at}/{n}") for n, one in enumerate(value))
            elif keyword in MAPS:
                found.extend((one, f"{at}/{name}") for name, one in value.items())
            elif keyword in {"$ref", "$dynamicRef"}:
                self._references.append(self._resources.absolute(schema, value))
        return found

    def _make(self, schema: Any) -> Node:
        if isinstance(schema, bool):
            return self._keep(Node(self._pool.number(schema), schema, self, never=not schema))
        view = self._dialect.view(schema)
        objection = self._objection(schema)
        child = self._child_numbers(view)
        content: list[object] = [("not decided", objection)] if objection else []
        for keyword, value in view.items():
            if keyword in child:
                content.append((keyword, child[keyword]))
            elif keyword in {"$ref", "$dynamicRef"}:
                content.append((self._identity, self._resources.absolute(schema, value)))
            elif keyword not in ANNOTATIONS and not keyword.startswith("x-"):
                content.append((keyword, key_of(value)))
        node = Node(self._pool.number(frozenset(content)), schema, self, unsupported=objection)
        fill(node, view, lambda one: self._nodes[id(one)])
        for keyword in ("$ref", "$dynamicRef"):
            if keyword in view:
                self._refer(node, keyword, self._resources.absolute(schema, view[keyword]))
        return self._keep(node)

    def _objection(self, schema: Mapping[str, Any]) -> str:
        """Return why a schema is not decided; empty when it is."""
        if "$schema" in schema:
            named = dialect_of(schema)
            same = named is self._dialect
            if not same and (named is None or not self._resources.agree(schema, named)):
                return f"the schema is of another draft: {schema['$schema']}"
        return self._dialect.objection(schema, beside_contains=self._has_contains)

    def _refer(self, node: Node, keyword: str, reference: str) -> None:
        if keyword == "$dynamicRef":
            self._dynamic.append((node, reference))
        if node.reference is None:
            node.reference = reference
        else:
            number = self._pool.number((self._identity, reference))
            also = Node(number, {"$ref": reference}, self, reference=reference)
            node.all_of = (*node.all_of, also)

    def _keep(self, node: Node) -> Node:
        self._pool.nodes.append(node)
        return node

    def _child_numbers(self, schema: Any) -> dict[str, object]:
        numbers: dict[str, object] = {}
        for keyword in schema:
            if keyword in {"contentSchema", "$defs"}:
                continue
            if keyword in SINGLES:
                numbers[keyword] = self._nodes[id(schema[keyword])].number
            elif keyword in LISTS:
                numbers[keyword] = tuple(self._nodes[id(one)].number for one in schema[keyword])
            elif keyword in MAPS:
                numbers[keyword] = frozenset(
                    (name, self._nodes[id(one)].number) for name, one in schema[keyword].items()
                )
        return numbers


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


def _refers_in_place(nodes: Iterable[Node]) -> bool:
    """Say whether a schema applies itself to the same value, by references and logic alone."""
    done: set[int] = set()
    for root in list(nodes):
        path: set[int] = set()
        stack: list[tuple[Node, bool]] = [(root, False)]
        while stack:
            node, leaving = stack.pop()
            if leaving:
                path.discard(id(node))
                done.add(id(node))
            elif id(node) in path:
                return True
            elif id(node) not in done:
                path.add(id(node))
                stack.append((node, True))
                stack.extend((one, False) for one in node.applied())
    return False
