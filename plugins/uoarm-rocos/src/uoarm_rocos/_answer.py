"""One question to a device and the answer that is waited for."""

from __future__ import annotations

import threading
from typing import Any

from uoarm.errors import BridgeError, FailureReason
from uoarm_rocos._messages import ErrorCode, ErrorMessage

__all__ = ["Answer", "refusal"]

_REASONS = {
    ErrorCode.PROFILE: FailureReason.UNSUPPORTED,
    ErrorCode.UNKNOWN_API: FailureReason.NOT_FOUND,
    ErrorCode.BAD_INPUT: FailureReason.BAD_MESSAGE,
    ErrorCode.BUSY: FailureReason.REFUSED,
    ErrorCode.CANCELLED: FailureReason.REFUSED,
    ErrorCode.FAILED: FailureReason.RAISED,
    ErrorCode.LIMIT: FailureReason.BAD_MESSAGE,
}


class Answer:
    """Waited for by one thread, given once by another."""

    def __init__(self) -> None:
        self._given = threading.Event()
        self._value: Any = None
        self._error: BridgeError | None = None

    def give(self, value: Any) -> None:
        """Answer."""
        self._value = value
        self._given.set()

    def fail(self, error: BridgeError) -> None:
        """Answer that there is none."""
        self._error = error
        self._given.set()

    def wait(self, timeout: float) -> bool:
        """Wait so many seconds; return whether there is an answer."""
        return self._given.wait(timeout)

    def value(self) -> Any:
        """Return the answer that was given.

        Raises:
            BridgeError: there is none; the text says why.
        """
        if self._error is not None:
            raise self._error
        return self._value


def refusal(message: ErrorMessage, what: str) -> BridgeError:
    """Return the error that a device's `error` message is."""
    text = f"{what}: the device says {message.code.value}: {message.text or 'no reason given'}"
    return BridgeError(text, _REASONS[message.code])
