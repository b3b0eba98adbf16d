"""Classes of message types that nobody generated, which rclpy takes for serialised messages.

rclpy and Fast DDS ask a type for its name, the hash of its definition and its greatest size; the
code that (de)serialises fields is asked for only where messages are not serialised already. So a
table with those few is all that a topic needs. Its layout is that of
`rosidl_message_type_support_t` and `message_type_support_callbacks_t` from Iron on.
"""

from __future__ import annotations

import ctypes
from collections.abc import Callable
from typing import Any

import rclpy

from uoarm.errors import BridgeError, FailureReason

__all__ = ["untyped_class"]

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
_Tell = ctypes.CFUNCTYPE(ctypes.c_void_p, ctypes.c_void_p)
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
        ("hash", _Tell),
        ("description", _Tell),
        ("sources", _Tell),
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
    tells = (
        _Tell(lambda _: ctypes.addressof(report)),
        _Tell(lambda _: ctypes.addressof(description)),
        _Tell(lambda _: ctypes.addressof(sources)),
    )
    members = _Members(callbacks.namespace, callbacks.name)
    tables: dict[bytes, _Support] = {}
    handle = _Handle(
        lambda _, wanted: ctypes.addressof(tables[wanted]) if wanted in tables else None
    )
    for identifier, data in ((_IDENTIFIER, callbacks), (_INTROSPECTION, members)):
        tables[identifier] = _Support(identifier, ctypes.addressof(data), handle, *tells)
    support = tables[_IDENTIFIER]
    _kept.append((tables, callbacks, members, report, description, sources, encoded))
    return support


def _most_size(bounds: Any) -> int:
    bounds[0] = _UNBOUNDED
    return 0
