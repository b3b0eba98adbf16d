"""A change of configuration: what is different, and what that means for connections that run."""

from __future__ import annotations

from enum import Enum

from attrs import field, frozen

from uoarm.model._robot import Robot

__all__ = ["ConfigurationChange", "ConnectionEffect", "Effect"]


class Effect(Enum):
    """What a change of configuration does to a connection."""

    MOVES = "moves"
    ENDS = "ends"


@frozen
class ConnectionEffect:
    """A connection that does not stay as it is.

    Attributes:
        connection: its id.
        function: that it asked for.
        effect: whether it goes on with another plan, or ends.
        before: the components of its plan, producers first.
        after: those of the plan that it goes on with; empty when it ends.
        cause: why it ends.
    """

    connection: str
    function: str
    effect: Effect
    before: tuple[str, ...]
    after: tuple[str, ...] = ()
    cause: str = ""

    def __str__(self) -> str:
        start = f"{self.connection} ({self.function}) {self.effect.value}"
        if self.effect is Effect.ENDS:
            return f"{start}: {self.cause}"
        return f"{start}: {' > '.join(self.before)}  to  {' > '.join(self.after)}"


@frozen
class ConfigurationChange:
    """One revision of the configuration, applied or only looked at.

    Attributes:
        revision: its number; the configuration that a manager began with is 0.
        differences: what it has other than the one before: a line for each bridge, component and
            function, `+` added, `-` taken away, `~` changed.
        connections: those that do not stay as they are, as seen when it was looked at.
        is_applied: whether it is in force.
        is_kept: whether it was written to the file of the configuration.
        time: when it was applied, in seconds since the epoch.
        robot: the configuration itself, to be applied again.

    As text (`str`, `print`) it is what `uoarm apply` shows.
    """

    revision: int
    differences: tuple[str, ...] = ()
    connections: tuple[ConnectionEffect, ...] = ()
    is_applied: bool = False
    is_kept: bool = False
    time: float = 0.0
    robot: Robot | None = field(default=None, eq=False, repr=False)

    def __str__(self) -> str:
        state = "applied" if self.is_applied else "not applied"
        state += " and kept" if self.is_kept else ""
        lines = [f"revision {self.revision}, {state}"]
        lines += [f"  {line}" for line in self.differences] or ["  nothing is different"]
        lines += [f"  connection {connection}" for connection in self.connections]
        return "\n".join(lines)
