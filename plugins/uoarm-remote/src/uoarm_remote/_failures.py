"""Errors of another manager as those of a bridge: whose they are, and of which kind."""

from __future__ import annotations

from collections.abc import Mapping

from uoarm.client import ServerError
from uoarm.errors import (
    BridgeError,
    BridgeTimeoutError,
    CommandRefusedError,
    ConfigurationError,
    ConnectionClosedError,
    FailureReason,
    MessageError,
    PluginError,
    ResolutionError,
    UoarmError,
    UsageError,
)

__all__ = ["translated"]

_REASONS: Mapping[type[UoarmError], FailureReason] = {
    ResolutionError: FailureReason.UNAVAILABLE,
    ConnectionClosedError: FailureReason.UNAVAILABLE,
    UsageError: FailureReason.BAD_ENDPOINT,
    ConfigurationError: FailureReason.UNAVAILABLE,
    PluginError: FailureReason.UNAVAILABLE,
}
_SERVER_REASONS: Mapping[str, FailureReason] = {"denied": FailureReason.NOT_FOUND}


def translated(place: str, error: UoarmError) -> UoarmError:
    """Return what a bridge raises for an error that came over the link.

    A message that does not fit, and a command that is refused there, stay what they are: they are
    no failure of the link or of the component.
    """
    text = f"{place}: {error}"
    if isinstance(error, MessageError):
        return MessageError(text)
    if isinstance(error, CommandRefusedError):
        return CommandRefusedError(text, error.reason)
    if isinstance(error, BridgeTimeoutError):
        return BridgeTimeoutError(text)
    if isinstance(error, BridgeError):
        return BridgeError(text, error.reason)
    if isinstance(error, ServerError):
        return BridgeError(text, _SERVER_REASONS.get(error.code, FailureReason.REFUSED))
    kinds = (reason for kind, reason in _REASONS.items() if isinstance(error, kind))
    return BridgeError(text, next(kinds, FailureReason.REFUSED))
