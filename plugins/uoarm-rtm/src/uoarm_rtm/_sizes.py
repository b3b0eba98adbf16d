# ruff: noqa: SLF001 - CORBA begins the names of its own operations with an underscore
"""How large a message a peer takes: learnt, since no profile says.

An ORB has a limit for one GIOP message, of omniORB 2 MiB unless it is configured. A larger one
makes the receiver close the connection (observed), which looks like its death: only a further
call finds out. What a limit refuses is a fault of the message, never of the component.
"""

from __future__ import annotations

from typing import Any

from omniORB import CORBA

from uoarm_rtm._calls import calls

__all__ = ["SizeLimit", "is_there"]

_SURELY_FITS = 1 << 16
_HINT = "omniORB's own limit is 2097152, the option -ORBgiopMaxMsgSize of that process raises it"


def is_there(target: Any) -> bool:
    """Whether an object answers, which must have its time limit set."""
    try:
        with calls:
            return not target._non_existent()
    except CORBA.Exception:
        return False


class SizeLimit:
    """What is known of the limit of one peer. Used by one thread at a time.

    Args:
        where: the port, for errors.
        ours: octets that our own ORB sends at most.
    """

    def __init__(self, where: str, ours: int) -> None:
        self._where = where
        self._ours = ours
        self._passed = 0
        self._refused: int | None = None

    def refusal(self, size: int) -> str:
        """Return why a message of this size need not be tried; empty for one that may pass."""
        if self._refused is None or size < self._refused:
            return ""
        return (
            f"{self._where} does not take a message of {size} octets: up to {self._passed} passed, "
            f"{self._refused} did not; {_HINT}"
        )

    def passed(self, size: int) -> None:
        """Note that a message of this size passed."""
        self._passed = max(self._passed, size)

    def explain(self, error: CORBA.Exception, target: Any, size: int) -> str:
        """Return why a message did not pass, where its size was the reason; empty otherwise.

        Args:
            error: with which the call ended.
            target: the object called, with its time limit; it is asked whether it is alive.
            size: octets of the message.
        """
        if isinstance(error, CORBA.MARSHAL) and error.completed == CORBA.COMPLETED_NO:
            if size <= max(self._passed, _SURELY_FITS):
                return ""
            text = f"a message of {size} octets is larger than our own limit of {self._ours}"
            return f"{self._where}: {text}: the bridge's option `max_message` raises it"
        if not isinstance(error, CORBA.COMM_FAILURE) or size <= max(self._passed, _SURELY_FITS):
            return ""
        if not is_there(target):
            return ""
        self._refused = min(size, self._refused or size)
        return self.refusal(size)
