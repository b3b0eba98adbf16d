"""What `uoarm rtm` shows and does, as values that can be printed as JSON; no terminal here."""

from __future__ import annotations

import os
import socket
from collections.abc import Iterator, Mapping, Sequence
from contextlib import closing, contextmanager
from typing import Any

from uoarm.errors import BridgeError, CommandLineError
from uoarm_rtm._control import change, configure
from uoarm_rtm._discovery import Directory
from uoarm_rtm._journal import NAME, PROCESS, end_connector, end_leftovers, journal, process_of
from uoarm_rtm._naming import NamingService
from uoarm_rtm._orb import Orb, corba_errors, limit
from uoarm_rtm._peer import PeerComponent, PeerPort, properties_of, state_of

Row = dict[str, Any]


class CommandSession:
    """One command's view of some naming services.

    Args:
        addresses: of the naming services.
        seconds: limit of each call.
    """

    def __init__(self, orb: Orb, addresses: Sequence[str], seconds: float) -> None:
        try:
            services = [NamingService(orb, address, seconds) for address in addresses]
        except ValueError as error:
            raise CommandLineError(f"--nameserver: {error}") from error
        self._orb = orb
        self._seconds = seconds
        self._directory = Directory(services, seconds)

    def components(self) -> list[Row]:
        """Return every component that has a name; of those that do not answer, why."""
        peers, silent = self._directory.peers()
        rows = [self._component(peer) for peer in peers]
        rows += [{"component": path, "state": why, "ports": []} for path, why in silent]
        return sorted(rows, key=lambda row: str(row["component"]))

    def component(self, path: str) -> Row:
        """Return all that one component says of itself."""
        peer = self._directory.peer(path)
        row = self._component(peer)
        for shown, port in zip(row["ports"], peer.ports, strict=True):
            shown["properties"] = dict(port.properties)
            shown["connections"] = [
                self._connection(peer, port, profile) for profile in self._all(port)
            ]
        return {**row, "configuration": configure(peer, {}, self._seconds)}

    def connections(self, *, mine: bool, remove: bool) -> list[Row]:
        """Return the connectors of all ports.

        Args:
            mine: only those that processes of uoarm made on this machine.
            remove: end those of them whose process does not run any more, and return these.
        """
        rows: dict[str, Row] = {}
        ends: dict[str, list[Any]] = {}
        peers, _ = self._directory.peers()
        for peer in peers:
            for port in peer.ports:
                for profile in self._all(port):
                    row = rows.setdefault(
                        profile.connector_id, self._connection(peer, port, profile)
                    )
                    here = f"{peer.path}:{port.name}"
                    if here not in row["ports"]:
                        row["ports"].append(here)
                    ends[profile.connector_id] = [
                        limit(end, self._seconds) for end in profile.ports
                    ]
        found = [row for row in rows.values() if not mine or row["runs"] != "elsewhere"]
        if not remove:
            return found
        left = [row for row in found if row["runs"] == "no"]
        for row in left:
            with corba_errors(f"ending connector {row['id']}"):
                end_connector(row["id"], [port for port in ends[row["id"]] if port is not None])
        end_leftovers(self._orb, self._seconds)  # of components that have no name any more
        return left

    def change(self, paths: Sequence[str], action: str) -> list[Row]:
        """Activate, deactivate or reset components, one after the other."""
        rows = []
        for path in paths:
            peer = self._directory.peer(path)
            state = change(peer, action, self._seconds, there_is_fine=action != "reset")
            rows.append({"component": peer.path, "state": state})
        return rows

    def configure(self, path: str, request: Mapping[str, object]) -> Row:
        """Write a component's configuration as a request says, and return all of it."""
        reply = configure(self._directory.peer(path), dict(request), self._seconds)
        assert isinstance(reply, dict)
        return reply

    def _component(self, peer: PeerComponent) -> Row:
        try:
            state = state_of(peer, self._seconds)
        except BridgeError as error:
            state = str(error)
        return {
            "component": peer.path,
            "state": state,
            "type": peer.type_name,
            "language": peer.language,
            "ports": [self._port(port) for port in peer.ports],
        }

    def _port(self, port: PeerPort) -> Row:
        interfaces = [
            f"{'provides' if interface.provided else 'requires'} {interface.type}"
            for interface in port.interfaces
        ]
        kind = port.data_type or ", ".join(interfaces)
        return {"port": port.name, "kind": port.kind, "type": kind}

    def _all(self, port: PeerPort) -> list[Any]:
        with corba_errors(f"connectors of port {port.name!r}"):
            return list(port.reference.get_connector_profiles())

    def _connection(self, peer: PeerComponent, port: PeerPort, profile: Any) -> Row:
        properties = properties_of(profile.properties)
        maker = properties.get(PROCESS, "")
        return {
            "id": profile.connector_id,
            "name": profile.name,
            "ports": [f"{peer.path}:{port.name}"],
            "maker": properties.get(NAME, ""),
            "process": maker,
            "runs": _runs(maker),
            "flow": properties.get("dataport.dataflow_type", ""),
            "subscription": properties.get("dataport.subscription_type", ""),
        }


@contextmanager
def session(addresses: Sequence[str], seconds: float) -> Iterator[CommandSession]:
    """Have an ORB for one command."""
    with closing(Orb("127.0.0.1", seconds)) as orb:
        yield CommandSession(orb, addresses, seconds)


def _runs(maker: str) -> str:
    """Return whether a connector's process runs: yes, no, unknown, or elsewhere for others'.

    The journal knows for certain. Without one, a process that is not there does not run, and a
    process id that is in use may be another's.
    """
    process = process_of(maker)
    if process is None or process[0] != socket.gethostname():
        return "elsewhere"
    known = journal().runs(process[2])
    if known is not None:
        return "yes" if known else "no"
    try:
        os.kill(process[1], 0)
    except ProcessLookupError:
        return "no"
    except OSError:
        return "unknown"
    return "unknown"
