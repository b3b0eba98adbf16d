"""Messages that a structure allows, biased to its edges: the input of property tests.

For JSON Schema 2020-12: bounds and the values beside them, lengths at their limits, members of
enumerations, optional fields present and absent, every branch of a union, near misses by mutation.
Each is checked by a validator before it is handed out, so the generation itself may be careless.
Choices are those of hypothesis, or of a random source.
"""

from __future__ import annotations

import math
import re
import sys
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from fractions import Fraction
from typing import TYPE_CHECKING, Protocol, TypeAlias, TypeVar

from jsonschema import Draft202012Validator

from uoarm.schema import follow

if TYPE_CHECKING:
    from hypothesis.strategies import DrawFn, SearchStrategy

Item = TypeVar("Item")

CHARACTERS = "a0Az_-. \n\u00e9\u2028\U0001f600"
"""Drawn for free strings: a line end, a line separator, two bytes, four bytes, a surrogate pair."""

_FREE_LENGTH = 24


class Choices(Protocol):
    """What a generator may ask for; every method is one choice."""

    def item(self, items: Sequence[Item]) -> Item:
        """One of ``items``, which must not be empty."""
        ...

    def integer(self, low: int, high: int) -> int:
        """An integer from ``low`` to ``high``, both included."""
        ...

    def matching(self, pattern: str) -> str:
        """A string in which ``pattern`` is probably found; any string when it cannot be read."""
        ...


class Draw(Protocol):
    """What hypothesis hands to a composite strategy, and ``data().draw``."""

    def __call__(self, strategy: SearchStrategy[Item], label: object = None) -> Item:
        """One example of ``strategy``."""
        ...


class DrawnChoices:
    """Choices drawn by hypothesis, so that a failing example shrinks."""

    def __init__(self, draw: Draw) -> None:
        from hypothesis import strategies  # noqa: PLC0415 - hypothesis is no dependency of uoarm

        self._draw = draw
        self._strategies = strategies

    def item(self, items: Sequence[Item]) -> Item:
        """One of ``items``; shrinks to the first."""
        return items[self.integer(0, len(items) - 1)]

    def integer(self, low: int, high: int) -> int:
        """An integer in the range; shrinks towards ``low``."""
        return self._draw(self._strategies.integers(low, high))

    def matching(self, pattern: str) -> str:
        """A string that hypothesis finds for ``pattern`` read with Python's rules."""
        try:
            compiled = re.compile(pattern, re.ASCII)
        except re.error:
            return CHARACTERS[self.integer(0, 1)]
        return self._draw(self._strategies.from_regex(compiled))


def chance(choices: Choices, percent: int) -> bool:
    """True in about ``percent`` of 100 cases; shrinks to False."""
    return choices.integer(0, 99) >= 100 - percent


def text(choices: Choices, length: int) -> str:
    """A free string of ``length`` code points; one character repeated when it is long."""
    if length > _FREE_LENGTH:
        return choices.item(CHARACTERS) * length
    return "".join(choices.item(CHARACTERS) for _ in range(length))


_LANDMARKS = tuple(
    map(
        Fraction,
        (0, 1, -1, 127, 128, 255, 256, -128, 2**31, 2**53, 2**53 + 1, -(2**63), 2**63, 2**64),
    )
)
_LOWER, _UPPER = ("minimum", "exclusiveMinimum"), ("maximum", "exclusiveMaximum")
_STEPS = (Fraction(0), Fraction(1), Fraction(-1), Fraction(1, 2), Fraction(-1, 2), Fraction(1, 10))
Keywords = Mapping[str, object]
_MOST_PARTS = 400
_GUESSED_TYPE = {
    "properties": "object",
    "required": "object",
    "patternProperties": "object",
    "additionalProperties": "object",
    "propertyNames": "object",
    "minProperties": "object",
    "maxProperties": "object",
    "dependentRequired": "object",
    "unevaluatedProperties": "object",
    "items": "array",
    "prefixItems": "array",
    "minItems": "array",
    "maxItems": "array",
    "uniqueItems": "array",
    "contains": "array",
    "unevaluatedItems": "array",
    "pattern": "string",
    "minLength": "string",
    "maxLength": "string",
    "x-max-utf8": "string",
    "x-max-utf16": "string",
    "minimum": "number",
    "maximum": "number",
    "exclusiveMinimum": "number",
    "exclusiveMaximum": "number",
    "multipleOf": "number",
}
_TYPES = ("object", "array", "string", "integer", "number", "boolean", "null")
_MOST_DEPTH = 12
_DEEPEST = 60
_MOST_NODES = 4_000
_LONG_TEXT = 300
_LONG_ARRAY = 12
_MOST_COUNT = 2_000
_UNITS = (("x-max-utf8", "utf-8", 1), ("x-max-utf16", "utf-16-le", 2))


def exact(number: float) -> Fraction:
    """The number that the JSON text of ``number`` denotes, not the binary approximation of it."""
    return Fraction(number) if isinstance(number, int) else Fraction(repr(number))


def as_json(number: Fraction) -> int | float:
    """``number`` as Python reads it from JSON: the nearest double when it is no integer."""
    if number.denominator == 1 or abs(number) >= sys.float_info.max:
        return int(number)
    return float(number)


def draw_number(
    choices: Choices, schemas: Sequence[Mapping[str, object]], *, integer: bool
) -> int | float:
    """A number at, or a step beside, a bound, a multiple or a landmark of ``schemas``."""
    bounds = list(_bounds(schemas))
    anchors = [*bounds, *_LANDMARKS]
    value = (
        anchors[choices.integer(0, len(anchors) - 1)]
        if not (bounds and chance(choices, 75))
        else choices.item(bounds)
    )
    value += choices.item(_STEPS)
    if chance(choices, 30):
        value += choices.integer(-12, 12)
    value = _inside(value, schemas)
    lattice = _lattice(schemas, integer=integer)
    if lattice is not None:
        rounding = choices.item((math.floor, math.ceil))
        value = rounding(value / lattice) * lattice
    number = as_json(value)
    if isinstance(number, int) and abs(number) < 2**53 and chance(choices, 10):
        return float(number)
    return number


def _inside(value: Fraction, schemas: Sequence[Mapping[str, object]]) -> Fraction:
    """The value mirrored at the bound that it passed: an object of 20 numbers needs all to fit."""
    low = max(_bounds(schemas, _LOWER), default=None)
    high = min(_bounds(schemas, _UPPER), default=None)
    if low is not None and value < low:
        value = 2 * low - value
        return value if high is None else min(value, high)
    if high is not None and value > high:
        value = 2 * high - value
        return value if low is None else max(value, low)
    return value


def _bounds(
    schemas: Sequence[Mapping[str, object]], keywords: Sequence[str] = (*_LOWER, *_UPPER)
) -> Iterator[Fraction]:
    for schema in schemas:
        for keyword in keywords:
            bound = schema.get(keyword)
            if isinstance(bound, (int, float)):
                yield exact(bound)


def _lattice(schemas: Sequence[Mapping[str, object]], *, integer: bool) -> Fraction | None:
    steps = [Fraction(1)] if integer else []
    for schema in schemas:
        step = schema.get("multipleOf")
        if isinstance(step, (int, float)) and step > 0:
            steps.append(exact(step))
    if not steps:
        return None
    common = steps[0]
    for step in steps[1:]:
        common = Fraction(
            math.lcm(common.numerator, step.numerator),
            math.gcd(common.denominator, step.denominator),
        )
    return common


class InstanceDocument:
    """A schema document in which local references are followed."""

    def __init__(self, root: object) -> None:
        self._root = root

    def parts(self, choices: Choices, schemas: Iterable[object]) -> list[Keywords] | None:
        """The keyword sets that ``schemas`` ask for together, one branch of each union chosen.

        None when one of them allows nothing, or when references lead round in a circle.
        """
        waiting = list(schemas)
        found: list[Keywords] = []
        steps = 0
        while waiting:
            schema = waiting.pop()
            steps += 1
            if schema is False or steps > _MOST_PARTS:
                return None
            if isinstance(schema, Mapping):
                found.append(schema)
                waiting.extend(self._implied(choices, schema))
        return found

    def _implied(self, choices: Choices, schema: Keywords) -> Iterator[object]:
        reference = schema.get("$ref")
        if isinstance(reference, str):
            target = follow(self._root, reference)
            yield True if target is None else target
        all_of = schema.get("allOf")
        if isinstance(all_of, list):
            yield from all_of
        for keyword in ("anyOf", "oneOf"):
            branches = schema.get(keyword)
            if isinstance(branches, list) and branches:
                yield choices.item(branches)
                if keyword == "anyOf" and chance(choices, 15):
                    yield choices.item(branches)
        if "if" in schema:
            if chance(choices, 50):
                yield schema["if"]
                yield schema.get("then", True)
            else:
                yield schema.get("else", True)


def choose_type(choices: Choices, parts: Iterable[Keywords]) -> str | None:
    """One type that every part allows, preferring types which the other keywords speak of."""
    allowed = set(_TYPES)
    spoken: list[str] = []
    for part in parts:
        declared = part.get("type")
        if declared is not None:
            names = {declared} if isinstance(declared, str) else set(_list(part, "type"))
            if "number" in names:
                names.add("integer")
            allowed &= names
        spoken += [_GUESSED_TYPE[keyword] for keyword in part if keyword in _GUESSED_TYPE]
    likely = [name for name in spoken if name in allowed]
    if likely and chance(choices, 85):
        return choices.item(likely)
    ordered = [name for name in _TYPES if name in allowed]
    return choices.item(ordered) if ordered else None


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


_OTHERS: tuple[object, ...] = (None, True, False, 0, 1, -1, 0.5, "", "a", [], [0], {}, {"x": 0})
Schema: TypeAlias = "bool | Mapping[str, object]"
_ATTEMPTS = 6
_TOO_LARGE = 2
"""Candidates that may become too large before a schema is given up: the next ones would, too."""


def mutate(choices: Choices, value: object) -> object:
    """A copy of ``value`` with one change: at this place, or one level deeper and so on."""
    if isinstance(value, dict) and value:
        return _mutate_object(choices, value)
    if isinstance(value, list) and value:
        return _mutate_array(choices, value)
    if chance(choices, 25):
        return choices.item(_OTHERS)
    if isinstance(value, bool) or value is None:
        return choices.item((True, False, None, 0, 1))
    if isinstance(value, int):
        return value + choices.item((1, -1, 0.5)) if abs(value) < 2**53 else value + 1
    if isinstance(value, float):
        return choices.item((value + 1, -value, round(value)))
    if isinstance(value, str):
        return _mutate_string(choices, value)
    return choices.item(_OTHERS)


def _mutate_string(choices: Choices, value: str) -> str:
    change = choices.item(("append", "drop", "replace"))
    if change == "append" or not value:
        return value + choices.item(CHARACTERS)
    place = choices.integer(0, len(value) - 1)
    replacement = "" if change == "drop" else choices.item(CHARACTERS)
    return value[:place] + replacement + value[place + 1 :]


def _mutate_array(choices: Choices, value: list[object]) -> object:
    change = choices.item(("drop", "repeat", "append", "rotate", "inside"))
    place = choices.integer(0, len(value) - 1)
    if change == "drop":
        return value[:place] + value[place + 1 :]
    if change == "repeat":
        return [*value, value[place]]
    if change == "append":
        return [*value, choices.item(_OTHERS)]
    if change == "rotate":
        return [*value[1:], value[0]]
    return [*value[:place], mutate(choices, value[place]), *value[place + 1 :]]


def _mutate_object(choices: Choices, value: dict[str, object]) -> object:
    change = choices.item(("drop", "add", "rename", "inside", "inside"))
    name = choices.item(list(value))
    changed = dict(value)
    if change == "drop":
        del changed[name]
    elif change == "add":
        changed[choices.item(("x", "", name + "_", name.upper()))] = choices.item(_OTHERS)
    elif change == "rename":
        changed[name + "x"] = changed.pop(name)
    else:
        changed[name] = mutate(choices, value[name])
    return changed


def instances(
    schema: Schema, *, accepts: Callable[[object], bool] | None = None
) -> SearchStrategy[object]:
    """A hypothesis strategy for JSON values that are valid for ``schema``.

    ``accepts`` decides what is valid; by default the ``jsonschema`` package, which reads patterns
    with Python's rules and divides with floats. A schema that hardly any value satisfies makes
    hypothesis complain that too much was filtered; one that none satisfies makes it fail.
    """
    from hypothesis import reject, strategies  # noqa: PLC0415 - hypothesis is no dependency of uoarm

    valid = accepts or Draft202012Validator(schema).is_valid

    @strategies.composite
    def drawn(draw: DrawFn) -> object:
        value, found = find_instance(schema, DrawnChoices(draw), valid)
        return value if found else reject()

    return drawn()


def find_instance(
    schema: object, choices: Choices, accepts: Callable[[object], bool]
) -> tuple[object, bool]:
    """A valid value and True, or None and False when a handful of attempts gave none."""
    builder, too_large = Builder(schema, choices), 0
    for _ in range(_ATTEMPTS):
        try:
            value = builder.candidate()
        except TooLargeError:
            too_large += 1
            if too_large == _TOO_LARGE:
                break
            continue
        if chance(choices, 40):
            changed = mutate(choices, value)
            if accepts(changed):
                return changed, True
        if accepts(value):
            return value, True
    return None, False
