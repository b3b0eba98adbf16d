"""Model values to JSON-ready data and back; JSON within a budget, and values in an error's text.

Every number is finite and every text can be encoded, in both directions.
"""

from __future__ import annotations

import json
import math
import re
from array import array
from collections.abc import Hashable, Mapping, Sequence
from enum import Enum
from functools import cache, lru_cache
from itertools import accumulate
from typing import TYPE_CHECKING, Any, TypeVar, cast

import attrs
from attrs import field, frozen
from attrs.validators import ge

from uoarm._encodable import encodable, is_encodable
from uoarm.errors import ControlMessageError
from uoarm.model._message import MOST_OCTETS, MessageStructure, elements_of, message_octets
from uoarm.model._plan import Reason, Rejection

if TYPE_CHECKING:
    from cattrs import Converter


T = TypeVar("T")

_MAX_CAUSES = 50
_MAX_DEPTH = 200
_SHOWN = 5
_LEAVES = frozenset({int, float, bool, type(None)})
_CUT = Reason("its own causes lie too deep to be written down")


def to_json(value: Any) -> Any:
    """Return a model value as dicts, lists, strings, numbers, booleans and None.

    Rejections nested more than 50 deep end in a reason that says so; half of a surrogate pair is
    written as an escape; what is no model value, such as octets in a message, is left as it is.
    """
    return _plain(value, _MAX_CAUSES)


def from_json(data: Any, kind: type[T]) -> T:
    """Return the model value that `to_json` made data of.

    Raises:
        ValueError: the data is of another shape; the text names the first few fields.
    """
    import cattrs  # noqa: PLC0415 - slow import

    if _is_deeper(data, _MAX_DEPTH):
        raise ValueError(f"{kind.__name__}: nested more than {_MAX_DEPTH} levels deep")
    try:
        return _converter().structure(data, kind)
    except cattrs.BaseValidationError as error:
        reports = cattrs.transform_error(error, format_exception=_say)
        more = f"; and {len(reports) - _SHOWN} more" if len(reports) > _SHOWN else ""
        raise ValueError(f"{kind.__name__}: {'; '.join(reports[:_SHOWN])}{more}") from error
    except (AttributeError, TypeError, ValueError) as error:
        raise ValueError(f"{kind.__name__}: {_say(error, kind)}") from error


def _plain(value: Any, causes: int) -> Any:
    # Most values of an endpoint or a structure are these: the rest asks much longer.
    kind = type(value)
    if kind is str:
        return encodable(value)
    if kind in _LEAVES:
        return value
    if kind is dict:
        return {encodable(str(key)): _plain(item, causes) for key, item in value.items()}
    if isinstance(value, Enum):
        return value.value
    if isinstance(value, MessageStructure):
        return {"schema": _plain(value.schema, causes), "native_type": value.native_type}
    if isinstance(value, Rejection):
        causes -= 1
        if causes <= 0 and value.because_of:
            value = attrs.evolve(value, reasons=(*value.reasons, _CUT), because_of=())
    names = _field_names(cast(Hashable, kind))
    if names is not None:
        return {name: _plain(getattr(value, name), causes) for name in names}
    if isinstance(value, Mapping):
        return {encodable(str(key)): _plain(item, causes) for key, item in value.items()}
    if isinstance(value, list | tuple | set | frozenset):
        return [_plain(item, causes) for item in value]
    return value


@lru_cache(maxsize=256)
def _field_names(kind: type) -> tuple[str, ...] | None:
    """Return the names of an attrs class' fields, None for any other class."""
    return tuple(field.name for field in attrs.fields(kind)) if attrs.has(kind) else None


@cache
def _converter() -> Converter:
    """Take nothing for what it is not: no number for text, no text for a number."""
    import cattrs  # noqa: PLC0415 - slow import

    converter = cattrs.Converter(forbid_extra_keys=True)
    for kind in (str, int, bool):
        converter.register_structure_hook(kind, _exactly)
    converter.register_structure_hook(float, lambda data, _: float(_number(data)))
    converter.register_structure_hook_func(
        lambda kind: kind is object or kind is Any, lambda data, _: data
    )
    converter.register_structure_hook_func(
        lambda kind: kind == str | tuple[str, ...],
        lambda data, _: data if isinstance(data, str) else tuple(_texts(data)),
    )
    converter.register_structure_hook_func(
        lambda kind: getattr(kind, "__args__", ()) == (str, object),
        lambda data, _: dict(_mapping(data)),
    )
    converter.register_structure_hook(MessageStructure, lambda data, _: _structure(data))
    return converter


def _exactly(data: Any, kind: type) -> Any:
    if type(data) is not kind:
        raise TypeError(f"expected {kind.__name__}, got {type(data).__name__}")
    return data


def _number(data: Any) -> int | float:
    if isinstance(data, bool) or not isinstance(data, int | float):
        raise TypeError(f"expected a number, got {type(data).__name__}")
    return data


def _texts(data: Any) -> list[str]:
    if not isinstance(data, list) or not all(isinstance(item, str) for item in data):
        raise TypeError("expected a string or a list of strings")
    return data


def _say(error: BaseException, kind: type | None) -> str:
    """One error of the converter as a sentence."""
    from cattrs import ForbiddenExtraKeysError  # noqa: PLC0415 - slow import

    if isinstance(error, ForbiddenExtraKeysError):
        return f"unknown fields {', '.join(sorted(error.extra_fields))}"
    if isinstance(error, KeyError):
        return f"the field {error} is missing"
    if isinstance(error, AttributeError):
        return f"expected the fields of {getattr(kind, '__name__', 'an object')}"
    return str(error)


def _is_deeper(data: Any, limit: int) -> bool:
    waiting: list[tuple[Any, int]] = [(data, 1)]
    while waiting:
        value, depth = waiting.pop()
        if isinstance(value, Mapping | list):
            if depth > limit:
                return True
            inner = value.values() if isinstance(value, Mapping) else value
            waiting.extend((item, depth + 1) for item in inner)
    return False


def _mapping(data: Any) -> Mapping[str, object]:
    if not isinstance(data, Mapping):
        raise TypeError(f"expected a mapping, got {type(data).__name__}")
    return data


def _structure(data: Any) -> MessageStructure:
    parts = _mapping(data)
    if parts.keys() != {"schema", "native_type"}:
        raise ValueError(f"expected schema and native_type, got {', '.join(parts) or 'neither'}")
    schema, native_type = parts["schema"], parts["native_type"]
    if not isinstance(schema, Mapping | bool) or not isinstance(native_type, str):
        raise TypeError("expected schema to be a mapping or a boolean and native_type a string")
    return MessageStructure(schema, native_type=native_type)


_HALF = re.compile(r"\\u[dD][89a-fA-F]")
_MOST_DIGITS = 1000
_MAY_BE_INFINITE = re.compile(r"[eE]\+?\d{3}|\d{300}")


def octets_of(value: Any) -> bytes:
    """Return numbers as octets: of a buffer of wider ones not what is in memory.

    Raises:
        TypeError: it holds something else.
        ValueError: a number is no octet.
    """
    try:
        view = memoryview(value)
    except TypeError:
        return bytes(elements_of(value))
    if view.nbytes > MOST_OCTETS:  # it repeats its values, perhaps
        raise ValueError(f"it has {view.nbytes:,} octets: {MOST_OCTETS:,} are allowed")
    return bytes(view if view.format == "B" else value.tolist())


def read_json(text: str | bytes) -> Any:
    """Return the value that JSON text stands for.

    Whole numbers are exact, of a thousand digits at most. What other readers would take otherwise
    is refused: `NaN` and `Infinity`, which are no JSON; numbers that are infinite in 64 bits, such
    as 1e400; half of a surrogate pair, which no encoding can write; a key that is given twice in
    one object.

    Args:
        text: JSON; octets are UTF-8.

    Raises:
        ValueError: it is none; the text says what is wrong with it.
    """
    text = text if isinstance(text, str) else bytes(text).decode()
    # A function for each number would cost as much as all the rest.
    is_long = _MAY_BE_INFINITE.search(text) is not None
    try:
        value = json.loads(
            text,
            parse_constant=_refuse,
            parse_float=_float if is_long else None,
            parse_int=_integer if is_long else None,
            object_pairs_hook=_unique,
        )
    except RecursionError as error:
        raise ValueError("it is nested too deep") from error
    _refuse_halves(text, value)
    return value


def _refuse_halves(text: str, value: Any) -> None:
    if _HALF.search(text) and not is_encodable(json.dumps(value, ensure_ascii=False)):
        raise ValueError("half of a surrogate pair is no character")


def write_json(value: Any, *, indent: int | None = None) -> str:
    """Return a plain value as JSON text that every reader takes.

    What JSON has no number for is written as a text, as the server's messages have it: "NaN",
    "Infinity" and "-Infinity".

    Raises:
        ValueError: it has no form in JSON.
        TypeError: as that.
    """
    try:
        text = json.dumps(value, indent=indent, allow_nan=False)
    except ValueError:  # it is not finite, mostly
        text = json.dumps(finite(value), indent=indent, allow_nan=False)
    _refuse_halves(text, value)
    return text


def finite(value: Any) -> Any:
    """Return a copy of a plain value in which each number that is not finite is its name."""
    if isinstance(value, float):
        if math.isfinite(value):
            return value
        return "NaN" if math.isnan(value) else "Infinity" if value > 0 else "-Infinity"
    if isinstance(value, Mapping):
        return {finite(key): finite(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [finite(item) for item in value]
    return value


def _float(text: str) -> float:
    number = float(text)
    if math.isinf(number):
        raise ValueError(f"{text[:40]} is beyond what a number of 64 bits can hold")
    return number


def _integer(text: str) -> int:
    if len(text) > _MOST_DIGITS:
        raise ValueError(f"a whole number of {len(text):,} digits; {_MOST_DIGITS:,} are allowed")
    return int(text)


def _refuse(name: str) -> Any:
    raise ValueError(f"{name} is no number of JSON")


def _unique(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    found = dict(pairs)
    if len(found) < len(pairs):
        twice = next(key for at, (key, _) in enumerate(pairs) if key in dict(pairs[:at]))
        raise ValueError(f"the key {json.dumps(twice)} is given twice in one object")
    return found


@frozen
class Budget:
    """Bounds of one message, held by every decoder before it does the work.

    A decoder that counts a value twice or too generously refuses early, never late.

    Attributes:
        octets: of the message as it comes.
        elements: values and names of members, however deep they lie; octets and a typed array are
            one each.
        depth: levels of nested lists and objects.
        dimensions: of one array that says how many it has.
    """

    octets: int = field(default=16_777_216, validator=ge(1))
    elements: int = field(default=500_000, validator=ge(1))
    depth: int = field(default=64, validator=ge(1))
    dimensions: int = field(default=8, validator=ge(1))


class BudgetUse:
    """How much of a budget one message has used; one decoder's at a time.

    Each method raises ControlMessageError when the budget does not allow it.

    Attributes:
        budget: what it may cost.
        elements: counted so far; never fewer than there are.
    """

    def __init__(self, budget: Budget) -> None:
        self.budget = budget
        self.elements = 0

    def octets(self, count: int) -> None:
        """Check the length of the message as it comes."""
        if count > self.budget.octets:
            allowed = f"{self.budget.octets:,} are allowed"
            raise ControlMessageError(f"it has {count:,} bytes; {allowed}")

    def add(self, elements: int) -> None:
        """Count elements that are about to be made."""
        self.elements += elements
        if self.elements > self.budget.elements:
            raise ControlMessageError(f"it holds more than {self.budget.elements:,} values")

    def depth(self, levels: int) -> None:
        """Check how deep it is nested."""
        if levels > self.budget.depth:
            raise ControlMessageError(f"nested more than {self.budget.depth} levels deep")

    def dimensions(self, sizes: Sequence[Any], items: int) -> int:
        """Check the sizes that an array of several dimensions claims.

        Done so that no product is taken of numbers that nothing in the message stands for.

        Args:
            sizes: one for each dimension, the outermost first.
            items: how many values the array has.

        Returns:
            How many rows it has, in all of its dimensions.
        """
        if not 1 <= len(sizes) <= self.budget.dimensions:
            most = self.budget.dimensions
            raise ControlMessageError(f"{len(sizes):,} dimensions; 1 to {most} are allowed")
        if not items and sizes[0] == 0 and all(type(size) is int and size >= 0 for size in sizes):
            return 1
        count = 1
        rows = 0
        for size in sizes:
            rows += count
            if type(size) is not int or not 1 <= size <= items:
                raise ControlMessageError(
                    f"dimensions must be whole numbers from 1 to the {items:,} items that came"
                )
            count *= size
            if count > items:
                break
        if count != items:
            raise ControlMessageError(f"the dimensions do not hold the {items:,} items that came")
        return rows


_STRING = re.compile(r'"[^"]*(?:"|\Z)')
_BRACKETS = bytes.maketrans(b"[{]}", b"\x01\x01\xff\xff")
_OTHERS = bytes(index for index in range(256) if index not in b"[{]}")


def scan_json(text: str, spending: BudgetUse) -> None:
    """Refuse text that would cost more than its budget; spend what it costs otherwise.

    Linear in the length of the text, and without a pass over its strings where that is not needed:
    brackets, commas and colons within them count as if they stood outside, unless the budget would
    not allow it.

    Raises:
        ControlMessageError: it holds too much, or is nested too deep.
    """
    opened = text.count("[") + text.count("{")
    elements = 1 + opened + text.count(",") + text.count(":")
    left = spending.budget.elements - spending.elements
    if elements > left or opened > spending.budget.depth:
        outside = _without_strings(text, 2 * left)
        opened = outside.count("[") + outside.count("{")
        elements = 1 + opened + outside.count(",") + outside.count(":")
        spending.add(elements)
        if opened > spending.budget.depth:
            spending.depth(_depth(outside))
    else:
        spending.add(elements)


def count_names(text: str) -> int:
    """Return how many names of members JSON text has, those that are given twice included."""
    return _without_strings(text, len(text)).count(":")


def _without_strings(text: str, quotes: int) -> str:
    """Return what stands outside of strings; each string is a value or a name."""
    plain = text
    if "\\" in text:
        plain = text.replace("\\\\", "").replace('\\"', "")
    if plain.count('"') > quotes:
        raise ControlMessageError(f"it holds more than {quotes // 2:,} texts")
    return _STRING.sub("", plain)


def _depth(outside: str) -> int:
    steps = outside.encode("utf-8", "replace").translate(_BRACKETS, _OTHERS)
    return max(accumulate(array("b", steps)), default=0)


_SMALL = 4096


def show_value(value: Any, most: int = 60) -> str:
    """Return a value as Python would write it, cut after some characters.

    What takes more than 4 KiB of memory is shown by its kind and length: to write out a list of a
    million numbers for sixty characters of it would take longer than to decode it.
    """
    if isinstance(value, str | bytes):
        shown = repr(value[:most])
        return shown if len(value) <= most else f"{shown}..."
    if message_octets(value, most=_SMALL) > _SMALL:
        if isinstance(value, Mapping):
            return f"an object with {len(value):,} members"
        if isinstance(value, list | tuple):
            return f"a list of {len(value):,} values"
        return f"a large {type(value).__name__}"
    shown = repr(value)
    return shown if len(shown) <= most else f"{shown[:most]}..."
