"""What an IDL type is made of: plain values, independent of any ORB.

Schemas, writers and readers are all derived from these.
"""

from __future__ import annotations

from typing import TypeAlias

from attrs import frozen

__all__ = [
    "INTEGERS",
    "IdlEnum",
    "IdlMember",
    "IdlScalar",
    "IdlSequence",
    "IdlString",
    "IdlStruct",
    "IdlUnion",
    "IdlUnionMember",
    "Shape",
    "least_size",
]

INTEGERS = {
    "octet": (0, 255),
    "short": (-(2**15), 2**15 - 1),
    "unsigned short": (0, 2**16 - 1),
    "long": (-(2**31), 2**31 - 1),
    "unsigned long": (0, 2**32 - 1),
    "long long": (-(2**63), 2**63 - 1),
    "unsigned long long": (0, 2**64 - 1),
}
"""Least and greatest value of each integer type."""

_SIZES = {"octet": 1, "boolean": 1, "char": 1, "wchar": 3, "float": 4, "double": 8}


@frozen
class IdlScalar:
    """A number, `boolean`, `char` or `wchar`, by its IDL name."""

    name: str


@frozen
class IdlString:
    """A string; `bound` counts characters, None for no bound."""

    wide: bool = False
    bound: int | None = None


@frozen
class IdlEnum:
    """One of several labels; the wire carries the position."""

    name: str
    labels: tuple[str, ...]


@frozen
class IdlSequence:
    """Many elements: exactly `size`, at most `size`, or any number when `size` is None."""

    element: Shape
    size: int | None = None
    fixed: bool = False


@frozen
class IdlMember:
    """One named member of a record."""

    name: str
    shape: Shape


@frozen
class IdlStruct:
    """A struct. `name` is its repository id, such as `IDL:RTC/Time:1.0`."""

    name: str
    fields: tuple[IdlMember, ...]


@frozen
class IdlUnionMember:
    """One member of a union; `labels` are the discriminator's values, empty for the default."""

    name: str
    labels: tuple[object, ...]
    shape: Shape


@frozen
class IdlUnion:
    """A union. `by` is the discriminator: a Scalar or an Enumeration (labels as strings)."""

    name: str
    by: IdlScalar | IdlEnum
    variants: tuple[IdlUnionMember, ...]


Shape: TypeAlias = "IdlScalar | IdlString | IdlEnum | IdlSequence | IdlStruct | IdlUnion"


def least_size(shape: Shape) -> int:
    """Return the least number of bytes that a value takes on the wire, padding aside.

    Never 0 but for an array of nothing: what a length in received data is checked against.
    """
    if isinstance(shape, IdlStruct):
        return sum(least_size(field.shape) for field in shape.fields)
    if isinstance(shape, IdlSequence):
        return least_size(shape.element) * (shape.size or 0) if shape.fixed else 4
    if isinstance(shape, IdlUnion):
        return least_size(shape.by)
    if isinstance(shape, IdlString):
        return 4 if shape.wide else 5
    if isinstance(shape, IdlEnum):
        return 4
    low, high = INTEGERS.get(shape.name, (0, 0))
    return _SIZES.get(shape.name) or (high - low + 1).bit_length() // 8
