"""Spans of OpenTelemetry, in applications that use it."""

from __future__ import annotations

import sys
import time
from contextlib import AbstractContextManager, nullcontext
from typing import Any

from uoarm._version import __version__


def span(name: str, context: Any = None, **attributes: str) -> AbstractContextManager[Any]:
    """Return a span around a block, which also notes what the block raises.

    Nothing is imported here: only an application that has imported OpenTelemetry can have said
    where its spans go. Without it, the block runs as it is.

    Args:
        name: of the span, without `uoarm.`.
        context: what it belongs to, as `current` gave it; None: the span around the caller.
        attributes: of the span; their names get the same prefix.
    """
    tracer = _tracer()
    if tracer is None:
        return nullcontext()
    whole: AbstractContextManager[Any] = tracer.start_as_current_span(
        f"uoarm.{name}", context=context, attributes=_named(attributes)
    )
    return whole


def past_span(name: str, seconds: float, context: Any = None, **attributes: str) -> None:
    """Record a span that ends now and began so many seconds ago."""
    tracer = _tracer()
    if tracer is not None:
        end = time.time_ns()
        start = end - max(0, int(1e9 * seconds))
        tracer.start_span(
            f"uoarm.{name}", context=context, attributes=_named(attributes), start_time=start
        ).end(end)


def current() -> Any:
    """Return what spans of other threads may belong to: the span around the caller."""
    get = _of("opentelemetry.context", "get_current")
    return None if get is None else get()


def _tracer() -> Any:
    get = _of("opentelemetry.trace", "get_tracer")
    return None if get is None else get("uoarm", __version__)


def _of(module: str, name: str) -> Any:
    """Return what a module has; None where it is not imported, or another thread is at it."""
    return getattr(sys.modules.get(module), name, None)


def _named(attributes: dict[str, str]) -> dict[str, str]:
    return {f"uoarm.{name}": value for name, value in attributes.items()}
