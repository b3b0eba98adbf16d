"""Inputs that move something: how long a command lives, what stops it, and what it may ask for."""

from __future__ import annotations

from enum import Enum

from attrs import field, frozen

__all__ = ["CommandPhase", "CommandPolicy", "CommandStatus", "FieldLimit", "StopMessage"]


@frozen
class StopMessage:
    """The message after which nothing moves."""

    message: object = field(hash=False)


@frozen
class FieldLimit:
    """What one field of a command may be; None: not limited.

    Attributes:
        path: of a number in the message, `linear.x`; `.` is the whole message.
        minimum, maximum: lowest and highest value.
        rate: by how much it may change in a second.
    """

    path: str
    minimum: float | None = None
    maximum: float | None = None
    rate: float | None = None


@frozen
class CommandPolicy:
    """How an input that moves something is kept safe, in the process that talks to the framework.

    Attributes:
        lifetime: seconds after which a command that nobody renewed is followed by the stop
            message; None: it lives until the next one.
        stop: the stop message; None: there is none.
        limits: what commands may ask for; one beyond is refused and renews nothing.
    """

    lifetime: float | None = None
    stop: StopMessage | None = None
    limits: tuple[FieldLimit, ...] = ()


class CommandPhase(Enum):
    """What an input that moves something was told last.

    IDLE: nothing yet. MOVING: a command. STOPPING: the stop message is on its way, and was not
    taken yet. STOPPED: the stop message, which was taken.
    """

    IDLE = "idle"
    MOVING = "moving"
    STOPPING = "stopping"
    STOPPED = "stopped"


@frozen
class CommandStatus:
    """An input that moves something, at one moment.

    Attributes:
        phase: what it was told last.
        since: seconds since that is so.
        left: seconds that the command still lives; None where nothing is to expire.
        held: whether commands are refused until the emergency stop is released.
        stops: how many stop messages were taken.
        dropped: commands that were refused, by reason.
        cause: why the last stop message was not taken, empty when it was.
    """

    phase: CommandPhase
    since: float
    left: float | None = None
    held: bool = False
    stops: int = 0
    dropped: tuple[tuple[str, int], ...] = ()
    cause: str = ""
