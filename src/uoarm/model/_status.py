"""Snapshots of the live system, and their text that a person can act on."""

from __future__ import annotations

import textwrap
from collections.abc import Callable, Iterator, Mapping, Sequence
from enum import Enum
from functools import partial
from typing import Any

from attrs import Factory, asdict, field, frozen

from uoarm.model._command import CommandStatus, FieldLimit, LeaseStatus
from uoarm.model._offer import OfferStatus

_COLUMNS: Mapping[str, tuple[str, ...]] = {
    "machines": ("name", "present", "clock_offset", "clock_error", "cause"),
    "bridges": ("name", "plugin", "health", "process", "assigned", "facts", "cause"),
    "components": ("name", "function", "health", "failed", "lost", "cause"),
    "channels": ("component", "port", "facts"),
    "commands": (
        "component",
        "phase",
        "for",
        "left",
        "lifetime",
        "lease",
        "limits",
        "refused",
        "cause",
    ),
    "connections": ("id", "function", "state", "lost", "cause"),
    "routes": ("producer", "consumer", "received", "delivered", "rate", "dropped"),
    "offers": ("name", "state", "calls", "failed", "cause"),
    "lock": ("component", "port", "refused", "times", "cause"),
}
_OFTEN_NONE = frozenset({"machines", "channels", "commands", "offers", "lock"})


def format_status(status: Mapping[str, Any], width: int | None = None) -> str:
    """Return a status map, as data or as JSON has it, as one table for each kind of thing.

    Args:
        status: the map.
        width: characters that a line may have; a table that is wider is written row by row, each
            with the names of what it has. None: as many as there are.
    """
    held = status.get("held")
    lines = (
        [] if held is None else [f"commands have been refused for {held:.3f} s, until a release"]
    )
    for name, columns in _COLUMNS.items():
        found = _OF_CHANNELS[name](status) if name in _OF_CHANNELS else status.get(name, ())
        rows = [[_shown(item.get(column), column) for column in columns] for item in found]
        if name in _OFTEN_NONE and not rows:
            continue
        lines.append(f"{name}: {len(rows) or 'none'}")
        if rows:
            lines.extend(_table(columns, rows, width))
    return "\n".join(lines)


def find_trouble(status: Mapping[str, Any], connection: str) -> tuple[str, ...]:
    """Say what keeps messages of a connection from coming.

    Args:
        status: the map, as data or as JSON has it.
        connection: its name.

    Returns:
        For what it waits, which of its components is not well, and why the last message between
        them was not taken; empty where nothing is known.
    """
    own = next((row for row in status.get("connections", ()) if row["id"] == connection), None)
    if own is None:
        return ()
    names = set(own["components"])
    causes = [f"the connection is {_word(own['state'])}: {own['cause']}"] if own["cause"] else []
    causes += [
        f"{component['name']} is {_word(component['health'])}: "
        f"{component['cause'] or component['last_error']}"
        for component in status.get("components", ())
        if component["name"] in names and _word(component["health"]) != "ok"
    ]
    for route in status.get("routes", ()):
        consumer, refusal = route["consumer"], route.get("refusal", "")
        is_own = consumer == connection or consumer.rpartition(".")[0] in names
        if is_own and refusal and not any(refusal in text for text in causes):
            ends = f"{route['producer']} -> {consumer}"
            causes.append(f"the last message of {ends} was refused: {refusal}")
    return tuple(causes)


def _word(value: Any) -> str:
    return str(getattr(value, "value", value))


def _commands(status: Mapping[str, Any]) -> list[Mapping[str, Any]]:
    """Return the inputs that move something: what each was sent last, and how long that holds."""
    return [
        {
            "component": f"{component['name']}.{channel['port'].partition('.')[2]}",
            "phase": report["phase"],
            "for": _seconds(report["since"]),
            "left": _seconds(report["left"]),
            "lifetime": _seconds(channel.get("lifetime")),
            "lease": _lease(channel.get("lease")),
            "limits": "; ".join(map(_limit, channel.get("limits", ()))),
            "refused": report["dropped"],
            "cause": report["cause"],
        }
        for component in status.get("components", ())
        for channel in component.get("channels", ())
        if (report := channel.get("command"))
    ]


def _lease(lease: Mapping[str, Any] | None) -> str:
    """Return who holds a lease and how long still, as `session 3 (driver), 0.400 s`."""
    if lease is None:
        return ""
    holder = lease["holder"]
    if holder is None:
        return "free"
    name = f"{holder['id']} ({holder['role']})" if holder["role"] else holder["id"]
    return f"{name}, {_seconds(lease['left'])}"


def _seconds(value: float | None) -> str:
    return "" if value is None else f"{value:.3f} s"


def _limit(limit: Mapping[str, Any]) -> str:
    """Return the limits of one number, as `linear.x at least -0.5, at most 0.5, 1 in a second`."""
    words = {"minimum": "at least {:g}", "maximum": "at most {:g}", "rate": "{:g} in a second"}
    report = (text.format(limit[key]) for key, text in words.items() if limit[key] is not None)
    return f"{limit['path']} {', '.join(report)}"


def _channels(status: Mapping[str, Any]) -> list[Mapping[str, Any]]:
    """Return the channels of which anything is known, with the names of their components."""
    return [
        {"component": component["name"], **channel}
        for component in status.get("components", ())
        for channel in component.get("channels", ())
        if channel["facts"]
    ]


_OF_CHANNELS: Mapping[str, Callable[[Mapping[str, Any]], list[Mapping[str, Any]]]] = {
    "channels": _channels,
    "commands": _commands,
}


def _table(columns: Sequence[str], rows: Sequence[Sequence[str]], width: int | None) -> list[str]:
    widths = [max(map(len, column)) for column in zip(columns, *rows, strict=True)]
    padded = (map(str.ljust, row, widths) for row in (columns, *rows))
    lines = [f"  {'  '.join(cells)}".rstrip() for cells in padded]
    if width is None or max(map(len, lines)) <= width:
        return lines
    return [line for row in rows for line in _record(columns, row, width)]


def _record(columns: Sequence[str], row: Sequence[str], width: int) -> Iterator[str]:
    """Yield a row as lines: its first cell, and what else it has with the names of the columns."""
    message = ", ".join(
        f"{name} {cell}" for name, cell in zip(columns[1:], row[1:], strict=True) if cell
    )
    for text, indent in ((row[0], "  "), (message, "    ")):
        wrap = partial(textwrap.wrap, initial_indent=indent, break_on_hyphens=False)
        yield from wrap(text, width, subsequent_indent=f"{indent}  ")


def _shown(value: object, column: str) -> str:
    if isinstance(value, Enum):
        return str(value.value)
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, float):
        return f"{1000 * value:.3f} ms" if column.startswith("clock_") else f"{value:.1f}"
    if isinstance(value, list | tuple):
        known = (pair for pair in value if pair[1] is not None and pair[1] != "")
        return ", ".join(f"{item} {_fact(other)}" for item, other in known)
    return "" if value is None else str(value)


def _fact(value: object) -> str:
    return f"{value:.3g}" if isinstance(value, float) else str(value)


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

    @property
    def is_over(self) -> bool:
        """Whether the connection has ended, for whatever reason."""
        return self in {ConnectionState.CLOSED, ConnectionState.FAILED}


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
        command: what an input that moves something was sent last; None of any other channel.
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

    Services are there that have raised or are not well: nothing of them is open.

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
            its framework had not handed over yet, cannot be counted. See `counted`.
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


_EVENT_CODES: Mapping[tuple[str, str], str] = {
    ("component", "lost"): "UOA-801",
    ("component", "degraded"): "UOA-802",
    ("bridge", "lost"): "UOA-803",
    ("bridge", "degraded"): "UOA-804",
    ("connection", "failed"): "UOA-805",
    ("connection", "waiting"): "UOA-806",
    ("connection", "replaced"): "UOA-807",
    ("offer", "failed"): "UOA-808",
    ("lock", "differs"): "UOA-809",
    ("recording", "failed"): "UOA-810",
}


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
        error_code: of `uoarm.error_codes`, where the change is a failure; empty otherwise.

    As text (`str`, `print`) it is the line that `uoarm status --url --watch` shows.
    """

    number: int
    time: float
    subject: str
    change: str
    cause: str = ""
    function: str = ""
    error_code: str = field(
        default=Factory(
            lambda event: _EVENT_CODES.get((event.subject.partition(" ")[0], event.change), ""),
            takes_self=True,
        )
    )

    def __str__(self) -> str:
        cause = f": {self.cause}" if self.cause else ""
        return f"#{self.number} {self.subject} {self.change}{cause}"
