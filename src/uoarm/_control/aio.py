"""The asyncio twins of the manager and its connections, for programs that must not block."""

from __future__ import annotations

import asyncio
import logging
import time
from abc import abstractmethod
from collections.abc import AsyncIterator, Callable, Mapping
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import asynccontextmanager
from functools import partial
from os import PathLike
from types import TracebackType
from typing import Any, Generic, TypeVar, final, overload

from typing_extensions import Self

from uoarm._control.connection import Connection
from uoarm._control.robot_manager import RobotManager
from uoarm._dataplane import Clock
from uoarm._deadlines import event_by
from uoarm._hints.applications import T
from uoarm._renewal import HeldCommand
from uoarm.bridge import Registry
from uoarm.errors import ConnectionClosedError, UsageError
from uoarm.model import (
    BridgeFindings,
    ConfigurationChange,
    ConnectionState,
    ConnectionStatus,
    Deliver,
    FunctionStatus,
    Gap,
    LeaseHolder,
    Message,
    MessageStructure,
    OfferStatus,
    Plan,
    QueuePolicy,
    Robot,
    RouteStatus,
    StatusEvent,
    StatusMap,
    StopReport,
    ValidationMode,
)

__all__ = ["AsyncConnection", "AsyncRobotManager"]

Result = TypeVar("Result")
_AT_ONCE = 32
_log = logging.getLogger("uoarm")


class _Closing:
    """Closed at the end of an `async with`."""

    @abstractmethod
    async def close(self) -> None: ...

    async def __aenter__(self) -> Self:
        return self

    async def __aexit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        await self.close()


@final
class AsyncConnection(_Closing, Generic[T]):
    """A connection read from an event loop: `async for`, `await get()`, `async with`.

    However many messages arrive, the loop is woken once until it has read them. Use it from the
    loop in which it was made. Everything else is as with `Connection`.
    """

    def __init__(self, connection: Connection[T], executor: ThreadPoolExecutor) -> None:
        self._connection = connection
        self._executor = executor
        self._loop = asyncio.get_running_loop()
        self._arrived = asyncio.Event()
        self._woken = False
        self._callbacks: tuple[Callable[[T], None], ...] = ()
        self._reading: asyncio.Task[None] | None = None

    @property
    def id(self) -> str:
        """The connection's id in the status map."""
        return self._connection.id

    @property
    def plan(self) -> Plan:
        """The plan that runs."""
        return self._connection.plan

    @property
    def state(self) -> ConnectionState:
        """Where in its life the connection is."""
        return self._connection.state

    @property
    def cause(self) -> str:
        """Why it ended, or for what it waits; empty while it runs and after `kill`."""
        return self._connection.cause

    @property
    def output(self) -> str | None:
        """The output that the application receives, None where it receives none."""
        return self._connection.output

    @property
    def gaps(self) -> tuple[Gap, ...]:
        """The changes of plan so far, oldest first, the newest thousand of them."""
        return self._connection.gaps

    @property
    def ended(self) -> bool:
        """Whether the connection is closed, for whatever reason."""
        return self._connection.ended

    async def get(self, timeout: float | None = None) -> T:
        """Return the next message; raises as `Connection.get` does."""
        deadline = None if timeout is None else self._loop.time() + timeout
        self._connection._on_wake(self._wake)  # noqa: SLF001 - its twin
        while True:
            self._arrived.clear()
            self._woken = False
            try:
                return self._connection.get(0)
            except TimeoutError:
                if deadline is not None and self._loop.time() >= deadline:
                    trouble = self._connection._trouble()  # noqa: SLF001 - its twin
                    raise TimeoutError(f"no message within {timeout:g} s{trouble}") from None
                await event_by(self._arrived, deadline)

    async def __aiter__(self) -> AsyncIterator[T]:
        """Yield messages until the connection is killed or its source finishes."""
        while True:
            try:
                message = await self.get()
            except ConnectionClosedError:
                if self.state is ConnectionState.FAILED:
                    raise
                return
            yield message

    def subscribe(self, callback: Callable[[T], None]) -> Callable[[], None]:
        """Give messages to a callback from now on, in the loop; returns what ends it.

        As long as there is one, a task of the loop reads the connection, and nobody else should.
        A callback that raises is logged and stays.

        Raises:
            UsageError: the function has no output.
        """
        if self.output is None:
            raise UsageError(f"function {self.plan.function!r} has no output to read")
        self._callbacks = (*self._callbacks, callback)
        if self._reading is None:
            self._reading = self._loop.create_task(self._read())

        def end() -> None:
            self._callbacks = tuple(one for one in self._callbacks if one is not callback)
            if not self._callbacks and self._reading is not None:
                self._reading.cancel()
                self._reading = None

        return end

    async def send(
        self,
        message: Message,
        port: str | None = None,
        *,
        sender: LeaseHolder | None = None,
        take_over: bool = False,
    ) -> None:
        """Hand one message to an input, as `Connection.send` does, outside the loop's thread."""
        send = partial(self._connection.send, sender=sender, take_over=take_over)
        await self._outside(partial(send, message, port))

    async def stop(
        self,
        port: str | None = None,
        *,
        sender: LeaseHolder | None = None,
        timeout: float = 2.0,
    ) -> None:
        """Stop an input that moves something, as `Connection.stop` does."""
        await self._outside(partial(self._connection.stop, port, sender=sender, timeout=timeout))

    @asynccontextmanager
    async def hold(
        self,
        message: Message,
        port: str | None = None,
        *,
        period: float | None = None,
        sender: LeaseHolder | None = None,
        take_over: bool = False,
    ) -> AsyncIterator[HeldCommand]:
        """Renew a command for the length of an `async with` block, as `Connection.hold` does.

        A thread renews it, so that a loop that is busy for a while does not stop what moves.
        """
        hold = partial(self._connection.hold, message, port, period=period, sender=sender)
        held = await self._outside(partial(hold, take_over=take_over))
        command = await self._outside(held.__enter__)
        try:
            yield command
        finally:
            await self._outside(partial(held.__exit__, None, None, None))

    async def leave(self, sender: LeaseHolder) -> None:
        """Give back what leases a sender holds, as `Connection.leave` does."""
        await self._outside(partial(self._connection.leave, sender))

    def lifetimes(self) -> Mapping[str, float]:
        """Return for how many seconds a command lives, by input; those without one are left out."""
        return self._connection.lifetimes()

    async def flush(self, timeout: float) -> bool:
        """Wait until the component has taken what was sent; False when time ran out."""
        return await self._outside(partial(self._connection.flush, timeout))

    async def kill(self) -> None:
        """End the connection, outside the loop's thread."""
        await self._outside(self._connection.kill)

    async def close(self) -> None:
        """End the connection: another name for `kill`, the word of the paper."""
        await self.kill()

    def status(self) -> ConnectionStatus:
        """Return what the status map shows."""
        return self._connection.status()

    def routes(self) -> tuple[RouteStatus, ...]:
        """Return the counters of the routes that belong to this connection alone."""
        return self._connection.routes()

    def __repr__(self) -> str:
        return f"<Async{repr(self._connection)[1:]}"

    async def _read(self) -> None:
        try:
            async for message in self:
                for callback in self._callbacks:
                    try:
                        callback(message)
                    except Exception:  # noqa: BLE001 - a callback may raise anything
                        _log.exception("callback %r raised", callback)
        except ConnectionClosedError as error:
            _log.debug("%s", error)  # its state and cause say so to whoever asks

    async def _outside(self, action: Callable[[], Result]) -> Result:
        return await asyncio.wrap_future(self._executor.submit(action))

    def _wake(self) -> None:
        if not self._woken:
            self._woken = True
            try:
                self._loop.call_soon_threadsafe(self._arrived.set)
            except RuntimeError:
                self._woken = False


@final
class AsyncRobotManager(_Closing):
    """A robot manager whose waiting calls are awaited; wraps one that lives on.

    Waiting calls run in threads of its own, 32 at once and 32 more of connections; further ones
    wait for their turn. Everything else is as with `RobotManager`.

    Args:
        robot: the manager to use. Closing the wrapper closes it.
    """

    def __init__(self, robot: RobotManager) -> None:
        self.robot = robot
        self._asking = ThreadPoolExecutor(_AT_ONCE, thread_name_prefix="uoarm-async")
        # What ends a connection never waits for a bridge that hangs as another one is opened.
        self._handling = ThreadPoolExecutor(_AT_ONCE, thread_name_prefix="uoarm-async-handle")

    @classmethod
    def from_file(
        cls,
        path: str | PathLike[str],
        *,
        registry: Registry | None = None,
        clock: Clock = time.monotonic,
        stop_file: str | PathLike[str] | None = None,
    ) -> AsyncRobotManager:
        """Read a configuration file and make its manager; raises as `RobotManager.from_file`.

        The file is read at once, in the calling thread.
        """
        robot = RobotManager.from_file(path, registry=registry, clock=clock, stop_file=stop_file)
        return cls(robot)

    @property
    def config(self) -> Robot:
        """The configuration, with the options that uoarm chose filled in."""
        return self.robot.config

    @property
    def revision(self) -> int:
        """How many changes of the configuration led to the one in force."""
        return self.robot.revision

    @property
    def registry(self) -> Registry:
        """The bridge plugins."""
        return self.robot.registry

    async def resolve(self, name: str, *, timeout: float = 60.0) -> Plan:
        """Return the plan that `request` would open; raises as `RobotManager.resolve`."""
        return await self._outside(partial(self.robot.resolve, name, timeout=timeout))

    async def structures(
        self, component: str, *, timeout: float = 60.0
    ) -> Mapping[str, MessageStructure]:
        """Return the structures of a component's ports, as `RobotManager.structures` does."""
        return await self._outside(partial(self.robot.structures, component, timeout=timeout))

    @overload
    async def request(
        self,
        name: str,
        *,
        as_type: type[T],
        validate: ValidationMode | str = ...,
        queue: QueuePolicy | None = None,
        on_message: Callable[[T], None] | None = None,
        timeout: float = 60.0,
    ) -> AsyncConnection[T]: ...

    @overload
    async def request(
        self,
        name: str,
        *,
        as_type: object = None,
        validate: ValidationMode | str = ...,
        queue: QueuePolicy | None = None,
        on_message: Deliver | None = None,
        timeout: float = 60.0,
    ) -> AsyncConnection: ...

    async def request(
        self,
        name: str,
        *,
        as_type: Any = None,
        validate: ValidationMode | str = ValidationMode.SAMPLED,
        queue: QueuePolicy | None = None,
        on_message: Callable[[Any], None] | None = None,
        timeout: float = 60.0,
    ) -> AsyncConnection[Any]:
        """Open a function and return its connection; raises as `RobotManager.request`.

        A callback is called in the loop. When the task is cancelled, what opens all the same is
        closed as soon as it has opened.
        """
        ask = partial(self.robot.request, name, validate=validate, queue=queue, timeout=timeout)
        asked = self._asking.submit(partial(ask, as_type=as_type))
        try:
            connection = AsyncConnection(await asyncio.wrap_future(asked), self._handling)
        except asyncio.CancelledError:
            asked.add_done_callback(self._put_away)
            raise
        if on_message is not None:
            connection.subscribe(on_message)
        return connection

    @overload
    async def call(
        self, name: str, message: Message, *, as_type: type[T], timeout: float = 10.0
    ) -> T: ...

    @overload
    async def call(
        self, name: str, message: Message, *, as_type: object = None, timeout: float = 10.0
    ) -> Message: ...

    async def call(
        self, name: str, message: Message, *, as_type: Any = None, timeout: float = 10.0
    ) -> Message:
        """Call a service; raises as `RobotManager.call`."""
        ask = partial(self.robot.call, name, message, as_type=as_type, timeout=timeout)
        return await self._outside(ask)

    def connections(self) -> tuple[AsyncConnection, ...]:
        """Return the connections that have not ended, oldest first, whoever requested them.

        Each is a handle of its own: one that is read here is no longer read elsewhere.
        """
        return tuple(AsyncConnection(one, self._handling) for one in self.robot.connections())

    def status(self) -> StatusMap:
        """Return the whole system as it is at this moment."""
        return self.robot.status()

    async def discover(
        self, *, timeout: float = 10.0, grace: float | None = None
    ) -> tuple[BridgeFindings, ...]:
        """Return what every bridge sees now, configured or not; opens nothing."""
        return await self._outside(partial(self.robot.discover, timeout=timeout, grace=grace))

    async def apply(
        self,
        robot: Robot,
        *,
        dry_run: bool = False,
        force: bool = False,
        revision: int | None = None,
        timeout: float = 60.0,
    ) -> ConfigurationChange:
        """Change the configuration while the manager runs, as `RobotManager.apply` does."""
        change = partial(
            self.robot.apply,
            robot,
            dry_run=dry_run,
            force=force,
            revision=revision,
            timeout=timeout,
        )
        return await self._outside(change)

    async def reload(
        self,
        path: str | PathLike[str] | None = None,
        *,
        dry_run: bool = False,
        force: bool = False,
        timeout: float = 60.0,
    ) -> ConfigurationChange:
        """Read a configuration file and apply it, as `RobotManager.reload` does."""
        reload = partial(self.robot.reload, path, dry_run=dry_run, force=force, timeout=timeout)
        return await self._outside(reload)

    async def rollback(
        self,
        to: int,
        *,
        dry_run: bool = False,
        force: bool = False,
        revision: int | None = None,
        timeout: float = 60.0,
    ) -> ConfigurationChange:
        """Apply an earlier revision's configuration again, as `RobotManager.rollback` does."""
        change = partial(
            self.robot.rollback,
            to,
            dry_run=dry_run,
            force=force,
            revision=revision,
            timeout=timeout,
        )
        return await self._outside(change)

    async def offer(self, *, timeout: float = 60.0) -> tuple[OfferStatus, ...]:
        """Open what the configuration offers in frameworks, as `RobotManager.offer` does."""
        return await self._outside(partial(self.robot.offer, timeout=timeout))

    def history(self) -> tuple[ConfigurationChange, ...]:
        """Return the last hundred revisions of the configuration, the one in force last."""
        return self.robot.history()

    async def stop_all(self, *, timeout: float = 2.0) -> StopReport:
        """Stop every input that moves something, as `RobotManager.stop_all` does."""
        # Not among other calls, for which it might have to wait.
        return await asyncio.to_thread(partial(self.robot.stop_all, timeout=timeout))

    async def release(self, *, timeout: float = 2.0) -> None:
        """Let commands through again; raises as `RobotManager.release`."""
        await asyncio.to_thread(partial(self.robot.release, timeout=timeout))

    @property
    def is_stopped(self) -> bool:
        """Whether commands are refused, from `stop_all` to `release`."""
        return self.robot.is_stopped

    async def check_availability(self) -> tuple[FunctionStatus, ...]:
        """Return which functions and components can be had now; opens nothing."""
        return await self._outside(self.robot.check_availability)

    def listen(self, listener: Callable[[StatusEvent], None]) -> Callable[[], None]:
        """Tell a listener every change from now on, in order and in the loop; returns what ends it.

        Call it in the loop.
        """
        loop = asyncio.get_running_loop()
        listening = True

        def tell(event: StatusEvent) -> None:
            if listening:
                listener(event)

        def pass_on(event: StatusEvent) -> None:
            if not loop.is_closed():
                loop.call_soon_threadsafe(tell, event)

        end_there = self.robot.listen(pass_on)

        def end() -> None:
            nonlocal listening
            listening = False
            end_there()

        return end

    async def close(self) -> None:
        """Close the manager. Idempotent; bounded in time."""
        await asyncio.wrap_future(self._handling.submit(self.robot.close))

    def __repr__(self) -> str:
        return f"<Async{repr(self.robot)[1:]}"

    async def _outside(self, action: Callable[[], Result]) -> Result:
        return await asyncio.wrap_future(self._asking.submit(action))

    def _put_away(self, asked: Future[Connection]) -> None:
        """Close what was opened for a task that is gone."""
        if not asked.cancelled() and asked.exception() is None:
            self._handling.submit(asked.result().kill)
