"""Errors that cross the link: kind, text and reason stay as they were."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from uoarm import errors
from uoarm.errors import BridgeError, BridgeTimeoutError, FailureReason, UoarmError

__all__ = ["from_failure", "to_failure"]

_KINDS: dict[str, type[UoarmError]] = {
    kind.__name__: kind
    for kind in vars(errors).values()
    if isinstance(kind, type) and issubclass(kind, UoarmError)
}


def to_failure(error: BaseException) -> dict[str, str]:
    """Return an error as plain values; a foreign one becomes a BridgeError that names it."""
    if isinstance(error, BridgeError):
        return {"kind": type(error).__name__, "text": str(error), "reason": error.reason.value}
    if isinstance(error, UoarmError):
        return {"kind": type(error).__name__, "text": str(error)}
    text = f"the bridge host failed: {type(error).__name__}: {error}"
    return {"kind": "BridgeError", "text": text, "reason": FailureReason.RAISED.value}


def from_failure(failure: Mapping[str, Any]) -> UoarmError:
    """Return the error that `to_failure` described; an unknown kind becomes a BridgeError."""
    text = str(failure.get("text"))
    kind = _KINDS.get(str(failure.get("kind")), BridgeError)
    if issubclass(kind, BridgeTimeoutError):
        return BridgeTimeoutError(text)
    if issubclass(kind, BridgeError):
        try:
            return BridgeError(text, FailureReason(failure.get("reason")))
        except ValueError:
            return BridgeError(text)
    return kind(text)
