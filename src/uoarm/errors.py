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
├── UsageError             the caller: an operation that this connection does not have
├── ListenError            the operator: a port is taken, or may not be listened on
└── CommandLineError       who typed a command: its words are wrong, or it cannot do its work

`BridgeError.reason` says which kind of failure it was, for programs that must branch on it.
`UoarmError.error_code` is what `uoarm explain` explains (`uoarm.error_codes`).
"""

from __future__ import annotations

import errno
import os
from collections.abc import Mapping
from enum import Enum

from uoarm._encodable import in_short_lines

__all__ = [
    "BridgeError",
    "BridgeTimeoutError",
    "CommandLineError",
    "CommandRefusedError",
    "ConfigurationError",
    "ConnectionClosedError",
    "ControlMessageError",
    "FailureReason",
    "ListenError",
    "MessageError",
    "PluginError",
    "ResolutionError",
    "UoarmError",
    "UsageError",
]


class UoarmError(Exception):
    """The root of every error that this library raises on purpose.

    Args:
        text: what is wrong, and what to do; "": the name of the class. Of a line of more than 2,000
            characters the middle is left out.
        error_code: where it is a more special one than that of the class.

    Attributes:
        error_code: stable, for programs and for `uoarm explain`, such as `UOA-201`.
    """

    error_code = "UOA-001"

    def __init__(self, text: str = "", *, error_code: str = "") -> None:
        super().__init__(in_short_lines(str(text)) or type(self).__name__)
        if error_code:
            self.error_code = error_code

    def __reduce__(self) -> tuple[object, ...]:
        # Copies are made without `__init__`, whose arguments are those of the class, not `args`.
        return _copied, (type(self), self.args), self.__dict__


def _copied(kind: type[UoarmError], args: tuple[object, ...]) -> UoarmError:
    error = kind.__new__(kind)
    error.args = args
    return error


class ConfigurationError(UoarmError, ValueError):
    """The configuration cannot be used; the text lists every mistake with its place."""

    error_code = "UOA-100"


class PluginError(UoarmError):
    """A bridge plugin is missing, broken, or implements another contract version."""

    error_code = "UOA-301"


class ResolutionError(UoarmError):
    """No plan satisfies the request; the text says for every candidate why."""

    error_code = "UOA-201"


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


_BRIDGE_CODES = {
    FailureReason.NOT_FOUND: "UOA-401",
    FailureReason.UNAVAILABLE: "UOA-402",
    FailureReason.UNSUPPORTED: "UOA-403",
    FailureReason.REFUSED: "UOA-404",
    FailureReason.BAD_ENDPOINT: "UOA-405",
    FailureReason.BAD_MESSAGE: "UOA-406",
    FailureReason.CLOSED: "UOA-407",
    FailureReason.TIMEOUT: "UOA-408",
    FailureReason.RAISED: "UOA-409",
    FailureReason.CONTRACT: "UOA-410",
}


class BridgeError(UoarmError):
    """A bridge could not do a step.

    Attributes:
        reason: the kind of failure.
    """

    def __init__(self, text: str, reason: FailureReason = FailureReason.RAISED) -> None:
        super().__init__(text, error_code=_BRIDGE_CODES[reason])
        self.reason = reason


class BridgeTimeoutError(BridgeError, TimeoutError):
    """A bridge did not finish a step within its time limit; the step was abandoned."""

    def __init__(self, text: str) -> None:
        super().__init__(text, FailureReason.TIMEOUT)


class MessageError(UoarmError, ValueError):
    """A message does not match the structure that its port declares."""

    error_code = "UOA-501"


_COMMAND_CODES = {
    "late": "UOA-601",
    "beyond-limits": "UOA-602",
    "stopping": "UOA-603",
    "held": "UOA-604",
    "leased": "UOA-605",
    "stopped": "UOA-606",
    "closed": "UOA-607",
}


class CommandRefusedError(UoarmError):
    """A command to an input that moves something was not sent.

    Attributes:
        reason: `late`, `beyond-limits`, `stopping`, `held` (the emergency stop is not released),
            `leased` (another client commands the input), `stopped` (its sender stopped while it
            waited) or `closed`: by it the command counts as dropped.
    """

    def __init__(self, text: str, reason: str) -> None:
        super().__init__(text, error_code=_COMMAND_CODES.get(reason, ""))
        self.reason = reason


class ControlMessageError(UoarmError, ValueError):
    """A control message cannot be read; the text names the field and what was expected."""

    error_code = "UOA-502"


class ConnectionClosedError(UoarmError):
    """The connection or the manager is closed; the text says why."""

    error_code = "UOA-504"


class UsageError(UoarmError, TypeError):
    """The operation does not exist on this function, for example `send` without an input."""

    error_code = "UOA-503"


class ListenError(UoarmError, OSError):
    """A server cannot listen; the text says where, and why.

    Args:
        place: host and port, as text.
        port: of the place.
        cause: what the system said.

    Attributes:
        port: on which it would have listened.
    """

    error_code = "UOA-709"

    def __init__(self, place: str, port: int, cause: OSError) -> None:
        number = cause.errno or 0  # of the resolver's errors it is negative
        reason = os.strerror(number) if number > 0 else cause.strerror or str(cause)
        super().__init__(f"cannot listen on {place}: {reason}")
        self.errno = number
        self.port = port

    def __reduce__(self) -> tuple[object, ...]:
        return *super().__reduce__()[:2], {**self.__dict__, "errno": self.errno}

    def name_option(self, options: Mapping[int, str]) -> None:
        """Say in the text which of a command's options, by their ports, takes another port."""
        if self.errno == errno.EADDRINUSE:
            self.args = (f"{self}; {options[self.port]} takes another",)


class CommandLineError(UoarmError):
    """The words of a command are wrong, or it ends with an exit code of its own.

    Args:
        text: what is wrong.
        exit_code: of the command; 2 is that of wrong words.
        error_code: where it is another one than that of wrong words.

    Attributes:
        exit_code: of the command.
    """

    error_code = "UOA-002"

    def __init__(self, text: str, *, exit_code: int = 2, error_code: str = "") -> None:
        super().__init__(text, error_code=error_code)
        self.exit_code = exit_code
