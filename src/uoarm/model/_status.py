"""Snapshots of the live system: bridges, components, connections and routes."""

from __future__ import annotations

from enum import Enum

from attrs import asdict, frozen

from uoarm.model._command import CommandStatus, FieldLimit, LeaseStatus
from uoarm.model._offer import OfferStatus
from uoarm.model._status_text import format_status

__all__ = [
    "BridgeStatus",
    "ChannelStatus",
    "ComponentStatus",
    "ConnectionState",
    "ConnectionStatus",
    "Health",
    "MachineStatus",
    "RouteStatus",
    "StatusEvent",
    "StatusMap",
]


class Health(Enum):
    """How a bridge, component or channel is doing.

    FINISHED is an orderly end: what is still under way is delivered before connections close.
    LOST is any other end.
    """

    OK = "ok"
    DEGRADED = "degraded"
    FINISHED = "finished"
    LOST = "lost"

    __hash__ = object.__hash__  # members are singletons; by name it costs ten times as much


class ConnectionState(Enum):
    """Life of a connection; it moves down this list only, but for WAITING and RUNNING.

    One that waits lost a component, nothing can take over, and `failover.wait` is not over yet.
    """

    OPENING = "opening"
    RUNNING = "running"
    WAITING = "waiting"
    CLOSING = "closing"
    CLOSED = "closed"
    FAILED = "failed"

    __hash__ = object.__hash__  # members are singletons; by name it costs ten times as much


@frozen
class BridgeStatus:
    """One bridge instance.

    Attributes:
        assigned: options that uoarm chose for it, by name.
        process: id of the process in which it runs; None once it was lost, and for one on another
            machine.
        facts: what it knows of its own work, by name, such as turns of its loop for nothing.
    """

    name: str
    plugin: str
    health: Health
    open_channels: int
    cause: str = ""
    assigned: tuple[tuple[str, object], ...] = ()
    process: int | None = None
    facts: tuple[tuple[str, object], ...] = ()


@frozen
class MachineStatus:
    """Another machine, whose hosts join by themselves.

    Attributes:
        present: whether a host there is joined for every bridge of the machine.
        bridges: the bridges of the machine.
        clock_offset: seconds by which its clock is ahead of the manager's, None while unknown.
        clock_error: seconds by which the offset may be wrong: half of the quickest round trip.
        cause: why it is not present.
    """

    name: str
    present: bool
    bridges: tuple[str, ...]
    clock_offset: float | None = None
    clock_error: float | None = None
    cause: str = ""

    def __str__(self) -> str:
        state = f"machine {self.name}  {self.cause or 'present'}"
        if self.clock_offset is None or self.clock_error is None:
            return state
        offset, error = 1000 * self.clock_offset, 1000 * self.clock_error
        return f"{state}, its clock is {offset:+.3f} ms from ours (to {error:.3f} ms)"


@frozen
class ChannelStatus:
    """One open channel of a component.

    Attributes:
        port: `output.default` or the like.
        facts: what the framework knows of the link, by name: matched peers, policies, losses.
        lost: messages that it knows will never arrive, its fact `lost_on_link`.
        command: what an input that moves something was told last; None of any other channel.
        lifetime: of its commands, in seconds; None where they do not expire.
        limits: of its commands.
        lease: who may send them; None where all may.
    """

    port: str
    facts: tuple[tuple[str, object], ...] = ()
    lost: int = 0
    command: CommandStatus | None = None
    lifetime: float | None = None
    limits: tuple[FieldLimit, ...] = ()
    lease: LeaseStatus | None = None


@frozen
class ComponentStatus:
    """One open component, the connections that use it, and its open channels.

    Services are there that have raised: nothing of them is open.

    Attributes:
        failed: how many messages or calls it raised on.
        last_error: what it raised last.
        lost: what its open channels have lost. A connection's `lost` has it when they are closed
            because the component died.
    """

    name: str
    function: str
    bridge: str
    health: Health
    users: tuple[str, ...]
    cause: str = ""
    channels: tuple[ChannelStatus, ...] = ()
    failed: int = 0
    last_error: str = ""
    lost: int = 0


@frozen
class RouteStatus:
    """One flow of messages, with its counters since it was opened.

    Attributes:
        producer: component and output, `head_camera.default`.
        consumer: component and input, or the connection's id when the application receives.
        received: messages that arrived from the producer.
        delivered: messages that the consumer took.
        dropped: messages lost on the way, by reason.
        invalid: messages that could not be read, or did not match the declared structure.
        rate: messages a second over the last seconds, None until two have arrived.
        age: seconds since the last message arrived, None before the first.
        last_error: text of the last failure on this route.
        native: the framework moves the messages itself; nothing is counted here.
        facts: what the framework knows of a native link, by name.
        copies: those of `received` that another route out of the same output got as well, such as
            that of a candidate which serves until a better one beside it takes over. Over all
            routes, what was sent and the copies are what was received or lost.
        refusal: why the last message was not taken; empty where one was taken since.
    """

    producer: str
    consumer: str
    received: int
    delivered: int
    dropped: tuple[tuple[str, int], ...] = ()
    invalid: int = 0
    rate: float | None = None
    age: float | None = None
    last_error: str = ""
    native: bool = False
    facts: tuple[tuple[str, object], ...] = ()
    copies: int = 0
    refusal: str = ""


@frozen
class Gap:
    """A change of providers behind a connection, where messages may be missing.

    Attributes:
        time: seconds of the manager's clock, when the new plan was open.
        position: how many messages the application had been given before it.
        seconds: how long nothing could arrive.
        lost: messages that were under way into or out of what died and did not arrive; what
            its framework had not handed over yet, nobody can count. See `counted`.
        before: the components of the plan that ended.
        after: the components of the plan that goes on.
        cause: why it was replaced.
        dropped: what the routes that ended with it had dropped since they were opened, by
            reason: `closed` waited in a queue, `replaced` came too late, `in-hand` was with a
            consumer that did not return. See `counted`.
        counted: whether `lost` and `dropped` are known: not before all that died is closed.
    """

    time: float
    position: int
    seconds: float
    lost: int
    before: tuple[str, ...]
    after: tuple[str, ...]
    cause: str
    dropped: tuple[tuple[str, int], ...] = ()
    counted: bool = True


@frozen
class ConnectionStatus:
    """One request that an application made.

    Attributes:
        components: of its plan; while it waits, those that are left of it.
        cause: why it ended, or for what it waits.
        lost: messages that were under way into or out of components that died, over all changes
            of plan.
        ended: the routes of plans that were replaced, those between the same ends as one. With
            these, `lost`, and the routes that are open, every message is accounted for.
    """

    id: str
    function: str
    state: ConnectionState
    components: tuple[str, ...]
    cause: str = ""
    lost: int = 0
    ended: tuple[RouteStatus, ...] = ()


@frozen
class LockDifference:
    """A port whose structure is not the one of the lock, as a search for a plan found it.

    Attributes:
        component: by name; of an offer its name, `BRIDGE:FUNCTION`.
        port: `output.default`, `request`.
        refused: whether it was passed over for it.
        times: how often a search came upon it.
        cause: what is different, and what to do.
    """

    component: str
    port: str
    refused: bool
    times: int
    cause: str


@frozen
class StatusMap:
    """The whole system at one moment.

    Attributes:
        deaths: how often each component was lost, since the manager began.
        takeovers: how often another plan took over for each function, returns included.
        held: seconds since commands are refused by an emergency stop; None where they are not.
        lock: what searches found to be others than in the lock, where requests are held to it.

    As text (`str`, `print`) it is what `uoarm status --url` shows.
    """

    bridges: tuple[BridgeStatus, ...] = ()
    components: tuple[ComponentStatus, ...] = ()
    connections: tuple[ConnectionStatus, ...] = ()
    routes: tuple[RouteStatus, ...] = ()
    machines: tuple[MachineStatus, ...] = ()
    deaths: tuple[tuple[str, int], ...] = ()
    takeovers: tuple[tuple[str, int], ...] = ()
    offers: tuple[OfferStatus, ...] = ()
    held: float | None = None
    lock: tuple[LockDifference, ...] = ()

    def __str__(self) -> str:
        return format_status(asdict(self))


@frozen
class StatusEvent:
    """One change, in the order in which it happened.

    Attributes:
        number: counts up by one with every event of a manager.
        time: seconds of the manager's clock.
        subject: what changed, `connection c3`, `component head_camera`, `bridge ros`.
        change: the new state, one word.
        cause: why, and who killed a connection; empty for what the application itself asked for.
        function: which a connection is of or a component provides; empty for other subjects.

    As text (`str`, `print`) it is the line that `uoarm status --url --watch` shows.
    """

    number: int
    time: float
    subject: str
    change: str
    cause: str = ""
    function: str = ""

    def __str__(self) -> str:
        cause = f": {self.cause}" if self.cause else ""
        return f"#{self.number} {self.subject} {self.change}{cause}"
