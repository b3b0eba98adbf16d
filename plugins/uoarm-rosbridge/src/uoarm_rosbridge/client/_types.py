"""Types as rosapi describes them: message structures, and values as rosbridge has them and back.

In JSON octets are base64 and what is no finite number is null; in CBOR octets are octets and arrays
of numbers are typed. What is published is JSON in either case.
"""

from __future__ import annotations

import binascii
import math
import operator
from array import array
from collections.abc import Callable, Mapping, Sequence
from functools import lru_cache, partial
from itertools import islice
from types import TracebackType
from typing import Any, TypeAlias, cast

import numpy as np
import pybase64
from attrs import field, frozen

from uoarm.bridge import foreign, shown, text_of
from uoarm.cdr import BASIC, FLOAT32_MAX, number_schema
from uoarm.errors import BridgeError, FailureReason, MessageError
from uoarm.model import (
    MOST_OCTETS,
    Message,
    MessageStructure,
    array_as_lists,
    closed_object,
    elements_of,
    plain_copy,
)

_MOST_NUMBER_OCTETS = 2**27
_OF_EACH_ROS = {"bool", "byte", "char"}  # no numbers, or other ones in ROS 1 than in ROS 2
FORMATS = {kind: code for kind, code in BASIC.items() if code and kind not in _OF_EACH_ROS}
# As the Python of ROS 2 calls them, and names of old, of which each ROS has another idea.
_OTHER_NAMES = {"boolean": "bool", "float": "float32", "double": "float64"}
_NAMES_OF_ONE = {"byte": "int8", "char": "uint8"}
_NAMES_OF_TWO = {"byte": "uint8", "octet": "uint8", "char": "uint8"}
_FLOATS = ("float32", "float64")
_MOST_TYPES, _MOST_FIELDS, _DEEPEST = 500, 20_000, 32
_SHOWN = 60


@frozen
class Primitive:
    """A truth value, a number or a text.

    Attributes:
        kind: of the value.
        is_wide: whether a text is serialised in characters of 16 bits.
        is_byte: whether it is a `byte` of ROS 2, which in Python is no number.
    """

    kind: str
    is_wide: bool = False
    is_byte: bool = field(default=False, eq=False)


@frozen
class ArrayOf:
    """Elements of one type: exactly `size`, or any number when `size` is None."""

    element: RosShape
    size: int | None = None


@frozen(eq=False)
class RosType:
    """A message type, with what it holds.

    Attributes:
        name: in full.
        is_real: whether the name is that of a type of ROS, or was made up for a function.
    """

    name: str
    fields: Mapping[str, RosShape]
    constants: Mapping[str, object] = field(factory=dict)
    is_real: bool = True

    @property
    def is_of_ros_1(self) -> bool:
        """Whether it is serialised as ROS 1 does: only ROS 2 says which kind a type is."""
        return self.is_real and not _has_kind(self.name)


RosShape: TypeAlias = "Primitive | ArrayOf | RosType"
_Read = Callable[[Any], Any]

_TIMES = {
    "time": RosType("time", {"secs": Primitive("uint32"), "nsecs": Primitive("uint32")}),
    "duration": RosType("duration", {"secs": Primitive("int32"), "nsecs": Primitive("int32")}),
}


def read_types(name: str, typedefs: object) -> RosType:
    """Return a type of what rosapi's details of it say.

    Args:
        name: of the outermost type, as ROS 1 or ROS 2 spells it.
        typedefs: the list that was answered.

    Raises:
        BridgeError: they cannot be used.
    """
    return _Definitions(name, typedefs).outermost()


class _Definitions:
    """The definitions of one answer, each read once."""

    def __init__(self, name: str, typedefs: object) -> None:
        self._name = name
        self._is_two = _has_kind(name)
        if not isinstance(typedefs, list) or not 0 < len(typedefs) <= _MOST_TYPES:
            raise self._wrong("no list of definitions")
        self._all: dict[str, Mapping[str, Any]] = {}
        for typedef in typedefs:
            if not isinstance(typedef, dict) or not isinstance(typedef.get("type"), str):
                raise self._wrong("a definition without a type")
            self._all.setdefault(typedef["type"], typedef)
        self._first: str = typedefs[0]["type"]
        self._made: dict[str, RosType] = {}
        self._count = 0

    def outermost(self) -> RosType:
        return self._record(self._first, self._name, ())

    def _record(self, key: str, name: str, path: tuple[str, ...]) -> RosType:
        if key in self._made:
            return self._made[key]
        typedef = self._all.get(key)
        if typedef is None or key in path or len(path) > _DEEPEST:
            raise self._wrong(f"the type {key[:100]!r} is not defined, or holds itself")
        columns = [typedef.get(part) for part in ("fieldnames", "fieldtypes", "fieldarraylen")]
        if not all(isinstance(column, list) for column in columns):
            raise self._wrong(f"the fields of {key[:100]!r} are no lists")
        names, kinds, lengths = columns
        if not len(names) == len(kinds) == len(lengths):  # type: ignore[arg-type]  # lists, see above
            raise self._wrong(f"the lists of the fields of {key[:100]!r} differ in length")
        fields: dict[str, RosShape] = {}
        for own, kind, length in zip(names, kinds, lengths, strict=True):  # type: ignore[arg-type]
            self._count += 1
            if self._count > _MOST_FIELDS or not isinstance(own, str) or not isinstance(kind, str):
                raise self._wrong(f"the fields of {key[:100]!r}")
            fields[own.removeprefix("_")] = self._shape(kind, length, (*path, key))
        is_real = "/" in name and not name.startswith("uoarm/")
        self._made[key] = RosType(name, fields, _constants(typedef), is_real)
        return self._made[key]

    def _shape(self, kind: str, length: object, path: tuple[str, ...]) -> RosShape:
        plain = kind.partition("[")[0].partition("<")[0]
        names = {**_OTHER_NAMES, **(_NAMES_OF_TWO if self._is_two else _NAMES_OF_ONE)}
        is_byte = self._is_two and plain in {"byte", "octet"}
        plain = names.get(plain, plain)
        shape: RosShape
        if plain in FORMATS or plain in {"bool", "string"}:
            shape = Primitive(plain, is_byte=is_byte)
        elif plain == "wstring":
            shape = Primitive("string", is_wide=True)
        elif not self._is_two and plain in _TIMES:
            shape = _TIMES[plain]
        else:
            shape = self._record(plain, self._full(plain), path)
        if not isinstance(length, int) or length < 0:
            return shape
        return ArrayOf(shape, length or None)

    def _full(self, name: str) -> str:
        package, _, own = name.partition("/")
        is_short = self._is_two and package != "uoarm" and own and "/" not in own
        return f"{package}/msg/{own}" if is_short else name

    def _wrong(self, why: str) -> BridgeError:
        text = f"rosapi describes {self._name} as nothing that can be used: {why}"
        return BridgeError(text, FailureReason.BAD_MESSAGE)


def _has_kind(name: str) -> bool:
    """Say whether a name is one of ROS 2, which alone says of what kind a type is."""
    return any(f"/{kind}/" in name for kind in ("msg", "srv", "action"))


def _constants(typedef: Mapping[str, Any]) -> dict[str, object]:
    names, values = typedef.get("constnames"), typedef.get("constvalues")
    if not isinstance(names, list) or not isinstance(values, list) or len(names) != len(values):
        return {}
    # What the Python of ROS 2 has beside constants is listed, too: fields, and the types of fields
    # with their addresses in memory.
    no_constants = {"SLOT_TYPES", *(name.removeprefix("_") for name in typedef["fieldnames"])}
    return {
        name: _constant(value)
        for name, value in zip(names, values, strict=True)
        if isinstance(name, str) and isinstance(value, str) and name not in no_constants
    }


def _constant(text: str) -> object:
    if text in {"True", "False"}:
        return text == "True"
    for kind in (int, float):
        try:
            return kind(text)
        except ValueError:
            continue
    return text


@lru_cache(maxsize=1024)
def structure_of(made: RosType) -> MessageStructure:
    """Return the structure of a type: a closed object with every field required."""
    return MessageStructure(_schema(made), native_type=made.name)


def _schema(shape: RosShape) -> dict[str, Any]:
    if isinstance(shape, RosType):
        properties = {name: _schema(inner) for name, inner in shape.fields.items()}
        schema = closed_object(properties, x_native_type=shape.name)
        if shape.is_real:
            schema["x-type"] = shape.name
        return {**schema, "x-constants": dict(shape.constants)} if shape.constants else schema
    if isinstance(shape, ArrayOf):
        schema = {"type": "array", "items": _schema(shape.element)}
        if shape.size is not None:
            schema["minItems"] = schema["maxItems"] = shape.size
        return {**schema, "x-octets": True} if _is_octets(shape) else schema
    if shape.kind == "string":
        return {"type": "string", **({"x-native-type": "wstring"} if shape.is_wide else {})}
    return number_schema(shape.kind, BASIC[shape.kind])


def compression_for(made: RosType, wanted: str) -> str:
    """Return how a type's messages can come where they are wanted so.

    Of a type without a form as CBOR rosbridge_suite sends nothing, and does not say so:
    https://github.com/RobotWebTools/rosbridge_suite/issues/864
    """
    return "none" if wanted == "cbor" and not _has_cbor(made) else wanted


def _has_cbor(shape: RosShape) -> bool:
    if isinstance(shape, RosType):
        return all(map(_has_cbor, shape.fields.values()))
    if isinstance(shape, Primitive):
        return not (shape.is_byte or shape.is_wide)
    element = shape.element
    if isinstance(element, RosType):
        return element not in _TIMES.values() and _has_cbor(element)
    return shape.size is None and _has_cbor(element)


def _is_octets(shape: ArrayOf) -> bool:
    return shape.element == Primitive("uint8")


@lru_cache(maxsize=16)
def _range(kind: str) -> tuple[int, int]:
    schema = number_schema(kind, FORMATS[kind])
    return schema["minimum"], schema["maximum"]


def _misfit(path: str, expected: str, value: object) -> MessageError:
    got = f"{type(value).__name__} {shown(value, _SHOWN)}"
    return MessageError(f"{path}: expected {expected}, got {got}")


def _out_of_range(path: str, kind: str, value: object) -> MessageError:
    least, most = _range(kind)
    return _misfit(path, f"{least} to {most} ({kind})", value)


@lru_cache(maxsize=1024)
def reader(made: RosType) -> Callable[[Any], Message]:
    """Return the function that makes a message of what came; it raises MessageError."""
    return _reading(made, made.name)


def _reading(shape: RosShape, path: str) -> _Read:
    if isinstance(shape, RosType):
        parts = [(name, _reading(part, f"{path}.{name}")) for name, part in shape.fields.items()]

        def read_record(value: Any) -> Any:
            if not isinstance(value, dict) or len(value) != len(parts):
                members = ", ".join(name for name, _ in parts) or "no member"
                raise _misfit(path, f"an object of {members}", value)
            try:
                return {name: read(value[name]) for name, read in parts}
            except KeyError as error:
                raise _misfit(path, f"a member {error.args[0]!r}", value) from None

        return read_record
    if isinstance(shape, ArrayOf):
        return _reading_array(shape, path)
    return _reading_primitive(shape.kind, path)


def _reading_primitive(kind: str, path: str) -> _Read:
    if kind == "string":
        return _exactly(str, "a text", path)
    if kind == "bool":
        return _exactly(bool, "true or false", path)
    if kind in _FLOATS:

        def read_float(value: Any) -> float:
            if type(value) is float:
                return value
            if value is None:  # JSON has no NaN and no infinity: which of them it was is lost
                return math.nan
            if type(value) is int:
                return float(value)
            raise _misfit(path, f"a number ({kind})", value)

        return read_float
    least, most = _range(kind)

    def read_integer(value: Any) -> int:
        if isinstance(value, str | bytes) and kind == "uint8":  # an octet of ROS 2
            octets = _octets(path, value)
            value = octets[0] if len(octets) == 1 else value
        if type(value) is not int or not least <= value <= most:
            raise _out_of_range(path, kind, value)
        return value

    return read_integer


def _exactly(kind: type, expected: str, path: str) -> _Read:
    def read(value: Any) -> Any:
        if type(value) is not kind:
            raise _misfit(path, expected, value)
        return value

    return read


def _reading_array(shape: ArrayOf, path: str) -> _Read:
    size, element = shape.size, shape.element
    if _is_octets(shape):

        def read_octets(value: Any) -> bytes:
            octets = _octets(path, value)
            _require_size(path, size, octets)
            return octets

        return read_octets
    if isinstance(element, Primitive) and element.kind in FORMATS:
        kind, dtype = element.kind, np.dtype(f"<{FORMATS[element.kind]}")

        def read_numbers(value: Any) -> Any:
            _require_size(path, size, value)
            return _numbers(path, kind, dtype, value)

        return read_numbers
    read = _reading(element, f"{path}[]")

    def read_list(value: Any) -> Any:
        if not isinstance(value, list):
            raise _misfit(path, "an array", value)
        _require_size(path, size, value)
        return [read(item) for item in value]

    return read_list


def _octets(path: str, value: Any) -> bytes:
    try:
        if isinstance(value, str):
            return pybase64.b64decode(value, validate=True)
        if isinstance(value, bytes | bytearray | memoryview | list):
            return bytes(value)
    except (binascii.Error, ValueError, TypeError):
        pass
    raise _misfit(path, "octets", value)


def _require_size(path: str, size: int | None, value: Any) -> None:
    if size is not None and (not hasattr(value, "__len__") or len(value) != size):
        raise _misfit(path, f"{size} elements", value)


def _numbers(path: str, kind: str, dtype: np.dtype[Any], value: Any) -> np.ndarray[Any, Any]:
    """Return an array of numbers of what came as a list, or as a typed array."""
    if not isinstance(value, list | array | np.ndarray):
        raise _misfit(path, f"an array of {kind}", value)
    try:
        if not isinstance(value, list):
            given = np.asarray(value)
        elif dtype.kind == "f":
            given = np.asarray(value, np.float64)
        else:  # numpy makes floats of large integers beside small ones
            given = np.asarray(array(FORMATS[kind], value))
    except (TypeError, ValueError):
        raise _misfit(path, f"an array of {kind}", value) from None
    except OverflowError:
        raise _out_of_range(path, kind, value) from None
    is_number = given.ndim == 1 and given.dtype.kind in ("iuf" if dtype.kind == "f" else "iu")
    if not is_number:
        raise _misfit(path, f"an array of {kind}", value)
    if dtype.kind != "f" and given.size and given.dtype != dtype:
        least, most = _range(kind)
        if not least <= given.min().item() <= given.max().item() <= most:
            raise _out_of_range(path, kind, value)
    with np.errstate(over="ignore"):
        return np.asarray(given, dtype)


@lru_cache(maxsize=1024)
def writer(made: RosType | None) -> Callable[[Message], Any]:
    """Return the function that makes of a message what is written as JSON.

    It raises MessageError where a message does not fit, or holds what JSON has no form for.

    Args:
        made: its type; None: the server describes none, and anything that JSON has a form for
            passes, as the function's own structures were checked.
    """
    write = _writing(made, "$") if made else partial(plain_copy, leaf=array_as_lists)

    def write_fitting(message: Message) -> Any:
        try:
            return foreign(write, message)
        except MessageError:
            raise
        except Exception as error:  # noqa: BLE001 - of a value's own methods, say
            raised = error.__cause__ or error
            raise MessageError(f"{_place_of(raised.__traceback__)}: {text_of(error)}") from raised

    return write_fitting


def _place_of(trace: TracebackType | None) -> str:
    """Return the path of the value at which the writing ended."""
    place = "$"
    while trace is not None:
        if trace.tb_frame.f_code.co_filename == __file__:
            place = trace.tb_frame.f_locals.get("path", place)
        trace = trace.tb_next
    return place


def _writing(shape: RosShape, path: str) -> _Read:
    if isinstance(shape, RosType):
        parts = [(name, _writing(part, f"{path}.{name}")) for name, part in shape.fields.items()]

        def write_record(value: Any) -> Any:
            if not isinstance(value, Mapping):
                raise _misfit(path, "an object", value)
            if missing := [name for name, _ in parts if name not in value]:
                raise MessageError(f"{path}: the member {missing[0]!r} is missing")
            if len(value) != len(parts):
                # No further: one that is no dict may have names without an end.
                for name in islice(value, len(parts) + 1):
                    if name not in shape.fields:
                        raise MessageError(f"{path}: there is no member {str(name)[:80]!r}")
            return {name: write(value[name]) for name, write in parts}

        return write_record
    if isinstance(shape, ArrayOf):
        return _writing_array(shape, path)
    return _writing_primitive(shape.kind, path)


def _writing_primitive(kind: str, path: str) -> _Read:
    if kind == "string":
        return partial(_text, path)
    if kind == "bool":
        return partial(_truth, path)
    return partial(_float, kind, path) if kind in _FLOATS else partial(_integer, kind, path)


def _text(path: str, value: Any) -> str:
    if not isinstance(value, str):
        raise _misfit(path, "a text", value)
    text = str.__str__(value)  # without the methods of a subclass
    try:
        text.encode()
    except UnicodeEncodeError:
        raise _misfit(path, "a text of whole characters", value) from None
    return text


def _truth(path: str, value: Any) -> bool:
    if not isinstance(value, bool | np.bool_):
        raise _misfit(path, "true or false", value)
    return bool(value)


def _float(kind: str, path: str, value: Any) -> float:
    if isinstance(value, bool | str | bytes):
        raise _misfit(path, f"a number ({kind})", value)
    try:
        number = float(value)
    except (TypeError, ValueError, OverflowError):
        raise _misfit(path, f"a number ({kind})", value) from None
    if not math.isfinite(number):
        raise _misfit(path, "a finite number, as JSON has no other", value)
    if kind == "float32" and abs(number) > FLOAT32_MAX:
        raise _misfit(path, "at most 3.4028234663852886e38 in size (float32)", value)
    return number


def _integer(kind: str, path: str, value: Any) -> int:
    if isinstance(value, bool) or (isinstance(value, float) and not value.is_integer()):
        raise _misfit(path, f"an integer ({kind})", value)
    try:
        number = int(value) if isinstance(value, float) else operator.index(value)
    except (TypeError, OverflowError):
        raise _misfit(path, f"an integer ({kind})", value) from None
    least, most = _range(kind)
    if not least <= number <= most:
        raise _out_of_range(path, kind, value)
    return number


def _writing_array(shape: ArrayOf, path: str) -> _Read:
    size, is_octets = shape.size, _is_octets(shape)
    write = _writing(shape.element, f"{path}[]")
    wants_numbers = isinstance(shape.element, Primitive) and shape.element.kind in FORMATS

    def write_array(value: Any) -> Any:
        if is_octets and isinstance(value, bytes | bytearray | memoryview):
            _require_size(path, size, value)
            if memoryview(value).nbytes > MOST_OCTETS:  # they repeat, perhaps
                raise _misfit(path, f"at most {MOST_OCTETS:,} octets", value)
            return pybase64.b64encode(value).decode()
        if isinstance(value, np.ndarray | array | memoryview) and wants_numbers:
            if memoryview(cast(Any, value)).nbytes > _MOST_NUMBER_OCTETS:  # they repeat, perhaps
                raise _misfit(path, f"at most {_MOST_NUMBER_OCTETS:,} octets of numbers", value)
            value = value.tolist()
        if not isinstance(value, Sequence) or isinstance(value, str | bytes | bytearray):
            raise _misfit(path, "an array", value)
        _require_size(path, size, value)
        items = [write(item) for item in elements_of(value)]
        return pybase64.b64encode(bytes(items)).decode() if is_octets else items

    return write_array
