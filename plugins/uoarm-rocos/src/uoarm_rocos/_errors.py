"""What can be wrong with octets from a line, or with the line itself."""

from __future__ import annotations

from uoarm.errors import BridgeError, FailureReason

__all__ = ["LineError", "WireError"]


class WireError(BridgeError):
    """A frame or message breaks the protocol; the text says where and what was expected."""

    def __init__(self, text: str) -> None:
        super().__init__(text, FailureReason.BAD_MESSAGE)


class LineError(BridgeError):
    """The line is not there, was cut, or takes nothing any more; the cause is chained."""

    def __init__(self, text: str) -> None:
        super().__init__(text, FailureReason.UNAVAILABLE)
