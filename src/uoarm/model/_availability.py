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

    As text (`str`, `print`) it is what `uoarm status` shows.
    """

    name: str
    provider: str | None
    candidates: tuple[Availability, ...]
    cause: str = ""

    def __str__(self) -> str:
        state = "cannot be had" if self.provider is None else f"from {self.provider}"
        lines = [f"{self.name}  {state}"]
        for candidate in self.candidates:
            mark = "*" if candidate.component == self.provider else " "
            text = candidate.cause or "available"
            lines.append(
                f"  {mark} {candidate.priority:>4}  {candidate.component}"
                f"  ({candidate.bridge})  {text}"
            )
        if self.provider is None and not any(candidate.cause for candidate in self.candidates):
            lines.append(f"  {self.cause}")
        return "\n".join(lines)
