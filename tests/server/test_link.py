"""The client's connection, with sockets that do what a test wants."""

from __future__ import annotations

import asyncio
import json
from collections import deque
from collections.abc import Callable, Mapping
from typing import Any, cast

import pytest
from websockets.asyncio.client import connect
from websockets.asyncio.server import ServerConnection, serve
from websockets.datastructures import Headers
from websockets.exceptions import ConnectionClosedError, InvalidStatus
from websockets.http11 import Response

from uoarm._backoff import Backoff
from uoarm._wire import TEXT_FORM
from uoarm.client import RemoteRobot
from uoarm.client._link import Link, Take
from uoarm.client._socket import ClientSocket, Received
from uoarm.errors import MessageError
from uoarm.model import StatusEvent, to_json
from uoarm.testing import patience

HELLO = {"op": "Status", "type": "hello"}
KEPT = {"op": "Reply", "id": "keep", "jsonMessage": {"key": "key", "seconds": 0.3}}
RESUMED = {"op": "Reply", "id": "resume", "jsonMessage": {"session": "s1", "own": []}}


class Socket:
    """A connection that notes what it is given, then drops."""

    paused = False
    transport = asyncio.WriteTransport()

    def __init__(self, *messages: Mapping[str, Any]) -> None:
        self.sent: list[dict[str, Any]] = []
        self._messages = deque(json.dumps(mapping) for mapping in messages)

    async def close(self) -> None: ...

    async def send(self, frame: bytes, text: bool) -> None:
        assert text
        self.sent.append(json.loads(frame))

    send_whole = send

    async def next_message(self) -> str:
        return self._messages.popleft()

    async def hand_over(self, take: Callable[[Received], object]) -> None:
        while self._messages:
            take(self._messages.popleft())
        raise ConnectionClosedError(None, None)


def _ignore(messages: Mapping[str, Any]) -> None:
    """Take what the server sends."""


def begin(*sockets: Socket, again: asyncio.Future[None], take: Take = _ignore) -> Link:
    """Return a link that gets these sockets, and then what becomes of the future."""
    waiting = deque(sockets)

    async def opening() -> ClientSocket:
        if not waiting:
            await again
        return cast("ClientSocket", waiting.popleft())

    return Link(opening, TEXT_FORM, take)


@pytest.mark.parametrize("turns", range(8))
async def test_it_ends_when_it_is_cancelled_just_as_connecting_again_fails(turns: int) -> None:
    failing = asyncio.get_running_loop().create_future()
    link = begin(Socket(KEPT), again=failing)
    await link.start(resume=True)
    reading = asyncio.ensure_future(link.run())
    for _ in range(8):  # until it connects again
        await asyncio.sleep(0)
    failing.set_exception(OSError("refused"))
    for _ in range(turns):
        await asyncio.sleep(0)
    reading.cancel()
    with pytest.raises(asyncio.CancelledError):
        await reading
    assert link.closed == "the client was closed"


@pytest.mark.parametrize(("status", "is_tried_again"), [(401, False), (503, True)])
async def test_who_is_not_let_in_any_more_is_not_tried_again(
    status: int, is_tried_again: bool
) -> None:
    refusals: list[str] = []

    async def opening() -> ClientSocket:
        if not refusals:
            refusals.append("after this")
            return cast("ClientSocket", Socket(KEPT))
        refusals.append(f"HTTP {status}")
        raise InvalidStatus(Response(status, "", Headers()))

    link = Link(opening, TEXT_FORM, _ignore)
    await link.start(resume=True)
    await link.run()
    assert f"HTTP {status}" in link.closed
    assert (len(refusals) > 2) is is_tried_again


async def test_connecting_again_ends_at_its_limit_also_between_two_attempts() -> None:
    failing = asyncio.get_running_loop().create_future()
    failing.set_exception(OSError("refused"))
    link = begin(Socket(KEPT), again=failing)
    link._backoff = Backoff(first=1e6, most=1e6)
    await link.start(resume=True)
    await asyncio.wait_for(link.run(), patience())
    assert "connecting again failed: refused" in link.closed


async def test_what_could_not_be_written_is_not_asked_for_after_a_drop() -> None:
    failing = asyncio.get_running_loop().create_future()
    failing.set_exception(OSError("refused"))
    after = Socket(HELLO, RESUMED)
    link = begin(Socket(KEPT), after, again=failing)
    await link.start(resume=True)
    await link.send({"op": "List", "id": "1"})
    with pytest.raises(MessageError):
        await link.send({"op": "Call", "id": "2", "jsonMessage": object()})
    await link.run()
    assert after.sent[0]["jsonMessage"]["waiting"] == ["1"]


async def test_of_more_than_can_be_asked_for_the_rest_fails() -> None:
    failing = asyncio.get_running_loop().create_future()
    failing.set_exception(OSError("refused"))
    after, messages = Socket(HELLO, RESUMED), list[Mapping[str, Any]]()
    link = begin(Socket(KEPT), after, again=failing, take=messages.append)
    await link.start(resume=True)
    for number in range(5000):
        await link.send({"op": "List", "id": str(number)})
    await link.run()
    waiting = after.sent[0]["jsonMessage"]["waiting"]
    assert waiting == [str(number) for number in range(4096)]
    assert [mapping["id"] for mapping in messages] == [str(number) for number in range(4096, 5000)]
    assert {(mapping["op"], mapping["jsonMessage"]["code"]) for mapping in messages} == {
        ("Error", "closed")
    }


async def test_changes_that_are_not_taken_are_the_newest() -> None:
    changes = (
        {"op": "Status", "type": "change", "jsonMessage": change(number)} for number in range(3000)
    )
    socket = Socket({"op": "Reply", "id": "1", "jsonMessage": {}}, *changes)

    async def opening() -> ClientSocket:
        return cast("ClientSocket", socket)

    client = RemoteRobot(opening, TEXT_FORM)
    watching = client.watch()
    first = asyncio.ensure_future(anext(watching))
    async with client.running(resume=False):
        await client.ended()
    numbers = [(await first).number, *[status_event.number async for status_event in watching]]
    assert len(numbers) < 2000
    assert numbers == list(range(numbers[0], 3000))


def change(number: int) -> object:
    return to_json(StatusEvent(number, 0, "connection c", "running"))


async def test_what_the_network_has_not_taken_yet_dies_with_a_drop() -> None:
    """An end in order still sends what the system holds, once the network is back."""

    endings: asyncio.Queue[Exception | None] = asyncio.Queue()

    class Peer(ServerConnection):
        def connection_lost(self, exc: Exception | None) -> None:
            super().connection_lost(exc)
            endings.put_nowait(exc)

    async def greet(connection: ServerConnection) -> None:
        await connection.send(json.dumps(HELLO))
        await connection.wait_closed()

    async with serve(greet, "127.0.0.1", 0, create_connection=Peer) as server:
        port = next(iter(server.sockets)).getsockname()[1]

        async def opening() -> ClientSocket:
            opened = await connect(
                f"ws://127.0.0.1:{port}/", proxy=None, create_connection=ClientSocket
            )
            assert isinstance(opened, ClientSocket)
            return opened

        link = Link(opening, TEXT_FORM, lambda _: None)
        await link.start(resume=False)
        running = asyncio.ensure_future(link.run())
        link.drop()
        assert isinstance(await endings.get(), ConnectionResetError)
        await running
