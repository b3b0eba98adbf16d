"""The one border at which exceptions of CORBA become ours."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

from omniORB import CORBA

from uoarm.errors import BridgeError, BridgeTimeoutError, FailureReason
from uoarm_rtm._calls import calls

__all__ = ["corba_errors", "corba_text"]

_GONE = (CORBA.COMM_FAILURE, CORBA.TRANSIENT, CORBA.OBJECT_NOT_EXIST, CORBA.INV_OBJREF)


@contextmanager
def corba_errors(what: str) -> Iterator[None]:
    """Turn CORBA's exceptions into a BridgeError that begins with what was being done.

    TIMEOUT becomes BridgeTimeoutError, a peer that is gone UNAVAILABLE, an answer or request
    that its stub does not understand REFUSED, anything else RAISED.
    """
    try:
        with calls:
            yield
    except CORBA.TIMEOUT as error:
        raise BridgeTimeoutError(f"{what}: no answer within the time limit") from error
    except _GONE as error:
        text = f"{what}: the other side is gone ({corba_text(error)})"
        raise BridgeError(text, FailureReason.UNAVAILABLE) from error
    except (CORBA.MARSHAL, CORBA.BAD_PARAM, CORBA.BAD_OPERATION) as error:
        text = f"{what}: the two sides do not understand each other ({corba_text(error)})"
        raise BridgeError(text, FailureReason.REFUSED) from error
    except CORBA.Exception as error:
        raise BridgeError(f"{what}: {corba_text(error)}", FailureReason.RAISED) from error


def corba_text(error: CORBA.Exception) -> str:
    """Return the name of a CORBA exception, with its minor code where that has a name."""
    text = type(error).__name__
    if isinstance(error, CORBA.SystemException):
        name = str(getattr(error, "_NP_RepositoryId", text)).split("/")[-1].split(":")[0]
        return f"{name}, {error.minor}" if error.minor else name
    return text
