"""Checks of live messages against their declared structure, octets and buffers included."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import lru_cache
from typing import TYPE_CHECKING, Any

from uoarm.errors import MessageError
from uoarm.model import Message, MessageStructure, ValidationMode

if TYPE_CHECKING:
    from jsonschema import Draft202012Validator
    from jsonschema.exceptions import ValidationError
    from jsonschema.protocols import Validator

__all__ = ["make_check"]

_SAMPLE_EVERY = 128
_KINDS: Mapping[str, frozenset[type]] = {
    "integer": frozenset({int}),
    "number": frozenset({int, float}),
}
_RANGE_KEYWORDS = frozenset(
    {"type", "minimum", "maximum", "exclusiveMinimum", "exclusiveMaximum", "title", "description"}
)


def make_check(
    structure: MessageStructure, mode: ValidationMode, place: str
) -> Callable[[Message], None] | None:
    """Return a function that raises MessageError for a message of another structure.

    Args:
        structure: what the messages must match.
        mode: OFF gives None; SAMPLED checks the first and then every 128th message.
        place: the port, for the error's text.
    """
    if mode is ValidationMode.OFF:
        return None
    validator = _validator(structure)

    def check(message: Message) -> None:
        error = next(validator.iter_errors(message), None)
        if error is not None:
            path = ".".join(str(part) for part in error.absolute_path) or "the message"
            raise MessageError(f"{place}: {path}: {_shorten(_sentence(error))}")

    if mode is ValidationMode.ALWAYS:
        return check
    count = -1

    def check_sample(message: Message) -> None:
        nonlocal count
        count += 1
        if count % _SAMPLE_EVERY == 0:
            check(message)

    return check_sample


@lru_cache(maxsize=256)
def _validator(structure: MessageStructure) -> Validator:
    from jsonschema import Draft202012Validator, validators  # noqa: PLC0415 - slow import

    from uoarm._dataplane._pattern_keywords import PATTERN_KEYWORDS  # noqa: PLC0415 - imports it, too

    each_item = Draft202012Validator.VALIDATORS["items"]

    def items(
        validator: Draft202012Validator, schema: object, instance: Any, whole: Mapping[str, object]
    ) -> Iterator[ValidationError]:
        if isinstance(instance, list | tuple):
            if not (isinstance(schema, Mapping) and _are_in_range(validator, schema, instance)):
                yield from each_item(validator, schema, instance, whole)
        elif isinstance(schema, Mapping) and schema.keys() <= _RANGE_KEYWORDS:
            for extreme in _extremes(instance):
                yield from validator.descend(extreme, schema)
        else:
            yield from each_item(validator, schema, [_plain(item) for item in instance], whole)

    known = Draft202012Validator.TYPE_CHECKER

    def numbers(name: str) -> Callable[[object, object], bool]:
        return lambda _, value: known.is_type(_plain_number(value), name)

    checker = known.redefine_many(
        {
            "array": lambda _, value: isinstance(value, list | tuple) or _is_buffer(value),
            "integer": numbers("integer"),
            "number": numbers("number"),
            "boolean": numbers("boolean"),
        }
    )
    kind: type[Validator] = validators.extend(  # type: ignore[no-untyped-call]
        Draft202012Validator,
        {"items": items, **PATTERN_KEYWORDS},
        type_checker=checker,
    )
    return kind(structure.schema)


def _are_in_range(
    validator: Draft202012Validator, schema: Mapping[str, Any], items: Sequence[Any]
) -> bool:
    """Say whether a list is known at once to have only numbers of a range, judged by its extremes.

    A long list then costs no more than a buffer. What is not known so is left to the whole check,
    which also names the place: other values, NaN, which has no order, and 1.0 for an integer.
    """
    kinds = _KINDS.get(str(schema.get("type")), frozenset())
    if not schema.keys() <= _RANGE_KEYWORDS or not set(map(type, items)) <= kinds:
        return False
    try:
        if math.isnan(sum(items)):
            return False
    except OverflowError:
        return False
    extremes = _extremes(items)
    return not any(True for one in extremes for _ in validator.descend(one, schema))


def _extremes(buffer: Any) -> tuple[object, ...]:
    """Return the least and the greatest item: a range that holds both holds all between."""
    if not len(buffer):
        return ()
    if hasattr(buffer, "min"):
        return _plain(buffer.min()), _plain(buffer.max())
    return min(buffer), max(buffer)


def _is_buffer(value: object) -> bool:
    if isinstance(value, bytes | bytearray | memoryview):
        return True
    return hasattr(value, "__array_interface__") or hasattr(value, "typecode")


def _plain_number(value: object) -> object:
    """Return a scalar of numpy as the Python number that it stands for, anything else as it is."""
    return _plain(value) if getattr(value, "ndim", None) == 0 else value


def _plain(value: object) -> object:
    """Return a numpy scalar as the Python number that it stands for."""
    item = getattr(value, "item", None)
    return item() if callable(item) else value


def _sentence(error: ValidationError) -> str:
    """Return what is wrong; of missing fields the validator names one in each error."""
    if error.validator != "required" or not isinstance(error.instance, Mapping):
        return error.message
    required: Any = error.validator_value
    missing = [repr(name) for name in required if name not in error.instance]
    if len(missing) == 1:
        return f"the field {missing[0]} is missing"
    return f"the fields {', '.join(missing[:-1])} and {missing[-1]} are missing"


def _shorten(text: str, limit: int = 300) -> str:
    return text if len(text) <= limit else f"{text[:limit]}..."
