"""Hints of numpy: which numbers in which shape, as a structure and as values.

numpy is never imported here: the module with such a hint has done it.
"""

from __future__ import annotations

import math
import operator
import sys
from collections.abc import Callable, Mapping
from functools import cache
from typing import Annotated, Any, Literal, NewType, TypeAlias, get_args, get_origin

from attrs import frozen

from uoarm._arguments import built_with_arguments
from uoarm._encodable import shown
from uoarm.errors import BridgeError, FailureReason


class HintError(BridgeError):
    """A type hint that has no message structure."""

    def __init__(self, text: str) -> None:
        super().__init__(text, FailureReason.BAD_ENDPOINT)


@built_with_arguments
@frozen
class Range:
    """Bounds of a number, both included; None where there is none."""

    minimum: float | int | None = None
    maximum: float | int | None = None


@frozen(init=False)
class Shape:
    """The lengths of an array's dimensions, None where any will do: `Shape(480, None, 3)`."""

    lengths: tuple[int | None, ...]

    def __init__(self, *lengths: int | None) -> None:
        self.__attrs_init__(lengths)


@frozen
class OctetsMark:
    """Marks `bytes` that may come as any buffer of octets, without a copy."""


UInt8: TypeAlias = Annotated[int, Range(0, 255)]
Octets: TypeAlias = Annotated[bytes, OctetsMark()]


def is_class(hint: Any) -> bool:
    """Say whether a hint is a class itself; `list[int]` says so on CPython 3.10, too."""
    return isinstance(hint, type) and get_origin(hint) is None


def unwrapped(hint: Any) -> Any:
    """Return what a NewType or a `type` alias, with its parameters or without, stands for."""
    while True:
        if isinstance(hint, NewType):
            hint = hint.__supertype__
        elif _is_alias(hint):
            hint = hint.__value__
        elif _is_alias(get_origin(hint)):
            hint = get_origin(hint).__value__[get_args(hint)]
        else:
            return hint


def _is_alias(hint: Any) -> bool:
    return type(hint).__name__ == "TypeAliasType"  # of typing or of typing_extensions


_HOW = (
    "write NDArray[numpy.float32], or another type of integers, floats or truths, and "
    "Annotated[NDArray[numpy.float32], Shape(480, 640)] where there are several dimensions"
)


def truth(value: Any) -> bool:
    """Return true or false; raises TypeError for all else."""
    if isinstance(value, bool):
        return value
    if type(value).__name__ in {"bool", "bool_"} and hasattr(value, "item"):  # numpy's
        return bool(value)
    raise TypeError(f"expected true or false, got {shown(value)}")


def integer(value: Any) -> int:
    """Return a whole number; raises TypeError for all else."""
    if value.__class__ is int:
        return value
    if isinstance(value, bool):
        raise TypeError(f"expected an integer, got {shown(value)}")
    if isinstance(value, float) and value.is_integer():  # one of JSON Schema
        return int(value)
    try:
        return operator.index(value)
    except TypeError:
        raise TypeError(f"expected an integer, got {shown(value)}") from None


def number(value: Any) -> float:
    """Return a number; raises TypeError for all else."""
    if value.__class__ is float or value.__class__ is int:
        return value
    if isinstance(value, bool | str | bytes) or not hasattr(value, "__float__"):
        raise TypeError(f"expected a number, got {shown(value)}")
    return float(value)


_OF_KINDS: Mapping[str, Callable[[Any], Any]] = {
    "b": truth, "i": integer, "u": integer, "f": number
}  # fmt: skip

# The kinds of numbers of which an array of a kind is made, as far as it can hold them. An empty
# array may have any: numpy makes floats of an empty list.
_TAKEN = {"b": "b", "i": "biu", "u": "biu", "f": "biuf"}


@frozen(eq=False)
class NumpyScalar:
    """A hint such as `numpy.float32`."""

    dtype: Any

    @property
    def schema(self) -> Mapping[str, object]:
        """The structure: a number within the type's range."""
        numpy = sys.modules["numpy"]
        if self.dtype.kind == "b":
            return {"type": "boolean"}
        if self.dtype.kind == "f":
            return {"type": "number"}
        limits = numpy.iinfo(self.dtype)
        return {"type": "integer", "minimum": int(limits.min), "maximum": int(limits.max)}

    def read(self, value: Any, _: Any = None) -> Any:
        """Make numpy's scalar of a number."""
        return self.dtype.type(value)

    def write(self, value: Any) -> Any:
        """Make a number of numpy's scalar, or of any that its type can hold."""
        given = _OF_KINDS[self.dtype.kind](value)
        with sys.modules["numpy"].errstate(over="ignore"):
            made = self.dtype.type(given).item()
        is_other = (
            made != given if self.dtype.kind in "iu" else math.isinf(made) != math.isinf(given)
        )
        if is_other:
            raise TypeError(f"expected a number of {self.dtype}, got {shown(value)}")
        return made


@frozen(eq=False)
class NumpyArray:
    """A hint such as `NDArray[numpy.float32]`, with or without a `Shape`."""

    item: NumpyScalar
    lengths: tuple[int | None, ...]

    @property
    def schema(self) -> Mapping[str, object]:
        """The structure: arrays in arrays."""
        schema = self.item.schema
        for length in reversed(self.lengths):
            schema = {"type": "array", "items": schema}
            if length is not None:
                schema |= {"minItems": length, "maxItems": length}
        if len(self.lengths) == 1 and self.item.dtype == "uint8":
            schema = {**schema, "x-octets": True}
        return schema

    def read(self, value: Any, _: Any = None) -> Any:
        """Make an array of lists, octets or a numeric buffer; without a copy where it can be."""
        numpy = sys.modules["numpy"]
        if isinstance(value, bytes | bytearray):  # as many numbers as octets, of whatever type
            value = numpy.frombuffer(value, "uint8")
        return self._checked(numpy.asarray(value, self.item.dtype))

    def write(self, value: Any) -> Any:
        """Return an array of the type and shape that were promised."""
        numpy = sys.modules["numpy"]
        if has_masked(value):
            raise TypeError(f"expected {self}, got one with masked items: fill them")
        given = numpy.asarray(value)
        if given.size and given.dtype.kind not in _TAKEN[self.item.dtype.kind]:
            raise TypeError(f"expected {self}, got numbers of {given.dtype}")
        with numpy.errstate(over="ignore"):
            cast = given.astype(self.item.dtype, copy=False)
        if cast is not given:
            compare = numpy.array_equal if cast.dtype.kind in "iu" else _are_held
            if not compare(cast, given):
                raise TypeError(f"expected {self}, got numbers that it cannot hold")
        return self._checked(cast)

    def _checked(self, array: Any) -> Any:
        if not array.size:  # a list says no more of it than how many rows it has
            inner = self.lengths[array.ndim :]
            array = array.reshape(array.shape + tuple(length or 0 for length in inner))
        text = f"expected {self}, got one of the shape {_shape(array.shape)}"
        if array.ndim != len(self.lengths):
            raise ValueError(f"{text}, which a hint says as Shape{_shape(array.shape)}")
        pairs = zip(self.lengths, array.shape, strict=True)
        if any(wanted not in {None, found} for wanted, found in pairs):
            raise ValueError(text)
        return array

    def __str__(self) -> str:
        return f"an array of {self.item.dtype} of the shape {_shape(self.lengths)}"


def has_masked(array: Any) -> bool:
    """Say whether items of an array of numpy are masked: what is behind a mask is no value."""
    mask = getattr(array, "mask", None)
    return mask is not None and hasattr(mask, "any") and bool(mask.any())


def _are_held(cast: Any, given: Any) -> bool:
    """Say whether no number became infinite as an array was cast."""
    numpy = sys.modules["numpy"]
    beyond = numpy.isinf(cast)
    return not beyond.any() or bool(numpy.isinf(given[beyond]).all())


def _shape(lengths: tuple[int | None, ...]) -> str:
    return f"({', '.join('any' if length is None else str(length) for length in lengths)})"


def _numpy(name: str) -> Any:
    """Return a class of numpy; None where it was not imported.

    Nor has one who is at it: another thread may be in the middle, and then no hint is of numpy yet.
    """
    return getattr(sys.modules.get("numpy"), name, None)


def scalar_of(hint: Any) -> NumpyScalar | None:
    """Return what a hint of one of numpy's numbers says; None for any other hint."""
    generic = _numpy("generic")
    if generic is None or not is_class(hint) or not issubclass(hint, generic):
        return None
    if hint not in _concrete():
        raise HintError(f"the type hint {hint!r} has no message structure: {_HOW}")
    return NumpyScalar(sys.modules["numpy"].dtype(hint))


def array_of(hint: Any) -> NumpyArray | None:
    """Return what a hint of an array says; None for any other hint.

    Raises:
        HintError: it does not say which numbers, or they make no message.
    """
    ndarray = _numpy("ndarray")
    if ndarray is None:
        return None
    notes: tuple[Any, ...] = ()
    if get_origin(hint) is Annotated:
        hint, *notes = get_args(hint)  # type: ignore[assignment] # a list of notes
    hint = unwrapped(hint)  # `NDArray` is a `type` alias to newer versions of numpy
    if hint is not ndarray and get_origin(hint) is not ndarray:
        return None
    shape, dtype = get_args(hint) or (None, None)
    inner = get_args(dtype)
    item = scalar_of(inner[0]) if inner else None
    if item is None:
        raise HintError(f"the type hint {hint!r} does not say which numbers: {_HOW}")
    stated = next((note.lengths for note in notes if isinstance(note, Shape)), None)
    return NumpyArray(item, _lengths(shape) if stated is None else stated)


def _lengths(shape: Any) -> tuple[int | None, ...]:
    """Return the lengths of `tuple[int, int]`; any that is not so exact is one dimension."""
    parts = get_args(shape)
    if not parts or Ellipsis in parts or get_origin(shape) is not tuple:
        return (None,)
    return tuple(get_args(part)[0] if get_origin(part) is Literal else None for part in parts)


@cache
def _concrete() -> frozenset[type]:
    numpy = sys.modules["numpy"]
    return frozenset(numpy.dtype(code).type for code in "?bBhHiIlLqQefd")
