"""What a native type looks like, read once from its class: records, fields, arrays, texts."""

from __future__ import annotations

from collections.abc import Mapping
from functools import lru_cache
from typing import TypeAlias

from attrs import field, frozen

from uoarm.errors import BridgeError, FailureReason

__all__ = [
    "NUMBER_CODES",
    "Field",
    "Listing",
    "Record",
    "Scalar",
    "Shape",
    "Text",
    "is_described",
    "is_large",
    "shape_of",
]

NUMBER_CODES = {
    "int8": "b",
    "uint8": "B",
    "int16": "h",
    "uint16": "H",
    "int32": "i",
    "uint32": "I",
    "int64": "q",
    "uint64": "Q",
    "float32": "f",
    "float64": "d",
}
"""How `array` and `struct` call the elements of a block of numbers."""

_MAX_DEPTH = 32
_OCTETS = frozenset({"byte", "int8", "uint8"})
_SCALARS = {
    "boolean": "bool",
    "octet": "byte",
    "char": "uint8",
    "float": "float32",
    "double": "float64",
    **{f"{sign}int{bits}": f"{sign}int{bits}" for sign in ("", "u") for bits in (8, 16, 32, 64)},
}


@frozen
class Scalar:
    """A truth value, a byte, an integer or a float; `name` as in a ROS message file."""

    name: str


@frozen
class Text:
    """A string. `bound`: the most code units (bytes of UTF-8, or of UTF-16 when `wide`)."""

    wide: bool = False
    bound: int | None = None


@frozen
class Listing:
    """Many elements: exactly `size`, at most `size`, or any number when `size` is None."""

    element: Scalar | Text | Record
    size: int | None = None
    fixed: bool = False


@frozen
class Field:
    """One named member of a record; `attribute` is where its native object keeps it."""

    name: str
    attribute: str
    shape: Shape
    default: object = field(default=None, hash=False)


@frozen(eq=False)
class Record:
    """A message, request, reply, goal, result or feedback type.

    Attributes:
        name: `package/msg/Name`.
        native: the Python class.
        fields: members in the order of the definition.
        constants: named constants of the definition.
        slots: every attribute of the native object.
    """

    name: str
    native: type
    fields: tuple[Field, ...]
    constants: Mapping[str, object]
    slots: tuple[str, ...]


Shape: TypeAlias = "Scalar | Text | Listing | Record"


def is_described(native: type) -> bool:
    """Whether a class stands for a type of which there is only a description."""
    return "described" in vars(native)


def is_large(shape: Shape) -> bool:
    """Whether a type holds any number of octets, as pictures, point clouds and grids do."""
    if isinstance(shape, Record):
        return any(is_large(item.shape) for item in shape.fields)
    if not isinstance(shape, Listing):
        return False
    element = shape.element
    if isinstance(element, Scalar):
        return shape.size is None and element.name in _OCTETS
    return is_large(element)


def shape_of(native: type, name: str) -> Record:
    """Return the shape of a generated message class, named `package/msg/Name`.

    The same one each time, so that what is compiled for it is compiled once.

    Raises:
        BridgeError: the class was not generated from a message definition that we understand.
    """
    return _kept_shape(native, name)


@lru_cache(maxsize=1024)
def _kept_shape(native: type, name: str) -> Record:
    return _shape_of(native, name, 0)


def _shape_of(native: type, name: str, depth: int) -> Record:
    described: object = vars(native).get("described")
    if isinstance(described, Record):
        return described
    if depth > _MAX_DEPTH:
        raise BridgeError(f"{name}: nested more than {_MAX_DEPTH} deep", FailureReason.UNSUPPORTED)
    try:
        names: Mapping[str, str] = native.get_fields_and_field_types()  # type: ignore[attr-defined]  # generated
        types: tuple[object, ...] = native.SLOT_TYPES  # type: ignore[attr-defined]  # generated
        slots = tuple(native.__slots__)  # type: ignore[attr-defined]  # generated
    except AttributeError as error:
        text = f"{name}: {native!r} is not a generated ROS 2 type ({error})"
        raise BridgeError(text, FailureReason.BAD_ENDPOINT) from error
    if len(names) != len(types):
        text = f"{name}: {len(names)} fields but {len(types)} types"
        raise BridgeError(text, FailureReason.UNSUPPORTED)
    fields = tuple(
        Field(
            field_name,
            f"_{field_name}" if f"_{field_name}" in slots else field_name,
            _shape(kind, f"{name}.{field_name}", depth),
            _plain(getattr(native, f"{field_name.upper()}__DEFAULT", None)),
        )
        for field_name, kind in zip(names, types, strict=True)
    )
    return Record(name, native, fields, _constants(native), slots)


def _shape(kind: object, where: str, depth: int) -> Shape:
    what = type(kind).__name__
    if what in {"Array", "BoundedSequence", "UnboundedSequence"}:
        element = _element(kind.value_type, where, depth)  # type: ignore[attr-defined]  # rosidl
        if what == "UnboundedSequence":
            return Listing(element)
        if what == "BoundedSequence":
            return Listing(element, kind.maximum_size)  # type: ignore[attr-defined]  # rosidl
        return Listing(element, kind.size, fixed=True)  # type: ignore[attr-defined]  # rosidl
    return _element(kind, where, depth)


def _element(kind: object, where: str, depth: int) -> Scalar | Text | Record:
    what = type(kind).__name__
    if what == "BasicType":
        scalar = _SCALARS.get(kind.typename)  # type: ignore[attr-defined]  # rosidl
        if scalar is not None:
            return Scalar(scalar)
    if what in {"UnboundedString", "BoundedString"}:
        return Text(bound=getattr(kind, "maximum_size", None))
    if what in {"UnboundedWString", "BoundedWString"}:
        return Text(wide=True, bound=getattr(kind, "maximum_size", None))
    if what == "NamespacedType":
        from uoarm_ros2._types import import_type  # noqa: PLC0415 - types are made of types

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
