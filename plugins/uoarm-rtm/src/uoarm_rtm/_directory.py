# ruff: noqa: SLF001 - CORBA begins the names of its own operations with an underscore
"""All naming services of a bridge together: components by path, and who of them is alive."""

from __future__ import annotations

import difflib
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import Any

from attrs import frozen
from omniORB import CORBA

from uoarm.errors import BridgeError, BridgeTimeoutError, FailureReason
from uoarm_rtm._calls import calls
from uoarm_rtm._naming import Name, NamingService
from uoarm_rtm._orb import limit
from uoarm_rtm._peer import PeerComponent, peer_at

__all__ = ["Directory", "DirectoryEntry"]

_AT_ONCE = 8
_SUFFIX = ".rtc"


@frozen
class DirectoryEntry:
    """A component's name and what stands behind it: `alive`, `dead` or `hung`."""

    path: str
    reference: Any
    condition: str


class Directory:
    """Finds components. Used from any thread.

    Args:
        services: naming services, asked in this order.
        seconds: limit of one call.
    """

    def __init__(self, services: Sequence[NamingService], seconds: float) -> None:
        self._services = services
        self._seconds = seconds

    def peer(self, path: str) -> PeerComponent:
        """Return the component at a path, or the only one whose path ends so.

        Raises:
            BridgeError: NOT_FOUND, also for two that are alive; UNAVAILABLE when it is dead or
                no naming service answers.
            BridgeTimeoutError: it hangs.
        """
        failures = []
        for service in self._services:
            try:
                reference = service.resolve(path)
            except BridgeError as error:
                if error.reason is FailureReason.BAD_ENDPOINT:
                    return self._below(path, error)  # a plain way of writing one, perhaps
                failures.append(error)
                continue
            if reference is not None:
                return peer_at(path, reference, self._seconds)
        if len(failures) == len(self._services):
            raise failures[0]
        return self._below(path)

    def entries(self) -> tuple[DirectoryEntry, ...]:
        """Return every component's name, with its condition; silent services are left out.

        Raises:
            BridgeError: no naming service answers.
        """
        names: dict[str, Name] = {}
        failures = []
        for service in self._services:
            try:
                for name in service.names():
                    if name.path.endswith(_SUFFIX):
                        names.setdefault(name.path, name)
            except BridgeError as error:
                failures.append(error)
        if len(failures) == len(self._services):
            raise failures[0]
        if not names:
            return ()
        try:
            with ThreadPoolExecutor(_AT_ONCE, "uoarm-rtm-look") as pool:
                return tuple(pool.map(self._look, names.values()))
        except RuntimeError as error:  # no thread can begin any more
            raise BridgeError("this process is ending", FailureReason.CLOSED) from error

    def peers(self) -> tuple[tuple[PeerComponent, ...], tuple[tuple[str, str], ...]]:
        """Return the components that answer, and (path, what is wrong) of those that do not."""
        found: list[PeerComponent] = []
        silent = []
        for entry in self.entries():
            if entry.condition != "alive":
                silent.append((entry.path, entry.condition))
                continue
            try:
                found.append(peer_at(entry.path, entry.reference, self._seconds))
            except BridgeError as error:
                silent.append((entry.path, str(error)))
        return tuple(found), tuple(silent)

    def _look(self, name: Name) -> DirectoryEntry:
        try:
            with calls:
                gone = limit(name.reference, self._seconds)._non_existent()
        except CORBA.TIMEOUT:
            return DirectoryEntry(name.path, name.reference, "hung")
        except CORBA.Exception:
            gone = True
        return DirectoryEntry(name.path, name.reference, "dead" if gone else "alive")

    def _below(self, path: str, unreadable: BridgeError | None = None) -> PeerComponent:
        """Return the component of this name in any context, or at this path written plainly.

        CORBA writes a dot within a step with a backslash before it; people write `x.y.host_cxt`.
        """
        plain = path.replace("\\", "")
        every = self.entries()
        seen = [
            entry
            for entry in every
            if entry.path.split("/")[-1] == path or entry.path.replace("\\", "") == plain
        ]
        alive = [entry for entry in seen if entry.condition == "alive"]
        if len(alive) == 1:
            return peer_at(alive[0].path, alive[0].reference, self._seconds)
        where = ", ".join(service.address for service in self._services)
        if alive:
            paths = ", ".join(entry.path for entry in alive)
            text = f"component {path!r} is there several times: {paths}; give one whole path"
            raise BridgeError(text, FailureReason.NOT_FOUND)
        for entry in seen:
            if entry.condition == "hung":
                raise BridgeTimeoutError(f"component {entry.path!r} does not answer")
        if seen:
            text = f"component {seen[0].path!r} is dead: only its name is left"
            raise BridgeError(text, FailureReason.UNAVAILABLE)
        if unreadable is not None:
            raise unreadable
        text = f"there is no component {path!r} in {where}"
        close = difflib.get_close_matches(path, [entry.path for entry in every], n=1)
        if close:
            text = f"{text}; did you mean {close[0]!r}?"
        raise BridgeError(text, FailureReason.NOT_FOUND)
