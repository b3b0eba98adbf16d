"""The IDL types that a bridge knows, found by name, and those derived from message structures.

Derived types are for ports whose endpoint names none. The name of one ends with a digest of what
it holds, since OpenRTM compares names and nothing else: two types of one name that are not the
same would hand garbage to a component.
"""

from __future__ import annotations

import hashlib
import re
from collections.abc import Iterable, Iterator, Mapping
from functools import cached_property
from typing import Any

from _uoarm_rtm_stubs import RTC, OpenRTM, SDOPackage

from uoarm.bridge import ServiceStructures, did_you_mean
from uoarm.errors import BridgeError, FailureReason
from uoarm.model import MessageStructure
from uoarm.schema import check
from uoarm_rtm._compiler import load_idl
from uoarm_rtm._descriptors import IdlInterface, descriptors, interfaces, shape_of
from uoarm_rtm._shape import (
    DERIVED,
    INTEGERS,
    CdrCodec,
    IdlMember,
    IdlScalar,
    IdlSequence,
    IdlString,
    IdlStruct,
    Shape,
    codec_of,
    schema_of,
    structure_of,
)

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
    name, lines = _name(port, (request, reply)), dict[str, str]()
    takes = "" if request is None else f"in {_define(request, f'{name}_request', lines)} {REQUEST}"
    gives = "void" if reply is None else _define(reply, f"{name}_reply", lines)
    lines[name.lower()] = f"interface {name} {{ {gives} {CALL}({takes}); }};"
    return _module(lines), f"uoarm/{name}"


def is_derived(type_id: str) -> bool:
    """Say whether a type is one that we derived."""
    return type_id.startswith(DERIVED)


def idl_of(record: IdlStruct) -> str:
    """Return the IDL of a derived type, for components that are to be compiled with it."""
    name = record.name.removeprefix(DERIVED).partition(":")[0]
    lines: dict[str, str] = {}
    _define(record, name, lines)
    return _module(lines)


def _module(lines: Mapping[str, str]) -> str:
    return "\n".join(["module uoarm {", *(f"  {line}" for line in lines.values()), "};", ""])


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
    if isinstance(kind, str) and kind in _PLAIN:
        return _PLAIN[kind]
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


def _define(shape: Shape, name: str, lines: dict[str, str]) -> str:
    """Write what a type rests on, then the type, and return how it is called.

    Lines stand by the names that they declare, in lower case: IDL distinguishes no others.
    """
    if isinstance(shape, IdlStruct):
        members = [
            f"{_define(field.shape, f'{name}_{field.name}', lines)} _{field.name};"
            for field in shape.fields
        ]
        name = _undeclared(name, lines)
        lines[name.lower()] = f"struct {name} {{ {' '.join(members)} }};"
        return name
    if isinstance(shape, IdlSequence):
        of = _define(shape.element, f"{name}_item", lines)
        name = _undeclared(name, lines)
        if shape.fixed:
            lines[name.lower()] = f"typedef {of} {name}[{shape.size}];"
        else:
            bound = "" if shape.size is None else f", {shape.size}"
            lines[name.lower()] = f"typedef sequence<{of}{bound}> {name};"
        return name
    return shape.name if isinstance(shape, IdlScalar) else "string"


def _undeclared(name: str, lines: Mapping[str, str]) -> str:
    """Return a name that no line declares: that of `a_b` is also that of `b` within `a`."""
    while name.lower() in lines:
        name += "_"
    return name


def _none(path: str, why: str) -> BridgeError:
    where = f"field {path!r}" if path else "the message"
    text = (
        f"no IDL can be derived from the structure: {where}: {why}. Name a type as the third "
        "part of the endpoint and give a `map`, or say the `structure` that the port has"
    )
    return BridgeError(text, FailureReason.UNSUPPORTED)


_ID = re.compile(r"(?:IDL:)?(?P<name>[^:]+?)(?::\d+\.\d+)?")


def plain_name(type_id: str) -> str:
    """Return `RTC/TimedLong` for any way of writing that type.

    Known are repository ids with and without a prefix, `RTC::TimedLong`, and bare names, which
    stay bare: `TimedLong` matches a type of that name in any module.
    """
    text = type_id.strip().replace("::", "/").strip("/")
    found = _ID.fullmatch(text)
    parts = (found["name"] if found else text).split("/")
    return "/".join(parts[1:] if len(parts) > 1 and "." in parts[0] else parts)


class Types:
    """The types of one bridge.

    Args:
        sources: IDL texts or files of the configuration; later ones win.
        encoding: of narrow strings.
        folder: where texts find what they include.

    Raises:
        BridgeError: a source cannot be compiled.
    """

    def __init__(
        self, sources: Iterable[str] = (), encoding: str = "utf-8", folder: str = "."
    ) -> None:
        self._encoding = encoding
        self._stubs = [load_idl(source, folder) for source in sources]
        self._codecs: dict[str, CdrCodec] = {}

    def codec(self, type_id: str) -> CdrCodec:
        """Return the codec of a type.

        Raises:
            BridgeError: UNSUPPORTED, when the type is unknown or holds what has no structure.
        """
        codec = self._codecs.get(type_id)
        if codec is None:
            codec = codec_of(shape_of(self.descriptor(type_id), type_id), self._encoding)
            self._codecs[type_id] = codec
        return codec

    def derive(self, port: str, structure: MessageStructure, *, is_read: bool) -> str:
        """Return the id of a type that carries a structure's messages; known from then on.

        Raises:
            BridgeError: as the function `derive`.
        """
        shape = derive(port, structure, is_read=is_read)
        self._codecs.setdefault(shape.name, codec_of(shape, self._encoding))
        return shape.name

    def derive_interface(
        self, port: str, structures: ServiceStructures
    ) -> tuple[IdlInterface, str]:
        """Return an interface for a service's messages, compiled, and its IDL.

        Raises:
            BridgeError: as the function `derive_interface`, or the compiler is not there.
        """
        idl, name = derive_interface(port, structures)
        return interfaces(load_idl(idl), self._encoding)[name], idl

    def structure(self, type_id: str) -> MessageStructure:
        """Return the message structure of a type; raises as `codec` does."""
        return structure_of(self.codec(type_id).shape, self._encoding)

    def descriptor(self, type_id: str) -> Any:
        """Return omniORB's descriptor of a type.

        Raises:
            BridgeError: UNSUPPORTED, when the type is unknown.
        """
        name = plain_name(type_id)
        if name in self._known:
            return self._known[name]
        if "/" not in name:
            ends = [known for known in self._known if known.endswith(f"/{name}")]
            if len(ends) == 1:
                return self._known[ends[0]]
        hint = f"give its IDL in the bridge's option `idl`{did_you_mean(name, self._known)}"
        text = f"data type {type_id!r} is not known: {hint}"
        raise BridgeError(text, FailureReason.UNSUPPORTED)

    def interface(self, name: str) -> tuple[IdlInterface, str]:
        """Return the interface that a text names, and the operation, empty for all of them.

        Args:
            name: `Module::Interface` or `Module::Interface::operation`, module optional.

        Raises:
            BridgeError: UNSUPPORTED, when no IDL of the configuration declares it.
        """
        plain = plain_name(name)
        known = self._interfaces
        for wanted, operation in ((plain, ""), tuple(plain.rpartition("/")[::2])):
            ends = [path for path in known if f"/{path}".endswith(f"/{wanted}")]
            if wanted and len(ends) == 1:
                return known[ends[0]], operation
        there = ", ".join(known) or "none"
        text = (
            f"interface {name!r} is not known (the option `idl` of the bridge declares {there}): "
            "give its IDL there"
        )
        raise BridgeError(text, FailureReason.UNSUPPORTED)

    def same(self, first: str, second: str) -> bool:
        """Whether two ways of writing a type name the same one."""
        first, second = plain_name(first), plain_name(second)
        return first == second or (
            ("/" in first) != ("/" in second) and first.split("/")[-1] == second.split("/")[-1]
        )

    @cached_property
    def _interfaces(self) -> dict[str, IdlInterface]:
        found: dict[str, IdlInterface] = {}
        for stubs in self._stubs:
            found.update(interfaces(stubs, self._encoding))
        return found

    @cached_property
    def _known(self) -> dict[str, Any]:
        known: dict[str, Any] = {}
        for module in (RTC, OpenRTM, SDOPackage):
            known.update((plain_name(name), found) for name, found in descriptors(module))
        for stubs in self._stubs:
            for scope in stubs.scopes:
                known.update((plain_name(name), found) for name, found in descriptors(scope))
        return known
