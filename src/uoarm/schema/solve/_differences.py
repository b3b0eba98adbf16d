"""Two schemas of one shape, which differ in schemas of members and items only: place by place.

What the one allows the other allows, too, if that holds at each such place. A value that the one
allows at a place and the other refuses is put into a whole message, which is then checked. Most
schemas that are compared in life are of this sort, as versions of one type are.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from operator import attrgetter, ge, le
from typing import Any, NamedTuple

from attrs import fields

from uoarm.schema._errors import Meter
from uoarm.schema._values import Repeated
from uoarm.schema.read import SchemaNode
from uoarm.schema.solve._branch import KINDS, Witness

_MAX_DEPTH = 200
_MAX_WRITTEN = 100
_MAX_TEXT = 1_000
_MAX_ITEMS = 10_000_000
_ASIDE = frozenset({"number", "raw", "document", "tags", "properties", "items"})
_SAID = tuple(field.name for field in fields(SchemaNode) if field.name not in _ASIDE)
_said = attrgetter(*_SAID)
_FOLLOWS: dict[str, Callable[[Any, Any], bool]] = {
    **dict.fromkeys(("minimum", "above", "min_length", "min_items", "min_properties"), ge),
    **dict.fromkeys(("maximum", "below", "max_length", "max_items", "max_properties"), le),
    **dict.fromkeys(("max_utf8", "max_utf16"), le),
    **dict.fromkeys(("integer_only", "unique", "no_nul"), ge),
    **dict.fromkeys(("pattern", "multiple", "additional"), lambda *_: False),
    "kinds": frozenset.issubset,
    "values": lambda mine, its: mine.keys() <= its.keys(),
    "required": lambda mine, its: set(mine).issuperset(its),
}
"""Whether what a schema says by a keyword follows from what another says by the same keyword."""
_beyond = attrgetter("unsupported", "reference", "unevaluated_items", "unevaluated_properties")
"""Keywords that depend on more than the value, or on what others evaluated."""
_sought = attrgetter("unsupported", "never", "reference", "all_of", "any_of", "one_of", "negated",
    "condition", "dependent_required", "dependent_schemas", "names", "contains", "unique",
    "pattern", "multiple", "above", "below", "min_properties")  # fmt: skip
"""Keywords for which a value is sought, not made."""


class SchemaDifference(NamedTuple):
    """Two schemas at one place: a path of names of members and of positions of items."""

    path: tuple[str | int, ...]
    first: SchemaNode
    second: SchemaNode


def differences(first: SchemaNode, second: SchemaNode, meter: Meter) -> Iterator[SchemaDifference]:
    """Yield the places at which two schemas differ: the whole, where they are of two shapes.

    Where one says more than the other, and the same besides, that is no difference.

    Each value that the first allows and the second refuses has at one of these places a part that
    the first allows there and the second refuses.
    """
    waiting = [SchemaDifference((), first, second)]
    seen: set[tuple[int, int]] = set()
    while waiting:
        found = waiting.pop()
        pair = found.first.number, found.second.number
        if pair[0] == pair[1] or pair in seen:
            continue
        seen.add(pair)
        meter.spend(1 + len(found.first.properties) // 8)
        alike = len(found.path) < _MAX_DEPTH and _are_alike(found.first, found.second)
        if alike:
            waiting.extend(_parts(found))
        else:
            yield found


def _are_alike(first: SchemaNode, second: SchemaNode) -> bool:
    """Say whether a value of one plain schema can fail another by its members and items alone.

    Each other keyword of the second one is said by the first one, too, or follows from it.
    """
    if (
        any(_beyond(first))
        or any(_beyond(second))
        or first.properties.keys() != second.properties.keys()
    ):
        return False
    if second.items is not None and first.items is None:
        return False
    for name, mine, its in zip(_SAID, _said(first), _said(second), strict=True):
        if not _is_same(mine, its):
            follows = _FOLLOWS.get(name)
            if follows is None or not (its is None or (mine is not None and follows(mine, its))):
                return False
    return True


def _is_same(first: Any, second: Any) -> bool:
    if first is second:
        return True
    if isinstance(first, SchemaNode) or isinstance(second, SchemaNode):
        return (
            isinstance(first, SchemaNode)
            and isinstance(second, SchemaNode)
            and first.number == second.number
        )
    if isinstance(first, tuple) and isinstance(second, tuple):
        return len(first) == len(second) and all(map(_is_same, first, second))
    if isinstance(first, dict) and isinstance(second, dict):  # the values of an enum, by their keys
        return first.keys() == second.keys()
    return bool(first == second)


def _parts(found: SchemaDifference) -> Iterator[SchemaDifference]:
    path, first, second = found
    for name, child in first.properties.items():
        yield SchemaDifference((*path, name), child, second.properties[name])
    if second.items is not None:
        assert first.items is not None, "schemas that are alike have items where the second has"
        yield SchemaDifference((*path, len(first.prefix)), first.items, second.items)


class Messages:
    """Makes the simplest messages of plain schemas, which the caller has to check."""

    def __init__(self, meter: Meter) -> None:
        self._meter = meter
        self._made: dict[int, Any] = {}

    def simplest(self, node: SchemaNode) -> Witness | None:
        """Return a value that a schema probably allows; None where one would have to be sought."""
        waiting = [node]
        while waiting:
            wanted = waiting[-1]
            kind = _kind(wanted)
            if kind is None or len(waiting) > _MAX_DEPTH:
                return None
            self._meter.spend()
            missing = [part for part in _needed(wanted, kind) if part.number not in self._made]
            if missing:
                waiting.append(missing[0])
            else:
                self._made[waiting.pop().number] = self._of_kind(wanted, kind)
        return Witness(self._made[node.number])

    def likely(self, node: SchemaNode, limits: SchemaNode) -> Iterator[Witness]:
        """Yield values that a plain schema may allow: the simplest, those just beyond limits."""
        simplest = self.simplest(node)
        if simplest is not None:
            yield simplest
        kind = _kind(node)
        if kind == "number":
            low, high = limits.minimum, limits.maximum
            if low is not None:
                yield Witness(-(-low.numerator // low.denominator) - 1)
            if high is not None:
                yield Witness(high.numerator // high.denominator + 1)
            if limits.integer_only:
                yield Witness(0.5)
        elif kind == "string" and limits.max_length is not None and limits.max_length < _MAX_TEXT:
            yield Witness("a" * (limits.max_length + 1))
        elif kind == "array" and limits.max_items is not None and limits.max_items < _MAX_ITEMS:
            item = Witness(None) if node.items is None else self.simplest(node.items)
            if item is not None and not node.prefix:
                yield Witness(_repeated([], item.value, limits.max_items + 1))

    def place(self, node: SchemaNode, path: tuple[str | int, ...], value: Any) -> Witness | None:
        """Return a message with a value at a place, and the simplest elsewhere."""
        around = [node]
        for step in path:
            inner = around[-1].items if isinstance(step, int) else around[-1].properties[step]
            assert inner is not None, "a path leads through what is there"
            around.append(inner)
        if any(subschema.min_items > _MAX_ITEMS for subschema in around):
            return None
        for step, subschema in zip(reversed(path), reversed(around[:-1]), strict=True):
            is_item = isinstance(step, int)
            for part in subschema.prefix if is_item else _needed(subschema, "object"):
                if self.simplest(part) is None:
                    return None
            if is_item:
                front = [self._made[part.number] for part in subschema.prefix]
                value = _repeated(front, value, max(1, subschema.min_items - len(front)))
            else:
                value = {**self._of_kind(subschema, "object"), step: value}
        return Witness(value)

    def _of_kind(self, node: SchemaNode, kind: str) -> Any:
        """Make a value of which all parts are made."""
        if node.values is not None:
            return next(iter(node.values.values()), None)
        if kind == "null":
            return None
        if kind == "boolean":
            return False
        if kind == "number":
            return _number(node)
        if kind == "string":
            return "a" * node.min_length
        if kind == "object":
            return {name: self._made[part.number] for name, part in _required(node)}
        front = [self._made[part.number] for part in node.prefix[: node.min_items]]
        rest = node.min_items - len(front)
        item = self._made[node.items.number] if rest and node.items is not None else None
        return _repeated(front, item, rest)


def _kind(node: SchemaNode) -> str | None:
    """Return the kind of the simplest value of a schema; None where one would have to be sought."""
    if any(_sought(node)) or node.min_length > _MAX_TEXT or node.min_items > _MAX_ITEMS:
        return None
    for kind in KINDS:
        if node.kinds is None or kind in node.kinds:
            return kind
    return None


def _needed(node: SchemaNode, kind: str) -> Iterator[SchemaNode]:
    """Yield the schemas of the parts that a value of a kind must have."""
    if node.values is not None:
        return
    if kind == "object":
        for _, part in _required(node):
            yield part
    elif kind == "array":
        yield from node.prefix[: node.min_items]
        if node.items is not None and node.min_items > len(node.prefix):
            yield node.items


def _required(node: SchemaNode) -> Iterator[tuple[str, SchemaNode]]:
    for name in node.required:
        if name in node.properties:
            yield name, node.properties[name]


def _number(node: SchemaNode) -> int:
    """Return the whole number next to zero within the bounds; one outside where there is none."""
    number = 0
    if node.minimum is not None and node.minimum > 0:
        number = -(-node.minimum.numerator // node.minimum.denominator)
    if node.maximum is not None and node.maximum < 0:
        number = node.maximum.numerator // node.maximum.denominator
    return number


def _repeated(front: list[Any], item: Any, count: int) -> Any:
    if count <= _MAX_WRITTEN:
        return [*front, *[item] * count]
    return Repeated([*((element, 1) for element in front), (item, count)])
