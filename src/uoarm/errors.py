"""Every error that uoarm raises on purpose.

UoarmError
├── ConfigurationError     the configuration author: wrong file, key, reference, cycle
├── PluginError            the operator: bridge plugin missing, broken, of another contract
├── ResolutionError        the configuration author or operator: no plan fits, with reasons
├── BridgeError            the operator or plugin author: a framework said no, raised, lied
│   └── BridgeTimeoutError     ... or did not answer within its limit
├── MessageError           the sender: a message does not match its declared structure
├── CommandRefusedError    the sender: what would move something came too late, or may not be
├── ControlMessageError    the client: a control message that cannot be read
├── ConnectionClosedError  the caller: the handle or manager was closed before the call
└── UsageError             the caller: an operation that this connection does not have

`BridgeError.reason` says which kind of failure it was, for programs that must branch on it.
"""

from __future__ import annotations

from enum import Enum

__all__ = [
    "BridgeError",
    "BridgeTimeoutError",
    "CommandRefusedError",
    "ConfigurationError",
    "ConnectionClosedError",
    "ControlMessageError",
    "FailureReason",
    "MessageError",
    "PluginError",
    "ResolutionError",
    "UoarmError",
    "UsageError",
]


class UoarmError(Exception):
    """The root of every error that this library raises on purpose."""


class ConfigurationError(UoarmError, ValueError):
    """The configuration cannot be used; the text lists every mistake with its place."""


class PluginError(UoarmError):
    """A bridge plugin is missing, broken, or implements another contract version."""


class ResolutionError(UoarmError):
    """No plan satisfies the request; the text says for every candidate why."""


class FailureReason(Enum):
    """Why a bridge could not do what it was asked."""

    NOT_FOUND = "not_found"
    UNAVAILABLE = "unavailable"
    UNSUPPORTED = "unsupported"
    REFUSED = "refused"
    BAD_ENDPOINT = "bad_endpoint"
    BAD_MESSAGE = "bad_message"
    CLOSED = "closed"
    TIMEOUT = "timeout"
    RAISED = "raised"
    CONTRACT = "contract"


class BridgeError(UoarmError):
    """A bridge could not do a step.

    Attributes:
        reason: the kind of failure.
    """

    def __init__(self, text: str, reason: FailureReason = FailureReason.RAISED) -> None:
        super().__init__(text)
        self.reason = reason


class BridgeTimeoutError(BridgeError, TimeoutError):
    """A bridge did not finish a step within its time limit; the step was abandoned."""

    def __init__(self, text: str) -> None:
        super().__init__(text, FailureReason.TIMEOUT)


class MessageError(UoarmError, ValueError):
    """A message does not match the structure that its port declares."""


class CommandRefusedError(UoarmError):
    """A command to an input that moves something was not sent.

    Attributes:
        reason: `late`, `beyond-limits`, `stopping`, `held` (the emergency stop is not released),
            `leased` (another client commands the input), `stopped` (its sender stopped while it
            waited) or `closed`: by it the command counts as dropped.
    """

    def __init__(self, text: str, reason: str) -> None:
        super().__init__(text)
        self.reason = reason


class ControlMessageError(UoarmError, ValueError):
    """A control message cannot be read; the text names the field and what was expected."""


class ConnectionClosedError(UoarmError):
    """The connection or the manager is closed; the text says why."""


class UsageError(UoarmError, TypeError):
    """The operation does not exist on this function, for example `send` without an input."""
