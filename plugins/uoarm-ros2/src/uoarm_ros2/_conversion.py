"""Between native objects and messages: generated functions, one for each type and direction.

Reading is one expression over the native object's attributes, nested records written out in place.
Numeric sequences pass as the buffers they are, octets as a read-only view of theirs.

Writing checks the common case in line. A value that needs more goes to a checker; when that fails,
the message is walked once more, slowly, to name the field. A native sequence of numbers takes any
contiguous buffer of its own element type, a native fixed array takes a numpy array: both are
recognised in two comparisons and passed without a copy.
"""

from __future__ import annotations

import math
import operator
from array import array
from collections.abc import Callable, Iterable, Mapping
from contextlib import suppress
from functools import lru_cache, partial
from itertools import count, islice
from typing import Any

import numpy as np
import numpy.typing as npt

from uoarm.bridge import foreign, text_of
from uoarm.bridge import shown as in_words
from uoarm.cdr import FLOAT32_MAX
from uoarm.errors import MessageError
from uoarm.model import MOST_OCTETS, Message, elements_of
from uoarm_ros2._schema import integer_range
from uoarm_ros2._types import NUMBER_CODES, ArrayType, RecordType, ScalarType, Shape, StringType


class FunctionBuilder:
    """One function, line by line; `argument` is what stands in its parentheses.

    Nothing of a message ever enters the text: names of fields come in as quoted literals or as
    attributes of generated classes, everything else as a constant.
    """

    def __init__(self, name: str, argument: str) -> None:
        self._name = name
        self._lines = [f"def {name}({argument}):"]
        self._constants: dict[str, object] = {}

    def line(self, text: str, depth: int = 1) -> None:
        """Add a line, indented by `depth` levels."""
        self._lines.append("    " * depth + text)

    def constant(self, value: object) -> str:
        """Return a name by which the function's text may refer to a value."""
        name = f"c{len(self._constants)}"
        self._constants[name] = value
        return name

    def function(self) -> Callable[[Any], Any]:
        """Compile the text."""
        names: dict[str, Any] = dict(self._constants)
        exec("\n".join(self._lines), names)  # noqa: S102 - our own text, see the class
        made: Callable[[Any], Any] = names[self._name]
        return made


@lru_cache(maxsize=1024)
def reader(record: RecordType) -> Callable[[object], Message]:
    """Return the function that makes a message of a native object of this type."""
    source = FunctionBuilder("read", "native")
    fresh = count()
    source.line(f"return {_read_record(record, 'native', source, fresh)}")
    return source.function()


def _read_record(
    record: RecordType, holder: str, source: FunctionBuilder, fresh: count[int]
) -> str:
    members = (
        f"{field.name!r}: {_read_value(field.shape, f'{holder}.{field.attribute}', source, fresh)}"
        for field in record.fields
    )
    return "{" + ", ".join(members) + "}"


def _read_value(shape: Shape, place: str, source: FunctionBuilder, fresh: count[int]) -> str:
    if isinstance(shape, RecordType):
        holder = f"r{next(fresh)}"
        source.line(f"{holder} = {place}")
        return _read_record(shape, holder, source, fresh)
    if isinstance(shape, ArrayType):
        return _read_array(shape, place, source)
    if shape == ScalarType("byte"):
        return f"{place}[0]"
    return f"ord({place})" if shape == ScalarType("char") else place


def _read_array(listing: ArrayType, place: str, source: FunctionBuilder) -> str:
    if isinstance(listing.element, RecordType):
        return f"[{source.constant(reader(listing.element))}(element) for element in {place}]"
    if listing.element == ScalarType("byte"):
        return f"b''.join({place})"
    if listing.element == ScalarType("char"):
        return f"bytes(map(ord, {place}))"
    if listing.element == ScalarType("uint8"):
        return f"memoryview({place}).toreadonly()"
    return place


_SHOWN = 60


class UnfitValueError(Exception):
    """A value that its native field cannot hold; the text says what was expected."""


def shown(value: object) -> str:
    """Return a short, safe rendering of a value for an error's sentence."""
    return f"{type(value).__name__} {in_words(value, _SHOWN)}"


def checker(shape: ScalarType | StringType) -> Callable[[Message], object]:
    """Return the function that makes a value fit for a native scalar or text, or raises Misfit."""
    if isinstance(shape, StringType):
        return partial(_wide_text if shape.wide else _text, shape.bound)
    if shape.name == "bool":
        return _truth
    if shape.name == "char":
        return _character
    limits = integer_range(shape.name)
    if limits is None:
        return _float32 if shape.name == "float32" else _float64
    if shape.name == "byte":
        return _byte
    return partial(_integer, shape.name, *limits)


def _integer(name: str, least: int, greatest: int, value: Message) -> int:
    if isinstance(value, bool) or (isinstance(value, float) and not value.is_integer()):
        raise UnfitValueError(f"expected an integer ({name}), got {shown(value)}")
    try:
        number = int(value) if isinstance(value, float) else operator.index(value)
    except (TypeError, OverflowError) as error:
        raise UnfitValueError(f"expected an integer ({name}), got {shown(value)}") from error
    if not least <= number <= greatest:
        raise UnfitValueError(f"expected {least} to {greatest} ({name}), got {shown(value)}")
    return number


def _byte(value: Message) -> bytes:
    return bytes((_integer("byte", 0, 255, value),))


def _character(value: Message) -> str:
    # Of one above, ROS 2 would send another octet: the first of its UTF-8.
    return chr(_integer("char", 0, 127, value))


def _truth(value: Message) -> bool:
    if isinstance(value, bool):
        return value
    if type(value).__name__ in {"bool_", "bool"}:  # numpy's
        return bool(value)
    raise UnfitValueError(f"expected true or false, got {shown(value)}")


def _float64(value: Message) -> float:
    if isinstance(value, bool | str | bytes):
        raise UnfitValueError(f"expected a number, got {shown(value)}")
    try:
        return float(value)
    except (TypeError, ValueError, OverflowError) as error:
        raise UnfitValueError(f"expected a number (float64), got {shown(value)}") from error


def _float32(value: Message) -> float:
    number = _float64(value)
    if math.isfinite(number) and not -FLOAT32_MAX <= number <= FLOAT32_MAX:
        raise UnfitValueError(
            f"expected at most 3.4028234663852886e38 in size (float32), got {number!r}"
        )
    return number


def _text(bound: int | None, value: Message) -> str:
    return _encodable(value, "utf-8", 1, bound)


def _wide_text(bound: int | None, value: Message) -> str:
    return _encodable(value, "utf-16-le", 2, bound)


def _encodable(value: Message, encoding: str, unit: int, bound: int | None) -> str:
    if not isinstance(value, str):
        raise UnfitValueError(f"expected a string, got {shown(value)}")
    text: str = str.__str__(value)  # without the methods of a subclass
    if "\0" in text:
        raise UnfitValueError(
            "expected a string without the character NUL, at which ROS 2 would cut it"
        )
    try:
        length = len(text.encode(encoding)) // unit
    except UnicodeEncodeError as error:
        why = f"expected a string of whole characters, got {shown(value)} ({error.reason})"
        raise UnfitValueError(why) from error
    if bound is not None and length > bound:
        raise UnfitValueError(f"expected at most {bound} {encoding} code units, got {length}")
    return text


def fitting(text: str, kind: StringType) -> str:
    """Return as much as a string holds of a text that can be encoded, without NUL."""
    encoding, unit = ("utf-16-le", 2) if kind.wide else ("utf-8", 1)
    octets = text.replace("\0", "").encode(encoding)
    most = None if kind.bound is None else kind.bound * unit
    return octets[:most].decode(encoding, "ignore")


def taker(listing: ArrayType) -> Callable[[Message], object]:
    """Return the function that makes a value fit for a native array, or raises Misfit.

    The listing's elements are scalars or texts.
    """
    counted = _counter(listing)
    if isinstance(listing.element, ScalarType) and listing.element.name in NUMBER_CODES:
        return _buffers(listing.element.name, counted, fixed=listing.fixed)
    if isinstance(listing.element, ScalarType) and listing.element.name in {"byte", "char"}:
        octets = _buffers("uint8", counted, fixed=False)
        if listing.element.name == "char":
            return lambda value: _checked(memoryview(octets(value)), _character)  # type: ignore[arg-type]  # a buffer
        return lambda value: [bytes((number,)) for number in memoryview(octets(value))]  # type: ignore[arg-type]  # a buffer
    assert isinstance(listing.element, ScalarType | StringType)
    return _items(listing.element, counted)


def _counter(listing: ArrayType) -> Callable[[int], None]:
    size, fixed = listing.size, listing.fixed

    def counted(count: int) -> None:
        if size is not None and (count != size if fixed else count > size):
            raise UnfitValueError(
                f"expected {'' if fixed else 'at most '}{size} elements, got {count}"
            )

    return counted


def _items(
    element: ScalarType | StringType, counted: Callable[[int], None]
) -> Callable[[Message], object]:
    check = checker(element)

    def take(value: Message) -> object:
        if isinstance(value, str | bytes) or not hasattr(value, "__len__"):
            raise UnfitValueError(f"expected an array, got {shown(value)}")
        counted(len(value))
        return _checked(elements_of(value), check)

    return take


def _checked(values: Iterable[Message], check: Callable[[Message], Any]) -> list[Any]:
    items = []
    for index, item in enumerate(values):
        try:
            items.append(check(item))
        except UnfitValueError as error:
            raise UnfitValueError(f"[{index}] {error}") from error
    return items


def _buffers(
    name: str, counted: Callable[[int], None], *, fixed: bool
) -> Callable[[Message], object]:
    dtype, code = np.dtype(name), NUMBER_CODES[name]
    octets = name == "uint8"

    def take(value: Message) -> object:
        kind = type(value)
        if kind is np.ndarray:
            ready = value.dtype == dtype and value.ndim == 1 and value.flags.c_contiguous
        elif kind is array:
            ready = not fixed and value.typecode == code
        else:
            ready = kind is bytes and octets and not fixed
        if not ready:
            value = _converted(value, name, dtype, code)
        counted(len(value))
        return value

    return take


def _converted(value: Message, name: str, dtype: np.dtype[np.generic], code: str) -> Message:
    """Return a numpy array of the field's element type that holds the same numbers."""
    if isinstance(value, bytes | bytearray | memoryview | array):
        view = memoryview(value)
        if isinstance(value, bytes | bytearray) and name != "uint8":
            raise UnfitValueError(f"expected an array of {name}, got octets")
        if view.ndim != 1:
            raise UnfitValueError(f"expected an array of one dimension, got {view.ndim}")
        # memoryview(b"") of zero length has no address that numpy would take.
        given = np.asarray(view) if len(view) > 0 else np.empty(0, dtype)
    elif isinstance(value, np.ndarray):
        if value.ndim != 1:
            raise UnfitValueError(f"expected an array of one dimension, got {value.ndim}")
        given = value
    elif isinstance(value, list | tuple):
        return _listed(elements_of(value), name, dtype, code)
    else:
        raise UnfitValueError(f"expected an array of {name}, got {shown(value)}")
    return _fitted(given, name, dtype)


def _listed(
    value: list[Message] | tuple[Message, ...], name: str, dtype: np.dtype[np.generic], code: str
) -> npt.NDArray[np.generic]:
    if not value:
        return np.empty(0, dtype)
    kinds = set(map(type, value))
    if code in "fd" and kinds == {float}:
        return _fitted(np.array(value, np.float64), name, dtype)
    if code not in "fd" and kinds == {int}:
        with suppress(OverflowError):
            return np.frombuffer(array(code, value), dtype)
    return np.array(_checked(value, checker(ScalarType(name))), dtype)


def _fitted(
    given: npt.NDArray[np.generic], name: str, dtype: np.dtype[np.generic]
) -> npt.NDArray[np.generic]:
    if (octets := given.size * dtype.itemsize) > MOST_OCTETS:  # its values repeat, perhaps
        raise UnfitValueError(f"expected at most {MOST_OCTETS:,} octets, got {octets:,}")
    if given.dtype == dtype:
        return np.ascontiguousarray(given)
    limits = integer_range(name)
    wanted = "iu" if limits is not None else "iuf"
    if given.dtype.kind not in wanted:
        raise UnfitValueError(f"expected an array of {name}, got an array of {given.dtype}")
    least, greatest = limits or (-FLOAT32_MAX, FLOAT32_MAX)
    if given.size and (limits is not None or (name == "float32" and given.dtype.kind == "f")):
        _within(given, name, least, greatest)
    return np.ascontiguousarray(given, dtype)


def _within(given: npt.NDArray[np.generic], name: str, least: int, greatest: int) -> None:
    """Raise Misfit naming the first element out of range; NaN and infinities pass as floats."""
    numbers: npt.NDArray[Any] = given
    finite = numbers[np.isfinite(numbers)] if numbers.dtype.kind == "f" else numbers
    if not finite.size or (least <= finite.min().item() and finite.max().item() <= greatest):
        return
    for index, item in enumerate(numbers.tolist()):
        if math.isfinite(item) and not least <= item <= greatest:
            raise UnfitValueError(
                f"[{index}] expected {least} to {greatest} ({name}), got {item!r}"
            )


def writer(record: RecordType) -> Callable[[Message], object]:
    """Return the function that makes a native object of a message.

    It raises MessageError with the path of the field that is missing, unknown or unfit. Buffers
    are not copied: the native object is good until the message changes.
    """
    build = _builder(record)

    def write(message: Message) -> object:
        try:
            return foreign(build, message)
        except Exception as error:  # noqa: BLE001 - of a value's own methods, too
            raise _explained(record, message, error) from error.__cause__

    return write


@lru_cache(maxsize=1024)
def _builder(record: RecordType) -> Callable[[Message], object]:
    source = FunctionBuilder("build", "message")
    root = _build_record(record, "message", source, count())
    source.line(f"return {root}")
    return source.function()


def _build_record(
    record: RecordType, place: str, source: FunctionBuilder, fresh: count[int]
) -> str:
    number = next(fresh)
    native, given, value = f"n{number}", f"m{number}", f"v{number}"
    make = source.constant(record.native.__new__)
    source.line(f"{given} = {place}")
    source.line(f"if len({given}) != {len(record.fields)}: raise KeyError")
    source.line(f"{native} = {make}({source.constant(record.native)})")
    if "_check_fields" in record.slots:
        source.line(f"{native}._check_fields = False")
    for field in record.fields:
        target = f"{native}.{field.attribute}"
        item = f"{given}[{field.name!r}]"
        if isinstance(field.shape, RecordType):
            source.line(f"{target} = {_build_record(field.shape, item, source, fresh)}")
        elif isinstance(field.shape, ArrayType):
            source.line(f"{target} = {source.constant(_array_builder(field.shape))}({item})")
        else:
            source.line(f"{value} = {item}")
            source.line(f"if {_doubt(field.shape, value)}:")
            source.line(f"{value} = {source.constant(checker(field.shape))}({value})", depth=2)
            source.line(f"{target} = {value}")
    return native


def _doubt(shape: ScalarType | StringType, value: str) -> str:
    """Return the expression that is true unless the value is plainly fit."""
    if isinstance(shape, StringType):
        doubt = f"type({value}) is not str or not {value}.isascii() or '\\0' in {value}"
        return doubt if shape.bound is None else f"{doubt} or len({value}) > {shape.bound}"
    if shape.name == "bool":
        return f"type({value}) is not bool"
    if shape.name in {"byte", "char"}:
        return "True"
    limits = integer_range(shape.name)
    if limits is not None:
        return f"type({value}) is not int or not {limits[0]} <= {value} <= {limits[1]}"
    if shape.name == "float32":
        limit = float(FLOAT32_MAX)
        return f"type({value}) is not float or not {-limit!r} <= {value} <= {limit!r}"
    return f"type({value}) is not float"


def _array_builder(listing: ArrayType) -> Callable[[Message], object]:
    if not isinstance(listing.element, RecordType):
        return taker(listing)
    build, size, fixed = _builder(listing.element), listing.size, listing.fixed

    def take(value: Message) -> object:
        if not isinstance(value, list | tuple):
            raise UnfitValueError(f"expected an array of objects, got {shown(value)}")
        if size is not None and (len(value) != size if fixed else len(value) > size):
            bound = f"{'' if fixed else 'at most '}{size}"
            raise UnfitValueError(f"expected {bound} elements, got {len(value)}")
        return [build(item) for item in elements_of(value)]

    return take


def _explained(record: RecordType, message: Message, error: Exception) -> MessageError:
    """Return the error that names the field on which the generated function stumbled."""
    found = _fault(record, message, "")
    if found is None:
        return MessageError(f"{record.name}: {text_of(error)}")
    path, cause = found
    return MessageError(f"{record.name}: field {path or '(the whole message)'}: {cause}")


def _fault(shape: Shape, value: Message, path: str) -> tuple[str, str] | None:
    try:
        if isinstance(shape, RecordType):
            return foreign(_record_fault, shape, value, path)
        if not isinstance(shape, ArrayType):
            foreign(checker(shape), value)
        elif not isinstance(shape.element, RecordType):
            foreign(taker(shape), value)
        else:
            return foreign(_elements_fault, shape, shape.element, value, path)
    except UnfitValueError as misfit:
        place, _, cause = str(misfit).partition(" ")
        if place.startswith("["):
            return path + place, cause
        return path, str(misfit)
    except Exception as error:  # noqa: BLE001 - of a value's own methods
        return path, text_of(error)
    return None


def _record_fault(record: RecordType, value: Message, path: str) -> tuple[str, str] | None:
    if not isinstance(value, Mapping):
        return path, f"expected an object ({record.name}), got {shown(value)}"
    names = [field.name for field in record.fields]
    # No further: one that is no dict may have names without an end.
    looked_at = islice(value, len(names) + 1)
    if unknown := sorted(str(name) for name in looked_at if name not in names):
        place = f"{path}.{unknown[0]}".lstrip(".")
        return place, f"{record.name} has no such field, only {', '.join(names) or 'none'}"
    for field in record.fields:
        place = f"{path}.{field.name}".lstrip(".")
        if field.name not in value:
            return place, "missing; ROS 2 messages carry every field"
        found = _fault(field.shape, value[field.name], place)
        if found is not None:
            return found
    return None


def _elements_fault(
    listing: ArrayType, element: RecordType, value: Message, path: str
) -> tuple[str, str] | None:
    if isinstance(value, list | tuple):
        for index, item in enumerate(elements_of(value)):
            found = _fault(element, item, f"{path}[{index}]")
            if found is not None:
                return found
    _array_builder(listing)(value)
    return None
