"""Native types, found by name and read once from their classes, and the structures of messages.

The hash by which types are distinguished (RIHS01) is the SHA-256 of their description as JSON,
without defaults, as `rosidl` writes it from Iron on. Types are numbered as in
`type_description_interfaces/msg/FieldType`. Structures are JSON Schema with exact ranges, native
facts, and the units that REP-103 and the comments of the message definitions state.
"""

from __future__ import annotations

import hashlib
import importlib
import json
import os
import re
import sys
from collections.abc import Mapping
from functools import lru_cache
from pathlib import Path
from typing import Any, TypeAlias

from attrs import field, frozen

from uoarm.bridge import Description, did_you_mean, text_of
from uoarm.cdr import BASIC, number_schema, ros_unit
from uoarm.errors import BridgeError, FailureReason
from uoarm.model import MessageStructure, closed_object

MESSAGE, SERVICE, ACTION = "msg", "srv", "action"
_INDEX = "share/ament_index/resource_index/rosidl_interfaces"
_NAME = re.compile(r"[a-z][a-z0-9_]*/(msg|srv|action)/[A-Z][A-Za-z0-9_]*")


def type_mistake(name: str) -> str:
    """Return what is wrong with the spelling of a type's name, or ""."""
    if _NAME.fullmatch(name):
        return ""
    package, _, rest = name.partition("/")
    meant = [f"{package}/{kind}/{rest}" for kind in (MESSAGE, SERVICE, ACTION)]
    hint = ""
    if _NAME.fullmatch(meant[0]):
        there = installed()
        meant = [kind for kind in meant if kind in there] or meant
        hint = f"; did you mean {meant[0]!r}?"
    spelt = "package/msg/Name, package/srv/Name or package/action/Name"
    return f"type {name!r} is not spelt {spelt}{hint}"


def installed() -> list[str]:
    """Return the types whose definitions are installed, as the index of ROS 2 lists them."""
    prefixes = [*os.environ.get("AMENT_PREFIX_PATH", "").split(os.pathsep), sys.prefix]
    found = set()
    for prefix in filter(None, prefixes):
        folder = Path(prefix) / _INDEX
        for package in folder.iterdir() if folder.is_dir() else ():
            lines = package.read_text().splitlines()
            found |= {f"{package.name}/{line.rpartition('.')[0]}" for line in lines}
    return sorted(name for name in found if _NAME.fullmatch(name))


def kind_of(name: str) -> str:
    """Return `msg`, `srv` or `action` of a well spelt type."""
    return name.split("/")[1]


def of_type(name: str) -> str:
    """Return what the errors about a type begin with."""
    return f"type {name!r}: "


def import_type(name: str) -> type:
    """Return the generated class of a type such as `sensor_msgs/msg/Image`.

    Raises:
        BridgeError: the package is not installed, cannot be imported, or has no such type; or the
            name is none of ROS, as that of a type on bare DDS.
    """
    if mistake := type_mistake(name):
        raise BridgeError(mistake, FailureReason.NOT_FOUND)
    package, kind, type_name = name.split("/")
    try:
        module = importlib.import_module(f"{package}.{kind}")
    except ImportError as error:
        missing = f"{package}.{kind}" if error.name is None else error.name
        text = (
            f"{of_type(name)}Python package {missing!r} cannot be imported ({error}); install "
            f"ros-<distribution>-{package.replace('_', '-')} (as ros-jazzy-...), have `uoarm ros2 "
            f"build-interfaces` build it of its definitions, or source the workspace that "
            f"provides {package!r}"
        )
        raise BridgeError(text, FailureReason.NOT_FOUND) from error
    except Exception as error:  # what was generated of a field that is called `from`, say
        text = f"{of_type(name)}Python package '{package}.{kind}' is broken: {text_of(error)}"
        raise BridgeError(text, FailureReason.NOT_FOUND) from error
    found = getattr(module, type_name, None)
    if not isinstance(found, type):
        known = sorted(variable for variable in vars(module) if variable[:1].isupper())
        meant = did_you_mean(type_name, known) or f", only {known}"
        text = f"{of_type(name)}package {package!r} has no {kind} {type_name!r}{meant}"
        raise BridgeError(text, FailureReason.NOT_FOUND)
    return found


_MAX_DEPTH = 32
_OCTETS = frozenset({"byte", "char", "int8", "uint8"})
_SCALARS = {
    "boolean": "bool",
    "octet": "byte",
    "char": "char",
    "float": "float32",
    "double": "float64",
    **{f"{sign}int{bits}": f"{sign}int{bits}" for sign in ("", "u") for bits in (8, 16, 32, 64)},
}


@frozen
class ScalarType:
    """A truth value, a byte, an integer or a float; `name` as in a ROS message file.

    A `char` is that of an `.idl` file, a text in Python; that of a message file is an `uint8`.
    """

    name: str


@frozen
class StringType:
    """A string. `bound`: the most code units (bytes of UTF-8, or of UTF-16 when `wide`)."""

    wide: bool = False
    bound: int | None = None


@frozen
class ArrayType:
    """Many elements: exactly `size`, at most `size`, or any number when `size` is None."""

    element: ScalarType | StringType | RecordType
    size: int | None = None
    fixed: bool = False


@frozen
class RecordField:
    """One named member of a record."""

    name: str
    shape: Shape
    default: object = field(default=None, hash=False)


@frozen(eq=False)
class RecordType:
    """A message, request, reply, goal, result or feedback type.

    Attributes:
        name: `package/msg/Name`.
        fields: members in the order of the definition.
    """

    name: str
    native: type
    fields: tuple[RecordField, ...]
    constants: Mapping[str, object]


Shape: TypeAlias = "ScalarType | StringType | ArrayType | RecordType"


def is_large(shape: Shape) -> bool:
    """Whether a type holds any number of octets, as pictures, point clouds and grids do."""
    if isinstance(shape, RecordType):
        return any(is_large(item.shape) for item in shape.fields)
    if not isinstance(shape, ArrayType):
        return False
    element = shape.element
    if isinstance(element, ScalarType):
        return shape.size is None and element.name in _OCTETS
    return is_large(element)


@lru_cache(maxsize=1024)
def shape_of(native: type, name: str) -> RecordType:
    """Return the shape of a generated message class, named `package/msg/Name`.

    The same one each time, so that what is compiled for it is compiled once.

    Raises:
        BridgeError: the class was not generated from a message definition that we understand.
    """
    return _shape_of(native, name, 0)


def _shape_of(native: type, name: str, depth: int) -> RecordType:
    described: object = vars(native).get("described")
    if isinstance(described, RecordType):
        return described
    if depth > _MAX_DEPTH:
        raise BridgeError(f"{name}: nested more than {_MAX_DEPTH} deep", FailureReason.UNSUPPORTED)
    try:
        names: Mapping[str, str] = native.get_fields_and_field_types()  # type: ignore[attr-defined]  # generated
        types: tuple[object, ...] = native.SLOT_TYPES  # type: ignore[attr-defined]  # generated
    except AttributeError as error:
        text = f"{name}: {native!r} is not a generated ROS 2 type ({error})"
        raise BridgeError(text, FailureReason.BAD_ENDPOINT) from error
    if len(names) != len(types):
        text = f"{name}: {len(names)} fields but {len(types)} types"
        raise BridgeError(text, FailureReason.UNSUPPORTED)
    fields = tuple(
        RecordField(
            field_name,
            _shape(kind, f"{name}.{field_name}", depth),
            _plain(getattr(native, f"{field_name.upper()}__DEFAULT", None)),
        )
        for field_name, kind in zip(names, types, strict=True)
    )
    return RecordType(name, native, fields, _constants(native))


def _shape(kind: object, where: str, depth: int) -> Shape:
    what = type(kind).__name__
    if what in {"Array", "BoundedSequence", "UnboundedSequence"}:
        element = _element(kind.value_type, where, depth)  # type: ignore[attr-defined]  # rosidl
        if what == "UnboundedSequence":
            return ArrayType(element)
        if what == "BoundedSequence":
            return ArrayType(element, kind.maximum_size)  # type: ignore[attr-defined]  # rosidl
        return ArrayType(element, kind.size, fixed=True)  # type: ignore[attr-defined]  # rosidl
    return _element(kind, where, depth)


def _element(kind: object, where: str, depth: int) -> ScalarType | StringType | RecordType:
    what = type(kind).__name__
    if what == "BasicType":
        scalar = _SCALARS.get(kind.typename)  # type: ignore[attr-defined]  # rosidl
        if scalar is not None:
            return ScalarType(scalar)
    if what in {"UnboundedString", "BoundedString"}:
        return StringType(bound=getattr(kind, "maximum_size", None))
    if what in {"UnboundedWString", "BoundedWString"}:
        return StringType(wide=True, bound=getattr(kind, "maximum_size", None))
    if what == "NamespacedType":
        name = "/".join((*kind.namespaces, kind.name))  # type: ignore[attr-defined]  # rosidl
        return _shape_of(import_type(name), name, depth + 1)
    raise BridgeError(f"{where}: native type {kind!r} is not known", FailureReason.UNSUPPORTED)


def _constants(native: type) -> dict[str, object]:
    names = (
        name
        for name in vars(type(native))
        if name.isupper() and not name.startswith("_") and not name.endswith("__DEFAULT")
    )
    return {name: _plain(getattr(native, name)) for name in sorted(names)}


def _plain(value: object) -> object:
    """Return a native default or constant as a JSON value."""
    if isinstance(value, bytes):
        return value[0] if len(value) == 1 else list(value)
    if hasattr(value, "tolist"):
        return value.tolist()
    if isinstance(value, list | tuple):
        return [_plain(item) for item in value]
    return value


EMPTY = "structure_needs_at_least_one_member"
"""What stands in C for a message without fields: one octet."""
KINDS = 48
"""Numbers of types: one value, then arrays, bounded and unbounded sequences of each."""
NESTED = 1
TEXTS = {17: False, 18: True, 21: False, 22: True}
"""Whether it is wide."""
BOUNDED_TEXTS = (21, 22)
SCALARS = {
    2: "int8",
    3: "uint8",
    4: "int16",
    5: "uint16",
    6: "int32",
    7: "uint32",
    8: "int64",
    9: "uint64",
    10: "float32",
    11: "float64",
    13: "char",
    15: "bool",
    16: "byte",
}
_NUMBERS = {name: number for number, name in SCALARS.items()}
_TEXT_NUMBERS = {(wide, number in BOUNDED_TEXTS): number for number, wide in TEXTS.items()}
_ARRAY, _BOUNDED, _UNBOUNDED = 1, 2, 3


def type_hash(record: RecordType) -> str:
    """Return `RIHS01_` and 64 hexadecimal digits."""
    within: dict[str, RecordType] = {}
    _collect(record, within)
    description = {
        "type_description": _described(record),
        "referenced_type_descriptions": [_described(within[name]) for name in sorted(within)],
    }
    text = json.dumps(description)  # its spaces and the order of its keys are part of the hash
    return f"RIHS01_{hashlib.sha256(text.encode()).hexdigest()}"


def _collect(record: RecordType, within: dict[str, RecordType]) -> None:
    for member in record.fields:
        shape = member.shape.element if isinstance(member.shape, ArrayType) else member.shape
        if isinstance(shape, RecordType) and shape.name not in within:
            within[shape.name] = shape
            _collect(shape, within)


def _described(record: RecordType) -> dict[str, Any]:
    fields = record.fields or (RecordField(EMPTY, ScalarType("uint8")),)
    return {
        "type_name": record.name,
        "fields": [{"name": field.name, "type": _kind(field.shape)} for field in fields],
    }


def _kind(shape: Shape) -> dict[str, Any]:
    element, many, capacity = shape, 0, 0
    if isinstance(shape, ArrayType):
        element, capacity = shape.element, shape.size or 0
        many = _ARRAY if shape.fixed else _UNBOUNDED if shape.size is None else _BOUNDED
    bound, nested = 0, ""
    if isinstance(element, RecordType):
        number, nested = NESTED, element.name
    elif isinstance(element, StringType):
        number, bound = _TEXT_NUMBERS[element.wide, element.bound is not None], element.bound or 0
    else:
        assert isinstance(element, ScalarType)
        number = _NUMBERS[element.name]
    return {
        "type_id": number + many * KINDS,
        "capacity": capacity,
        "string_capacity": bound,
        "nested_type_name": nested,
    }


@lru_cache(maxsize=64)
def integer_range(name: str) -> tuple[int, int] | None:
    """Return the least and greatest value of an integer type, None for other scalars."""
    if name == "byte":
        return 0, 255
    signed = name.startswith("int")
    if not signed and not name.startswith("uint"):
        return None
    bits = int(name.removeprefix("u").removeprefix("int"))
    return (-(2 ** (bits - 1)), 2 ** (bits - 1) - 1) if signed else (0, 2**bits - 1)


@lru_cache(maxsize=1024)
def structure_of(record: RecordType) -> MessageStructure:
    """Return the structure of a record: a closed object with every field required."""
    return MessageStructure(schema_of(record), native_type=record.name)


def schema_of(shape: Shape, unit: str | None = None) -> dict[str, Any]:
    """Return the schema of a shape; `unit` holds for the numbers in it that state none."""
    if isinstance(shape, RecordType):
        return _object(shape, unit)
    if isinstance(shape, ArrayType):
        return _array(shape, unit)
    if isinstance(shape, StringType):
        return _string(shape)
    return number_schema(shape.name, BASIC[shape.name], unit)


def _object(record: RecordType, unit: str | None) -> dict[str, Any]:
    properties = {field.name: _member(record, field, unit) for field in record.fields}
    schema = closed_object(properties, x_native_type=record.name, x_type=record.name)
    if record.constants:
        schema["x-constants"] = dict(record.constants)
    return schema


def _member(record: RecordType, member: RecordField, unit: str | None) -> dict[str, Any]:
    # A vector that is a velocity counts metres a second, whatever its own type would say.
    schema = schema_of(member.shape, unit or ros_unit(record.name, member.name))
    if member.default is not None:
        schema["default"] = member.default
    return schema


def _array(listing: ArrayType, unit: str | None) -> dict[str, Any]:
    schema: dict[str, Any] = {"type": "array", "items": schema_of(listing.element, unit)}
    if listing.size is not None:
        schema["maxItems"] = listing.size
        if listing.fixed:
            schema["minItems"] = listing.size
    if listing.element in {ScalarType("uint8"), ScalarType("byte"), ScalarType("char")}:
        schema["x-octets"] = True
    return schema


def _string(text: StringType) -> dict[str, Any]:
    """A bound counts what the text is written in: octets, or units of UTF-16."""
    schema: dict[str, Any] = {"type": "string", "x-nul": False}
    if text.bound is not None:
        schema["maxLength"] = text.bound
        schema["x-max-utf16" if text.wide else "x-max-utf8"] = text.bound
    if text.wide:
        schema["x-native-type"] = "wstring"
    return schema


_STATES = ["accepted", "rejected", "succeeded", "canceled", "aborted", "lost"]


def describe_action(type_name: str) -> Description:
    """Return an action as a call: the goal as request, the result as reply."""
    goal, _, result = action_records(type_name)
    return Description(request=structure_of(goal), reply=structure_of(result))


def part_structure(type_name: str, part: str) -> MessageStructure:
    """Return the structure of one stream of an action."""
    goal, feedback, result = action_records(type_name)
    if part == "goal":
        return structure_of(goal)
    members: dict[str, object] = {"goal_id": {"type": "string"}}
    if part in {"status", "result"}:
        members["status"] = {"type": "string", "enum": _STATES}
    if part in {"feedback", "result"}:
        members[part] = schema_of(feedback if part == "feedback" else result)
    return MessageStructure(closed_object(members), native_type=f"{type_name}.{part}")


def action_records(type_name: str) -> tuple[RecordType, RecordType, RecordType]:
    """Return the shapes of the goal, the feedback and the result of an action type."""
    native: Any = import_type(type_name)
    return (
        shape_of(native.Goal, f"{type_name}_Goal"),
        shape_of(native.Feedback, f"{type_name}_Feedback"),
        shape_of(native.Result, f"{type_name}_Result"),
    )


def describe_service(type_name: str) -> Description:
    """Return the request and reply structures of a service type."""
    request, reply = service_records(import_type(type_name), type_name)
    return Description(request=structure_of(request), reply=structure_of(reply))


def service_records(native: type, name: str) -> tuple[RecordType, RecordType]:
    request: type = native.Request  # type: ignore[attr-defined]  # generated
    reply: type = native.Response  # type: ignore[attr-defined]  # generated
    return shape_of(request, f"{name}_Request"), shape_of(reply, f"{name}_Response")
