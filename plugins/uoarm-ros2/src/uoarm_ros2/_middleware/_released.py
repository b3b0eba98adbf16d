"""Publishing past rclpy, by the middleware's own interface (rmw), where rclpy's way will not do.

A history that keeps all has the middleware wait for room, a tenth of a second each time; rclpy
keeps the interpreter's lock meanwhile, so that nothing else in the process goes on. And when the
context has ended, as rclpy's signal handlers end every one of a process, the client library refuses
every message, also the one that stops a robot, although publisher and participant are still there.
"""

from __future__ import annotations

import ctypes
from functools import cache
from typing import Any

from rclpy import get_rmw_implementation_identifier
from rclpy.serialization import serialize_message

__all__ = ["publish_released"]

_ERROR_OCTETS = 1024


class _Octets(ctypes.Structure):
    """`rcutils_uint8_array_t`; the allocator is used for growing alone, which nobody does here."""

    _fields_ = (
        ("buffer", ctypes.c_char_p),
        ("length", ctypes.c_size_t),
        ("capacity", ctypes.c_size_t),
        ("allocator", ctypes.c_void_p * 5),
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
    find, publish, told, forget = _functions()
    given = _Octets(octets, len(octets), len(octets))
    with publisher.handle:
        native = find(publisher.handle.pointer)
        failed = native is None or publish(native, ctypes.byref(given), None)
    if failed:
        why = told().text.decode(errors="replace")
        forget()  # else the next one is told on the terminal, too
        raise OSError(why or "the middleware takes no message any more")
