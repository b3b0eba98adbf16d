"""Publishing after the context has ended, as rclpy's signal handlers end every one of a process.

The client library then refuses every message, also the one that stops a robot, although publisher
and participant are still there. So the message goes by the middleware's own interface (rmw).
"""

from __future__ import annotations

import ctypes
from typing import Any

from rclpy import get_rmw_implementation_identifier
from rclpy.serialization import serialize_message

__all__ = ["publish_after_the_end"]


class _Octets(ctypes.Structure):
    """`rcutils_uint8_array_t`; the allocator is used for growing alone, which nobody does here."""

    _fields_ = (
        ("buffer", ctypes.c_char_p),
        ("length", ctypes.c_size_t),
        ("capacity", ctypes.c_size_t),
        ("allocator", ctypes.c_void_p * 5),
    )


def publish_after_the_end(publisher: Any, message: Any) -> None:
    """Publish a native object, or octets that are serialised already.

    Raises:
        OSError: the middleware takes nothing, or its libraries are not found.
    """
    octets = message if isinstance(message, bytes) else serialize_message(message)
    find = ctypes.CDLL("librcl.so").rcl_publisher_get_rmw_handle
    find.restype, find.argtypes = ctypes.c_void_p, (ctypes.c_void_p,)
    name = get_rmw_implementation_identifier()
    publish = ctypes.CDLL(f"lib{name}.so").rmw_publish_serialized_message
    publish.argtypes = (ctypes.c_void_p, ctypes.POINTER(_Octets), ctypes.c_void_p)
    given = _Octets(octets, len(octets), len(octets))
    with publisher.handle:
        native = find(publisher.handle.pointer)
        failed = native is None or publish(native, ctypes.byref(given), None)
    if failed:
        raise OSError("the middleware takes no message any more")
