"""What can be had now: functions, their candidates, and which of them a request would get."""

from __future__ import annotations

from attrs import frozen

__all__ = ["Availability", "FunctionStatus"]


@frozen
class Availability:
    """One candidate for a function; `cause` says why it cannot be had, empty when it can."""

    component: str
    bridge: str
    priority: int
    cause: str = ""


@frozen
class FunctionStatus:
    """One function as a request would find it now.

    Attributes:
        name: the function.
        provider: the component that a request would get, None when no plan fits.
        candidates: its components in the order in which they are tried.
        cause: why no plan fits, empty when one does.
    """

    name: str
    provider: str | None
    candidates: tuple[Availability, ...]
    cause: str = ""
