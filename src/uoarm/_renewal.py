"""Commands that are renewed while something is held, such as a button or a context manager."""

from __future__ import annotations

import threading
import time
from collections.abc import AsyncIterator, Awaitable, Callable, Iterator
from contextlib import asynccontextmanager, contextmanager, suppress

from uoarm._raised import Log
from uoarm.errors import ConnectionClosedError, UoarmError
from uoarm.model import Message

_log = Log("uoarm.commands")
_SHARE = 0.25  # of the lifetime: three renewals may come late before it is over
_PERIOD = 0.1
_LAST_SECONDS = 1.0


class HeldCommand:
    """A command that is sent again and again.

    Attributes:
        message: what is sent the next time; may be replaced.
        error: why it is not renewed any more; None while it is.
    """

    def __init__(self, message: Message) -> None:
        self.message = message
        self.error: Exception | None = None


def renewal_period(lifetime: float | None, period: float | None, place: str) -> float:
    """Return the seconds between two renewals; warn where a command dies in between.

    Args:
        lifetime: of a command; None: it lives until the next one.
        period: what the sender wants; None: a quarter of the lifetime.
        place: of the input, for people.
    """
    if period is None:
        return _PERIOD if lifetime is None else _SHARE * lifetime
    if lifetime is not None and period >= lifetime:
        lives = f"commands live for {lifetime:g} s, and are renewed every {period:g} s"
        _log.warning("%s: %s: it stops in between", place, lives)
    return period


@contextmanager
def renewed(
    message: Message,
    send: Callable[[Message], object],
    stop: Callable[[], object],
    period: float,
) -> Iterator[HeldCommand]:
    """Renew a command in a thread for the length of a block, and stop at its end.

    Raises:
        Exception: what the first `send` raises, and at the end what a later one raised.
    """
    held, over = HeldCommand(message), threading.Event()

    def renew() -> None:
        while not over.wait(period):
            try:
                send(held.message)
            except Exception as error:  # noqa: BLE001 - raised where the block ends
                held.error = error
                return

    send(message)
    thread = threading.Thread(target=renew, name="uoarm-renewal", daemon=True)
    try:
        thread.start()
        yield held
    finally:
        over.set()
        if thread.ident is not None:
            thread.join(_LAST_SECONDS)  # so that nothing is sent behind the stop
        try:
            stop()
        except ConnectionClosedError as error:  # it was stopped with that, and not renewed since
            held.error = held.error or error
    if held.error is not None:
        raise held.error


@asynccontextmanager
async def renewed_in_task(
    message: Message,
    send: Callable[[Message], Awaitable[object]],
    stop: Callable[[], Awaitable[object]],
    period: float,
) -> AsyncIterator[HeldCommand]:
    """Renew a command in a task for the length of a block, and stop at its end; as `renewed`.

    One is under way at a time: what waits for a link that is down is never more than one.
    """
    import asyncio  # noqa: PLC0415 - slow import, of asynchronous programs only

    held = HeldCommand(message)

    async def renew() -> None:
        due = time.monotonic()
        while True:
            due = max(due + period, time.monotonic())
            await asyncio.sleep(due - time.monotonic())
            try:
                await send(held.message)
            except Exception as error:  # noqa: BLE001 - raised where the block ends
                held.error = error
                return

    try:
        await send(message)
    except asyncio.CancelledError:  # it may have arrived, and nothing ends it then
        with suppress(UoarmError):
            await stop()
        raise
    renewing = asyncio.ensure_future(renew())
    try:
        yield held
    finally:
        renewing.cancel()
        with suppress(asyncio.CancelledError):
            await renewing
        try:
            await stop()
        except ConnectionClosedError as error:
            held.error = held.error or error
    if held.error is not None:
        raise held.error
