"""Makes a process define a type otherwise, as one built from another version would."""

from __future__ import annotations

import ctypes
from typing import Any

# rosidl_message_type_support_t: identifier, data, two functions; then that of the hash.
_POINTERS = 6
_HASH_FUNCTION = 3
# rosidl_service_type_support_t: identifier, data, a function, the types of request and reply ...
_SERVICE_POINTERS = 11
_REPLY = 4
# rosidl_action_type_support_t: the services to send a goal, get its result and cancel it ...
_ACTION_POINTERS = 8
_SEND_GOAL = 0
_kept: list[Any] = []  # what native code points to


class _Hash(ctypes.Structure):
    _fields_ = (("version", ctypes.c_uint8), ("value", ctypes.c_uint8 * 32))


_Getter = ctypes.CFUNCTYPE(ctypes.c_void_p, ctypes.c_void_p)


def redefine(native: Any) -> None:
    """Give a message class another type hash; its name, fields and bytes stay as they are."""
    _replace(native, _redefined(_address(native)))


def redefine_reply(native: Any) -> None:
    """Give the reply of a service class another type hash."""
    table = _copied(_address(native), _SERVICE_POINTERS)
    table[_REPLY] = ctypes.addressof(_redefined(table[_REPLY]))
    _replace(native, table)


def redefine_goal_reply(native: Any) -> None:
    """Give the answer to a goal of an action class another type hash."""
    action = _copied(_address(native), _ACTION_POINTERS)
    service = _copied(action[_SEND_GOAL], _SERVICE_POINTERS)
    service[_REPLY] = ctypes.addressof(_redefined(service[_REPLY]))
    action[_SEND_GOAL] = ctypes.addressof(service)
    _kept.append(service)
    _replace(native, action)


def _redefined(address: Any) -> Any:
    other = _Hash(1, (ctypes.c_uint8 * 32)(*range(32)))
    report = _Getter(lambda _: ctypes.addressof(other))
    table = _copied(address, _POINTERS)
    table[_HASH_FUNCTION] = ctypes.cast(report, ctypes.c_void_p).value
    _kept.extend((table, other, report))
    return table


def _copied(address: Any, pointers: int) -> Any:
    octets = ctypes.string_at(address, pointers * ctypes.sizeof(ctypes.c_void_p))
    return (ctypes.c_void_p * pointers).from_buffer_copy(octets)


def _address(native: Any) -> Any:
    kind, api = native.__class__, ctypes.pythonapi
    kind.__import_type_support__()
    api.PyCapsule_GetPointer.restype = ctypes.c_void_p
    api.PyCapsule_GetPointer.argtypes = (ctypes.py_object, ctypes.c_char_p)
    return api.PyCapsule_GetPointer(kind._TYPE_SUPPORT, None)


def _replace(native: Any, table: Any) -> None:
    api = ctypes.pythonapi
    api.PyCapsule_New.restype = ctypes.py_object
    api.PyCapsule_New.argtypes = (ctypes.c_void_p, ctypes.c_char_p, ctypes.c_void_p)
    _kept.append(table)
    native.__class__._TYPE_SUPPORT = api.PyCapsule_New(ctypes.addressof(table), None, None)
