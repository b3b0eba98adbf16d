"""Errors as clients receive them: a code to branch on and a text to read."""

from __future__ import annotations

import logging
from collections.abc import Mapping
from typing import TypeAlias

from uoarm import errors
from uoarm._raised import LimitedLog
from uoarm.server.access import DeniedError

_log = logging.getLogger("uoarm.server")
_records = LimitedLog(_log, burst=16)


class BusyError(errors.UoarmError):
    """Every worker is taken; nothing was begun. Ask again later."""

    error_code = "UOA-701"


class LimitError(errors.UoarmError):
    """A client wants more than it may have at one time."""

    error_code = "UOA-702"


class UnknownError(errors.UoarmError):
    """There is nothing of that name among what this client may see."""

    error_code = "UOA-703"


_Kinds: TypeAlias = Mapping[type[Exception], str]

# The first that fits holds: subclasses stand before their bases.
_CODES: _Kinds = {
    errors.ControlMessageError: "unreadable",
    UnknownError: "unknown",
    DeniedError: "denied",
    errors.ConfigurationError: "configuration",
    errors.ResolutionError: "resolution",
    errors.BridgeTimeoutError: "timeout",
    errors.BridgeError: "bridge",
    errors.PluginError: "bridge",
    errors.MessageError: "message",
    errors.CommandRefusedError: "refused",
    errors.UsageError: "usage",
    errors.ConnectionClosedError: "closed",
    LimitError: "limit",
    BusyError: "busy",
}

_REFUSALS = frozenset({"held", "leased"})
"""Reasons for which a command is refused that clients distinguish."""


def code_of(error: BaseException) -> str:
    """Return the code of an error; `internal` for an unforeseen one."""
    if isinstance(error, errors.CommandRefusedError) and error.reason in _REFUSALS:
        return error.reason
    return next((code for kind, code in _CODES.items() if isinstance(error, kind)), "internal")


def error_code_of(error: BaseException) -> str:
    """Return the code that `uoarm explain` explains."""
    return error.error_code if isinstance(error, errors.UoarmError) else "UOA-708"


def without_frames(error: Exception) -> Exception:
    """Return an error without what it knows of its raising.

    The frames of a decoder, and the causes of its errors, hold the message. They hold the job of
    its thread, too, whose result is the error: only the garbage collector breaks that circle.
    """
    error.__cause__ = error.__context__ = None
    return error.with_traceback(None)


def error_text(error: BaseException) -> str:
    """Return an error's text; of an unforeseen one, log it and say no more than that."""
    if isinstance(error, errors.UoarmError):
        return str(error)
    _records.write(logging.ERROR, "the server failed", error)
    return "the server failed; its log says more"


def coded_text(error: BaseException) -> str:
    """Return an error's text, with the code that `uoarm explain` explains.

    For protocols whose errors are a text, and have no place for a code.
    """
    return f"{error_text(error)} ({error_code_of(error)})"
