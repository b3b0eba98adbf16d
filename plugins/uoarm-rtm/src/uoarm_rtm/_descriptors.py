"""What compiled stubs hold: types as shapes, interfaces with their operations.

Stubs keep their types as descriptors, tuples in the layout of omniORBpy's `tcInternal`, unchanged
from 3 to 4.3. Type codes would be the standard's way, but omniORB keeps one type code a repository
id in a process, so that two bridges with different IDL of one name would see the same type.

Arguments and results of operations pass through our codec, which checks them field by field, and
then through omniORB's own unmarshalling, which makes the objects that its stubs take. Strings
cross as Latin-1 in both, so their bytes are those of the codec's encoding.
"""

from __future__ import annotations

import importlib
import keyword
from collections.abc import Iterator, Mapping, Sequence
from types import ModuleType
from typing import Any

import _omnipy
from attrs import field, frozen
from omniORB import tcInternal

from uoarm.bridge import shown
from uoarm.errors import BridgeError, FailureReason, MessageError
from uoarm.model import Message, MessageStructure
from uoarm_rtm._compiler import Stubs
from uoarm_rtm._shape import (
    LITTLE,
    CdrCodec,
    IdlEnum,
    IdlMember,
    IdlScalar,
    IdlSequence,
    IdlString,
    IdlStruct,
    IdlUnion,
    IdlUnionMember,
    Shape,
    codec_of,
    structure_of,
)

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
            # An operation begins with a tuple of what it takes, in which a union has a dictionary.
            if isinstance(value, tuple) and isinstance(value[0], int) and value[0] in _NAMED_AT:
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


RETURN = "return"
"""Where a reply keeps what the operation returns, beside its out parameters."""


@frozen
class _Parameter:
    name: str
    descriptor: Any
    codec: CdrCodec


@frozen
class IdlOperation:
    """One operation.

    Attributes:
        name: as in IDL; attributes are `_get_NAME` and `_set_NAME`.
        structures: of the request and of the reply.
        raised: codec and descriptor of each declared exception, by repository id.
    """

    name: str
    takes: tuple[_Parameter, ...]
    gives: tuple[_Parameter, ...]
    structures: tuple[MessageStructure, MessageStructure]
    raised: Mapping[str, _Parameter] = field(hash=False)

    def arguments(self, message: Message) -> list[Any]:
        """Return omniORB's arguments for a request.

        Raises:
            MessageError: the request does not fit; the text names the field.
        """
        return _natives(self.takes, message, f"request of {self.name}")

    def message(self, arguments: Sequence[Any]) -> Message:
        """Return the request that omniORB's arguments make."""
        return _message(self.takes, arguments)

    def members(self, part: _Parameter, error: Any) -> Message:
        """Return the members of a declared exception that was raised."""
        return part.codec.decode(bytes(_omnipy.cdrMarshal(part.descriptor, error, 1)), LITTLE)

    def exception(self, identifier: str, members: Mapping[str, Any]) -> Exception | None:
        """Return a declared exception to raise; None when it is not declared.

        Raises:
            MessageError: the members do not fit.
        """
        part = self.raised.get(identifier)
        if part is None:
            return None
        data = part.codec.encode(dict(members), LITTLE)
        raised: Exception = _omnipy.cdrUnmarshal(part.descriptor, data, 1)
        return raised

    def reply(self, result: Any) -> Message:
        """Return the reply that a stub's result makes."""
        if len(self.gives) <= 1:
            return _message(self.gives, [result])
        return _message(self.gives, result)

    def result(self, message: Message) -> Any:
        """Return what a servant gives omniORB for a reply.

        Raises:
            MessageError: the reply does not fit; the text names the field.
        """
        values = _natives(self.gives, message, f"reply of {self.name}")
        if not values:
            return None
        return values[0] if len(values) == 1 else tuple(values)


@frozen
class IdlInterface:
    """One interface: its stub and skeleton classes, and what can be called.

    `refused` holds the operations that have no structure, each with the reason.
    """

    name: str
    stub: Any
    skeleton: Any
    operations: Mapping[str, IdlOperation] = field(hash=False)
    refused: Mapping[str, str] = field(hash=False)

    def operation(self, name: str) -> IdlOperation:
        """Return an operation by name.

        Raises:
            BridgeError: BAD_ENDPOINT when there is none, UNSUPPORTED when it has no structure.
        """
        if name in self.refused:
            raise BridgeError(f"{self.name}: {self.refused[name]}", FailureReason.UNSUPPORTED)
        if name not in self.operations:
            names = ", ".join(self.operations)
            text = f"interface {self.name} has no operation {name!r}; it has {names}"
            raise BridgeError(text, FailureReason.BAD_ENDPOINT)
        return self.operations[name]


def interfaces(stubs: Stubs, encoding: str) -> dict[str, IdlInterface]:
    """Return every interface of compiled IDL, by `Module/Name`."""
    found = {}
    for identifier, names in stubs.names.items():
        path = identifier.split(":")[1].split("/")
        if "." in path[0]:
            path = path[1:]  # a prefix
        scopes = {scope.__name__.split(".")[-1]: scope for scope in stubs.scopes}
        if path[0] not in scopes or len(path) == 1:
            continue  # an interface outside every module has no stubs of its own
        stub, skeleton = (
            scopes[path[0]],
            importlib.import_module(f"{scopes[path[0]].__name__}__POA"),
        )
        for step in path[1:]:
            stub, skeleton = getattr(stub, step), getattr(skeleton, step)
        operations: dict[str, IdlOperation] = {}
        refused: dict[str, str] = {}
        for name, parameters in names.items():
            try:
                operations[name] = _operation(name, parameters, stub, encoding)
            except BridgeError as error:
                refused[name] = str(error)
        full = "/".join(path)
        found[full] = IdlInterface(full, stub, skeleton, operations, refused)
    return found


def _operation(
    name: str, parameters: Sequence[Sequence[str]], stub: Any, encoding: str
) -> IdlOperation:
    takes, gives, raised = getattr(stub, f"_d_{name}")[:3]
    ins = [parameter for parameter, direction in parameters if direction != "out"]
    outs = [parameter for parameter, direction in parameters if direction != "in"]
    gives = gives or ()  # oneway
    if len(gives) > len(outs):
        outs.insert(0, RETURN)
    taken = _parts(ins, takes, name, encoding)
    given = _parts(outs, gives, name, encoding)
    structures = _structure(taken, encoding), _structure(given, encoding)
    if any("'wchar'" in str(structure.schema) for structure in structures):
        text = f"{name}: omniORB cannot read a wchar in a call; it can a wstring"
        raise BridgeError(text, FailureReason.UNSUPPORTED)
    errors = {
        # Without its repository id, which an exception's own marshalling puts first.
        identifier: _Parameter(
            descriptor[3],
            (tcInternal.tv_struct, *descriptor[1:]),
            codec_of(shape_of(descriptor, identifier), encoding),
        )
        for identifier, descriptor in (raised or {}).items()
    }
    return IdlOperation(name, taken, given, structures, errors)


def _parts(
    names: Sequence[str], descriptors: Sequence[Any], operation: str, encoding: str
) -> tuple[_Parameter, ...]:
    return tuple(
        _Parameter(
            name, descriptor, codec_of(shape_of(descriptor, f"{operation}.{name}"), encoding)
        )
        for name, descriptor in zip(names, descriptors, strict=True)
    )


def _structure(parts: Sequence[_Parameter], encoding: str) -> MessageStructure:
    record = IdlStruct("", tuple(IdlMember(part.name, part.codec.shape) for part in parts))
    return structure_of(record, encoding)


def _natives(parts: Sequence[_Parameter], message: Message, what: str) -> list[Any]:
    names = [part.name for part in parts]
    if not isinstance(message, Mapping) or set(message) != set(names):
        expected = ", ".join(names) or "no fields"
        raise MessageError(f"{what}: expected an object with {expected}, got {shown(message)}")
    natives = []
    for part in parts:
        try:
            data = part.codec.encode(message[part.name], LITTLE)
        except MessageError as error:
            raise MessageError(f"{what}, field {part.name!r}: {error}") from None
        natives.append(_omnipy.cdrUnmarshal(part.descriptor, data, 1))
    return natives


def _message(parts: Sequence[_Parameter], values: Sequence[Any]) -> Message:
    return {
        part.name: part.codec.decode(bytes(_omnipy.cdrMarshal(part.descriptor, value, 1)), LITTLE)
        for part, value in zip(parts, values, strict=False)
    }
