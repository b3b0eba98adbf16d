"""A client's socket is read in small turns: floods of tiny frames cost the others little."""

from __future__ import annotations

import asyncio
import functools
import socket
import threading
from collections.abc import Awaitable, Callable, Iterable
from contextlib import ExitStack, suppress

import pytest
from tests.server.conftest import Connect, Hurry, Serve
from tests.server.robot import script
from tests.server.talk import Talk, eventually, frame, open_socket
from websockets.asyncio.client import connect
from websockets.asyncio.server import ServerConnection, serve
from websockets.frames import Opcode

from uoarm.server import Limits, Server
from uoarm.server.session import DEFLATE, Sockets, TurnConnection
from uoarm.testing import patience, slowness

PINGS = 100_000


def flood(plain: socket.socket) -> threading.Thread:
    """Send pings as fast as they are taken, and read nothing."""
    plain.settimeout(patience())

    def send() -> None:
        with suppress(OSError):
            plain.sendall(frame(b"", Opcode.PING) * PINGS)

    thread = threading.Thread(target=send, daemon=True)
    thread.start()
    return thread


def test_pings_by_the_thousand_are_answered_slowly_and_others_at_once(
    server: Server, talk: Connect
) -> None:
    other = talk()
    with open_socket(server.ports[0]) as plain:
        flooding = flood(plain)
        for _ in range(100):
            other.ask("List")
        assert pongs(plain) < PINGS // 2
    flooding.join(patience())
    assert other.ask("List")


def pongs(plain: socket.socket) -> int:
    """Return how many pongs can be read without waiting, and no fewer."""
    plain.setblocking(False)
    octets = 0
    with suppress(BlockingIOError):
        while data := plain.recv(65536):
            octets += len(data)
    return octets // 2


def test_one_that_floods_with_pings_and_reads_nothing_is_cut_off_in_time(
    serve: Serve, hurry: Hurry
) -> None:
    server = serve()
    with Talk(f"ws://127.0.0.1:{server.ports[0]}/") as other, ExitStack() as stack:
        with hurry(slowness()):
            plain = stack.enter_context(open_socket(server.ports[0]))
        flood(plain)
        eventually(lambda: _closed(plain), "it is cut off")
        assert other.ask("List")


def _closed(plain: socket.socket) -> bool:
    try:
        plain.settimeout(0.01)
        return not plain.recv(65536)
    except TimeoutError:
        return False
    except ConnectionError:
        return True


def test_thousands_of_small_messages_in_one_segment_are_all_answered_in_order(
    server: Server, talk: Connect
) -> None:
    other = talk()
    with open_socket(server.ports[0]) as plain:
        asked = [frame(b'{"op":"Kill","type":"c0","id":"%d"}' % number) for number in range(2000)]
        sending = threading.Thread(target=plain.sendall, args=(b"".join(asked),), daemon=True)
        sending.start()
        plain.settimeout(patience())
        received = b""
        while received.count(b'"op":"Error"') < 2000:
            received += plain.recv(65536)
        ids = [int(part.split(b'"')[1]) for part in received.split(b'"id"')[1:]]
        assert ids == list(range(2000))
        assert other.ask("List")


def test_what_a_session_has_not_read_is_bounded(serve: Serve) -> None:
    """However much a client sends, a few messages wait, and the rest stays in its own socket."""
    server = serve(Limits(messages_per_second=1, message_bytes=100_000))
    with open_socket(server.ports[0]) as plain:
        plain.settimeout(1)
        sent = 0
        with suppress(TimeoutError):
            for _ in range(1000):
                plain.sendall(frame(b'{"op":"List","id":"1","x-":"%s"}' % (b"x" * 90_000)))
                sent += 1
        assert sent < 1000
        eventually(lambda: server.unread_octets > 0, "some of it arrived")
        assert server.unread_octets < 1_000_000


LENGTHS = (125, 126, 0, 512, 32_767, 65_535, 65_536, 1, 300_000, 127)
FRAMES = [(b"x" * length, text) for length in LENGTHS for text in (True, False)]


Handler = Callable[[ServerConnection], Awaitable[None]]


def received_from(send: Handler, *, deflate: bool = False) -> list[str | bytes]:
    """Return what a client gets from a server that sends in this way, compressed or not."""

    async def receive() -> list[str | bytes]:
        make = functools.partial(TurnConnection, Sockets(2, Limits()))
        async with serve(
            send,
            "127.0.0.1",
            0,
            create_connection=make,  # type: ignore[arg-type] # it is only called
            compression=None,
            extensions=[DEFLATE] if deflate else None,
        ) as server:
            port = next(iter(server.sockets)).getsockname()[1]
            async with connect(f"ws://127.0.0.1:{port}/", max_size=None) as client:
                return [message async for message in client]

    return asyncio.run(asyncio.wait_for(receive(), patience()))


@pytest.mark.parametrize("deflate", [False, True])
@pytest.mark.parametrize("at_once", [False, True])
def test_frames_of_every_length_arrive_whole_and_in_order(deflate: bool, at_once: bool) -> None:
    async def send(socket: ServerConnection) -> None:
        assert isinstance(socket, TurnConnection)
        if not at_once:
            await socket.send_frames(FRAMES)
            return
        for number in range(len(FRAMES)):
            await socket.send_frames([])
            assert number > 0 or socket.takes_at_once()
            socket.send_now(FRAMES[number : number + 1])

    received = [frame.decode() if text else frame for frame, text in FRAMES]
    assert received_from(send, deflate=deflate) == received


def test_nothing_is_sent_at_once_where_that_would_have_to_wait() -> None:
    async def send(socket: ServerConnection) -> None:
        assert isinstance(socket, TurnConnection)
        assert socket.takes_at_once()
        socket.send_now([(bytes(50_000_000), False)])
        assert not socket.takes_at_once(), "the kernel does not take as much"
        await socket.close()
        assert not socket.takes_at_once(), "it is closed"

    assert len(received_from(send)) == 1


def test_a_message_that_comes_alone_is_written_in_the_turn_in_which_it_came(
    server: Server, talk: Connect, monkeypatch: pytest.MonkeyPatch
) -> None:
    """By no turn of the writer's task, save while the answer to a ping is awaited."""
    del server
    by_writer: list[bytes] = []
    send = TurnConnection.send_frames

    async def noted(self: TurnConnection, frames: Iterable[tuple[bytes, bool]]) -> None:
        by_writer.extend(frame for frame, _ in frames if b'"value"' in frame)
        await send(self, frames)

    monkeypatch.setattr(TurnConnection, "send_frames", noted)
    client = talk()
    numbers = client.open("numbers")
    for number in range(50):
        script.put({"value": number})
        assert client.data(numbers, 1) == [{"value": number}]
    assert len(by_writer) < 50


@pytest.mark.skipif(not hasattr(socket, "TCP_NOTSENT_LOWAT"), reason="the kernel has no such limit")
def test_the_kernel_keeps_little_unsent_until_a_message_is_large() -> None:
    """Else a client that reads slowly gets what was written seconds ago, too late to drop."""
    limits: list[int] = []

    async def send(connection: ServerConnection) -> None:
        assert isinstance(connection, TurnConnection)
        near = connection.transport.get_extra_info("socket")
        for length in (1, 65_535, 65_536, 1):
            await connection.send_frames([(b"x" * length, True)])
            limits.append(near.getsockopt(socket.IPPROTO_TCP, socket.TCP_NOTSENT_LOWAT))

    assert len(received_from(send)) == 4
    assert limits[0] == limits[1] <= 65_536
    assert limits[2] == limits[3] > 16_777_216
