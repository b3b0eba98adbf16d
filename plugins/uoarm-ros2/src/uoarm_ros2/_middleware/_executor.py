"""The two executors of rclpy that a station can have."""

from __future__ import annotations

import faulthandler
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

from rclpy.executors import SingleThreadedExecutor

try:
    from rclpy.experimental.events_executor import EventsExecutor
except ImportError:
    EventsExecutor = None

__all__ = ["has_events_executor", "new_executor"]


def has_events_executor() -> bool:
    """Whether this rclpy has an events executor."""
    return EventsExecutor is not None


def new_executor(kind: str, context: Any) -> Any:
    """Return an executor: `standard` or `events`.

    Raises:
        RuntimeError: this rclpy has no events executor.
    """
    if kind == "standard":
        return SingleThreadedExecutor(context=context)
    if EventsExecutor is None:
        raise RuntimeError("this rclpy has no events executor; set executor: standard")
    with _same_faulthandler():
        return EventsExecutor(context=context)


@contextmanager
def _same_faulthandler() -> Iterator[None]:
    """Undo what making an events executor does to the whole process."""
    before = faulthandler.is_enabled()
    yield
    if not before:
        faulthandler.disable()
