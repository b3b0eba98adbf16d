"""One candidate message for a schema: probably valid, at the edges where it can be."""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import TYPE_CHECKING

from uoarm.testing._choices import CHARACTERS, chance, text
from uoarm.testing._instance_numbers import draw_number
from uoarm.testing._instance_parts import InstanceDocument, choose_type

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Sequence

    from uoarm.testing._choices import Choices
    from uoarm.testing._instance_parts import Keywords

_MOST_DEPTH = 12
_DEEPEST = 60
_MOST_NODES = 4_000
_LONG_TEXT = 300
_LONG_ARRAY = 12
_MOST_COUNT = 2_000
_UNITS = (("x-max-utf8", "utf-8", 1), ("x-max-utf16", "utf-16-le", 2))


class TooLargeError(ValueError):
    """A candidate became too large to be finished."""


class Builder:
    """Builds candidates for one schema document."""

    def __init__(self, schema: object, choices: Choices) -> None:
        self._schema = schema
        self._document = InstanceDocument(schema)
        self._choices = choices
        self._nodes = 0
        self._by_type: Mapping[str, Callable[[Sequence[Keywords], int], object]] = {
            "object": self._object,
            "array": self._array,
            "string": self._string,
            "integer": lambda parts, _: draw_number(choices, parts, integer=True),
            "number": lambda parts, _: draw_number(choices, parts, integer=False),
            "boolean": lambda *_: choices.item((True, False)),
            "null": lambda *_: None,
        }

    def candidate(self) -> object:
        """A value meant to satisfy the schema; not checked.

        Raises:
            TooLargeError: it would have more nodes than one may have.
        """
        self._nodes = 0
        return self._build([self._schema])

    def _build(self, schemas: Iterable[object], depth: int = 0) -> object:
        """A part of a candidate, meant to satisfy all of ``schemas``."""
        self._nodes += 1
        if self._nodes > _MOST_NODES:
            raise TooLargeError
        if depth > _DEEPEST:
            return None
        parts = self._document.parts(self._choices, schemas)
        if parts is None:
            return None
        named = [value for part in parts for value in _members(part)]
        if named:
            return self._choices.item(named)
        chosen = choose_type(self._choices, parts)
        return None if chosen is None else self._by_type[chosen](parts, depth)

    def _string(self, parts: Sequence[Keywords], _: int) -> str:
        value = self._characters(parts)
        for keyword, encoding, unit in _UNITS:
            most = _smallest(parts, keyword)
            if most is not None:
                value = value.encode(encoding)[: unit * most].decode(encoding, "ignore")
        return value

    def _characters(self, parts: Sequence[Keywords]) -> str:
        choices = self._choices
        patterns = [part["pattern"] for part in parts if isinstance(part.get("pattern"), str)]
        low = _largest(parts, "minLength")
        high = _smallest(parts, "maxLength")
        if patterns:
            value = choices.matching(str(choices.item(patterns)))
            if high is not None and len(value) > high:
                return value[:high]
            return value + choices.item(CHARACTERS[:2]) * min(low - len(value), _LONG_TEXT)
        return text(choices, self._count(low, high, _LONG_TEXT))

    def _array(self, parts: Sequence[Keywords], depth: int) -> list[object]:
        choices = self._choices
        low = _largest(parts, "minItems")
        prefix = max((len(_list(part, "prefixItems")) for part in parts), default=0)
        contained = [part["contains"] for part in parts if "contains" in part]
        if contained:
            low = max(low, _largest(parts, "minContains", 1))
        count = self._count(low, _smallest(parts, "maxItems"), _LONG_ARRAY, prefix)
        if depth > _MOST_DEPTH:
            count = min(low, count)
        items: list[object] = []
        while len(items) < count:
            place = len(items)
            wanted = [_item_schema(part, place) for part in parts]
            if contained and chance(choices, 60):
                wanted += contained
            item = self._build(wanted, depth + 1)
            repeat = count - place if place >= prefix and count > _LONG_ARRAY else 1
            items += [item] * repeat
        return items

    def _object(self, parts: Sequence[Keywords], depth: int) -> dict[str, object]:
        choices = self._choices
        wanted = list(dict.fromkeys(name for part in parts for name in _list(part, "required")))
        optional = [
            name for part in parts for name in _mapping(part, "properties") if name not in wanted
        ]
        if depth <= _MOST_DEPTH:
            taste = choices.item((0, 50, 100))
            wanted += [name for name in dict.fromkeys(optional) if chance(choices, taste)]
            wanted += self._extra_names(parts)
        wanted += [name for name in self._depending(parts, wanted) if name not in wanted]
        low = _largest(parts, "minProperties")
        spare = (name for name in (*optional, *(f"p{n}" for n in range(low))))
        wanted += [name for name in spare if name not in wanted][: max(0, low - len(wanted))]
        names = [name for name in dict.fromkeys(wanted) if isinstance(name, str)]
        return {name: self._build(_value_schemas(parts, name), depth + 1) for name in names}

    def _extra_names(self, parts: Sequence[Keywords]) -> list[object]:
        choices = self._choices
        names: list[object] = []
        for part in parts:
            patterns = _mapping(part, "patternProperties")
            names += [choices.matching(pattern) for pattern in patterns if chance(choices, 60)]
            constraint = part.get("propertyNames")
            if constraint is not None and chance(choices, 60):
                names += [name for name in (self._build([constraint]),) if isinstance(name, str)]
            for keyword in ("dependentRequired", "dependentSchemas"):
                names += [name for name in _mapping(part, keyword) if chance(choices, 50)]
        closed = any(part.get("additionalProperties") is False for part in parts)
        if not closed and chance(choices, 40):
            names.append(choices.item(("x", "", "p0", "\U0001f600")))
        return names

    @staticmethod
    def _depending(parts: Sequence[Keywords], present: Sequence[object]) -> list[object]:
        needed: list[object] = []
        for part in parts:
            rules = _mapping(part, "dependentRequired")
            for name in present:
                needed += _list(rules, str(name))
        return needed

    def _count(self, low: int, high: int | None, sane: int, landmark: int = 0) -> int:
        near = [low, low + 1, landmark, landmark + 1, low + 3]
        if high is not None:
            near += [high, high - 1]
        fitting = [
            count
            for count in near
            if low <= count <= max(low, sane) and (high is None or count <= high)
        ]
        return min(self._choices.item(fitting or [low]), _MOST_COUNT)


def _members(part: Keywords) -> list[object]:
    if "const" in part:
        return [part["const"]]
    return _list(part, "enum")


def _list(part: Keywords, keyword: str) -> list[object]:
    value = part.get(keyword)
    return list(value) if isinstance(value, list) else []


def _mapping(part: Keywords, keyword: str) -> Mapping[str, object]:
    value = part.get(keyword)
    return value if isinstance(value, Mapping) else {}


def _largest(parts: Iterable[Keywords], keyword: str, default: int = 0) -> int:
    return max((int(part[keyword]) for part in parts if _counts(part, keyword)), default=default)  # type: ignore[call-overload] # _counts has seen a number


def _smallest(parts: Iterable[Keywords], keyword: str) -> int | None:
    return min((int(part[keyword]) for part in parts if _counts(part, keyword)), default=None)  # type: ignore[call-overload] # _counts has seen a number


def _counts(part: Keywords, keyword: str) -> bool:
    return isinstance(part.get(keyword), (int, float))


def _item_schema(part: Keywords, place: int) -> object:
    prefix = _list(part, "prefixItems")
    if place < len(prefix):
        return prefix[place]
    return part.get("items", part.get("unevaluatedItems", True))


def _value_schemas(parts: Iterable[Keywords], name: str) -> list[object]:
    schemas: list[object] = []
    for part in parts:
        named = _mapping(part, "properties")
        matched = [
            schema
            for pattern, schema in _mapping(part, "patternProperties").items()
            if _found(pattern, name)
        ]
        schemas += matched
        if name in named:
            schemas.append(named[name])
        elif not matched:
            schemas.append(part.get("additionalProperties", True))
    return schemas


def _found(pattern: str, name: str) -> bool:
    try:
        return re.search(pattern, name) is not None
    except re.error:
        return False
