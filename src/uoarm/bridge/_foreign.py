"""The one border at which foreign exceptions become ours."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

from uoarm._raised import ContainedError, contained, from_own_frames, text_of
from uoarm._support.deadlines import BoundedStep
from uoarm.errors import BridgeError, FailureReason, UoarmError
from uoarm.model import Endpoint

__all__ = ["reading_endpoint", "translated"]


class translated:  # noqa: N801 - read as a block's beginning, as those of contextlib are
    """Turns whatever a bridge raises into a BridgeError with the step's name, cause kept.

    Errors of uoarm pass as they are, and what interrupts the main thread for the user. A class,
    since each opening enters one, and a generator takes twice as long.
    """

    __slots__ = ("_step",)

    def __init__(self, step: str | BoundedStep) -> None:
        self._step = step

    def __enter__(self) -> None:
        pass

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: object
    ) -> None:
        if error is None:
            return
        raised = contained(error)
        if isinstance(raised, ContainedError) or not isinstance(raised, UoarmError):
            text = f"{self._step} failed: {text_of(raised)}"
            raise BridgeError(text, FailureReason.RAISED) from from_own_frames(error)


@contextmanager
def reading_endpoint(endpoint: Endpoint) -> Iterator[None]:
    """Read an endpoint's address or options: a ValueError becomes a BridgeError that names it.

    Raises:
        BridgeError: with BAD_ENDPOINT, the endpoint, and the sentence of the ValueError.
    """
    try:
        yield
    except ValueError as error:
        text = f"bridge {endpoint.bridge!r}: {endpoint}: {error}"
        raise BridgeError(text, FailureReason.BAD_ENDPOINT) from None
