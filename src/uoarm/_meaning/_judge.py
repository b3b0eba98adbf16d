"""The judgement of meaning: what two structures say of each value that passes between them.

It follows containment and changes nothing of it. Only what both sides state is compared; a number
or octets of which one side says nothing rests on shape alone, and is named.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from itertools import chain, zip_longest
from typing import Any

from attrs import define, field, frozen

from uoarm._encodable import shown
from uoarm._meaning._statements import (
    AROUND,
    INHERITED,
    WORDS_COMPARED,
    Findings,
    MeaningDifference,
    Path,
    Said,
    compare_types,
    compare_units,
    compare_words,
    name_of_type,
    said_around,
    with_own,
)
from uoarm.schema import document_of, follow

ITEMS = "[]"
_MOST_PAIRS = 50_000
_MOST_DEPTH = 100
_MOST_VIEWS = 32
_MOST_LISTED = 200
_NUMBERS = frozenset({"number", "integer"})
_NOTHING: Said = {}
_MEASURES = frozenset({"x-unit", "x-quantity", "x-time"})
_PARTS = frozenset({"properties", "additionalProperties", "items", "prefixItems"})
_WORDS_SAID = frozenset({"x-type", "x-unit", "x-quantity", "x-frame", "x-encoding", "x-time"})
_INHERITED = frozenset(INHERITED)
_CHOICES = frozenset({"$ref", "allOf", "anyOf", "oneOf"})


@frozen
class Meanings:
    """What comes of a judgement.

    Attributes:
        differences: what both sides state otherwise.
        unstated: numbers and octets of which a side says nothing; they rest on shape alone.
        notes: what a careful reader should know.
    """

    differences: tuple[MeaningDifference, ...] = ()
    unstated: tuple[Path, ...] = ()
    notes: tuple[str, ...] = ()


def judge(producer: Any, consumer: Any, alike: tuple[frozenset[str], ...] = ()) -> Meanings:
    """Compare what two schemas mean, of which one contains the other. Pure; raises nothing.

    Args:
        producer: JSON Schema of what is emitted.
        consumer: JSON Schema of what is taken.
        alike: names of types that are declared to stand for the same.
    """
    walk = _Walk(producer, consumer, alike)
    found = Findings()
    if _are_equal(producer, consumer):
        walk.find_unstated(producer, (), _NOTHING, found)
    else:
        walk.compare(producer, consumer, (), _NOTHING, _NOTHING, False, found)
    return Meanings(
        tuple(found.differences)[:_MOST_LISTED],
        tuple(found.unstated)[:_MOST_LISTED],
        tuple(found.notes)[:_MOST_LISTED],
    )


def _are_equal(one: Any, other: Any) -> bool:
    try:
        return bool(one == other)
    except RecursionError:  # nested deeper than anything is looked at
        return False


@define
class _Walk:
    """One judgement.

    Its steps take what the values around a place say of all within them, `mine` and `theirs`, and
    whether types of one name stand around it, which say what is within. They are plain arguments,
    as there are as many steps as parts of a structure.
    """

    producer: Any
    consumer: Any
    alike: tuple[frozenset[str], ...]
    pairs: int = 0
    # What pairs with a choice or a reference came to; nothing yet of those that are under way,
    # since what refers to itself says the same again.
    referred: dict[tuple[int, int, str], Findings] = field(factory=dict)
    # Schemas that hold together, by their identities: what is met again is the same object.
    joint: dict[tuple[int, ...], Said] = field(factory=dict)

    def find_unstated(self, schema: Any, path: Path, said: Said, found: Findings) -> None:
        """Find what rests on shape alone in a schema of both sides, where nothing can differ."""
        if not (schema.__class__ is dict or isinstance(schema, Mapping)):
            return
        self.pairs += 1
        if self.pairs > _MOST_PAIRS or len(path) > _MOST_DEPTH:
            found.unstated[path] = None
        elif not _CHOICES.isdisjoint(schema):
            self.compare(schema, schema, path, said, said, False, found)
        elif "$id" in schema and self._is_outside(schema, schema):
            with self._within(schema, schema):
                self.find_unstated(schema, path, said, found)
        elif "x-type" in schema and name_of_type(schema["x-type"]):
            return
        elif "x-octets" in schema:
            if "x-encoding" not in schema:
                found.unstated[path] = None
        else:
            if not _INHERITED.isdisjoint(schema):
                said = with_own(said, schema)
            if not _PARTS.isdisjoint(schema):
                for name, child, _ in (*_fields(schema, schema), *_items(schema, schema)):
                    self.find_unstated(child, (*path, name), said, found)
            if _is_number(schema) and _MEASURES.isdisjoint(said):
                found.unstated[path] = None

    def compare(
        self,
        one: Any,
        other: Any,
        path: Path,
        mine: Said,
        theirs: Said,
        covered: bool,  # noqa: FBT001 - as above
        found: Findings,
    ) -> None:
        """Compare two schemas and all within them."""
        # What is read from JSON is a dict, and recognised faster.
        if not (one.__class__ is dict or isinstance(one, Mapping)) or not (
            other.__class__ is dict or isinstance(other, Mapping)
        ):
            return
        self.pairs += 1
        if self.pairs > _MOST_PAIRS or len(path) > _MOST_DEPTH:
            found.unstated[path] = None
            return
        if _CHOICES.isdisjoint(one) and _CHOICES.isdisjoint(other):
            self._compare_views(one, other, path, mine, theirs, covered, found)
            return
        key = (id(one), id(other), f"{mine} {theirs} {covered}")
        if key not in self.referred:
            self.referred[key] = report = Findings()
            self._compare_choices(one, other, path, mine, theirs, covered, report)
        found.add(self.referred[key])

    def _compare_choices(
        self,
        one: Said,
        other: Said,
        path: Path,
        mine: Said,
        theirs: Said,
        covered: bool,  # noqa: FBT001 - as in `compare`
        found: Findings,
    ) -> None:
        try:
            made, taken = self._views(one, self.producer), self._views(other, self.consumer)
        except _NotFollowedError:
            if not covered:
                found.unstated[path] = None
            return
        for view in made:
            # A consumer with a choice takes a value as what agrees with it most, of what may be it.
            near = taken
            if len(made) + len(taken) > 2:  # noqa: PLR2004 - a choice on a side
                near = [mapping for mapping in taken if _are_of_one_kind(view, mapping)]
                near = [mapping for mapping in near if self._may_meet(view, mapping)] or near
            reports = []
            for mapping in near:
                reports.append(Findings())
                self._compare_views(view, mapping, path, mine, theirs, covered, reports[-1])
            if reports:
                found.add(min(reports, key=lambda report: len(report.differences)))

    def _compare_views(
        self,
        one: Said,
        other: Said,
        path: Path,
        mine: Said,
        theirs: Said,
        covered: bool,  # noqa: FBT001 - as in `compare`
        found: Findings,
    ) -> None:
        if ("$id" in one or "$id" in other) and self._is_outside(one, other):
            with self._within(one, other):
                self._compare_views(one, other, path, mine, theirs, covered, found)
            return
        one = {**said_around(one), **one} if AROUND in one else one
        if not (_WORDS_SAID.isdisjoint(one) and _WORDS_SAID.isdisjoint(other)):
            if "x-type" in one and "x-type" in other:
                known = compare_types(one, other, path, self.alike, found)
                if known is False:
                    return
                covered = covered or known is True
            mine, theirs = with_own(mine, one), with_own(theirs, other)
            if not (WORDS_COMPARED.isdisjoint(one) and WORDS_COMPARED.isdisjoint(other)):
                compare_words({**one, **mine}, {**other, **theirs}, one, other, path, found)
        # A unit around numbers is that of those which state no other: it is compared at each.
        if mine and theirs and _may_be_measured(one, other):
            compare_units(one, path, mine.get("x-unit"), theirs.get("x-unit"), found)
        if "x-octets" in one or "x-octets" in other:
            if not covered and not ("x-encoding" in one and "x-encoding" in other):
                found.unstated[path] = None
            return
        if "properties" in one or "additionalProperties" in one:
            for name, child, taken in _fields(one, other):
                self.compare(child, taken, (*path, name), mine, theirs, covered, found)
        if "items" in one or "prefixItems" in one:
            for name, child, taken in _items(one, other):
                self.compare(child, taken, (*path, name), mine, theirs, covered, found)
        if covered or (mine and theirs and any(key in mine and key in theirs for key in _MEASURES)):
            return
        if _is_number(one) and _is_number(other):
            found.unstated[path] = None

    def _may_meet(self, one: Said, other: Said) -> bool:
        """Say whether an object of one alternative may be of another, by its fields and tags."""
        if not (_has_room(one, other) and _has_room(other, one)):
            return False
        mine, theirs = one.get("properties", {}), other.get("properties", {})
        for name in mine.keys() & theirs:
            made = self._only_values(mine[name], self.producer)
            taken = self._only_values(theirs[name], self.consumer)
            if made and taken and made.isdisjoint(taken):
                return False
        return True

    def _only_values(self, schema: Any, root: Any) -> set[str]:
        """Return the only values of a schema as texts; none where it does not name them all."""
        try:
            values = [_values(view) for view in self._views(schema, root)]
        except _NotFollowedError:
            return set()
        return set(chain(*values)) if all(values) else set()

    def _is_outside(self, one: Said, other: Said) -> bool:
        """Say whether references within these schemas are to other documents than around them."""
        return _is_another(one, self.producer) or _is_another(other, self.consumer)

    @contextmanager
    def _within(self, one: Said, other: Said) -> Iterator[None]:
        around = self.producer, self.consumer
        self.producer = one if _is_another(one, self.producer) else self.producer
        self.consumer = other if _is_another(other, self.consumer) else self.consumer
        try:
            yield
        finally:
            self.producer, self.consumer = around

    def _views(self, schema: Any, root: Any, depth: int = 0) -> list[Said]:
        """Return the plain schemas that a schema is a choice of; references are followed."""
        self.pairs += 1
        if depth > _MOST_VIEWS or self.pairs > _MOST_PAIRS:
            raise _NotFollowedError
        if not isinstance(schema, Mapping):
            return []
        if schema.keys().isdisjoint(_CHOICES):
            return [schema]
        root = document_of(schema, root)
        bases: list[Said] = [{key: value for key, value in schema.items() if key not in _CHOICES}]
        if "$ref" in schema:
            target = follow(root, schema["$ref"])
            if target is None:
                raise _NotFollowedError
            bases = self._all([target], bases, root, depth)
        bases = self._all(schema.get("allOf", ()), bases, root, depth)
        for key in ("anyOf", "oneOf"):
            if key in schema:
                views = [
                    view for part in schema[key] for view in self._views(part, root, depth + 1)
                ]
                bases = self._product(views, bases)
        return bases

    def _all(self, parts: Iterable[Any], bases: list[Said], root: Any, depth: int) -> list[Said]:
        for part in parts:
            views = self._views(part, root, depth + 1)
            if views:
                bases = self._product(views, bases)
        return bases

    def _product(self, views: list[Said], bases: list[Said]) -> list[Said]:
        if len(views) * len(bases) > _MOST_VIEWS:
            raise _NotFollowedError
        return [self._merged(view, base) for base in bases for view in views]

    def _merged(self, inner: Said, outer: Said) -> Said:
        """Return one schema for two that hold together; what stands outside comes first."""
        made = {**inner, **outer}
        for key in _PARTS & inner.keys() & outer.keys():
            one, other = outer[key], inner[key]
            if key == "properties":
                both = {name: self._joint(one[name], other[name]) for name in one if name in other}
                made[key] = {**other, **one, **both}
            elif key == "prefixItems":
                pairs = zip_longest(one, other, fillvalue=True)
                made[key] = [self._joint(*pair) for pair in pairs]
            else:
                made[key] = self._joint(one, other)
        return made

    def _joint(self, outer: Any, inner: Any) -> Any:
        """Return a schema of what two accept."""
        if not isinstance(outer, Mapping) or not isinstance(inner, Mapping):
            return inner if outer is True or inner is False else outer
        schemas = (
            schema["allOf"] if schema.keys() == {"allOf"} else [schema] for schema in (outer, inner)
        )
        parts = {id(part): part for part in chain.from_iterable(schemas)}
        return self.joint.setdefault(tuple(parts), {"allOf": list(parts.values())})


def _is_another(schema: Said, document: Any) -> bool:
    """Say whether a schema is a document of its own; a view of a document is none."""
    return "$id" in schema and (
        not isinstance(document, Mapping) or schema["$id"] != document.get("$id")
    )


class _NotFollowedError(Exception):
    """A reference leads out of the document, or choices multiply beyond what is looked at."""


def _fields(one: Said, other: Said) -> Iterator[tuple[str, Any, Any]]:
    """Yield the fields of the same name of two plain schemas."""
    mine, theirs = one.get("properties") or {}, other.get("properties") or {}
    rest = other.get("additionalProperties")
    for name, child in mine.items():
        taken = theirs.get(name, rest)
        if taken is not None:
            yield name, child, taken
    if isinstance(one.get("additionalProperties"), Mapping):
        for name, taken in theirs.items():
            if name not in mine:
                yield name, one["additionalProperties"], taken
        if rest is not None:
            yield "*", one["additionalProperties"], rest


def _items(one: Said, other: Said) -> Iterator[tuple[str, Any, Any]]:
    """Yield the items of two plain schemas that stand at the same place."""
    first, second = one.get("prefixItems", ()), other.get("prefixItems", ())
    for number in range(max(len(first), len(second))):
        child = first[number] if number < len(first) else one.get("items")
        taken = second[number] if number < len(second) else other.get("items")
        yield f"[{number}]", child, taken
    yield ITEMS, one.get("items"), other.get("items")


def _is_number(schema: Said) -> bool:
    """Say whether values are numbers that measure something: no codes, no constants."""
    kinds = schema.get("type")
    if isinstance(kinds, list):
        kinds = next((kind for kind in kinds if kind in _NUMBERS), None)
    return kinds in _NUMBERS and "enum" not in schema and "const" not in schema


def _may_be_measured(one: Said, other: Said) -> bool:
    """Say whether values are numbers, or state a unit and are neither null nor of parts."""
    if _is_number(one) and _is_number(other):
        return True
    is_said = "x-unit" in one or "x-unit" in other
    is_null = "null" in (one.get("type"), other.get("type"))
    return is_said and not is_null and (_PARTS.isdisjoint(one) or _PARTS.isdisjoint(other))


def _has_room(one: Said, other: Said) -> bool:
    """Say whether an object may have all fields that the other must have."""
    is_open = one.get("additionalProperties") is not False or "patternProperties" in one
    return is_open or one.get("properties", {}).keys() >= set(other.get("required", ()))


def _values(schema: Said) -> list[str]:
    """Return the only values of a schema as texts, long ones cut; none where it names none."""
    values = [schema["const"]] if "const" in schema else schema.get("enum", ())
    return [
        shown(int(value) if isinstance(value, float) and value.is_integer() else value)
        for value in values
    ]


def _are_of_one_kind(one: Said, other: Said) -> bool:
    kinds = []
    for mapping in (one, other):
        text = mapping.get("type")
        kind = {text} if isinstance(text, str) else set(text or ())
        kinds.append({"number" if name == "integer" else name for name in kind})
    return not kinds[0] or not kinds[1] or bool(kinds[0] & kinds[1])
