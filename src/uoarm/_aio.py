"""The asyncio forms of the manager and its connections, for programs that must not block."""

from __future__ import annotations

import asyncio
import logging
import time
from abc import abstractmethod
from collections.abc import AsyncIterator, Callable, Coroutine
from concurrent.futures import Executor, Future
from contextlib import asynccontextmanager
from functools import partial, wraps
from os import PathLike
from typing import Any, Concatenate, Generic, ParamSpec, TypeVar, final, overload

from typing_extensions import Self

from uoarm._arguments import arguments
from uoarm._control.connection import Connection
from uoarm._control.robot_manager import RobotManager
from uoarm._dataplane import Clock
from uoarm._forks import forks
from uoarm._hints.applications import T
from uoarm._raised import LimitedLog, Log, foreign, name_of
from uoarm._renewal import HeldCommand
from uoarm._support.aio_deadlines import event_by
from uoarm._support.workers import WorkerExecutor, settle
from uoarm.bridge import Registry
from uoarm.errors import ConnectionClosedError, UsageError
from uoarm.model import (
    ConnectionState,
    Deliver,
    Gap,
    LeaseHolder,
    Message,
    Plan,
    QueuePolicy,
    Robot,
    StatusEvent,
    StopReport,
    ValidationMode,
)

Result = TypeVar("Result")
# Covariant: methods that a manager inherits are those of a proxy of what it is more generally.
Threaded_co = TypeVar("Threaded_co", covariant=True)
P = ParamSpec("P")
_AT_ONCE = 32
_log = Log("uoarm")


class _AsyncProxy(Generic[Threaded_co]):
    """What has the methods of something that blocks, awaited; closed at the end of `async with`."""

    def __init__(self, threaded: Threaded_co, executor: Executor, handling: Executor) -> None:
        self._threaded = threaded
        self._executor = executor
        self._handling = handling  # has threads for what ends something
        self._process = forks.generation

    @abstractmethod
    async def close(self) -> None: ...

    async def _outside(
        self, action: Callable[[], Result], undo: Callable[[Result], object] | None = None
    ) -> Result:
        """Await what blocks; `undo` gets what comes of it after the task was cancelled."""
        asked = self._executor.submit(action)
        try:
            return await asyncio.wrap_future(asked)
        except asyncio.CancelledError:
            if undo is not None:
                asked.add_done_callback(partial(self._put_away, undo))
            raise

    def _put_away(self, undo: Callable[[Result], object], asked: Future[Result]) -> None:
        if not asked.cancelled() and asked.exception() is None:
            _begun(partial(undo, asked.result()), self._handling)

    async def _surely(self, action: Callable[[], Result], executor: Executor) -> Result:
        """Await what ends or stops something; done even where the task is cancelled before."""
        asked = _begun(action, executor)
        try:
            return await asyncio.wrap_future(asked)
        except asyncio.CancelledError:
            if asked.cancelled():
                _begun(action, executor)
            raise

    async def __aenter__(self) -> Self:
        return self

    async def __aexit__(self, *_: object) -> None:
        # A forked child has none of the threads, and owns nothing.
        if forks.generation == self._process:
            await self.close()

    def __repr__(self) -> str:
        return f"<Async{repr(self._threaded)[1:]}"


def _begun(action: Callable[[], Result], executor: Executor) -> Future[Result]:
    try:
        return executor.submit(action)
    except RuntimeError:  # the system gives no thread: late is better than not at all
        done: Future[Result] = Future()
        settle(done, action)
        return done


def _awaited(
    method: Callable[Concatenate[Threaded_co, P], Result],
    *,
    undo: Callable[[Result], object] | None = None,
    surely: bool = False,
) -> Callable[Concatenate[_AsyncProxy[Threaded_co], P], Coroutine[Any, Any, Result]]:
    """Return a method that blocks as one to await: it runs outside the loop's thread.

    Parameters, result and text are those of the method, for type checkers and documentation too.
    """

    @wraps(method)
    async def proxy(self: _AsyncProxy[Threaded_co], /, *args: P.args, **kwargs: P.kwargs) -> Result:
        action = partial(method, self._threaded, *args, **kwargs)
        if surely:
            return await self._surely(action, self._handling)
        return await self._outside(action, undo)

    return proxy


def _at_once(
    method: Callable[Concatenate[Threaded_co, P], Result],
) -> Callable[Concatenate[_AsyncProxy[Threaded_co], P], Result]:
    """Return the form for asyncio of a method that does not block, which is called as it is."""

    @wraps(method)
    def proxy(self: _AsyncProxy[Threaded_co], /, *args: P.args, **kwargs: P.kwargs) -> Result:
        return method(self._threaded, *args, **kwargs)

    return proxy


@final
class AsyncConnection(_AsyncProxy[Connection[T]], Generic[T]):
    """A connection read from an event loop: `async for`, `await get()`, `async with`.

    However many messages arrive, the loop is woken once until it has read them. It is of one loop
    at a time: that which read last. Everything else is as with `Connection`.
    """

    def __init__(self, connection: Connection[T], executor: Executor) -> None:
        super().__init__(connection, executor, executor)
        self._loop = asyncio.get_running_loop()
        self._arrived = asyncio.Event()
        self._woken = False
        self._callbacks: tuple[Callable[[T], None], ...] = ()
        self._reading: asyncio.Task[None] | None = None

    @property
    def id(self) -> str:
        """The connection's id in the status map."""
        return self._threaded.id

    @property
    def plan(self) -> Plan:
        """The plan that runs."""
        return self._threaded.plan

    @property
    def state(self) -> ConnectionState:
        """Where in its life the connection is."""
        return self._threaded.state

    @property
    def cause(self) -> str:
        """Why it ended, or for what it waits; empty while it runs and after `kill`."""
        return self._threaded.cause

    @property
    def output(self) -> str | None:
        """The output that the application receives, None where it receives none."""
        return self._threaded.output

    @property
    def gaps(self) -> tuple[Gap, ...]:
        """The changes of plan so far, oldest first, the newest thousand of them."""
        return self._threaded.gaps

    @property
    def ended(self) -> bool:
        """Whether the connection is closed, for whatever reason."""
        return self._threaded.ended

    async def get(self, timeout: float | None = None) -> T:
        """Return the next message; raises as `Connection.get` does."""
        loop = asyncio.get_running_loop()
        if loop is not self._loop:  # the one before has ended, as `asyncio.run` does
            self._loop, self._arrived = loop, asyncio.Event()
        deadline = None if timeout is None else loop.time() + timeout
        self._threaded._on_wake(self._wake)  # noqa: SLF001 - of ours
        while True:
            self._arrived.clear()
            self._woken = False
            try:
                return self._threaded.get(0)
            except TimeoutError:
                if deadline is not None and loop.time() >= deadline:
                    trouble = self._threaded._trouble()  # noqa: SLF001 - of ours
                    raise TimeoutError(f"no message within {timeout:g} s{trouble}") from None
                await event_by(self._arrived, deadline)

    async def __aiter__(self) -> AsyncIterator[T]:
        """Yield messages until the connection is killed or its source finishes."""
        while True:
            try:
                message = await self.get()
            except ConnectionClosedError:
                self._threaded._require_own()  # noqa: SLF001 - of ours
                if self.state is ConnectionState.FAILED:
                    raise
                return
            yield message

    @arguments()
    def subscribe(self, callback: Callable[[T], None]) -> Callable[[], None]:
        """Give messages to a callback from now on, in the loop; returns what ends it.

        As long as there is one, a task of the loop reads the connection, and nothing else should.
        A callback that raises is logged and stays.

        Raises:
            UsageError: the function has no output.
        """
        if self.output is None:
            raise UsageError(f"function {self.plan.function!r} has no output to read")
        self._callbacks = (*self._callbacks, callback)
        if self._reading is None or self._reading.done():  # with the loop before
            self._reading = asyncio.get_running_loop().create_task(self._read())

        def end() -> None:
            self._callbacks = tuple(
                function for function in self._callbacks if function is not callback
            )
            if not self._callbacks and self._reading is not None:
                self._reading.cancel()
                self._reading = None

        return end

    send = _awaited(Connection.send)
    stop = _awaited(Connection.stop, surely=True)
    leave = _awaited(Connection.leave, surely=True)
    flush = _awaited(Connection.flush)
    kill = _awaited(Connection.kill, surely=True)
    lifetimes = _at_once(Connection.lifetimes)
    status = _at_once(Connection.status)
    routes = _at_once(Connection.routes)

    @asynccontextmanager
    @arguments()
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
        hold = partial(self._threaded.hold, message, port, period=period, sender=sender)
        held = await self._outside(partial(hold, take_over=take_over))
        end = partial(held.__exit__, None, None, None)
        command = await self._outside(held.__enter__, undo=lambda _: end())
        try:
            yield command
        finally:
            await self._surely(end, self._handling)

    async def close(self) -> None:
        """End the connection: another name for `kill`, the word of the paper."""
        await self.kill()

    async def _read(self) -> None:
        records = LimitedLog(_log)
        try:
            async for message in self:
                for callback in self._callbacks:
                    try:
                        foreign(callback, message)
                    except Exception as error:  # noqa: BLE001 - a callback may raise anything
                        records.write(logging.ERROR, f"callback {name_of(callback)} raised", error)
        except ConnectionClosedError as error:
            _log.debug("%s", error)  # its state and cause say so to a caller that asks

    def _wake(self) -> None:
        if not self._woken:
            self._woken = True
            try:
                self._loop.call_soon_threadsafe(self._arrived.set)
            except RuntimeError:
                self._woken = False


@final
class AsyncRobotManager(_AsyncProxy[RobotManager]):
    """A robot manager whose waiting calls are awaited; wraps one that lives on.

    Waiting calls run in threads of its own, 32 at once and 32 more of connections; further ones
    wait for their turn. What ends or stops something is done even where its task is cancelled
    before its turn. Everything else is as with `RobotManager`.

    Args:
        robot: the manager to use. Closing the wrapper closes it.
    """

    @arguments(robot="AsyncRobotManager.from_file(path) reads a file")
    def __init__(self, robot: RobotManager) -> None:
        # What ends a connection never waits for a bridge that hangs as another one is opened.
        handling = WorkerExecutor("uoarm-async-handle", _AT_ONCE)
        super().__init__(robot, WorkerExecutor("uoarm-async", _AT_ONCE), handling)
        self.robot = robot
        # Without a limit: a stop waits for no other call, nor for a thread of the application.
        self._stopping = WorkerExecutor("uoarm-async-stop")

    @classmethod
    @arguments(path="AsyncRobotManager(manager) takes a RobotManager")
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
    def identity(self) -> str:
        """What other managers know this one by: random, and as long as the manager lives."""
        return self.robot.identity

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

    resolve = _awaited(RobotManager.resolve)
    structures = _awaited(RobotManager.structures)
    structure_of_type = _awaited(RobotManager.structure_of_type)
    check_availability = _awaited(RobotManager.check_availability)
    discover = _awaited(RobotManager.discover)
    apply = _awaited(RobotManager.apply)
    reload = _awaited(RobotManager.reload)
    rollback = _awaited(RobotManager.rollback)
    offer = _awaited(RobotManager.offer)
    record = _awaited(RobotManager.record, undo=lambda recording: recording.close())
    playback = _awaited(RobotManager.playback)
    history = _at_once(RobotManager.history)
    recordings = _at_once(RobotManager.recordings)
    status = _at_once(RobotManager.status)

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

    @arguments()
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
        opened = await self._outside(partial(ask, as_type=as_type), undo=Connection.kill)
        connection = AsyncConnection(opened, self._handling)
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

    @arguments()
    async def call(
        self, name: str, message: Message, *, as_type: Any = None, timeout: float = 10.0
    ) -> Message:
        """Call a service; raises as `RobotManager.call`."""
        ask = partial(self.robot.call, name, message, as_type=as_type, timeout=timeout)
        return await self._outside(ask)

    def connections(self) -> tuple[AsyncConnection, ...]:
        """Return the connections that have not ended, oldest first, of every caller.

        Each is a handle of its own: one that is read here is no longer read elsewhere.
        """
        return tuple(
            AsyncConnection(connection, self._handling) for connection in self.robot.connections()
        )

    async def stop_all(self, *, timeout: float = 2.0) -> StopReport:
        """Stop every input that moves something, as `RobotManager.stop_all` does."""
        return await self._surely(partial(self.robot.stop_all, timeout=timeout), self._stopping)

    async def release(self, *, timeout: float = 2.0) -> None:
        """Let commands through again; raises as `RobotManager.release`."""
        await self._surely(partial(self.robot.release, timeout=timeout), self._stopping)

    @property
    def is_stopped(self) -> bool:
        """Whether commands are refused, from `stop_all` to `release`."""
        return self.robot.is_stopped

    @arguments()
    def listen(self, listener: Callable[[StatusEvent], None]) -> Callable[[], None]:
        """Notify a listener of every change, in order and in the loop; returns what ends that.

        Call it in the loop.
        """
        loop = asyncio.get_running_loop()
        listening, records = True, LimitedLog(_log)

        def notify(event: StatusEvent) -> None:
            if listening:
                try:
                    foreign(listener, event)
                except Exception as error:  # noqa: BLE001 - a listener may raise anything
                    text = f"listener {name_of(listener)} failed at event {event.number}"
                    records.write(logging.ERROR, text, error)

        def pass_on(event: StatusEvent) -> None:
            if not loop.is_closed():
                loop.call_soon_threadsafe(notify, event)

        end_there = self.robot.listen(pass_on)

        def end() -> None:
            nonlocal listening
            listening = False
            end_there()

        return end

    async def close(self) -> None:
        """Close the manager. Idempotent; bounded in time."""
        await self._surely(self.robot.close, self._handling)
