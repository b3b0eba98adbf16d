"""Shapes from omniORB's type descriptors, the tuples in which compiled stubs keep their types.

Type codes would be the standard's way, but omniORB keeps one type code a repository id in a
process, so that two bridges with different IDL of one name would see the same type. Descriptors
belong to their stubs. Their layout is that of omniORBpy's `tcInternal`, unchanged from 3 to 4.3.
"""

from __future__ import annotations

import keyword
from collections.abc import Iterator
from types import ModuleType
from typing import Any

from omniORB import tcInternal

from uoarm.errors import BridgeError, FailureReason
from uoarm_rtm._shape import (
    IdlEnum,
    IdlMember,
    IdlScalar,
    IdlSequence,
    IdlString,
    IdlStruct,
    IdlUnion,
    IdlUnionMember,
    Shape,
)

__all__ = ["descriptors", "shape_of"]

_DEEPEST = 32
_SCALARS = {
    tcInternal.tv_octet: "octet",
    tcInternal.tv_boolean: "boolean",
    tcInternal.tv_char: "char",
    tcInternal.tv_wchar: "wchar",
    tcInternal.tv_short: "short",
    tcInternal.tv_ushort: "unsigned short",
    tcInternal.tv_long: "long",
    tcInternal.tv_ulong: "unsigned long",
    tcInternal.tv_longlong: "long long",
    tcInternal.tv_ulonglong: "unsigned long long",
    tcInternal.tv_float: "float",
    tcInternal.tv_double: "double",
}
_REFUSED = {
    tcInternal.tv_any: "any has no structure that could be checked before connecting",
    tcInternal.tv_objref: "an object reference means nothing outside CORBA",
    tcInternal.tv_TypeCode: "a type code means nothing outside CORBA",
    tcInternal.tv_longdouble: "long double has no counterpart in JSON",
    tcInternal.tv_fixed: "fixed-point decimals have no counterpart in JSON",
    tcInternal.tv_value: "value types may be shared and cyclic",
    tcInternal.tv_value_box: "value types may be shared and cyclic",
    tcInternal.tv__indirect: "it contains itself",
}
_NAMED_AT = {
    tcInternal.tv_struct: 2,
    tcInternal.tv_union: 2,
    tcInternal.tv_except: 2,
    tcInternal.tv_enum: 1,
    tcInternal.tv_alias: 1,
    tcInternal.tv_objref: 1,
}


def descriptors(scope: Any) -> Iterator[tuple[str, Any]]:
    """Yield (repository id, descriptor) of every type in a stub module, and in those within it."""
    for name, value in list(vars(scope).items()):
        if name.startswith(("_d_", "_ad_")):
            if isinstance(value, tuple) and value[0] in _NAMED_AT:
                yield value[_NAMED_AT[value[0]]], value
        elif isinstance(value, ModuleType):
            if value.__name__.startswith(f"{scope.__name__}."):
                yield from descriptors(value)
        elif isinstance(value, type) and hasattr(value, "_NP_RepositoryId"):
            yield from descriptors(value)


def shape_of(descriptor: Any, where: str, depth: int = 0) -> Shape:
    """Return the shape of a descriptor; `where` is its name or path, for errors.

    Raises:
        BridgeError: UNSUPPORTED, with the path of the member and the reason.
    """
    if depth > _DEEPEST:
        text = f"{where}: nested more than {_DEEPEST} deep"
        raise BridgeError(text, FailureReason.UNSUPPORTED)
    parts: Any = (descriptor,) if isinstance(descriptor, int) else descriptor
    kind = parts[0]
    if kind in _SCALARS:
        return IdlScalar(_SCALARS[kind])
    if kind == tcInternal.tv_alias:
        return shape_of(parts[3], where, depth + 1)
    if kind in {tcInternal.tv_string, tcInternal.tv_wstring}:
        return IdlString(kind == tcInternal.tv_wstring, parts[1] or None)
    if kind == tcInternal.tv_enum:
        return IdlEnum(parts[1], tuple(map(_label, parts[3])))
    if kind in {tcInternal.tv_sequence, tcInternal.tv_array}:
        element = shape_of(parts[1], f"{where}[]", depth + 1)
        return IdlSequence(element, parts[2] or None, fixed=kind == tcInternal.tv_array)
    if kind in {tcInternal.tv_struct, tcInternal.tv_except}:
        members = zip(parts[4::2], parts[5::2], strict=True)
        fields = [
            IdlMember(_plain(name), shape_of(item, f"{where}.{name}", depth + 1))
            for name, item in members
        ]
        return IdlStruct(parts[2], tuple(fields))
    if kind == tcInternal.tv_union:
        return _choice(parts, where, depth)
    reason = _REFUSED.get(kind, f"IDL type number {kind} is not known here")
    raise BridgeError(f"{where}: {reason}", FailureReason.UNSUPPORTED)


def _choice(parts: Any, where: str, depth: int) -> IdlUnion:
    by = shape_of(parts[4], f"{where}.switch", depth + 1)
    assert isinstance(by, IdlScalar | IdlEnum)
    default = parts[5]
    labels: dict[str, list[object]] = {}
    shapes: dict[str, Shape] = {}
    for label, name, member in parts[6]:
        shapes[name] = shape_of(member, f"{where}.{name}", depth + 1)
        labels.setdefault(name, []).append(
            bool(label) if by == IdlScalar("boolean") else _label(label)
        )
    if default >= 0:
        labels[parts[6][default][1]] = []  # labels beside `default:` add nothing to it
    variants = (
        IdlUnionMember(_plain(name), tuple(known), shapes[name]) for name, known in labels.items()
    )
    return IdlUnion(parts[2], by, tuple(variants))


def _label(value: Any) -> Any:
    """Return a label: of an enumerator its name, anything else as it is."""
    return str(value._n) if hasattr(value, "_n") else value  # noqa: SLF001 - as omniORBpy has it


def _plain(name: str) -> str:
    """Return a member's name as IDL has it: omniidl puts `_` before words of Python."""
    return name[1:] if name.startswith("_") and keyword.iskeyword(name[1:]) else name
