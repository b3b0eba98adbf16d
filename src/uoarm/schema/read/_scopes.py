"""Dynamic scopes: what references that find their target by the way to them depend on.

A scope says, for each name of a dynamic anchor that matters, which document on the way has set it
first. Where no reference can be led astray, every scope is empty, and nothing is told apart.
`$recursiveRef` is a reference to the name RECURSIVE.
"""

from __future__ import annotations

from typing import TypeAlias

from uoarm.schema._errors import OutOfScopeError
from uoarm.schema.read._resources import RECURSIVE, Resources

__all__ = ["Scope", "Scopes"]

Scope: TypeAlias = "tuple[tuple[str, str], ...]"
"""Names of dynamic anchors, each with the base of the document that has set it."""

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
