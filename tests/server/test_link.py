"""The client's connection, with sockets that do what a test wants."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Mapping
from typing import Any, cast

import pytest
from websockets.asyncio.client import ClientConnection
from websockets.exceptions import ConnectionClosedError

from uoarm.client._link import Link
from uoarm.wire import TEXT_FORM


class Dropping:
    """A connection that drops once its session is kept."""

    async def send(self, frame: bytes, text: bool) -> None:
        """Take what the client asks."""

    async def __aiter__(self) -> AsyncIterator[str]:
        kept = {"key": "key", "seconds": 0.3}
        yield TEXT_FORM.write({"op": "Reply", "id": "keep", "jsonMessage": kept}).decode()
        raise ConnectionClosedError(None, None)


@pytest.mark.parametrize("turns", range(8))
def test_it_ends_when_it_is_cancelled_just_as_connecting_again_fails(turns: int) -> None:
    async def work() -> None:
        again = asyncio.Event()
        failing = asyncio.get_running_loop().create_future()
        sockets = [Dropping()]

        async def opening() -> ClientConnection:
            if not sockets:
                again.set()
                await failing
            return cast("ClientConnection", sockets.pop())

        link = Link(opening, TEXT_FORM, _ignore)
        await link.start(resume=True)
        reading = asyncio.ensure_future(link.run())
        await again.wait()
        failing.set_exception(OSError("refused"))
        for _ in range(turns):
            await asyncio.sleep(0)
        reading.cancel()
        with pytest.raises(asyncio.CancelledError):
            await reading
        assert link.closed == "the client was closed"

    asyncio.run(asyncio.wait_for(work(), 10))


def _ignore(told: Mapping[str, Any]) -> None:
    """Take what the server tells."""
