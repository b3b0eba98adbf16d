"""Past rclpy, by the interfaces beneath it (rcl, rmw), where rclpy's own way will not do.

A history that keeps all has the middleware wait for room, a tenth of a second each time; rclpy
keeps the interpreter's lock meanwhile, so that the whole process stands still. And when the context
has ended, as rclpy's signal handlers end every one of a process, the client library refuses every
message, also the one that stops a robot, although publisher and participant are still there. And
rclpy does not say which publisher a message is of, although the middleware names it with each.

Classes of message types without generated code serve serialised messages: rclpy and Fast DDS ask a
type for its name, the hash of its definition and its greatest size; the code that (de)serialises
fields is asked for only where messages are not serialised already. So a table with those few is all
that a topic needs. Its layout is that of `rosidl_message_type_support_t` and
`message_type_support_callbacks_t` from Iron on.
"""

from __future__ import annotations

import ctypes
from collections.abc import Callable
from functools import cache
from typing import Any

import rclpy
from rclpy import get_rmw_implementation_identifier
from rclpy.serialization import deserialize_message, serialize_message

from uoarm.errors import BridgeError, FailureReason

_ERROR_OCTETS = 1024
_GID_OCTETS = 16
_NONE_TAKEN = 401  # RCL_RET_SUBSCRIPTION_TAKE_FAILED


class _Octets(ctypes.Structure):
    """`rcutils_uint8_array_t`; the allocator is for growing alone, which is not done here."""

    _fields_ = (
        ("buffer", ctypes.c_char_p),
        ("length", ctypes.c_size_t),
        ("capacity", ctypes.c_size_t),
        ("allocator", ctypes.c_void_p * 5),
    )


class _Allocator(ctypes.Structure):
    """`rcutils_allocator_t`."""

    _fields_ = (("functions", ctypes.c_void_p * 5),)


class _SerialisedBuffer(ctypes.Structure):
    """`rcutils_uint8_array_t`, which the middleware makes as large as it needs."""

    _fields_ = (
        ("buffer", ctypes.c_void_p),
        ("length", ctypes.c_size_t),
        ("capacity", ctypes.c_size_t),
        ("allocator", _Allocator),
    )


class _MessageInfo(ctypes.Structure):
    """`rmw_message_info_t`; identifiers of publishers had 24 octets up to Humble, then 16."""

    _fields_ = (
        ("times", ctypes.c_int64 * 2),
        ("numbers", ctypes.c_uint64 * 2),
        ("implementation", ctypes.c_void_p),
        ("publisher", ctypes.c_uint8 * _GID_OCTETS),
        ("rest", ctypes.c_uint8 * 64),
    )


class _Error(ctypes.Structure):
    """`rcutils_error_string_t`, of the thread that asks."""

    _fields_ = (("text", ctypes.c_char * _ERROR_OCTETS),)


@cache
def _functions() -> tuple[Any, Any, Any, Any]:
    """Return the functions that find the native publisher, publish, read and reset an error."""
    find = ctypes.CDLL("librcl.so").rcl_publisher_get_rmw_handle
    find.restype, find.argtypes = ctypes.c_void_p, (ctypes.c_void_p,)
    middleware = ctypes.CDLL(f"lib{get_rmw_implementation_identifier()}.so")
    publish = middleware.rmw_publish_serialized_message
    publish.argtypes = (ctypes.c_void_p, ctypes.POINTER(_Octets), ctypes.c_void_p)
    errors = ctypes.CDLL("librcutils.so")
    errors.rcutils_get_error_string.restype = _Error
    return find, publish, errors.rcutils_get_error_string, errors.rcutils_reset_error


def publish_released(publisher: Any, octets: bytes) -> None:
    """Publish octets of a message without the lock.

    Raises:
        OSError: the middleware takes nothing, for the reason that it gives, or its libraries are
            not found.
        InvalidHandle: the publisher was destroyed.
    """
    find, publish, *_ = _functions()
    given = _Octets(octets, len(octets), len(octets))
    with publisher.handle:
        native = find(publisher.handle.pointer)
        failed = native is None or publish(native, ctypes.byref(given), None)
    if failed:
        raise OSError(_error())


def serialised(native: object) -> bytes:
    """Return what goes over the wire for a native object."""
    octets: bytes = serialize_message(native)
    return octets


def deserialised(octets: bytes, native: type) -> object:
    """Return the native object of a class that octets hold."""
    made: object = deserialize_message(octets, native)
    return made


@cache
def _taking() -> tuple[Any, Any, Any, _Allocator]:
    """Return the functions that take a serialised message, allocate and free it; the allocator."""
    take = ctypes.CDLL("librcl.so").rcl_take_serialized_message
    take.argtypes = (
        ctypes.c_void_p,
        ctypes.POINTER(_SerialisedBuffer),
        ctypes.POINTER(_MessageInfo),
        ctypes.c_void_p,
    )
    utilities = ctypes.CDLL("librcutils.so")
    utilities.rcutils_get_default_allocator.restype = _Allocator
    pointers = (ctypes.POINTER(_SerialisedBuffer), ctypes.c_size_t, ctypes.POINTER(_Allocator))
    utilities.rcutils_uint8_array_init.argtypes = pointers
    utilities.rcutils_uint8_array_fini.argtypes = pointers[:1]
    allocator = utilities.rcutils_get_default_allocator()
    made, freed = utilities.rcutils_uint8_array_init, utilities.rcutils_uint8_array_fini
    return take, made, freed, allocator


def take_with_writer(handle: Any) -> tuple[bytes, bytes] | None:
    """Take a message as it is serialised, with its publisher's identity; None: there was none.

    Args:
        handle: rclpy's, of a subscription.

    Raises:
        OSError: the middleware gives none, for the reason that it says, or its libraries are not
            found.
        InvalidHandle: the subscription was destroyed.
    """
    take, make, free, allocator = _taking()
    taken, info = _SerialisedBuffer(), _MessageInfo()
    if make(ctypes.byref(taken), 0, ctypes.byref(allocator)):
        raise OSError("there is no memory for a message")
    try:
        with handle:
            failed = take(handle.pointer, ctypes.byref(taken), ctypes.byref(info), None)
        if failed == _NONE_TAKEN:
            return None
        if failed:
            raise OSError(_error())
        return ctypes.string_at(taken.buffer, taken.length), bytes(info.publisher)
    finally:
        free(ctypes.byref(taken))


def _error() -> str:
    """Return what rcutils says went wrong, and forget it: else the terminal shows it, too."""
    *_, report, forget = _functions()
    why: str = report().text.decode(errors="replace")
    forget()
    return why or "the middleware says no reason"


_MIDDLEWARE = "rmw_fastrtps_cpp"
_IDENTIFIER = b"rosidl_typesupport_fastrtps_c"
_HASH_BYTES = 32
_INTROSPECTION = b"rosidl_typesupport_introspection_c"
_UNBOUNDED = b"\0"
_kept: list[Any] = []  # what native code points to lives as long as the process


class _Hash(ctypes.Structure):
    _fields_ = (("version", ctypes.c_uint8), ("value", ctypes.c_uint8 * _HASH_BYTES))


class _String(ctypes.Structure):
    _fields_ = (("data", ctypes.c_char_p), ("size", ctypes.c_size_t), ("room", ctypes.c_size_t))


class _Sequence(ctypes.Structure):
    _fields_ = (("data", ctypes.c_void_p), ("size", ctypes.c_size_t), ("room", ctypes.c_size_t))


class _Description(ctypes.Structure):
    """An `IndividualTypeDescription` with the sequence of those that it refers to."""

    _fields_ = (("name", _String), ("fields", _Sequence), ("referenced", _Sequence))


_Serialise = ctypes.CFUNCTYPE(ctypes.c_bool, ctypes.c_void_p, ctypes.c_void_p)
_Size = ctypes.CFUNCTYPE(ctypes.c_uint32, ctypes.c_void_p)
_MostSize = ctypes.CFUNCTYPE(ctypes.c_size_t, ctypes.POINTER(ctypes.c_char))
_Getter = ctypes.CFUNCTYPE(ctypes.c_void_p, ctypes.c_void_p)
_Handle = ctypes.CFUNCTYPE(ctypes.c_void_p, ctypes.c_void_p, ctypes.c_char_p)


class _Callbacks(ctypes.Structure):
    _fields_ = (
        ("namespace", ctypes.c_char_p),
        ("name", ctypes.c_char_p),
        ("serialise", _Serialise),
        ("deserialise", _Serialise),
        ("size", _Size),
        ("most_size", _MostSize),
        ("keys", ctypes.c_void_p),
    )


class _Members(ctypes.Structure):
    """The start of `MessageMembers` of introspection: of a structure without members."""

    _fields_ = (
        ("namespace", ctypes.c_char_p),
        ("name", ctypes.c_char_p),
        ("count", ctypes.c_uint32),
        ("rest", ctypes.c_void_p * 8),
    )


class _Support(ctypes.Structure):
    _fields_ = (
        ("identifier", ctypes.c_char_p),
        ("data", ctypes.c_void_p),
        ("handle", _Handle),
        ("hash", _Getter),
        ("description", _Getter),
        ("sources", _Getter),
    )


def untyped_class(name: str, definition: str, attributes: dict[str, object]) -> type:
    """Return a class that rclpy takes for the type `package/msg/Name`, of serialised messages only.

    Args:
        name: of the type.
        definition: the hash of its definition, `RIHS01_` and 64 hexadecimal digits; empty: none.
        attributes: of the class.

    Raises:
        BridgeError: the middleware is not the one whose tables are known here.
    """
    middleware = rclpy.get_rmw_implementation_identifier()
    if middleware != _MIDDLEWARE:
        text = f"{name} is not installed; only {_MIDDLEWARE} does without, and this is {middleware}"
        raise BridgeError(text, FailureReason.UNSUPPORTED)
    package, kind, short = name.split("/")
    support = _support(f"{package}::{kind}", short, name, definition)
    capsule = _capsule(support)
    members = dict.fromkeys(
        ("_CREATE_ROS_MESSAGE", "_CONVERT_FROM_PY", "_CONVERT_TO_PY", "_DESTROY_ROS_MESSAGE"),
        capsule,  # rclpy sees that they are there, and calls none of them
    )
    metaclass = type(f"Metaclass_{short}", (type,), {**members, "_TYPE_SUPPORT": capsule})
    made: type = metaclass(short, (), attributes)
    return made


def _capsule(support: _Support) -> object:
    new: Callable[..., object] = ctypes.pythonapi.PyCapsule_New
    new.restype = ctypes.py_object  # type: ignore[attr-defined]  # of ctypes
    new.argtypes = (ctypes.c_void_p, ctypes.c_char_p, ctypes.c_void_p)  # type: ignore[attr-defined]  # of ctypes
    return new(ctypes.addressof(support), None, None)


def _support(namespace: str, short: str, name: str, definition: str) -> _Support:
    digits = definition.removeprefix("RIHS01_")
    value = bytes.fromhex(digits) if definition else bytes(_HASH_BYTES)
    report = _Hash(1 if definition else 0, (ctypes.c_uint8 * _HASH_BYTES)(*value))
    encoded = name.encode()
    text = _String(encoded, len(encoded), len(encoded) + 1)
    description, sources = _Description(text), _Sequence()
    callbacks = _Callbacks(
        namespace.encode(),
        short.encode(),
        _Serialise(lambda *_: False),
        _Serialise(lambda *_: False),
        _Size(lambda _: 0),
        _MostSize(_most_size),
    )
    getters = (
        _Getter(lambda _: ctypes.addressof(report)),
        _Getter(lambda _: ctypes.addressof(description)),
        _Getter(lambda _: ctypes.addressof(sources)),
    )
    members = _Members(callbacks.namespace, callbacks.name)
    tables: dict[bytes, _Support] = {}
    handle = _Handle(
        lambda _, wanted: ctypes.addressof(tables[wanted]) if wanted in tables else None
    )
    for identifier, data in ((_IDENTIFIER, callbacks), (_INTROSPECTION, members)):
        tables[identifier] = _Support(identifier, ctypes.addressof(data), handle, *getters)
    support = tables[_IDENTIFIER]
    _kept.append((tables, callbacks, members, report, description, sources, encoded))
    return support


def _most_size(bounds: Any) -> int:
    bounds[0] = _UNBOUNDED
    return 0
