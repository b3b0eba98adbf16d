"""The event loop of a bridge: coroutines of its components run in one thread, each with a limit."""

from __future__ import annotations

import inspect
import logging
import threading
from collections.abc import AsyncIterator, Callable, Coroutine, Iterator
from concurrent.futures import CancelledError, Future
from concurrent.futures import TimeoutError as FutureTimeoutError
from contextlib import suppress
from typing import TYPE_CHECKING, Any, TypeAlias

from uoarm._raised import LimitedLog, contained
from uoarm._support.workers import WorkerExecutor
from uoarm.errors import BridgeError, BridgeTimeoutError, FailureReason

if TYPE_CHECKING:
    import asyncio

_CLOSE_SECONDS = 1.0
_WAITING = 32  # threads for what a coroutine has wait outside the loop
_log = logging.getLogger("uoarm")
_Outcome: TypeAlias = tuple[Any, Exception | None]


class LoopThread:
    """An event loop in a daemon thread, which starts with the first coroutine. Thread safe."""

    def __init__(self, name: str) -> None:
        self._name = name
        self._changing = threading.Lock()
        self._loop: asyncio.AbstractEventLoop | None = None
        self._thread: threading.Thread | None = None
        self._is_closed = False
        self._is_stopped = False  # in the loop's thread

    @property
    def is_closed(self) -> bool:
        """Whether `close` was called, which cancels everything."""
        return self._is_closed

    def submit(self, coroutine: Coroutine[Any, Any, Any]) -> Future[_Outcome]:
        """Start a coroutine in the loop; the future has its result and what it raised.

        Raises:
            BridgeError: the loop is closed.
        """
        import asyncio  # noqa: PLC0415 - slow, and of coroutines only

        with self._changing:  # whatever is submitted before the close is cancelled by it
            if not self._is_closed:
                try:
                    loop = self._started()
                except RuntimeError:
                    coroutine.close()
                    raise
                future = asyncio.run_coroutine_threadsafe(_outcome(coroutine), loop)
                future.add_done_callback(lambda _: _close_unbegun(coroutine))
                return future
        coroutine.close()
        raise BridgeError(f"{self._name} is closed", FailureReason.CLOSED)

    def close(self) -> None:
        """Cancel everything and end the thread, waiting a second at most. Idempotent."""
        with self._changing:
            self._is_closed = True
            loop, self._loop = self._loop, None
        if loop is None or self._thread is None:
            return
        loop.call_soon_threadsafe(self._stop, loop)
        self._thread.join(_CLOSE_SECONDS)

    def _started(self) -> asyncio.AbstractEventLoop:
        if self._loop is None:
            import asyncio  # noqa: PLC0415 - slow, and of coroutines only

            loop = asyncio.new_event_loop()
            loop.set_default_executor(WorkerExecutor(f"{self._name}-wait", _WAITING))
            thread = threading.Thread(target=self._work, args=(loop,), name=self._name, daemon=True)
            try:
                thread.start()
            except RuntimeError:  # the system gives no more threads
                loop.close()
                raise
            self._loop, self._thread = loop, thread
        return self._loop

    def _stop(self, loop: asyncio.AbstractEventLoop) -> None:
        self._is_stopped = True
        loop.stop()

    def _work(self, loop: asyncio.AbstractEventLoop) -> None:
        def serve() -> None:
            while not self._is_stopped:  # a component may stop the loop, which serves others, too
                loop.run_forever()

        try:
            _run_through(serve)
            _run_through(lambda: loop.run_until_complete(_cancel_others()))
            _run_through(lambda: loop.run_until_complete(loop.shutdown_asyncgens()))
        finally:
            loop.close()


def _run_through(run: Callable[[], None]) -> None:
    """Run a loop to the end, whatever the tasks raise that components have left in it."""
    records = LimitedLog(_log)
    while True:
        try:
            return run()
        except BaseException as error:  # noqa: BLE001 - the loop serves other components, too
            text = "a task that a component left behind raised"
            records.write(logging.ERROR, text, error)


async def _outcome(coroutine: Coroutine[Any, Any, Any]) -> _Outcome:
    """Return what a coroutine of a component returns, and what it raises.

    A loop raises the `SystemExit` of a task out of `run_forever`, and a task whose coroutine raises
    `CancelledError` looks as if we had cancelled it.
    """
    try:
        return await coroutine, None
    except BaseException as error:  # noqa: BLE001 - raised again in the thread that waits
        return None, contained(error)


def _close_unbegun(coroutine: Coroutine[Any, Any, Any]) -> None:
    """Close a coroutine that was cancelled before it began, of which Python would warn."""
    if inspect.getcoroutinestate(coroutine) == inspect.CORO_CREATED:
        with suppress(ValueError):  # it begins just now
            coroutine.close()


async def _cancel_others() -> None:
    import asyncio  # noqa: PLC0415 - slow, and of coroutines only

    others = asyncio.all_tasks() - {asyncio.current_task()}
    for task in others:
        task.cancel()
    await asyncio.gather(*others, return_exceptions=True)


class Coroutines:
    """The coroutines of one component. Thread safe.

    Args:
        seconds: how long a coroutine may take, where nothing else is said.
    """

    def __init__(self, loop: LoopThread, seconds: float) -> None:
        self._loop = loop
        self._seconds = seconds
        self._running: set[Future[_Outcome]] = set()
        self._cancels = 0

    def run(
        self, what: str, coroutine: Coroutine[Any, Any, Any], seconds: float | None = None
    ) -> Any:
        """Wait for a coroutine in this thread and return its result.

        Raises:
            BridgeTimeoutError: it did not finish in time; it was cancelled.
            BridgeError: the component was closed meanwhile.
        """
        limit = self._seconds if seconds is None else seconds
        cancels = self._cancels
        future = self._loop.submit(coroutine)
        try:
            return self._wait(what, future, limit, cancels)
        except FutureTimeoutError:
            if future.done():
                raise  # the component's own
            future.cancel()
            text = f"{what} did not finish within {limit:g} s and was cancelled"
            raise BridgeTimeoutError(text) from None

    def iterate(self, what: str, messages: AsyncIterator[Any]) -> Iterator[Any]:
        """Yield what an asynchronous iterator yields, each item as late as it likes."""
        try:
            while True:
                cancels = self._cancels
                try:
                    item = self._wait(what, self._loop.submit(_next(messages)), None, cancels)
                except StopAsyncIteration:
                    return
                yield item
        finally:
            if hasattr(messages, "aclose"):
                try:
                    self.run(f"the end of {what}", _end(messages))
                except BridgeError as error:
                    if error.reason is not FailureReason.CLOSED:  # a closed loop has ended it
                        raise

    def cancel(self) -> None:
        """Cancel what runs; a caller that waits for it gets a BridgeError."""
        self._cancels += 1
        for future in tuple(self._running):
            future.cancel()

    def _wait(
        self, what: str, future: Future[_Outcome], seconds: float | None, cancels: int
    ) -> Any:
        self._running.add(future)
        if cancels != self._cancels:  # it was submitted before a cancel that did not see it yet
            future.cancel()
        try:
            result, error = future.result(seconds)
        except CancelledError:
            raise _closes(what) from None
        finally:
            self._running.discard(future)
        if error is None:
            return result
        import asyncio  # noqa: PLC0415 - slow, and of coroutines only

        if self._loop.is_closed and isinstance(error.__cause__, asyncio.CancelledError):
            raise _closes(what)
        raise error


def _closes(what: str) -> BridgeError:
    return BridgeError(f"{what} was cancelled: it closes", FailureReason.CLOSED)


# What a generator gives to wait for is no coroutine, whose state can be asked for.
async def _next(messages: AsyncIterator[Any]) -> Any:
    return await anext(messages)


async def _end(messages: Any) -> None:
    await messages.aclose()
