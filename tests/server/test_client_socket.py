"""The client's WebSocket: messages as they come, and writing in any thread."""

from __future__ import annotations

import asyncio
import socket
import ssl
import threading
from collections.abc import AsyncIterator, Awaitable, Callable
from contextlib import asynccontextmanager
from pathlib import Path

import pytest
from tests.server.authority import Authority
from websockets.asyncio.client import connect
from websockets.asyncio.server import ServerConnection, serve
from websockets.exceptions import ConnectionClosedError

from uoarm.client._socket import ClientSocket, Received
from uoarm.testing import patience

SECONDS = 0.05
Serve = Callable[[ServerConnection], Awaitable[None]]


@asynccontextmanager
async def connected(
    attend: Serve, silence: float | None = None, authority: Authority | None = None
) -> AsyncIterator[ClientSocket]:
    near = far = None
    if authority is not None:
        far = ssl.create_default_context(ssl.Purpose.CLIENT_AUTH)
        far.load_cert_chain(authority.issue("server"))
        near = ssl.create_default_context(cafile=authority.path)
    async with serve(attend, "127.0.0.1", 0, ssl=far, max_size=None, compression=None) as server:
        port = next(iter(server.sockets)).getsockname()[1]
        opening = connect(
            f"{'ws' if near is None else 'wss'}://127.0.0.1:{port}/",
            ssl=near,
            proxy=None,
            max_size=None,
            compression=None,
            ping_interval=silence,
            ping_timeout=silence,
            close_timeout=2 * patience(),
            create_connection=ClientSocket,
        )
        async with opening as opened:
            assert isinstance(opened, ClientSocket)
            yield opened


async def test_messages_are_handed_over_in_order_those_that_wait_first() -> None:
    async def attend(connection: ServerConnection) -> None:
        await connection.send("greeting")
        for number in range(100):
            await connection.send(str(number))
        await connection.send(["in ", "three ", "pieces"])
        await connection.send([b"in ", b"two"])

    async with connected(attend) as connection:
        assert await connection.next_message() == "greeting"
        came: list[Received] = []
        await connection.hand_over(came.append)
        assert came == [*map(str, range(100)), "in three pieces", b"in two"]


@pytest.mark.parametrize("in_order", [True, False])
async def test_what_came_before_the_end_of_tls_is_taken_after_it(
    in_order: bool, tmp_path: Path
) -> None:
    """CPython 3.10 does not say of such a transport that it is closed."""

    async def attend(connection: ServerConnection) -> None:
        for number in range(3):
            await connection.send(str(number))
        if not in_order:
            connection.transport.abort()

    async with connected(attend, authority=Authority(tmp_path)) as connection:
        await connection.wait_closed()
        assert [await connection.next_message() for _ in range(3)] == ["0", "1", "2"]


async def test_what_is_read_before_it_is_taken_is_bounded() -> None:
    sent: list[int] = []

    async def attend(connection: ServerConnection) -> None:
        for number in range(2000):
            await connection.send(bytes(65_536))
            sent.append(number)

    async with connected(attend) as connection:
        await asyncio.sleep(0)
        while connection.transport.is_reading():  # noqa: ASYNC110 - there is no event of it
            await asyncio.sleep(0)
        assert len(connection._waiting) < 64
        count = 0

        def take(message: Received) -> None:
            nonlocal count
            count += 1

        await connection.hand_over(take)
        assert count == 2000


async def test_what_taking_a_message_raises_ends_the_reading() -> None:
    async def attend(connection: ServerConnection) -> None:
        for number in range(3):
            await connection.send(str(number))
        await connection.wait_closed()

    came: list[Received] = []

    def take(message: Received) -> None:
        came.append(message)
        if message == "1":
            raise ValueError("strange")

    async with connected(attend) as connection:
        with pytest.raises(ValueError, match="strange"):
            await connection.hand_over(take)
        assert came == ["0", "1"]


async def test_a_text_that_is_none_and_an_end_without_a_word_are_errors() -> None:
    async def garble(connection: ServerConnection) -> None:
        connection.transport.write(b"\x81\x02\xff\xff")
        await connection.wait_closed()

    async def cut(connection: ServerConnection) -> None:
        connection.transport.abort()

    for attend in (garble, cut):
        async with connected(attend) as connection:
            with pytest.raises(ConnectionClosedError):
                await connection.hand_over(lambda _: None)


async def test_threads_write_whole_messages_beside_the_loop() -> None:
    """Small and large ones, more than the kernel takes, while the loop writes, too."""
    came: list[bytes] = []
    count, threads = 60, 4

    async def attend(connection: ServerConnection) -> None:
        while len(came) < threads * count + count:
            came.append(bytes(await connection.recv(decode=False)))

    async with connected(attend) as connection:

        def write(name: int) -> None:
            for number in range(count):
                size = 400_000 if number % 7 == 0 else 10
                content = bytes([name, number]) * size
                while not connection.try_send(content):
                    future = asyncio.run_coroutine_threadsafe(
                        connection.send_whole(content, text=False), connection.loop
                    )
                    future.result(patience())
                    break

        writers = [threading.Thread(target=write, args=(name,)) for name in range(threads)]
        for writer in writers:
            writer.start()
        for number in range(count):
            await connection.send_whole(bytes([threads, number]), text=False)
            await asyncio.sleep(0)
        await connection.hand_over(lambda _: None)
        for writer in writers:
            await asyncio.to_thread(writer.join)
    assert len(came) == threads * count + count
    assert all(item == item[:2] * (len(item) // 2) for item in came)
    for name in range(threads + 1):
        assert [item[1] for item in came if item[0] == name] == list(range(count))


async def test_nothing_is_written_to_a_connection_that_ends_and_no_descriptor_is_left() -> None:
    async def attend(connection: ServerConnection) -> None:
        await connection.recv()
        connection.transport.abort()

    async with connected(attend) as connection:
        assert connection.try_send(b"one")
        near = connection._near
        assert isinstance(near, socket.socket)
        with pytest.raises(ConnectionClosedError):
            await connection.hand_over(lambda _: None)
        assert near.fileno() == -1
        assert not connection.try_send(b"two")


async def test_a_peer_that_answers_nothing_is_dropped_without_waiting_for_a_goodbye() -> None:
    over = asyncio.Event()

    async def attend(connection: ServerConnection) -> None:
        connection.transport.pause_reading()
        await over.wait()
        connection.transport.abort()

    async with connected(attend, SECONDS) as connection:
        with pytest.raises(ConnectionClosedError) as caught:
            await connection.hand_over(lambda _: None)
        over.set()
        assert caught.value.sent is None  # a server that gets a word ends the session
        assert "nothing came for 0.1 s" in str(caught.value.__cause__)


async def test_what_comes_is_a_sign_of_life_though_no_ping_is_answered() -> None:
    ready = asyncio.Event()

    async def attend(connection: ServerConnection) -> None:
        connection.transport.pause_reading()
        await ready.wait()
        await connection.send("late")
        connection.transport.resume_reading()
        await connection.wait_closed()

    async with connected(attend, patience()) as connection:
        before = connection.silent_at
        ready.set()
        assert await connection.next_message() == "late"
        assert connection.silent_at > before
