"""One question to a device and the answer that is waited for."""

from __future__ import annotations

import threading
from typing import Any

from uoarm.errors import BridgeError, FailureReason
from uoarm_rocos._messages import ErrorCode, ErrorMessage

__all__ = ["Answer", "Answers", "refusal"]

_MOST = 1000
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
        self._given = threading.Lock()
        self._given.acquire()
        self._value: Any = None
        self._error: BridgeError | None = None

    def give(self, value: Any) -> None:
        """Answer."""
        self._value = value
        self._given.release()

    def fail(self, error: BridgeError) -> None:
        """Answer that there is none."""
        self._error = error
        self._given.release()

    def is_given(self) -> bool:
        """Say whether there is an answer, or an error in its place."""
        return not self._given.locked()

    def wait(self, timeout: float) -> bool:
        """Wait so many seconds, once; return whether there is an answer."""
        return self._given.acquire(timeout=timeout)

    def value(self) -> Any:
        """Return the answer that was given.

        Raises:
            BridgeError: there is none; the text says why.
        """
        if self._error is not None:
            raise self._error
        return self._value


class Answers:
    """What one device is asked now, by the id of the conversation; any thread.

    Args:
        name: of the device, for errors.
    """

    def __init__(self, name: str) -> None:
        self._name = name
        self._lock = threading.Lock()
        self._waiting: dict[int, tuple[Answer, str]] = {}

    def expect(self, identity: int, what: str) -> Answer:
        """Wait for an answer from now on; `what` is asked.

        Raises:
            BridgeError: too many wait already.
        """
        answer = Answer()
        with self._lock:
            if len(self._waiting) >= _MOST:
                text = f"{what}: {_MOST} questions already wait for {self._name}"
                raise BridgeError(text, FailureReason.REFUSED)
            self._waiting[identity] = (answer, what)
        return answer

    def forget(self, identity: int) -> bool:
        """Wait no longer; return whether anybody did."""
        with self._lock:
            return self._waiting.pop(identity, None) is not None

    def give(self, identity: int, value: Any) -> bool:
        """Answer; return whether anybody waited."""
        with self._lock:
            found = self._waiting.pop(identity, None)
        if found is not None:
            found[0].give(value)
        return found is not None

    def refuse(self, message: ErrorMessage) -> bool:
        """Answer with the device's error; return whether anybody waited."""
        with self._lock:
            found = self._waiting.pop(message.id, None)
        if found is not None:
            found[0].fail(refusal(message, found[1]))
        return found is not None

    def fail(self, error: BridgeError) -> None:
        """Answer everything with an error."""
        with self._lock:
            waiting, self._waiting = list(self._waiting.values()), {}
        for answer, _ in waiting:
            answer.fail(error)


def refusal(message: ErrorMessage, what: str) -> BridgeError:
    """Return the error that a device's `error` message is."""
    text = f"{what}: the device says {message.code.value}: {message.text or 'no reason given'}"
    return BridgeError(text, _REASONS[message.code])
