"""Through which managers a question came, so that a bridge to another leads back to none."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar

from uoarm.errors import BridgeError, FailureReason

__all__ = ["MOST_HOPS", "asking", "asking_managers", "refuse_loop"]

MOST_HOPS = 8
"""Managers through which a message or a question may pass, the first and the last included."""

_asking: ContextVar[tuple[str, ...]] = ContextVar("uoarm-asking-managers", default=())


def asking_managers() -> tuple[str, ...]:
    """Return the identities of the managers whose question is answered here, the first one first.

    Empty where an application of this process asks, and where the manager itself does.
    """
    return _asking.get()


@contextmanager
def asking(managers: tuple[str, ...]) -> Iterator[None]:
    """Answer a question of other managers, for the length of a block and in what it starts."""
    token = _asking.set(managers)
    try:
        yield
    finally:
        _asking.reset(token)


def refuse_loop(what: str, way: tuple[str, ...]) -> None:
    """Refuse a way through managers that comes back to one of them, or is too long.

    Args:
        what: is reached on it, for the error's text.
        way: identities, in order.

    Raises:
        BridgeError: it is refused; the text shows the way.
    """
    shown = " -> ".join(identity[:8] for identity in way)
    if len(set(way)) < len(way):
        text = f"{what}: a loop through managers: {shown}"
        raise BridgeError(text, FailureReason.REFUSED)
    if len(way) > MOST_HOPS:
        text = f"{what}: the way has {len(way)} managers, {MOST_HOPS} at most: {shown}"
        raise BridgeError(text, FailureReason.REFUSED)
