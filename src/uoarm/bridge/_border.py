"""The one border at which foreign exceptions become ours."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

from uoarm.errors import BridgeError, FailureReason, UoarmError

__all__ = ["translated"]


@contextmanager
def translated(step: str) -> Iterator[None]:
    """Turn whatever a bridge raises into a BridgeError with the step's name, cause kept.

    Errors of uoarm pass as they are; KeyboardInterrupt and SystemExit do too.
    """
    try:
        yield
    except UoarmError:
        raise
    except Exception as error:
        text = f"{step} failed: {type(error).__name__}: {error}"
        raise BridgeError(text, FailureReason.RAISED) from error
