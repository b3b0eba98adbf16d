"""Makes a process define a message type otherwise, as one built from another version would."""

from __future__ import annotations

import ctypes
from typing import Any

__all__ = ["redefine"]

# rosidl_message_type_support_t: identifier, data, two functions; then what tells the hash.
_POINTERS = 6
_HASH_FUNCTION = 3
_kept: list[Any] = []  # what native code points to


class _Hash(ctypes.Structure):
    _fields_ = (("version", ctypes.c_uint8), ("value", ctypes.c_uint8 * 32))


_Tell = ctypes.CFUNCTYPE(ctypes.c_void_p, ctypes.c_void_p)


def redefine(native: Any) -> None:
    """Give a message class another type hash; its name, fields and bytes stay as they are."""
    kind = native.__class__
    kind.__import_type_support__()
    api = ctypes.pythonapi
    api.PyCapsule_GetPointer.restype = ctypes.c_void_p
    api.PyCapsule_GetPointer.argtypes = (ctypes.py_object, ctypes.c_char_p)
    api.PyCapsule_New.restype = ctypes.py_object
    api.PyCapsule_New.argtypes = (ctypes.c_void_p, ctypes.c_char_p, ctypes.c_void_p)
    original = api.PyCapsule_GetPointer(kind._TYPE_SUPPORT, None)
    table = (ctypes.c_void_p * _POINTERS).from_buffer_copy(
        ctypes.string_at(original, _POINTERS * ctypes.sizeof(ctypes.c_void_p))
    )
    other = _Hash(1, (ctypes.c_uint8 * 32)(*range(32)))
    tell = _Tell(lambda _: ctypes.addressof(other))
    table[_HASH_FUNCTION] = ctypes.cast(tell, ctypes.c_void_p).value
    _kept.extend((table, other, tell))
    kind._TYPE_SUPPORT = api.PyCapsule_New(ctypes.addressof(table), None, None)
