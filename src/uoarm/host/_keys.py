"""Names on the link, and the version of what is said there."""

from __future__ import annotations

__all__ = ["ALIVE", "ASK", "FOLDER", "LINK_VERSION", "PING", "TOLD", "flow", "service"]

LINK_VERSION = 2
"""Both ends must have the same; it grows with every change of what crosses the link."""

FOLDER = "uoarm-host-"
"""How the name of a folder begins that holds the socket of a link."""

ALIVE = "uoarm/host/alive"
ASK = "uoarm/host/ask"
PING = "uoarm/host/ping"
TOLD = "uoarm/manager/told"


def flow(number: int) -> str:
    """Name the flow of one channel."""
    return f"uoarm/flow/{number}"


def service(number: int) -> str:
    """Name the place where the manager answers for a service that the framework calls."""
    return f"uoarm/manager/service/{number}"
