"""What foreign code raised: whose failure it is, its text, and a log that it does not flood."""

from __future__ import annotations

import logging
import threading
import time
from collections.abc import Callable

from uoarm.errors import BridgeError, FailureReason, UoarmError

__all__ = ["LimitedLog", "is_raised", "text_of"]

_LENGTH = 1000
_OWN = frozenset({FailureReason.RAISED, FailureReason.BAD_MESSAGE, FailureReason.CONTRACT})
_RECORD_SECONDS = 10.0


def is_raised(error: BaseException) -> bool:
    """Say whether who raised this has failed, and not what it was given or the link to it.

    A MessageError is about the message, and a BridgeError for what is closed or not available is
    about the way there, of which its bridge reports.
    """
    if isinstance(error, BridgeError):
        return error.reason in _OWN
    return not isinstance(error, UoarmError)


def text_of(error: BaseException) -> str:
    """Return type and text of an error, a thousand characters at most. Never raises."""
    try:
        text = f"{type(error).__name__}: {error}"
    except Exception as other:  # noqa: BLE001 - foreign, as the error is
        text = f"{type(error).__name__}, whose text raised {type(other).__name__}"
    return text[:_LENGTH]


class LimitedLog:
    """Writes the first of many like records, and then as many in ten seconds. Thread safe.

    A record says how many were left out since the one before it.

    Args:
        logger: where records go, or its name: many of these never write anything.
        burst: how many records in ten seconds.
        clock: seconds.
    """

    _lock = threading.Lock()  # one for all: there are thousands of these, and few write
    _room = 0
    _next: float | None = None
    _left_out = 0

    def __init__(
        self,
        logger: logging.Logger | str,
        burst: int = 1,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self._logger = logger
        self._burst = burst
        self._clock = clock

    def write(self, level: int, text: str, error: BaseException | None = None) -> None:
        """Write a record, with the traceback of an error, or count it as left out."""
        now = self._clock()
        with self._lock:
            if self._next is None or now >= self._next:
                self._next, self._room = now + _RECORD_SECONDS, self._burst
            if not self._room:
                self._left_out += 1
                return
            self._room -= 1
            left_out, self._left_out = self._left_out, 0
        more = f" (and {left_out} more since the last record)" if left_out else ""
        logger = self._logger
        if isinstance(logger, str):
            logger = logging.getLogger(logger)
        logger.log(level, "%s%s", text, more, exc_info=error)
