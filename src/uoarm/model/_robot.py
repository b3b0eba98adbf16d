"""The configuration of one robot, read and checked, and what a change of it means."""

from __future__ import annotations

import ipaddress
import re
from collections.abc import Iterator, Mapping
from enum import Enum
from typing import Any

from attrs import asdict, field, fields, filters, frozen
from typing_extensions import Self

from uoarm.model._component import Component, Function
from uoarm.model._message import Options
from uoarm.model._offer import Offer

_PLACE = re.compile(r"(tls|tcp)/(\[[0-9a-fA-F:.]+\]|[A-Za-z0-9.-]+):([0-9]{1,5})")
_LAST_PORT = 65535


@frozen
class Listening:
    """Where a manager waits for other machines.

    Attributes:
        place: `tls/ADDRESS:PORT`; `tcp/...` on loopback only.
        certificates: the folder of its certificate; None where there is no TLS.
        silence: seconds without a sign of life after which a link to a machine counts as cut.
    """

    place: str
    certificates: str | None = None
    silence: float = 3.0


def place_problem(place: str) -> str:
    """Say why machines cannot meet at this place, "" when they can."""
    found = _PLACE.fullmatch(place)
    if found is None or not 0 < int(found[3]) <= _LAST_PORT:
        return "expected tls/ADDRESS:PORT"
    if found[1] == "tcp" and not is_loopback(found[2].strip("[]")):
        return "without TLS only on loopback, such as tcp/127.0.0.1:7447"
    return ""


def is_loopback(host: str) -> bool:
    """Say whether a host name or address is this machine's loopback."""
    if host == "localhost":
        return True
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return False


_OF_MANAGER = ("host", "assigned")


@frozen
class BridgeSpec:
    """One bridge instance as the configuration asks for it.

    Attributes:
        name: name of the instance, by which components refer to it.
        plugin: name of the plugin that makes it.
        options: settings handed to the plugin.
        host: settings of the process it runs in; None: the application's own.
        assigned: the options among these that uoarm chose, since the configuration left them out.
        folder: that of the configuration's file, where relative paths among the options begin;
            "": they begin where the bridge runs.
        manager: identity of the manager that uses the bridge; "": it has none.
    """

    name: str
    plugin: str
    options: Options = field(factory=dict, hash=False)
    host: Options | None = field(default=None, hash=False)
    assigned: Options = field(factory=dict, hash=False)
    folder: str = ""
    manager: str = field(default="", eq=False)

    def to_host(self) -> dict[str, Any]:
        """Return what its host is given of it, as JSON: all but what is the manager's own."""
        given = asdict(self, recurse=False, filter=filters.exclude(*_OF_MANAGER))
        return given | {"options": dict(self.options)}

    @classmethod
    def in_host(cls, given: Mapping[str, Any]) -> Self:
        """Return the bridge of which a host was given this, whatever else is beside it."""
        names = {attribute.name for attribute in fields(cls)}.difference(_OF_MANAGER)
        return cls(**{name: given[name] for name in names & given.keys()})


@frozen
class FailureLimits:
    """When a component that raises counts as lost.

    That is when, from one failure on, so large a share of its messages has failed for so many
    messages and so many seconds. By default: no success in the last ten messages and half a second.

    Attributes:
        share: of the messages, more than 0 and at most 1.
        messages: at least one.
        seconds: 0 or more.
    """

    share: float = 1.0
    messages: int = 10
    seconds: float = 0.5


@frozen
class FailoverPolicy:
    """What happens to connections when a component that they use dies.

    Attributes:
        enabled: whether another candidate takes over; else the connection ends.
        wait: seconds in which the dead may come back when no other candidate fits.
        limit: takeovers of one connection within a minute; at the next one it ends.
        return_after: seconds that a better candidate must have been available before the
            connection returns to it; None: it stays where it is.
        failing: when a component that raises counts as lost.
    """

    enabled: bool = True
    wait: float = 0.0
    limit: int = 5
    return_after: float | None = None
    failing: FailureLimits = FailureLimits()


class LockMode(Enum):
    """What becomes of a component whose structures are not those of the lock.

    WARN: it is used, and reported. ENFORCE: it is passed over.
    """

    WARN = "warn"
    ENFORCE = "enforce"


@frozen
class RecordSettings:
    """What `record:` of a configuration says.

    Attributes:
        functions: by name, as for a request.
        path: of the file; a relative one begins at the configuration's file.
        options: as `RobotManager.record` takes them.
    """

    functions: tuple[str, ...]
    path: str
    options: Options = field(factory=dict, hash=False)


@frozen
class Robot:
    """Bridges and functions by name, in the order of the file.

    Attributes:
        warnings: remarks about the file that do not stop it from being used.
        origin: the absolute path of the file it was read from, empty when it was built in memory.
        applications: the functions that each application is said to ask for; for readers and
            checks, no other client is kept from asking.
        failover: what happens to connections when a component dies.
        hosts: where hosts on other machines join; None where there are none.
        offers: the functions that are offered in frameworks.
        lock: how requests are held to the lock beside the file; None: they are not.
        text: the YAML that it was read from, empty when it was built in memory.
        record: what is recorded while the robot is served; None: nothing.
        exports: names and patterns of the functions that other managers may import, by role.
    """

    bridges: Mapping[str, BridgeSpec] = field(hash=False)
    functions: Mapping[str, Function] = field(hash=False)
    warnings: tuple[str, ...] = ()
    origin: str = ""
    applications: Mapping[str, tuple[str, ...]] = field(factory=dict, hash=False)
    failover: FailoverPolicy = FailoverPolicy()
    hosts: Listening | None = None
    offers: tuple[Offer, ...] = ()
    lock: LockMode | None = None
    text: str = field(default="", eq=False, repr=False)
    record: RecordSettings | None = None
    exports: Mapping[str, tuple[str, ...]] = field(factory=dict, hash=False)

    def components(self) -> Iterator[Component]:
        """Yield every component, in the order of the file."""
        for function in self.functions.values():
            yield from function.components


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
