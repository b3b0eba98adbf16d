"""Names on the link, and the version of what is said there."""

from __future__ import annotations

PROTOCOL_VERSION = 14
"""Both ends must have the same; it grows with every change of what crosses the link."""

ALIVE = "uoarm/host/alive"
ASK = "uoarm/host/ask"
HEARTBEAT = "uoarm/host/heartbeat"
CLOSING = "uoarm/host/closing"
HEALTH = "uoarm/manager/health"
MANAGED = "uoarm/manager/alive"

COMMAND = "command"
"""Names, among the facts of an input that moves something, the status of its commands."""
SKIPPED = "skipped"
"""Names, among the facts of an output, how many of its messages found no room on the link."""
BRIDGE = 0
"""Stands where the answer to a heartbeat has a channel's number, before the facts of the bridge."""

MACHINES = "uoarm/machine"
"""Every key of another machine begins so, and then with its name: the access list knows no more."""

ANY_BRIDGE = "-"
"""Stands for a bridge's name where a host serves every one; no bridge has this name."""


def flow(number: int) -> str:
    """Name the flow of one channel."""
    return f"uoarm/flow/{number}"


def service(number: int) -> str:
    """Name the place where the manager answers for a service that the framework calls."""
    return f"uoarm/manager/service/{number}"


def here(machine: str, bridge: str, host: str) -> str:
    """Name the token of a host on another machine that serves this bridge; behind `MACHINES`."""
    return f"{machine}/here/{bridge}/{host}"


def attach(machine: str, host: str) -> str:
    """Name the place where such a host takes orders; behind `MACHINES`."""
    return f"{machine}/attach/{host}"


def clock(machine: str, host: str) -> str:
    """Name the key at which such a host answers with its time; behind `MACHINES`."""
    return f"{machine}/clock/{host}"


def bridge_prefix(machine: str, bridge: str, time: str) -> str:
    """Name what stands before every key of one bridge while one manager uses it."""
    return f"{machine}/talk/{bridge}/{time}"
