"""The structures of functions, found out side by side and kept, so that asking costs no waiting."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Awaitable, Callable, Iterable, Mapping
from types import MappingProxyType
from typing import Any, TypeAlias

from attrs import define, field

from uoarm._raised import Log
from uoarm.errors import UoarmError
from uoarm.model import MessageStructure, Plan
from uoarm.server.streams._workers import Workers

_FRESH_SECONDS = 2.0
_WAIT_SECONDS = 0.15
_NEVER = float("-inf")
_NONE: Mapping[str, MessageStructure] = MappingProxyType({})


@define(eq=False)
class _Entry:
    """What is known of one function, and since which change; `asking` finds out more."""

    structures: Mapping[str, MessageStructure] = _NONE
    until: float = _NEVER
    generation: int = -1
    asking: asyncio.Task[None] | None = None


class KnownStructures:
    """Structures by function and port, in the loop's thread.

    What was found out is answered at once for two seconds, and after that as well, while it is
    looked up again: the second question has the new answer. A function that cannot be had has
    no structures.

    Args:
        resolve: finds the plan of a function; may wait, so it is called in a worker.
        at_once: functions that are asked for side by side.
    """

    def __init__(self, resolve: Callable[[str], Plan], workers: Workers, at_once: int) -> None:
        self._resolve = resolve
        self._workers = workers
        self._turns = asyncio.Semaphore(at_once)
        self._entries: dict[str, _Entry] = {}
        # Counts changes of the robot: what was found before the last one is asked for again.
        self._generation = 0

    async def of(self, functions: Iterable[str]) -> dict[str, Mapping[str, MessageStructure]]:
        """Return the structures of functions by port, such as `output.default`.

        What is not known is waited for 0.15 s at most, all together; until it is known a function
        has none.
        """
        asked = {name: self._entries.setdefault(name, _Entry()) for name in functions}
        now = time.monotonic()
        for name, entry in asked.items():
            # One question a function at a time, of all clients: a stale answer is given meanwhile.
            if entry.asking is None and (entry.until < now or entry.generation != self._generation):
                entry.asking = asyncio.ensure_future(self._ask(name, entry))
        unknown = [
            entry.asking
            for entry in asked.values()
            if entry.asking and entry.generation != self._generation
        ]
        if unknown:  # not cancelled when the time is over: the next who asks has the answer
            await asyncio.wait(unknown, timeout=_WAIT_SECONDS)
        return {name: entry.structures for name, entry in asked.items()}

    def forget(self) -> None:
        """Have everything asked for again: the configuration or what can be had has changed."""
        self._generation += 1

    def close(self) -> None:
        for entry in self._entries.values():
            if entry.asking is not None:
                entry.asking.cancel()

    async def _ask(self, name: str, entry: _Entry) -> None:
        # Read again when its turn comes, and before the look: a change during the look must make
        # the answer stale, not be taken for a part of it.
        generation = self._generation
        try:
            async with self._turns:
                generation = self._generation
                plan = await self._workers.open(lambda: self._resolve(name))
            entry.structures = plan.provider.structures
        except UoarmError:
            entry.structures = _NONE
        finally:
            entry.until = time.monotonic() + _FRESH_SECONDS
            entry.generation = generation
            entry.asking = None


_MOST_KEPT = 1024
_LONGEST = 255
_log = Log("uoarm.server")
InWorker: TypeAlias = Callable[[Callable[[], Any]], Awaitable[Any]]


@define(eq=False)
class KnownTypes:
    """Structures by the name of the type, in the loop's thread; that there is none is kept too.

    Args:
        find: asks the plugins; may wait, so it is called in a worker.
        bridges: those of the configuration in force; others know other types.
    """

    _find: Callable[[str], MessageStructure | None]
    _in_worker: InWorker
    _bridges: Callable[[], object]
    _asked: object = field(default=None, init=False)
    _entries: dict[str, asyncio.Task[MessageStructure | None]] = field(factory=dict, init=False)

    async def of(self, name: str) -> MessageStructure | None:
        """Return the structure of a type; who asks beside another waits for the same answer."""
        if not name or len(name) > _LONGEST:
            return None
        if self._asked is not (bridges := self._bridges()):
            # By identity: another configuration has another mapping, and may know other types.
            self._asked = bridges
            self._entries.clear()
        entry = self._entries.get(name)
        if entry is None:
            # The oldest goes, in whatever state: who waits for it holds its task.
            if len(self._entries) >= _MOST_KEPT:
                del self._entries[next(iter(self._entries))]
            entry = self._entries[name] = asyncio.ensure_future(self._ask(name))
        # Shielded: one client that goes must not end the question for others.
        return await asyncio.shield(entry)

    def close(self) -> None:
        for entry in self._entries.values():
            entry.cancel()

    async def _ask(self, name: str) -> MessageStructure | None:
        try:
            found: MessageStructure | None = await self._in_worker(lambda: self._find(name))
        except UoarmError as error:
            _log.warning("messages of type %.200r are not checked: %s", name, error)
            return None
        return found
