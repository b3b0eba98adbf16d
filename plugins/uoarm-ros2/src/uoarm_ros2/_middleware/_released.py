"""Past rclpy, by the interfaces beneath it (rcl, rmw), where rclpy's way will not do.

A history that keeps all has the middleware wait for room, a tenth of a second each time; rclpy
keeps the interpreter's lock meanwhile, so that nothing else in the process goes on. And when the
context has ended, as rclpy's signal handlers end every one of a process, the client library refuses
every message, also the one that stops a robot, although publisher and participant are still there.

And rclpy does not say which publisher a message is of, although the middleware names it with each.
"""

from __future__ import annotations

import ctypes
from functools import cache
from typing import Any

from rclpy import get_rmw_implementation_identifier
from rclpy.serialization import serialize_message

__all__ = ["publish_released", "take_with_writer"]

_ERROR_OCTETS = 1024
_GID_OCTETS = 16
_NONE_TAKEN = 401  # RCL_RET_SUBSCRIPTION_TAKE_FAILED


class _Octets(ctypes.Structure):
    """`rcutils_uint8_array_t`; the allocator is used for growing alone, which nobody does here."""

    _fields_ = (
        ("buffer", ctypes.c_char_p),
        ("length", ctypes.c_size_t),
        ("capacity", ctypes.c_size_t),
        ("allocator", ctypes.c_void_p * 5),
    )


class _Allocator(ctypes.Structure):
    """`rcutils_allocator_t`."""

    _fields_ = (("functions", ctypes.c_void_p * 5),)


class _Taken(ctypes.Structure):
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
    """Return what finds the native publisher, publishes, tells an error and forgets it."""
    find = ctypes.CDLL("librcl.so").rcl_publisher_get_rmw_handle
    find.restype, find.argtypes = ctypes.c_void_p, (ctypes.c_void_p,)
    middleware = ctypes.CDLL(f"lib{get_rmw_implementation_identifier()}.so")
    publish = middleware.rmw_publish_serialized_message
    publish.argtypes = (ctypes.c_void_p, ctypes.POINTER(_Octets), ctypes.c_void_p)
    errors = ctypes.CDLL("librcutils.so")
    errors.rcutils_get_error_string.restype = _Error
    return find, publish, errors.rcutils_get_error_string, errors.rcutils_reset_error


def publish_released(publisher: Any, message: Any) -> None:
    """Publish a native object, or octets that are serialised already, without the lock.

    Raises:
        OSError: the middleware takes nothing, for the reason that it gives, or its libraries are
            not found.
        InvalidHandle: the publisher was destroyed.
    """
    octets = message if isinstance(message, bytes) else serialize_message(message)
    find, publish, *_ = _functions()
    given = _Octets(octets, len(octets), len(octets))
    with publisher.handle:
        native = find(publisher.handle.pointer)
        failed = native is None or publish(native, ctypes.byref(given), None)
    if failed:
        raise OSError(_error())


@cache
def _taking() -> tuple[Any, Any, Any, _Allocator]:
    """Return what takes a serialised message, makes room for it and frees that, and how."""
    take = ctypes.CDLL("librcl.so").rcl_take_serialized_message
    take.argtypes = (
        ctypes.c_void_p,
        ctypes.POINTER(_Taken),
        ctypes.POINTER(_MessageInfo),
        ctypes.c_void_p,
    )
    utilities = ctypes.CDLL("librcutils.so")
    utilities.rcutils_get_default_allocator.restype = _Allocator
    pointers = (ctypes.POINTER(_Taken), ctypes.c_size_t, ctypes.POINTER(_Allocator))
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
    taken, info = _Taken(), _MessageInfo()
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
