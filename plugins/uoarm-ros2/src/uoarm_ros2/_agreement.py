"""Whether those who serve a name mean by it what a client of ours does.

DDS matches the ends of a service by the names of their types alone. A server whose type has the
same name and another definition misreads requests; one of another type is not matched, and nobody
says so.
"""

from __future__ import annotations

import time
from collections.abc import Iterable

from attrs import frozen

from uoarm_ros2._middleware import Peer, Station

__all__ = ["Agreement", "Disagreement"]

_LOOK_SECONDS = 1.0
_UNNAMED = "NAME_UNKNOWN"  # what the graph says of an end whose node it has not heard of yet


@frozen
class Disagreement:
    """What is otherwise, in words, empty where nothing is; and whether no server agrees."""

    text: str = ""
    is_everybody: bool = False


class Agreement:
    """Compares the servers of some services, those of one action, with a client of ours.

    Args:
        station: in which the client is.
        what: the client is of, for the text.
        services: the full names.
    """

    def __init__(self, station: Station, what: str, services: Iterable[str]) -> None:
        self._station = station
        self._what = what
        self._services = tuple(services)
        self._due = 0.0
        self._seen = Disagreement()

    def look(self) -> Disagreement:
        """Look at the graph, once a second at most.

        Raises:
            BridgeError: the station has ended.
        """
        now = time.monotonic()
        if now >= self._due:
            seen = self._compare()
            if _UNNAMED not in seen.text:  # its node is heard of a moment later
                self._due, self._seen = now + _LOOK_SECONDS, seen
        return self._seen

    def _compare(self) -> Disagreement:
        reports: dict[str, str] = {}
        agreeing: set[str] = set()
        for service in self._services:
            servers, clients = self._station.service_ends(service)
            own = {
                client.type: client for client in clients if client.node == self._station.full_name
            }
            for server in servers if own else ():
                otherwise = _otherwise(server, own.get(server.type))
                if otherwise:
                    reports.setdefault(server.node, f"{server.node} {otherwise}")
                else:
                    agreeing.add(server.node)
        if not reports:
            return Disagreement()
        text = f"{self._what} is not the same everywhere: {'; '.join(reports.values())}"
        return Disagreement(text, is_everybody=agreeing <= reports.keys())


def _otherwise(server: Peer, own: Peer | None) -> str:
    name = server.type.replace("::dds_::", "::").removesuffix("_").replace("::", "/")
    if own is None:
        return f"has {name}"
    if "" in {server.definition, own.definition} or server.definition == own.definition:
        return ""
    return f"has {name} as {server.definition}, this process has {own.definition}"
