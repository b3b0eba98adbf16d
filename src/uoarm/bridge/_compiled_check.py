"""A quick look at messages: a structure compiled into closures that know most good messages.

What a closure accepts, the whole validator accepts, too; what it does not know is left to that,
which also finds the words. So nothing here needs to be complete, and it never imports jsonschema.
"""

from __future__ import annotations

import math
import threading
from array import array
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from typing import Any, TypeAlias

from attrs import define, field, frozen

from uoarm._encodable import is_encodable
from uoarm._hints.arrays import has_masked
from uoarm.model import Schema


@frozen
class NumberRange:
    """Which numbers: `low <= x <= high`, and perhaps those that are not finite."""

    kinds: frozenset[type]
    low: float
    high: float
    any_nonfinite: bool
    bounded: bool

    def accepts(self, value: Any) -> bool:
        # Not `isinstance`: True is an int to Python, and no integer to JSON Schema.
        kind: Any = value.__class__
        if kind not in self.kinds:
            return False
        return self.low <= value <= self.high or (
            kind is float
            and (not self.bounded or (self.any_nonfinite and not math.isfinite(value)))
        )

    def accepts_all(self, values: list[Any] | tuple[Any, ...]) -> bool:
        """Judge a list at the speed of C, by its kinds and its extremes."""
        if not self.kinds.issuperset(map(type, values)):
            return False
        if not self.bounded or not values:
            return True
        low, high = self.low, self.high
        if self.any_nonfinite:
            return not any(
                map(math.isfinite, [value for value in values if not low <= value <= high])
            )
        if not (low <= min(values) and max(values) <= high):
            return False
        try:
            return not math.isnan(sum(values))  # as it is wherever one of them is
        except OverflowError:
            return False

    def accepts_buffer(self, buffer: Any) -> bool:
        """Judge an array of numpy by what its type can hold, else by its extremes."""
        kind = buffer.dtype.kind
        if kind == "f":
            if float not in self.kinds:
                return False
            if not self.bounded:
                return True
            limit = _GREATEST_FLOAT32 if buffer.dtype.itemsize <= 4 else math.inf  # noqa: PLR2004
            if self.any_nonfinite:
                return self.low <= -limit and limit <= self.high
        elif kind in "iu":
            bits = 8 * buffer.dtype.itemsize
            low, high = (
                (0, 2**bits - 1) if kind == "u" else (-(2 ** (bits - 1)), 2 ** (bits - 1) - 1)
            )
            if self.low <= low and high <= self.high:
                return True
        else:
            return False
        if not buffer.size:
            return True
        # NaN is the least and the greatest of an array that has one, and within no range.
        return bool(self.low <= buffer.min().item() and buffer.max().item() <= self.high)


_GREATEST_FLOAT32 = 3.4028234663852886e38


Accepts: TypeAlias = Callable[[Any], bool]
_Limits: TypeAlias = tuple[float, float]

_DEPTH = 64
_NOTES = frozenset(
    {"$comment", "$defs", "default", "definitions", "deprecated", "description", "examples"}
    | {"format", "readOnly", "title", "writeOnly"}
)
_UNITS = frozenset({"x-max-utf8", "x-max-utf16", "x-nul"})
_KINDS = {"integer": frozenset({int}), "number": frozenset({int, float})}
_CLASSES: Mapping[str, set[type]] = {
    "string": {str},
    "integer": {int},
    "number": {int},
    "boolean": {bool},
    "null": {type(None)},
}
_SPEAKS_OF = {
    **dict.fromkeys(("properties", "required", "additionalProperties"), "object"),
    **dict.fromkeys(("items", "minItems", "maxItems"), "array"),
    **dict.fromkeys(("minLength", "maxLength", *_UNITS), "string"),
    **dict.fromkeys(("minimum", "maximum"), "number"),
}
_LITERALS = frozenset({str, int, bool, type(None)})
_PLAIN = frozenset({bool, int, float, str, dict, list, tuple, type(None)})
_MISSING = object()


class _UnknownError(Exception):
    """A keyword, or a use of one, whose meaning is left to the whole validator."""


_COMPOSITE = frozenset({dict, list, tuple})


class _Judged(threading.local):
    """What the parts of the message that a thread judges came to, by reference and part.

    Where several forms of a structure lead to the same part, as those of a tree's nodes do, each
    level would double what the check takes.

    Attributes:
        parts: with each part, so that no other gets its identity meanwhile; None: nothing is kept.
    """

    parts: dict[tuple[object, int], tuple[Any, Any]] | None = None


judged = _Judged()


@contextmanager
def judging() -> Iterator[None]:
    """Judge one message in this thread, which looks at each part of it once for each reference."""
    judged.parts = {}
    try:
        yield
    finally:
        judged.parts = None


def compile_check(schema: Schema, judge: Callable[[Schema], Accepts]) -> Accepts:
    """Return a function that is true of messages that certainly match, in any thread.

    Args:
        schema: of the messages.
        judge: gives the judgement of the whole validator on a part of the schema.
    """
    return _Compiler(schema, judge).root()


@define(eq=False)
class _Compiler:
    whole: Schema
    judge: Callable[[Schema], Accepts]
    references: dict[str, Accepts] = field(factory=dict, init=False)

    def root(self) -> Accepts:
        if isinstance(self.whole, Mapping) and "$id" not in self.whole:
            return self.part(
                {name: value for name, value in self.whole.items() if name != "$schema"}, 0
            )
        return self.part(self.whole, 0)

    def part(self, schema: Any, depth: int) -> Accepts:
        """Return the function of a part; where a keyword is not known, the judge's."""
        if schema is True:
            return lambda _: True
        if not isinstance(schema, Mapping) or depth > _DEPTH:
            return self.judge(schema)
        try:
            return self._known(schema, depth)
        except (_UnknownError, TypeError, AttributeError):  # the others: no JSON Schema
            return self.judge(schema)

    def _known(self, schema: Mapping[str, Any], depth: int) -> Accepts:
        names = _meaningful(schema)
        if not names:
            return lambda _: True
        # Beside any other keyword a reference is left to the judge: what holds of both is not
        # compiled.
        if names == {"$ref"}:
            return self._reference(schema["$ref"], depth)
        for union in ("anyOf", "allOf"):
            if names == {union}:
                return self._several(union, [self.part(item, depth + 1) for item in schema[union]])
        if names <= {"enum", "type"} and "enum" in names:
            return self._one_of(schema["enum"], schema.get("type"))
        if names <= {"const", "type"} and "const" in names:
            return self._one_of([schema["const"]], schema.get("type"))
        kind = schema.get("type")
        if isinstance(kind, list | tuple):
            kinds = [self.part(_of_kind(schema, item), depth + 1) for item in kind]
            return self._several("anyOf", kinds)
        if kind == "object":
            return self._object(schema, depth)
        if kind == "array":
            return self._array(schema, depth)
        if kind == "string" and names - _UNITS <= {"type", "minLength", "maxLength"}:
            accepts = _text(*_limits(schema, "minLength", "maxLength"))
            return self._units(schema, accepts) if names & _UNITS else accepts
        if kind == "boolean" and names == {"type"}:
            return self._or_judged(lambda value: value is True or value is False, schema)
        if kind == "null" and names == {"type"}:
            return lambda value: value is None
        return self._or_judged(self._range(schema).accepts, schema)

    def _or_judged(self, accepts: Accepts, schema: Mapping[str, Any]) -> Accepts:
        """Leave values of other classes to the judge here, where they cost the least: numpy's."""
        judge = self.judge(schema)
        # By class and not `isinstance`: a subclass may answer anything, and is the judge's.
        return lambda value: accepts(value) or (value.__class__ not in _PLAIN and judge(value))

    def _units(self, schema: Mapping[str, Any], accepts: Accepts) -> Accepts:
        """Know texts that are short enough whatever they hold, or hold ASCII; the judge counts."""
        judge = self.judge(schema)
        # A character has four octets at most, and two units of UTF-16; of ASCII it has one of each.
        _, octets = _limits(schema, "minLength", "x-max-utf8")
        _, units = _limits(schema, "minLength", "x-max-utf16")
        most = min(octets, units)

        def is_plain(value: Any) -> bool:
            return (
                accepts(value)
                and "\0" not in value
                and (4 * len(value) <= most or (value.isascii() and len(value) <= most))
            ) or (value.__class__ is str and judge(value))

        return is_plain

    def _range(self, schema: Any) -> NumberRange:
        if not isinstance(schema, Mapping):
            raise _UnknownError
        names = _meaningful(schema)
        if schema.get("type") not in _KINDS or not names <= {"type", "minimum", "maximum"}:
            raise _UnknownError
        low, high = _limits(schema, "minimum", "maximum", -math.inf)
        nonfinite = schema.get("x-nonfinite") is True
        return NumberRange(_KINDS[schema["type"]], low, high, nonfinite, len(names) > 1)

    def _one_of(self, values: Sequence[Any], kind: Any) -> Accepts:
        if any(value.__class__ not in _LITERALS for value in values):
            raise _UnknownError
        # 1 and True are equal to Python, and not to JSON Schema: the class belongs to the value.
        allowed = _LITERALS if kind is None else _CLASSES.get(kind, frozenset())
        known = frozenset((item.__class__, item) for item in values if item.__class__ in allowed)

        def accepts(value: Any) -> bool:
            kind: Any = value.__class__
            return kind in _LITERALS and (kind, value) in known

        return accepts

    def _several(self, union: str, parts: list[Accepts]) -> Accepts:
        if len(parts) == 1:
            return parts[0]
        if union == "anyOf":
            return lambda value: any(accepts(value) for accepts in parts)
        return lambda value: all(accepts(value) for accepts in parts)

    def _reference(self, reference: Any, depth: int) -> Accepts:
        known = self.references
        if reference not in known:
            from uoarm.schema import follow  # noqa: PLC0415 - hosts of most components need none

            place = follow(self.whole, reference)
            if not isinstance(place, Mapping):
                raise _UnknownError

            def later(value: Any) -> bool:  # where it refers to itself
                parts = judged.parts
                kind: Any = value.__class__
                if parts is None or kind not in _COMPOSITE:
                    return known[reference](value)
                key = (reference, id(value))
                if key not in parts:
                    parts[key] = value, known[reference](value)
                return bool(parts[key][1])

            # Before its part is compiled, which may refer to it: it finds this, and ends.
            known[reference] = later
            known[reference] = self.part(place, depth + 1)
        return known[reference]

    def _object(self, schema: Mapping[str, Any], depth: int) -> Accepts:
        if not _meaningful(schema) <= {"type", "properties", "required", "additionalProperties"}:
            raise _UnknownError
        properties = schema.get("properties", {})
        required = schema.get("required", ())
        more = schema.get("additionalProperties", True)
        parts = {name: self.part(property_, depth + 1) for name, property_ in properties.items()}
        names = dict.fromkeys(required)
        always = tuple((name, parts.get(name, lambda _: True)) for name in names)
        perhaps = tuple((name, part) for name, part in parts.items() if name not in required)
        if more is False:
            return _closed(always, perhaps)
        rest = None if more is True else self.part(more, depth + 1)
        return _open(always, perhaps, frozenset(properties), rest)

    def _array(self, schema: Mapping[str, Any], depth: int) -> Accepts:
        if not _meaningful(schema) <= {"type", "items", "minItems", "maxItems"}:
            raise _UnknownError
        lengths = _limits(schema, "minItems", "maxItems")
        judge = self.judge(schema)
        try:
            inner, numbers = self._grid(schema)
        except _UnknownError:
            return _list(self.part(schema.get("items", True), depth + 1), lengths, None, judge)
        if len(inner) == 1:
            return _numbers(numbers, lengths, judge)
        part = self.part(schema["items"], depth + 1)
        return _list(part, lengths, lambda value: _is_grid(value, inner, numbers), judge)

    def _grid(self, schema: Any) -> tuple[list[_Limits], NumberRange]:
        """Return the lengths of arrays in arrays, from the outside, and their numbers."""
        lengths: list[_Limits] = []
        while isinstance(schema, Mapping) and schema.get("type") == "array":
            if (
                not _meaningful(schema) <= {"type", "items", "minItems", "maxItems"}
                or len(lengths) >= _DEPTH
            ):
                raise _UnknownError
            lengths.append(_limits(schema, "minItems", "maxItems"))
            schema = schema.get("items")
        return lengths, self._range(schema)


def _meaningful(schema: Mapping[str, Any]) -> set[str]:
    """Return the keywords of a schema that say which values match."""
    return {
        name
        for name in schema
        if name not in _NOTES and (not name.startswith("x-") or name in _UNITS)
    }


def _of_kind(schema: Mapping[str, Any], kind: str) -> dict[str, Any]:
    """Return what a schema of several types says of one of them."""
    group = "number" if kind == "integer" else kind
    kept = {name: value for name, value in schema.items() if _SPEAKS_OF.get(name, group) == group}
    return {**kept, "type": kind}


def _limits(schema: Mapping[str, Any], least: str, most: str, none: float = 0) -> _Limits:
    low, high = schema.get(least, none), schema.get(most, math.inf)
    if {low.__class__, high.__class__} <= {int, float}:
        return low, high
    raise _UnknownError


def _text(least: float, most: float) -> Accepts:
    def is_text(value: Any) -> bool:
        return value.__class__ is str and (value.isascii() or is_encodable(value))

    if least <= 0 and most == math.inf:
        return is_text
    return lambda value: is_text(value) and least <= len(value) <= most


def _closed(
    always: tuple[tuple[str, Accepts], ...], perhaps: tuple[tuple[str, Accepts], ...]
) -> Accepts:
    count = len(always)

    def accepts(value: Any) -> bool:
        if value.__class__ is not dict:
            return False
        # Fields are counted and not compared: a message has few, and as many as were found are all.
        left = len(value) - count
        try:
            for name, part in always:
                if not part(value[name]):
                    return False
        except KeyError:
            return False
        if left:
            for name, part in perhaps:
                one = value.get(name, _MISSING)
                if one is not _MISSING:
                    left -= 1
                    if not part(one):
                        return False
        return not left

    return accepts


def _open(
    always: tuple[tuple[str, Accepts], ...],
    perhaps: tuple[tuple[str, Accepts], ...],
    named: frozenset[str],
    rest: Accepts | None,
) -> Accepts:
    def accepts(value: Any) -> bool:
        if value.__class__ is not dict:
            return False
        for name, part in always:
            one = value.get(name, _MISSING)
            if one is _MISSING or not part(one):
                return False
        for name, part in perhaps:
            one = value.get(name, _MISSING)
            if one is not _MISSING and not part(one):
                return False
        return rest is None or all(
            isinstance(name, str) and is_encodable(name) and rest(item)
            for name, item in value.items()
            if name not in named
        )

    return accepts


def _list(part: Accepts, lengths: _Limits, is_grid: Accepts | None, judge: Accepts) -> Accepts:
    least, most = lengths

    def accepts(value: Any) -> bool:
        if value.__class__ is list or value.__class__ is tuple:
            return least <= len(value) <= most and all(map(part, value))
        if value.__class__ in _PLAIN:
            return False
        return (is_grid is not None and is_grid(value)) or judge(value)

    return accepts


def _numbers(numbers: NumberRange, lengths: _Limits, judge: Accepts) -> Accepts:
    least, most = lengths
    any_octet = numbers.low <= 0 and numbers.high >= 255  # noqa: PLR2004 - an octet

    def accepts(value: Any) -> bool:
        kind = value.__class__
        if kind is list or kind is tuple:
            # First at the speed of C; only a list that holds something else than numbers is looked
            # at again.
            if numbers.accepts_all(value):
                return least <= len(value) <= most
            return not _PLAIN.issuperset(map(type, value)) and judge(value)
        if kind is bytes or kind is bytearray:
            return least <= len(value) <= most and (any_octet or judge(value))
        if kind is memoryview:
            is_octets = any_octet and value.ndim == 1 and value.format == "B"
            return (is_octets and least <= len(value) <= most) or judge(value)
        if kind is array:
            return least <= len(value) <= most and numbers.accepts_all(value.tolist())
        if kind in _PLAIN:
            return False
        return _is_grid(value, [lengths], numbers) or judge(value)

    return accepts


def _is_grid(value: Any, lengths: Sequence[_Limits], numbers: NumberRange) -> bool:
    """Judge an array of numpy in its dimensions and its numbers."""
    shape = getattr(value, "shape", None)
    if not hasattr(value, "dtype") or not isinstance(shape, tuple) or len(shape) != len(lengths):
        return False
    fits = all(least <= item <= most for item, (least, most) in zip(shape, lengths, strict=True))
    return fits and not has_masked(value) and numbers.accepts_buffer(value)
