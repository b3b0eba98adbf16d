"""What rclpy raises of handles and contexts that have ended, as errors that say so."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

from rclpy.exceptions import InvalidHandle
from rclpy.impl.implementation_singleton import rclpy_implementation as _rclpy

from uoarm.errors import BridgeError, FailureReason

__all__ = ["rclpy_errors"]


@contextmanager
def rclpy_errors(what: str) -> Iterator[None]:
    """Have what rclpy raises in a block be an error that names it.

    Threads of ours may ask for something while, or after, another one closes the bridge, or
    rclpy's signal handlers end its context.

    Raises:
        BridgeError: with CLOSED, the handle was put away; with RAISED, anything else.
    """
    try:
        yield
    except InvalidHandle:
        raise BridgeError(f"{what}: the bridge was closed", FailureReason.CLOSED) from None
    except _rclpy.RCLError as error:
        raise BridgeError(f"{what}: {error}", FailureReason.RAISED) from error
