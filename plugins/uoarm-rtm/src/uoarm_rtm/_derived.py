"""IDL types and interfaces derived from message structures, for ports whose endpoint names none.

The name of a derived type ends with a digest of what it holds, since OpenRTM compares names and
nothing else: two types of one name that are not the same would hand garbage to a component.
"""

from __future__ import annotations

import hashlib
import re
from collections.abc import Iterator, Mapping
from typing import Any

from uoarm.bridge import ServiceStructures
from uoarm.errors import BridgeError, FailureReason
from uoarm.model import MessageStructure
from uoarm.schema import check
from uoarm_rtm._schema import DERIVED, schema_of
from uoarm_rtm._shape import (
    INTEGERS,
    IdlMember,
    IdlScalar,
    IdlSequence,
    IdlString,
    IdlStruct,
    Shape,
)

__all__ = ["CALL", "IDL", "REQUEST", "derive", "derive_interface", "idl_of", "is_derived"]

CALL, REQUEST = "call", "request"
"""The operation of a derived interface, and its parameter."""

IDL = "uoarm.idl"
"""The property of a port that holds the IDL of what was derived."""

_NAME = re.compile(r"[A-Za-z][A-Za-z0-9_]*")
_DEEPEST = 32
_NULL = {"type": "null"}
_PLAIN: Mapping[str, Shape] = {
    "boolean": IdlScalar("boolean"),
    "number": IdlScalar("double"),
    "string": IdlString(),
}


def derive(port: str, structure: MessageStructure, *, is_read: bool) -> IdlStruct:
    """Return the type of a port of ours that carries the messages of a structure.

    Args:
        port: its name, with which the type's begins.
        structure: what the port is opened with.
        is_read: whether messages come in: then each of the type must be one of the structure, else
            each of the structure one of the type.

    Raises:
        BridgeError: UNSUPPORTED, where no type of IDL holds them; the text says at which field.
    """
    shape = _exact(structure, is_read=is_read)
    if not isinstance(shape, IdlStruct):
        raise _none("", "a data type is a struct, and this is no object")
    return IdlStruct(f"{DERIVED}{_name(port, shape)}:1.0", shape.fields)


def derive_interface(port: str, structures: ServiceStructures) -> tuple[str, str]:
    """Return the IDL and the name of an interface with one operation, `call`, for a service.

    Its parameter `request` and what it returns are the two messages; a message that is always null
    is none.

    Raises:
        BridgeError: UNSUPPORTED, as of `derive`.
    """
    request, reply = (
        None if structure.schema == _NULL else _exact(structure, is_read=is_read)
        for structure, is_read in ((structures.request, True), (structures.reply, False))
    )
    name, lines = _name(port, (request, reply)), list[str]()
    takes = "" if request is None else f"in {_define(request, f'{name}_request', lines)} {REQUEST}"
    gives = "void" if reply is None else _define(reply, f"{name}_reply", lines)
    lines.append(f"interface {name} {{ {gives} {CALL}({takes}); }};")
    return _module(lines), f"uoarm/{name}"


def is_derived(type_id: str) -> bool:
    """Say whether a type is one that we derived."""
    return type_id.startswith(DERIVED)


def idl_of(record: IdlStruct) -> str:
    """Return the IDL of a derived type, for components that are to be compiled with it."""
    name = record.name.removeprefix(DERIVED).partition(":")[0]
    lines: list[str] = []
    _define(record, name, lines)
    return _module(lines)


def _module(lines: list[str]) -> str:
    return "\n".join(["module uoarm {", *(f"  {line}" for line in lines), "};", ""])


def _name(port: str, shape: object) -> str:
    """Return a name of IDL that begins with the port's, and that no other shape has."""
    digest = hashlib.sha256(repr(shape).encode()).hexdigest()[:8]
    stem = re.sub(r"\W", "_", port, flags=re.ASCII)
    return f"{stem if stem[:1].isalpha() else 'port' + stem}_{digest}"


def _exact(structure: MessageStructure, *, is_read: bool) -> Shape:
    """Return the shape that carries the messages of a structure, and, read, gives no others."""
    shape = _shape(structure.schema, "", 0)
    ours = schema_of(shape)
    verdict = check(ours, structure.schema) if is_read else check(structure.schema, ours)
    if not verdict.compatible:
        first = verdict.reasons[0] if verdict.reasons else None
        raise _none(first.path if first else "", first.sentence if first else "undecided")
    return shape


def _shape(schema: Any, path: str, depth: int) -> Shape:
    if depth > _DEEPEST:
        raise _none(path, f"it is nested deeper than {_DEEPEST}")
    kind = schema.get("type") if isinstance(schema, Mapping) else None
    if kind == "object":
        return IdlStruct("", tuple(_fields(schema, path, depth)))
    if kind == "array":
        return _listing(schema, path, depth)
    if kind == "integer":
        return _integer(schema, path)
    if kind in _PLAIN:
        return _PLAIN[str(kind)]
    raise _none(path, "it has no type of its own: expected an object, array, number or text")


def _fields(schema: Mapping[str, Any], path: str, depth: int) -> Iterator[IdlMember]:
    properties = schema.get("properties", {})
    if not properties:
        raise _none(path, "a struct has at least one member")
    seen: dict[str, str] = {}
    for name, property_ in properties.items():
        within = f"{path}.{name}" if path else str(name)
        if not _NAME.fullmatch(name):
            raise _none(within, "IDL has no member of this name")
        alike = seen.setdefault(name.lower(), name)
        if alike != name:
            raise _none(within, f"IDL does not distinguish it from {alike!r}")
        if name not in schema.get("required", ()):
            raise _none(within, "a struct has all its members, and this may be left out")
        yield IdlMember(name, _shape(property_, within, depth + 1))


def _listing(schema: Mapping[str, Any], path: str, depth: int) -> IdlSequence:
    if schema.get("x-octets"):
        element: Shape = IdlScalar("octet")
    else:
        element = _shape(schema.get("items"), f"{path}[]", depth + 1)
    least, most = schema.get("minItems", 0), schema.get("maxItems")
    size = None if most is None else int(most)
    if size == 0:
        raise _none(path, "IDL has no array of nothing")
    return IdlSequence(element, size, fixed=size is not None and least == most)


def _integer(schema: Mapping[str, Any], path: str) -> IdlScalar:
    least, most = schema.get("minimum"), schema.get("maximum")
    if least is None or most is None:
        raise _none(path, "an integer of IDL has bounds: say minimum and maximum")
    for name, (low, high) in INTEGERS.items():
        if name != "octet" and low <= least and most <= high:
            return IdlScalar(name)
    raise _none(path, "no integer of IDL has 65 bits")


def _define(shape: Shape, name: str, lines: list[str]) -> str:
    """Write what a type rests on, then the type, and return how it is called."""
    if isinstance(shape, IdlStruct):
        members = [
            f"{_define(field.shape, f'{name}_{field.name}', lines)} _{field.name};"
            for field in shape.fields
        ]
        lines.append(f"struct {name} {{ {' '.join(members)} }};")
        return name
    if isinstance(shape, IdlSequence):
        of = _define(shape.element, f"{name}_item", lines)
        if shape.fixed:
            lines.append(f"typedef {of} {name}[{shape.size}];")
        else:
            bound = "" if shape.size is None else f", {shape.size}"
            lines.append(f"typedef sequence<{of}{bound}> {name};")
        return name
    return shape.name if isinstance(shape, IdlScalar) else "string"


def _none(path: str, why: str) -> BridgeError:
    where = f"field {path!r}" if path else "the message"
    text = (
        f"no IDL can be derived from the structure: {where}: {why}. Name a type as the third "
        "part of the endpoint and give a `map`, or say the `structure` that the port has"
    )
    return BridgeError(text, FailureReason.UNSUPPORTED)
