"""The validator that knows every keyword and finds the words: jsonschema's, taught our messages.

Octets, numeric buffers and scalars of numpy are arrays and numbers; numbers that are not finite are
within a range only where `x-nonfinite` says so; half of a surrogate pair is in no text; patterns
are read as the proof reads them.
"""

from __future__ import annotations

import math
import operator
import re
from collections.abc import Callable, Hashable, Iterator, Mapping, Sequence
from fractions import Fraction
from functools import cache
from typing import Any, TypeAlias, cast

from jsonschema import Draft7Validator, Draft202012Validator, validators
from jsonschema.exceptions import ValidationError
from jsonschema.protocols import Validator

from uoarm._encodable import is_encodable
from uoarm._hints.arrays import has_masked
from uoarm.bridge._compiled_check import judged
from uoarm.model import Schema
from uoarm.schema import UnsupportedPatternError, found_in


def _pattern(_: Draft202012Validator, pattern: str, instance: Any, __: object) -> Errors:
    if isinstance(instance, str) and not _found(pattern, instance):
        yield ValidationError("of another pattern")


def _pattern_properties(
    validator: Draft202012Validator, rules: Mapping[str, Any], instance: Any, _: object
) -> Errors:
    if isinstance(instance, Mapping):
        for pattern, rule in rules.items():
            for name in instance:
                if not isinstance(name, str) or _found(pattern, name):
                    yield from _unencodable(name)
                if _found(pattern, name):
                    yield from validator.descend(instance[name], rule, name, pattern)


def _additional_properties(
    validator: Draft202012Validator, rule: Any, instance: Any, whole: Mapping[str, Any]
) -> Errors:
    if not isinstance(instance, Mapping):
        return
    patterns = whole.get("patternProperties", ())
    known = whole.get("properties", {})
    for name in instance:
        if name in known or any(_found(pattern, name) for pattern in patterns):
            continue
        if rule is False:
            yield ValidationError("unknown field", path=(name,))
        elif rule is not True:
            yield from _unencodable(name)
            yield from validator.descend(instance[name], rule, name)


def _unencodable(name: Any) -> Errors:
    if not (isinstance(name, str) and is_encodable(name)):
        yield ValidationError("no text, or half of a surrogate pair", path=(name,))


def _found(pattern: str, text: object) -> bool:
    if not isinstance(text, str):
        return False
    try:
        return found_in(pattern, text)
    except UnsupportedPatternError:
        return re.search(pattern, text) is not None


PATTERN_KEYWORDS = {
    "pattern": _pattern,
    "patternProperties": _pattern_properties,
    "additionalProperties": _additional_properties,
}


Errors: TypeAlias = Iterator[ValidationError]

_KINDS: Mapping[str, frozenset[type]] = {
    "integer": frozenset({int}),
    "number": frozenset({int, float}),
}
_BOUNDS: Mapping[str, Callable[[Any, Any], bool]] = {
    "minimum": operator.ge,
    "maximum": operator.le,
    "exclusiveMinimum": operator.gt,
    "exclusiveMaximum": operator.lt,
}
_SIZES: Mapping[str, tuple[str, Callable[[int, int], bool]]] = {
    f"{bound}{name}": (kind, holds)
    for bound, holds in (("min", operator.ge), ("max", operator.le))
    for name, kind in (("Items", "array"), ("Properties", "object"), ("Length", "string"))
}
_RANGE_KEYWORDS = frozenset({"type", "title", "description", *_BOUNDS})


def validator_of(schema: Schema) -> Validator:
    """Return the validator of messages of a schema."""
    return _kind()(schema)


@cache
def _kind() -> type[Validator]:
    known = Draft202012Validator.TYPE_CHECKER

    def numbers(name: str) -> Callable[[object, object], bool]:
        def is_of(_: object, value: object) -> bool:
            number = _plain_number(value)
            # The library takes Decimal, Fraction and complex, too, which are in no message.
            is_real = isinstance(number, bool | int | float) or _kind_of(number) == "f"
            return is_real and known.is_type(number, name)

        return is_of

    # Made as the first message needs it, and kept: to extend the library's own takes milliseconds.
    checker = known.redefine_many(
        {
            "array": lambda _, value: isinstance(value, list | tuple) or _is_buffer(value),
            "string": lambda _, value: isinstance(value, str) and is_encodable(value),
            "integer": numbers("integer"),
            "number": numbers("number"),
            "boolean": numbers("boolean"),
        }
    )
    units = {
        "x-max-utf8": _within_units("utf-8", 1),
        "x-max-utf16": _within_units("utf-16-le", 2),
        "x-nul": _nul,
    }
    ranges = {name: _bounded(holds) for name, holds in _BOUNDS.items()}
    sizes = {name: _sized(*size) for name, size in _SIZES.items()}
    kind: type[Validator] = validators.extend(  # type: ignore[no-untyped-call]
        Draft202012Validator,
        {
            "type": _type,
            "items": _items,
            "uniqueItems": _unique,
            "enum": _enumerated,
            "const": lambda validator, value, *rest: _enumerated(validator, [value], *rest),
            "$ref": _reference,
            "multipleOf": _bounded(_is_multiple),
            # Of drafts before 2019-09: in a structure the proof reads it so, too.
            "dependencies": Draft7Validator.VALIDATORS["dependencies"],
            **ranges,
            **sizes,
            **units,
            **PATTERN_KEYWORDS,
        },
        type_checker=checker,
    )
    return kind


# The library's own keywords write the whole value into each error, which takes as long as a message
# is large, and cannot be done for a number of too many digits.


def _type(validator: Validator, types: Any, instance: Any, _: object) -> Errors:
    names = [types] if isinstance(types, str) else types
    if not any(validator.is_type(instance, item) for item in names):
        yield ValidationError("of another type")


def _sized(kind: str, holds: Callable[[int, int], bool]) -> Callable[..., Errors]:
    def within(validator: Validator, bound: int, instance: Any, _: object) -> Errors:
        if validator.is_type(instance, kind) and not holds(len(instance), bound):
            yield ValidationError("of another size")

    return within


def _reference(
    validator: Draft202012Validator, reference: str, instance: Any, schema: object
) -> Errors:
    """Hold a reference; a part of the message that it was held against has its first error."""
    hold = Draft202012Validator.VALIDATORS["$ref"]
    errors: Errors = hold(validator, reference, instance, schema)
    parts = judged.parts
    if parts is None or not isinstance(instance, list | tuple | Mapping):
        yield from errors
        return
    # The schema around a reference says which of those of the same text it is.
    key = (id(schema), id(instance))
    if key in parts:
        first = parts[key][1]
        if first is not None:
            yield ValidationError.create_from(first)
        return
    first = None
    for error in errors:
        if first is None:
            # Before it gets the places around it.
            first = ValidationError.create_from(error)
            parts[key] = instance, first
        yield error
    parts[key] = instance, first


def _unique(
    validator: Validator,
    wanted: bool,  # noqa: FBT001 - a keyword
    instance: Any,
    _: object,
) -> Errors:
    """Hold `uniqueItems` in time that grows with the items: jsonschema compares each two."""
    if wanted and validator.is_type(instance, "array"):
        keys = set(map(_key, instance))
        if len(keys) < len(instance):
            yield ValidationError("the same item twice")


def _enumerated(_: Validator, values: Sequence[Any], instance: Any, __: object) -> Errors:
    """Hold `enum` for arrays of numpy, too, which are compared with a number item by item."""
    if _key(instance) not in set(map(_key, values)):
        yield ValidationError("none of the known values")


def _key(value: object) -> Hashable:
    """Return what is equal where JSON values are, and differs in its hash where they do not.

    Numbers are written down: who sends them can choose thousands of one hash.
    """
    value = _plain_number(value)
    if isinstance(value, bool) or value is None:
        return value is None, bool(value)
    if isinstance(value, float) and not value.is_integer():
        return value if math.isnan(value) else ("number", value.hex())
    if isinstance(value, int | float):
        return "number", f"{int(value):x}"
    if isinstance(value, Mapping):
        return "object", frozenset((name, _key(item)) for name, item in value.items())
    if isinstance(value, list | tuple) or _is_buffer(value):
        return "array", tuple(map(_key, cast("Sequence[object]", value)))
    return value if isinstance(value, str) else ("no value of JSON", id(value))


def _within_units(encoding: str, unit: int) -> Callable[..., Errors]:
    """Return a keyword that counts a text as an encoding writes it; it says how many there are."""

    def within(_: Validator, bound: int, instance: Any, __: object) -> Errors:
        if isinstance(instance, str):
            count = len(instance.encode(encoding, "surrogatepass")) // unit
            if count > bound:
                yield ValidationError(str(count))

    return within


def _nul(_: Validator, allowed: bool, instance: Any, __: object) -> Errors:  # noqa: FBT001 - a keyword
    if allowed is False and isinstance(instance, str) and "\0" in instance:
        yield ValidationError("with NUL")


def _bounded(holds: Callable[[Any, Any], bool]) -> Callable[..., Errors]:
    """Return a keyword of ranges that knows what is not finite."""

    def within(validator: Validator, bound: float, instance: Any, schema: Schema) -> Errors:
        if not validator.is_type(instance, "number"):
            return
        number: Any = _plain_number(instance)
        is_finite = not isinstance(number, float) or math.isfinite(number)
        allows_all = isinstance(schema, Mapping) and schema.get("x-nonfinite") is True
        if not (holds(number, bound) or (allows_all and not is_finite)):  # NaN never holds
            yield ValidationError("out of range")

    return within


def _is_multiple(number: Any, step: Any) -> bool:
    """Say whether it is one as both are written, as the proof reads them: in binary few are."""
    if isinstance(number, float) and not math.isfinite(number):
        return False
    return not _exact(number) % _exact(step)


def _exact(number: Any) -> int | Fraction:
    return number if isinstance(number, int) else Fraction(float.__repr__(number))


def _items(
    validator: Draft202012Validator, schema: object, instance: Any, whole: Mapping[str, object]
) -> Errors:
    each_item = Draft202012Validator.VALIDATORS["items"]
    if isinstance(instance, list | tuple):
        if not (isinstance(schema, Mapping) and _are_in_range(validator, schema, instance)):
            yield from each_item(validator, schema, instance, whole)
    elif not _is_buffer(instance):
        return  # of what is no array the keyword says nothing
    elif getattr(instance, "ndim", 1) != 1:
        yield from each_item(validator, schema, list(instance), whole)  # rows, arrays themselves
    elif (
        isinstance(schema, Mapping)
        and _has_range_only(schema)
        and not _may_split(instance, schema)
        and _kind_of(instance) in {"", *"iuf"}  # others have no least and greatest number
    ):
        for extreme in _extremes(instance, schema):
            yield from validator.descend(extreme, schema)
    else:
        yield from each_item(validator, schema, [_plain(item) for item in instance], whole)


def _may_split(buffer: Any, schema: Mapping[str, Any]) -> bool:
    """Say whether numbers between two integers may be none, which extremes do not show."""
    if schema.get("type") != "integer":
        return False
    return _kind_of(buffer) == "f" or getattr(buffer, "typecode", "") in {"f", "d"}


def _has_range_only(schema: Mapping[str, Any]) -> bool:
    return all(name in _RANGE_KEYWORDS or name.startswith("x-") for name in schema)


def _are_in_range(
    validator: Draft202012Validator, schema: Mapping[str, Any], items: Sequence[Any]
) -> bool:
    """Say whether a list is known at once to have only numbers of a range, judged by its extremes.

    A long list then costs no more than a buffer. What is not known so is left to the whole check,
    which also names the place: other values, NaN, which has no order, and 1.0 for an integer.
    """
    kinds = _KINDS.get(str(schema.get("type")), frozenset())
    if not _has_range_only(schema) or not set(map(type, items)) <= kinds:
        return False
    try:
        if math.isnan(sum(items)):
            return False
    except OverflowError:
        return False
    extremes = _extremes(items, {})
    return not any(True for extreme in extremes for _ in validator.descend(extreme, schema))


def _extremes(buffer: Any, schema: Mapping[str, Any]) -> tuple[object, ...]:
    """Return the least and the greatest item: a range that holds both holds all between."""
    if schema.get("x-nonfinite") is True and getattr(buffer, "typecode", "") in {"f", "d"}:
        buffer = [item for item in buffer if math.isfinite(item)]
    elif schema.get("x-nonfinite") is True and hasattr(buffer, "dtype"):
        buffer = buffer[(buffer > -math.inf) & (buffer < math.inf)]
    elif hasattr(buffer, "typecode") and any(item != item for item in buffer):  # noqa: PLR0124 - NaN
        # Least and greatest of what holds NaN depend on the order: NaN alone says that it is there.
        return (math.nan,)
    if not len(buffer):
        return ()
    if hasattr(buffer, "min"):
        return _plain(buffer.min()), _plain(buffer.max())
    return min(buffer), max(buffer)


def _kind_of(value: object) -> str:
    """Return the letter of what numpy has in an array or a scalar; "" for anything else."""
    return str(getattr(getattr(value, "dtype", None), "kind", ""))


def _is_buffer(value: object) -> bool:
    if isinstance(value, bytes | bytearray | memoryview):
        return not isinstance(value, memoryview) or value.ndim == 1
    # A scalar of numpy, and an array of no dimension, is a number.
    is_array = hasattr(value, "__array_interface__") and getattr(value, "ndim", 1) > 0
    return (is_array and not has_masked(value)) or hasattr(value, "typecode")


def _plain_number(value: object) -> object:
    """Return a scalar of numpy as the Python number that it stands for, anything else as it is."""
    return _plain(value) if getattr(value, "ndim", None) == 0 else value


def _plain(value: object) -> object:
    """Return a numpy scalar as the Python number that it stands for."""
    item = getattr(value, "item", None)
    return item() if callable(item) else value
