"""Errors of this plugin that a program may want to catch by kind."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from uoarm.errors import BridgeError, FailureReason

__all__ = ["IdlError"]


class IdlError(BridgeError):
    """A service raised an exception that its IDL declares.

    Attributes:
        exception: repository id, `IDL:Arm/OutOfReach:1.0`.
        members: its members, as a message.
    """

    def __init__(self, text: str, exception: str, members: Mapping[str, Any]) -> None:
        super().__init__(text, FailureReason.REFUSED)
        self.exception = exception
        self.members = members
