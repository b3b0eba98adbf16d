"""Faults on demand: a step of any bridge raises, hangs or lies while a `with` block runs.

Each replaces one raw step (`_describe`, `_open_sink`, ...) of one bridge instance, below the
core's final methods, which is where a framework would fail. What a real framework does beside
(print, crash the process, hold the interpreter) is not imitated.
"""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

from uoarm._arguments import arguments
from uoarm.bridge import Bridge, Channel
from uoarm.testing._time import patience

__all__ = ["Hang", "hanging", "lying", "raising"]


class Hang:
    """A step that hangs until it is released.

    Attributes:
        entered: set when the step was called and hangs.
    """

    def __init__(self) -> None:
        self.entered = threading.Event()
        self._released = threading.Event()

    def release(self) -> None:
        """Let the step go on."""
        self._released.set()

    def wait(self) -> None:
        """Hang here; for use as a step."""
        self.entered.set()
        self._released.wait(2 * patience())  # longer than the test waits for what hangs here


@arguments()
@contextmanager
def raising(subject: Bridge | Channel, step: str, error: BaseException) -> Iterator[None]:
    """Have a step raise, as a framework does that is broken or offline."""

    def fail(*_: Any, **__: Any) -> Any:
        raise error

    with _replaced(subject, step, lambda _: fail):
        yield


@arguments()
@contextmanager
def hanging(subject: Bridge | Channel, step: str) -> Iterator[Hang]:
    """Have a step hang until `release`, or the end of the block, and then do its work."""
    hang = Hang()

    def stuck(original: Callable[..., Any]) -> Callable[..., Any]:
        def step_of_fault(*given: Any, **named: Any) -> Any:
            hang.wait()
            return original(*given, **named)

        return step_of_fault

    with _replaced(subject, step, stuck):
        try:
            yield hang
        finally:
            hang.release()


@arguments()
@contextmanager
def lying(subject: Bridge | Channel, step: str, answer: object) -> Iterator[None]:
    """Have a step return something that the contract does not allow."""
    with _replaced(subject, step, lambda _: lambda *_, **__: answer):
        yield


@contextmanager
def _replaced(
    subject: Bridge | Channel,
    step: str,
    replace: Callable[[Callable[..., Any]], Callable[..., Any]],
) -> Iterator[None]:
    original = getattr(subject, step, None)
    if not callable(original):
        raise ValueError(f"{type(subject).__name__} has no step {step!r}")  # noqa: TRY004
    before = vars(subject).get(step)
    setattr(subject, step, replace(original))
    try:
        yield
    finally:
        if before is None:
            delattr(subject, step)
        else:
            setattr(subject, step, before)
