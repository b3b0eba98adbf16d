"""Inputs that move something: how long a command lives, what stops it, and what it may ask for."""

from __future__ import annotations

from enum import Enum

from attrs import field, frozen


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
class LeasePolicy:
    """That one sender at a time may command an input.

    Attributes:
        duration: seconds after its last command for which a sender holds the lease.
        priorities: by role; of any other role it is 0. A higher one takes over by sending.
    """

    duration: float
    priorities: tuple[tuple[str, float], ...] = ()


@frozen
class LeaseHolder:
    """Who sends commands.

    Attributes:
        id: distinguishes it from every other, for people too: `session 3`, `connection c1`.
        role: by which it has its priority; of a client of the server the one it was let in with.
    """

    id: str
    role: str = ""

    def __str__(self) -> str:
        return f"{self.id} ({self.role})" if self.role else self.id


@frozen
class LeaseStatus:
    """The lease of an input, at one moment.

    Attributes:
        holder: who holds it; None where it is free.
        priority: of the holder.
        left: seconds for which it holds it without another command.
        refused: commands of others that were refused.
    """

    holder: LeaseHolder | None = None
    priority: float = 0.0
    left: float = 0.0
    refused: int = 0


@frozen
class CommandPolicy:
    """How an input that moves something is kept safe, in the process that talks to the framework.

    Attributes:
        lifetime: seconds after which a command that was not renewed is followed by the stop
            message; None: it lives until the next one.
        stop: the stop message; None: there is none.
        limits: what commands may ask for; one beyond is refused and renews nothing.
        lease: how one sender at a time may command it; None: all may.
    """

    lifetime: float | None = None
    stop: StopMessage | None = None
    limits: tuple[FieldLimit, ...] = ()
    lease: LeasePolicy | None = None


class CommandPhase(Enum):
    """What an input that moves something was sent last.

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
        phase: what it was sent last.
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


@frozen
class StopOutcome:
    """What an emergency stop came to at one input.

    Attributes:
        function, component, port: which input.
        stopped: whether the framework took the stop message, and has been handed nothing since.
        since: seconds since it took it; None where it did not.
        cause: why not.
    """

    function: str
    component: str
    port: str
    stopped: bool
    since: float | None = None
    cause: str = ""

    def __str__(self) -> str:
        place = f"{self.component}.{self.port} ({self.function})"
        if self.since is None:
            return f"NOT STOPPED  {place}: {self.cause}"
        return f"stopped      {place}, {self.since:.3f} s ago"


@frozen
class StopReport:
    """What an emergency stop came to, at every input that is open and moves something.

    Attributes:
        since: seconds since commands are refused.
        inputs: by component and port.
        unkept: why a manager that is started again would not be stopped; empty where it would,
            and where that was not asked for.
    """

    since: float
    inputs: tuple[StopOutcome, ...] = ()
    unkept: str = ""

    @property
    def stopped(self) -> bool:
        """Whether every one of them has stopped."""
        return all(input_.stopped for input_ in self.inputs)

    def __str__(self) -> str:
        held = f"commands have been refused for {self.since:.3f} s"
        lines = [held, *(str(input_) for input_ in self.inputs or ("nothing open moves",))]
        if self.unkept:
            lines.append(f"NOT STOPPED AFTER A RESTART  {self.unkept}")
        return "\n".join(lines)
