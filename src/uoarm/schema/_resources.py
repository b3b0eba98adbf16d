"""Where references lead: identifiers, anchors and pointers within one document.

A schema with an `$id` is a document of its own inside the whole; references are read relative to
the innermost one around them. Nothing is ever fetched.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from typing import Any
from urllib.parse import unquote, urljoin

from uoarm.schema._dialects import Dialect
from uoarm.schema._errors import OutOfScopeError, SchemaError
from uoarm.schema._shapes import ANNOTATIONS, LISTS, MAPS, SINGLES

__all__ = ["Resources"]

_INDEX = re.compile("[0-9]{1,9}")
_POSITIONAL = frozenset({"$id", "$ref", "$dynamicRef", "$anchor", "$dynamicAnchor"})


class Resources:
    """The identifiers and anchors of one schema and of all schemas inside it."""

    def __init__(self, schema: object, dialect: Dialect) -> None:
        self._dialect = dialect
        self._documents: dict[str, object] = {"": schema}
        self._bases: dict[int, str] = {}
        self._seen: set[tuple[int, str]] = set()
        self._anchors: dict[tuple[str, str], object] = {}
        self._dynamic: dict[str, set[str]] = {}
        self.refers = False
        self.walk(schema, "")

    def walk(self, schema: object, base: str) -> None:
        """Take in a schema that stands in the document of a base."""
        waiting = [(schema, base)]
        while waiting:
            one, around = waiting.pop()
            if not isinstance(one, Mapping) or (id(one), around) in self._seen:
                continue
            self._seen.add((id(one), around))
            view = self._dialect.view(one)
            if self._bases.setdefault(id(one), around) != around and _POSITIONAL & view.keys():
                raise OutOfScopeError("one object with references stands in two documents")
            inner = self._enter(one, view, around)
            waiting.extend((child, inner) for child in _children(view))

    def absolute(self, schema: Mapping[str, Any], reference: str) -> str:
        """Return a reference of a schema in the form that `find` takes."""
        base = self._inner(schema, self._bases[id(schema)])
        target, _, fragment = reference.partition("#")
        return f"{_joined(base, target, '$ref') if target else base}#{fragment}"

    def is_static(self, absolute: str) -> bool:
        """Say whether a dynamic reference leads to the same place from everywhere."""
        base, _, name = absolute.partition("#")
        bases = self._dynamic.get(name, set())
        return base not in bases or len(bases) == 1

    def agree(self, schema: Mapping[str, Any], other: Dialect) -> bool:
        """Say whether a schema means the same in another draft as in that of the document."""
        waiting: list[object] = [schema]
        while waiting:
            one = waiting.pop()
            if isinstance(one, Mapping):
                view, its = self._dialect.view(one), other.view(one)
                if _meaning(view) != _meaning(its) or other.objection(one, beside_contains=True):
                    return False
                waiting.extend(_children(view))
        return True

    def find(self, absolute: str) -> tuple[object, str] | None:
        """Return what a reference leads to and the base around it; None when it leads out.

        Raises:
            SchemaError: the document is here, but has no such part.
        """
        base, _, fragment = absolute.partition("#")
        if base not in self._documents:
            return None
        if fragment and not fragment.startswith("/"):
            if (base, fragment) not in self._anchors:
                raise SchemaError("#/$ref", "a reference to a part of the document", absolute)
            named = self._anchors[base, fragment]
            return named, self._bases[id(named)]
        at: Any = self._documents[base]
        around = self._bases.get(id(at), "")
        for step in unquote(fragment).split("/")[1:]:
            around = self._inner(at, around)
            name = step.replace("~1", "/").replace("~0", "~")
            if isinstance(at, Mapping) and name in at:
                at = at[name]
            elif isinstance(at, list) and _INDEX.fullmatch(name) and int(name) < len(at):
                at = at[int(name)]
            else:
                raise SchemaError("#/$ref", "a reference to a part of the document", absolute)
        if not isinstance(at, bool | Mapping):
            raise SchemaError("#/$ref", "a reference to a schema", absolute)
        return at, around

    def _enter(self, schema: Mapping[str, Any], view: Mapping[str, Any], around: str) -> str:
        base = _named(view, around)
        if isinstance(view.get("$id"), str):
            known = self._documents.setdefault(base, schema)
            if known is not schema:
                raise OutOfScopeError(f"two documents are called {base!r}")
        for keyword in ("$anchor", "$dynamicAnchor"):
            name = view.get(keyword)
            if isinstance(name, str):
                self._anchors[base, name] = schema
                if keyword == "$dynamicAnchor":
                    self._dynamic.setdefault(name, set()).add(base)
        self.refers = self.refers or "$ref" in view or "$dynamicRef" in view
        return base

    def _inner(self, schema: object, around: str) -> str:
        """Return the base inside a schema."""
        return _named(self._dialect.view(schema), around) if isinstance(schema, Mapping) else around


def _named(view: Mapping[str, Any], around: str) -> str:
    named = view.get("$id")
    return _joined(around, named.partition("#")[0], "$id") if isinstance(named, str) else around


def _joined(base: str, target: str, keyword: str) -> str:
    try:
        return urljoin(base, target)
    except ValueError:
        raise SchemaError(f"#/{keyword}", "a URI reference", target) from None


def _meaning(view: Mapping[str, Any]) -> dict[str, object]:
    return {name: id(one) for name, one in view.items() if name not in ANNOTATIONS}


def _children(schema: Mapping[str, Any]) -> Iterator[object]:
    for keyword, value in schema.items():
        if keyword in SINGLES:
            yield value
        elif keyword in LISTS and isinstance(value, list):
            yield from value
        elif keyword in MAPS and isinstance(value, Mapping):
            yield from value.values()
