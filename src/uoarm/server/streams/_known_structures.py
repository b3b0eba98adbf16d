"""The structures of functions, found out side by side and kept, so that asking costs no waiting."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Callable, Iterable, Mapping
from types import MappingProxyType

from attrs import define

from uoarm.errors import UoarmError
from uoarm.model import MessageStructure, Plan
from uoarm.server.streams._workers import Workers

__all__ = ["KnownStructures"]

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

    What was found out is told at once for two seconds, and after that as well, while it is asked
    for again: who asks a second time has it. A function that cannot be had has no structures.

    Args:
        resolve: finds the plan of a function; may wait, so it is called in a worker.
        workers: where it waits.
        at_once: functions that are asked for side by side.
    """

    def __init__(self, resolve: Callable[[str], Plan], workers: Workers, at_once: int) -> None:
        self._resolve = resolve
        self._workers = workers
        self._turns = asyncio.Semaphore(at_once)
        self._entries: dict[str, _Entry] = {}
        self._generation = 0

    async def of(self, functions: Iterable[str]) -> dict[str, Mapping[str, MessageStructure]]:
        """Return the structures of functions by port, such as `output.default`.

        What is not known is waited for 0.15 s at most, all together; until it is known a function
        has none.
        """
        asked = {name: self._entries.setdefault(name, _Entry()) for name in functions}
        now = time.monotonic()
        for name, entry in asked.items():
            if entry.asking is None and (entry.until < now or entry.generation != self._generation):
                entry.asking = asyncio.ensure_future(self._ask(name, entry))
        unknown = [
            entry.asking
            for entry in asked.values()
            if entry.asking and entry.generation != self._generation
        ]
        if unknown:
            await asyncio.wait(unknown, timeout=_WAIT_SECONDS)
        return {name: entry.structures for name, entry in asked.items()}

    def forget(self) -> None:
        """Have everything asked for again: the configuration or what can be had has changed."""
        self._generation += 1

    def close(self) -> None:
        """Find out nothing more."""
        for entry in self._entries.values():
            if entry.asking is not None:
                entry.asking.cancel()

    async def _ask(self, name: str, entry: _Entry) -> None:
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
