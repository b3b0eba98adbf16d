"""Documents: a whole schema turned into nodes, its references resolved when they are met."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Any
from urllib.parse import unquote

from uoarm.schema._errors import OutOfScopeError, SchemaError
from uoarm.schema._node import Node
from uoarm.schema._shapes import ANNOTATIONS, LISTS, MAPS, SINGLES, check_keyword
from uoarm.schema._values import exact, key_of

__all__ = ["Document", "Pool"]

_OUT_OF_SCOPE = {
    "$dynamicRef": "$dynamicRef is not followed",
    "$recursiveRef": "$recursiveRef is not followed",
}
_DRAFT = "https://json-schema.org/draft/2020-12/schema"
_MAX_POINTER = 20_000
_KINDS = frozenset({"null", "boolean", "number", "string", "array", "object"})


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
        self._schema = schema
        self._pool = pool
        self._nodes: dict[int, Node] = {}
        self._anchors: dict[str, object] = {}
        self._by_reference: dict[str, Node] = {}
        self._identity = 0 if not _has_references(schema) else pool.number(("document", id(schema)))
        self._references: list[str] = []
        self._embeds_documents = False
        self.root = self._read(schema, "#")
        for reference in self._references:
            self.resolve(reference)
        if self._references and _refers_in_place(self._nodes.values()):
            self.root.unsupported = "the schema refers to itself without descending into the value"

    def resolve(self, reference: str) -> Node:
        """Return the node that a reference points to; an unsupported one when it is elsewhere."""
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
        base, _, fragment = reference.partition("#")
        own = self._schema.get("$id", "") if isinstance(self._schema, Mapping) else ""
        if base and base != own:
            return self._strange(f"the reference {reference!r} leads out of the document")
        try:
            return self._look_up(unquote(fragment), reference)
        except SchemaError:
            if self._embeds_documents:
                return self._strange("a reference within a document with an embedded $id")
            raise

    def _look_up(self, fragment: str, reference: str) -> Node:
        if not fragment:
            return self._node_of(self._schema)
        if not fragment.startswith("/"):
            if fragment not in self._anchors:
                raise SchemaError("#/$ref", "a reference to a part of the document", reference)
            return self._node_of(self._anchors[fragment])
        at: Any = self._schema
        for step in fragment[1:].split("/"):
            name = step.replace("~1", "/").replace("~0", "~")
            if isinstance(at, Mapping) and name in at:
                at = at[name]
            elif isinstance(at, list) and name.isdecimal() and int(name) < len(at):
                at = at[int(name)]
            else:
                raise SchemaError("#/$ref", "a reference to a part of the document", reference)
        if not isinstance(at, bool | Mapping):
            raise SchemaError("#/$ref", "a reference to a schema", reference)
        return self._node_of(at)

    def _node_of(self, schema: object) -> Node:
        return self._nodes.get(id(schema)) or self._read(schema, "#")

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
        for keyword, value in schema.items():
            at = f"{pointer}/{keyword}"
            check_keyword(keyword, value, at)
            if keyword in SINGLES:
                found.append((value, at))
            elif keyword in LISTS:
                found.extend((one, f"{at}/{n}") for n, one in enumerate(value))
            elif keyword in MAPS:
                found.extend((one, f"{at}/{name}") for name, one in value.items())
            elif keyword in {"$anchor", "$dynamicAnchor"}:
                self._anchors[value] = schema
            elif keyword == "$ref":
                self._references.append(value)
            elif keyword == "$id" and schema is not self._schema:
                self._embeds_documents = True
        return found

    def _make(self, schema: Any) -> Node:
        if isinstance(schema, bool):
            return self._keep(Node(self._pool.number(schema), schema, self, never=not schema))
        child = self._child_numbers(schema)
        content: list[object] = [self._identity if "$ref" in schema else 0]
        for keyword, value in schema.items():
            if keyword in child:
                content.append((keyword, child[keyword]))
            elif self._matters(keyword, value, schema):
                content.append((keyword, key_of(value)))
        node = Node(self._pool.number(frozenset(content)), schema, self)
        self._fill(node, schema)
        return self._keep(node)

    def _matters(self, keyword: str, value: Any, schema: Any) -> bool:
        """Say whether a keyword makes a schema differ from one without it."""
        if keyword == "$schema":
            return bool(value != _DRAFT)
        if keyword == "$id":
            return schema is not self._schema
        return keyword not in ANNOTATIONS and not keyword.startswith("x-")

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

    def _fill(self, node: Node, schema: Mapping[str, Any]) -> None:
        for keyword, reason in _OUT_OF_SCOPE.items():
            if keyword in schema:
                node.unsupported = reason
        named = schema.get("$schema", _DRAFT)
        if not isinstance(named, str) or named.rstrip("#") != _DRAFT:
            node.unsupported = f"the schema is of another draft: {named}"
        if "$id" in schema and schema is not self._schema:
            node.unsupported = "an embedded $id"
        self._fill_scalars(node, schema)
        self._fill_array(node, schema)
        self._fill_object(node, schema)
        self._fill_logic(node, schema)

    def _fill_scalars(self, node: Node, schema: Mapping[str, Any]) -> None:
        if "type" in schema:
            names = schema["type"] if isinstance(schema["type"], list) else [schema["type"]]
            node.integer_only = "integer" in names and "number" not in names
            node.kinds = frozenset("number" if one == "integer" else one for one in names)
        if "const" in schema:
            node.values = {key_of(schema["const"]): schema["const"]}
        if "enum" in schema:
            values = {key_of(one): one for one in schema["enum"]}
            if node.values is not None:
                values = {key: one for key, one in values.items() if key in node.values}
            node.values = values
        for name, keyword in _NUMBERS.items():
            if keyword in schema:
                setattr(node, name, exact(schema[keyword]))
        for name, keyword in _COUNTS.items():
            if keyword in schema:
                setattr(node, name, int(schema[keyword]))
        node.pattern = schema.get("pattern")

    def _fill_array(self, node: Node, schema: Mapping[str, Any]) -> None:
        node.prefix = self._many(schema.get("prefixItems", ()))
        node.items = self._one(schema, "items")
        node.contains = self._one(schema, "contains")
        node.unevaluated_items = self._one(schema, "unevaluatedItems")
        node.unique = schema.get("uniqueItems", False)

    def _fill_object(self, node: Node, schema: Mapping[str, Any]) -> None:
        node.properties = dict(self._named(schema.get("properties", {})))
        node.patterns = self._named(schema.get("patternProperties", {}))
        node.additional = self._one(schema, "additionalProperties")
        node.unevaluated_properties = self._one(schema, "unevaluatedProperties")
        node.names = self._one(schema, "propertyNames")
        node.required = tuple(dict.fromkeys(schema.get("required", ())))
        node.dependent_required = tuple(
            (name, tuple(names)) for name, names in schema.get("dependentRequired", {}).items()
        )
        node.dependent_schemas = self._named(schema.get("dependentSchemas", {}))

    def _fill_logic(self, node: Node, schema: Mapping[str, Any]) -> None:
        node.all_of = self._many(schema.get("allOf", ()))
        node.any_of = self._many(schema["anyOf"]) if "anyOf" in schema else None
        node.one_of = self._many(schema["oneOf"]) if "oneOf" in schema else None
        node.negated = self._one(schema, "not")
        node.condition = self._one(schema, "if")
        node.then = self._one(schema, "then")
        node.otherwise = self._one(schema, "else")
        node.reference = schema.get("$ref")

    def _one(self, schema: Mapping[str, Any], keyword: str) -> Node | None:
        return self._nodes[id(schema[keyword])] if keyword in schema else None

    def _many(self, schemas: Any) -> tuple[Node, ...]:
        return tuple(self._nodes[id(one)] for one in schemas)

    def _named(self, schemas: Mapping[str, Any]) -> tuple[tuple[str, Node], ...]:
        return tuple((name, self._nodes[id(one)]) for name, one in schemas.items())


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


_NUMBERS = {
    "minimum": "minimum",
    "maximum": "maximum",
    "above": "exclusiveMinimum",
    "below": "exclusiveMaximum",
    "multiple": "multipleOf",
}
_COUNTS = {
    "min_length": "minLength",
    "max_length": "maxLength",
    "min_items": "minItems",
    "max_items": "maxItems",
    "min_contains": "minContains",
    "max_contains": "maxContains",
    "min_properties": "minProperties",
    "max_properties": "maxProperties",
}


def _has_references(schema: object) -> bool:
    waiting, seen = [schema], set[int]()
    while waiting:
        one = waiting.pop()
        if id(one) in seen:
            continue
        seen.add(id(one))
        if isinstance(one, Mapping):
            if "$ref" in one:
                return True
            waiting.extend(one.values())
        elif isinstance(one, list):
            waiting.extend(one)
    return False
