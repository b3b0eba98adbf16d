"""The event loop of a bridge: coroutines of its components run in one thread, each with a limit."""

from __future__ import annotations

import asyncio
import threading
from collections.abc import AsyncIterator, Coroutine, Iterator
from concurrent.futures import CancelledError, Future
from concurrent.futures import TimeoutError as FutureTimeoutError
from contextlib import suppress
from typing import Any

from uoarm.errors import BridgeError, BridgeTimeoutError, FailureReason

__all__ = ["Coroutines", "LoopThread"]

_CLOSE_SECONDS = 1.0


class LoopThread:
    """An event loop in a daemon thread, which starts with the first coroutine. Thread safe."""

    def __init__(self, name: str) -> None:
        self._name = name
        self._changing = threading.Lock()
        self._loop: asyncio.AbstractEventLoop | None = None
        self._thread: threading.Thread | None = None
        self._is_closed = False

    def submit(self, coroutine: Coroutine[Any, Any, Any]) -> Future[Any]:
        """Start a coroutine in the loop.

        Raises:
            BridgeError: the loop is closed.
        """
        with self._changing:  # whatever is submitted before the close is cancelled by it
            if not self._is_closed:
                return asyncio.run_coroutine_threadsafe(coroutine, self._started())
        coroutine.close()
        raise BridgeError(f"{self._name} is closed", FailureReason.CLOSED)

    def close(self) -> None:
        """Cancel everything and end the thread, waiting a second at most. Idempotent."""
        with self._changing:
            self._is_closed = True
            loop, self._loop = self._loop, None
        if loop is None or self._thread is None:
            return
        loop.call_soon_threadsafe(loop.stop)
        self._thread.join(_CLOSE_SECONDS)

    def _started(self) -> asyncio.AbstractEventLoop:
        if self._loop is None:
            self._loop = asyncio.new_event_loop()
            self._thread = threading.Thread(
                target=_work, args=(self._loop,), name=self._name, daemon=True
            )
            self._thread.start()
        return self._loop


def _work(loop: asyncio.AbstractEventLoop) -> None:
    try:
        loop.run_forever()
        loop.run_until_complete(_cancel_others())
        loop.run_until_complete(loop.shutdown_asyncgens())
    finally:
        loop.close()


async def _cancel_others() -> None:
    others = asyncio.all_tasks() - {asyncio.current_task()}
    for task in others:
        task.cancel()
    await asyncio.gather(*others, return_exceptions=True)


class Coroutines:
    """The coroutines of one component. Thread safe.

    Args:
        loop: where they run.
        seconds: how long a coroutine may take, where nothing else is said.
    """

    def __init__(self, loop: LoopThread, seconds: float) -> None:
        self._loop = loop
        self._seconds = seconds
        self._running: set[Future[Any]] = set()
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
            close = getattr(messages, "aclose", None)
            if close is not None:
                with suppress(BridgeError):  # a closed loop has ended it
                    self.run(f"the end of {what}", close())

    def cancel(self) -> None:
        """Cancel what runs; whoever waits for it gets a BridgeError."""
        self._cancels += 1
        for future in tuple(self._running):
            future.cancel()

    def _wait(self, what: str, future: Future[Any], seconds: float | None, cancels: int) -> Any:
        self._running.add(future)
        if cancels != self._cancels:  # it was submitted before a cancel that did not see it yet
            future.cancel()
        try:
            return future.result(seconds)
        except CancelledError:
            raise BridgeError(f"{what} was cancelled: it closes", FailureReason.CLOSED) from None
        finally:
            self._running.discard(future)


async def _next(messages: AsyncIterator[Any]) -> Any:
    return await anext(messages)
