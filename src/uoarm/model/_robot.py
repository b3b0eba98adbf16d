"""The configuration of one robot, read and checked."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from enum import Enum

from attrs import field, frozen

from uoarm.model._component import Component, Function
from uoarm.model._listening import Listening
from uoarm.model._offer import Offer
from uoarm.model._values import Options

__all__ = ["BridgeSpec", "FailoverPolicy", "FailureLimits", "LockMode", "Robot"]


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
    """

    name: str
    plugin: str
    options: Options = field(factory=dict, hash=False)
    host: Options | None = field(default=None, hash=False)
    assigned: Options = field(factory=dict, hash=False)
    folder: str = ""


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

    WARN: it is used, and told. ENFORCE: it is passed over.
    """

    WARN = "warn"
    ENFORCE = "enforce"


@frozen
class Robot:
    """Bridges and functions by name, in the order of the file.

    Attributes:
        warnings: remarks about the file that do not stop it from being used.
        origin: the absolute path of the file it was read from, empty when it was built in memory.
        applications: the functions that each application is said to ask for; for readers and
            checks, nobody else is kept from asking.
        failover: what happens to connections when a component dies.
        hosts: where hosts on other machines join; None where there are none.
        offers: the functions that are offered in frameworks.
        lock: how requests are held to the `robot.lock` beside the file; None: they are not.
        text: the YAML that it was read from, empty when it was built in memory.
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

    def components(self) -> Iterator[Component]:
        """Yield every component, in the order of the file."""
        for function in self.functions.values():
            yield from function.components
