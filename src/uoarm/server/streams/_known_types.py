"""The structures of native types by name, found out once each."""

from __future__ import annotations

import asyncio
import logging
from collections.abc import Awaitable, Callable
from typing import Any, TypeAlias

from uoarm.errors import UoarmError
from uoarm.model import MessageStructure

__all__ = ["KnownTypes"]

_MOST_KEPT = 1024
_LONGEST = 255
_log = logging.getLogger("uoarm.server")
InWorker: TypeAlias = Callable[[Callable[[], Any]], Awaitable[Any]]


class KnownTypes:
    """Structures by the name of the type, in the loop's thread; that there is none is kept too.

    Args:
        find: asks the plugins; may wait, so it is called in a worker.
        in_worker: calls it there.
        bridges: those of the configuration in force; others know other types.
    """

    def __init__(
        self,
        find: Callable[[str], MessageStructure | None],
        in_worker: InWorker,
        bridges: Callable[[], object],
    ) -> None:
        self._find = find
        self._in_worker = in_worker
        self._bridges = bridges
        self._asked: object = None
        self._entries: dict[str, asyncio.Task[MessageStructure | None]] = {}

    async def of(self, name: str) -> MessageStructure | None:
        """Return the structure of a type; who asks beside another waits for the same answer."""
        if not name or len(name) > _LONGEST:
            return None
        if self._asked is not (bridges := self._bridges()):
            self._asked = bridges
            self._entries.clear()
        entry = self._entries.get(name)
        if entry is None:
            if len(self._entries) >= _MOST_KEPT:
                del self._entries[next(iter(self._entries))]
            entry = self._entries[name] = asyncio.ensure_future(self._ask(name))
        return await asyncio.shield(entry)

    def close(self) -> None:
        """Find out nothing more."""
        for entry in self._entries.values():
            entry.cancel()

    async def _ask(self, name: str) -> MessageStructure | None:
        try:
            found: MessageStructure | None = await self._in_worker(lambda: self._find(name))
        except UoarmError as error:
            _log.warning("messages of type %.200r are not checked: %s", name, error)
            return None
        return found
