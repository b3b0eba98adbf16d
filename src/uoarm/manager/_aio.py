"""The asyncio twins of the manager and its connections, for programs that must not block."""

from __future__ import annotations

import asyncio
import functools
from collections.abc import AsyncIterator, Callable
from types import TracebackType
from typing import TypeVar, final

from uoarm._event_by import event_by
from uoarm.errors import ConnectionClosedError
from uoarm.manager._connection import Connection
from uoarm.manager._robot_manager import RobotManager
from uoarm.model import (
    ConnectionState,
    ConnectionStatus,
    Message,
    Plan,
    QueuePolicy,
    StatusMap,
    ValidationMode,
)

__all__ = ["AsyncConnection", "AsyncRobotManager"]

T = TypeVar("T")


@final
class AsyncConnection:
    """A connection read from an event loop: `async for`, `await get()`, `async with`.

    However many messages arrive, the loop is woken once until it has read them. Use it from the
    loop in which it was made.
    """

    def __init__(self, connection: Connection) -> None:
        self._connection = connection
        self._loop = asyncio.get_running_loop()
        self._arrived = asyncio.Event()
        self._woken = False
        connection.on_wake(self._wake)

    @property
    def id(self) -> str:
        """The connection's id in the status map."""
        return self._connection.id

    @property
    def plan(self) -> Plan:
        """The plan that runs."""
        return self._connection.plan

    async def get(self, timeout: float | None = None) -> Message:
        """Return the next message; raises as `Connection.get` does."""
        deadline = None if timeout is None else self._loop.time() + timeout
        while True:
            self._arrived.clear()
            self._woken = False
            try:
                return self._connection.get(0)
            except TimeoutError:
                if deadline is not None and self._loop.time() >= deadline:
                    raise TimeoutError(f"no message within {timeout:g} s") from None
                await event_by(self._arrived, deadline)

    async def __aiter__(self) -> AsyncIterator[Message]:
        """Yield messages until the connection is killed or its source finishes."""
        while True:
            try:
                message = await self.get()
            except ConnectionClosedError:
                if self._connection.state is ConnectionState.FAILED:
                    raise
                return
            yield message

    async def send(self, message: Message, port: str | None = None) -> None:
        """Hand one message to an input, as `Connection.send` does, outside the loop's thread."""
        await _outside(self._connection.send, message, port)

    async def kill(self) -> None:
        """End the connection, outside the loop's thread."""
        await _outside(self._connection.kill)

    def status(self) -> ConnectionStatus:
        """Return what the status map shows."""
        return self._connection.status()

    async def __aenter__(self) -> AsyncConnection:
        return self

    async def __aexit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        await self.kill()

    def _wake(self) -> None:
        if not self._woken:
            self._woken = True
            try:
                self._loop.call_soon_threadsafe(self._arrived.set)
            except RuntimeError:
                self._woken = False


@final
class AsyncRobotManager:
    """A robot manager whose waiting calls are awaited; wraps one that lives on.

    Args:
        robot: the manager to use. Closing the wrapper closes it.
    """

    def __init__(self, robot: RobotManager) -> None:
        self.robot = robot

    async def resolve(self, name: str) -> Plan:
        """Return the plan that `request` would open; raises as `RobotManager.resolve`."""
        return await _outside(self.robot.resolve, name)

    async def request(
        self,
        name: str,
        *,
        validate: ValidationMode | str = ValidationMode.OFF,
        queue: QueuePolicy | None = None,
        timeout: float = 60.0,
    ) -> AsyncConnection:
        """Open a function and return its connection; raises as `RobotManager.request`."""
        ask = functools.partial(
            self.robot.request, name, validate=validate, queue=queue, timeout=timeout
        )
        return AsyncConnection(await _outside(ask))

    async def call(self, name: str, message: Message, *, timeout: float = 10.0) -> Message:
        """Call a service; raises as `RobotManager.call`."""
        return await _outside(functools.partial(self.robot.call, name, message, timeout=timeout))

    def status(self) -> StatusMap:
        """Return the whole system as it is at this moment."""
        return self.robot.status()

    async def close(self) -> None:
        """Close the manager."""
        await _outside(self.robot.close)

    async def __aenter__(self) -> AsyncRobotManager:
        return self

    async def __aexit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        await self.close()


async def _outside(action: Callable[..., T], *arguments: object) -> T:
    """Run a waiting call in a thread of the loop's executor."""
    return await asyncio.get_running_loop().run_in_executor(None, action, *arguments)
