"""What arrives is counted from its first octet, ends in time, and is unpacked within a budget."""

from __future__ import annotations

import asyncio
import socket
import time
import zlib
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager, suppress
from functools import partial
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st
from tests.server.conftest import Hurry, Serve
from tests.server.talk import Talk, eventually, frame, open_socket, request
from websockets.exceptions import ConnectionClosed
from websockets.frames import CloseCode, Frame, Opcode
from websockets.sync.client import connect

from uoarm.server import Limits, Server
from uoarm.server.http import HandshakeHandler
from uoarm.server.session._incoming import (
    DEFLATE,
    IncomingError,
    IncomingFrames,
    ParsingTurns,
    Turn,
)
from uoarm.testing import patience, slowness

MEGABYTE = 1_000_000
BURST = 20


def packed(content: bytes, level: int = 9) -> bytes:
    packer = zlib.compressobj(level, wbits=-15)
    return (packer.compress(content) + packer.flush(zlib.Z_SYNC_FLUSH))[:-4]


def parsed(*frames: Frame) -> list[Frame]:
    """Return frames as they are after the extension has had them."""
    extension = DEFLATE.process_request_params([], [])[1]
    return [extension.decode(item) for item in frames]


def pieces(content: bytes, lengths: list[int], *, deflate: bool) -> list[Frame]:
    """Return a binary message in fragments of these lengths, and the rest."""
    left = packed(content) if deflate else content
    parts = []
    for length in lengths:
        parts.append(left[:length])
        left = left[length:]
    parts.append(left)
    frames = [
        Frame(Opcode.CONT if place else Opcode.BINARY, part, fin=place == len(parts) - 1)
        for place, part in enumerate(parts)
    ]
    frames[0].rsv1 = deflate
    return parsed(*frames)


def messages(incoming: IncomingFrames) -> list[bytes]:
    taken = []
    while incoming.is_packed:
        incoming.unpack()
    while (message := incoming.take()) is not None:
        taken.append(bytes(message[0]))
    return taken


CONTENT = st.one_of(
    st.binary(max_size=300), st.integers(0, 400_000).map(lambda length: b"a" * length)
)


@given(
    st.lists(st.tuples(CONTENT, st.lists(st.integers(0, 200), max_size=5), st.booleans())),
)
def test_messages_come_whole_and_in_order_and_leave_nothing(
    sent: list[tuple[bytes, list[int], bool]],
) -> None:
    incoming = IncomingFrames(MEGABYTE)
    for content, lengths, deflate in sent:
        for piece in pieces(content, lengths, deflate=deflate):
            incoming.add(piece)
    assert messages(incoming) == [content for content, *_ in sent]
    assert incoming.octets == 0
    assert not incoming.is_within_message


def test_what_is_packed_is_unpacked_64_kib_at_a_time() -> None:
    incoming = IncomingFrames(16 * MEGABYTE)
    letters = (b"".join(b"%d," % number for number in range(100_000)) * 28)[: 16 * MEGABYTE]
    [bomb] = pieces(letters, [], deflate=True)
    incoming.add(bomb)
    before, steps = incoming.octets, 0
    assert before < 6 * MEGABYTE
    while incoming.is_packed:
        incoming.unpack()
        assert incoming.octets - before <= 65_536
        before, steps = incoming.octets, steps + 1
    assert steps > 240
    assert incoming.octets == 16 * MEGABYTE


@pytest.mark.parametrize("lengths", [[], [5], [1, 2, 3]])
@pytest.mark.parametrize(
    ("most", "said"),
    [(MEGABYTE, "longer than 1,000,000 octets"), (16 * MEGABYTE, "more than 64 times as long")],
)
def test_what_is_too_long_unpacked_is_unpacked_no_further(
    most: int, said: str, lengths: list[int]
) -> None:
    """15 KB never become 16 MB: who makes the server work has to send something for it."""
    incoming = IncomingFrames(most)
    for piece in pieces(bytes(14 * MEGABYTE), lengths, deflate=True):
        incoming.add(piece)
    with pytest.raises(IncomingError, match=said) as caught:
        messages(incoming)
    assert caught.value.code is CloseCode.MESSAGE_TOO_BIG
    assert incoming.octets < 2 * MEGABYTE


def test_a_message_that_is_not_compressed_as_it_says_is_refused() -> None:
    incoming = IncomingFrames(MEGABYTE)
    incoming.add(parsed(Frame(Opcode.TEXT, b"\xff\xff\xff", rsv1=True))[0])
    with pytest.raises(IncomingError, match="decompression failed") as caught:
        incoming.unpack()
    assert caught.value.code is CloseCode.PROTOCOL_ERROR


def test_what_follows_the_last_block_of_a_message_is_dropped() -> None:
    """RFC 7692, 7.2.3.4: a block may say that it is the last; what comes then costs nothing."""
    packer = zlib.compressobj(wbits=-15)
    ended = packer.compress(b"Hello") + packer.flush()
    incoming = IncomingFrames(MEGABYTE)
    first = Frame(Opcode.BINARY, ended + b"\x00", fin=False, rsv1=True)
    more = [Frame(Opcode.CONT, bytes(50_000), fin=False) for _ in range(50)]
    for item in parsed(first, *more, Frame(Opcode.CONT, b"")):
        incoming.add(item)
        while incoming.is_packed:
            incoming.unpack()
        assert incoming.octets < 100
    assert messages(incoming) == [b"Hello"]


def test_fragments_without_content_leave_nothing() -> None:
    incoming = IncomingFrames(MEGABYTE)
    for number in range(10_000):
        incoming.add(Frame(Opcode.CONT if number else Opcode.TEXT, b"", fin=False))
    assert incoming.octets == 0
    assert not incoming.is_full


def busy(seconds: float) -> None:
    """Use the processor."""
    end = time.thread_time() + seconds
    while time.thread_time() < end:
        pass


def served(*asking: tuple[int, int]) -> list[int]:
    """Return in which order connections work that ask, by name and how often each goes on."""

    async def serve() -> list[int]:
        turns, order, left = ParsingTurns(), [], dict(asking)
        done = asyncio.Event()

        def work(name: int) -> bool:
            order.append(name)
            left[name] -= 1
            if not any(left.values()):
                done.set()
            busy(0.002)
            return left[name] > 0

        made = {name: Turn(partial(work, name)) for name in left}
        for turn in made.values():
            turns.ask(turn)
            turns.ask(turn)
        await asyncio.wait_for(done.wait(), patience())
        return order

    return asyncio.run(serve())


def test_who_has_had_least_of_the_loop_goes_first() -> None:
    order = served((0, 9), (1, 3), (2, 1), (3, 1))
    assert order[:4] == [0, 1, 2, 3]
    assert order[-5:] == [0] * 5


def test_who_was_idle_has_saved_up_nothing_and_waits_for_no_flood() -> None:
    async def serve() -> list[str]:
        turns, order = ParsingTurns(), []
        done = asyncio.Event()

        def flood(name: str) -> bool:
            order.append(name)
            busy(0.002)
            if len(order) == 6:
                turns.ask(late)
            if len(order) > 12:
                done.set()
            return len(order) < 13

        def small() -> bool:
            order.append("small")
            return False

        floods = [Turn(partial(flood, name)) for name in "abc"]
        late = Turn(small)
        for turn in floods:
            turns.ask(turn)
        await asyncio.wait_for(done.wait(), patience())
        return order

    order = asyncio.run(serve())
    assert order.index("small") <= 9  # after each of the others once, at most
    assert order.count("small") == 1


def test_who_is_connected_goes_before_a_burst_of_those_who_come() -> None:
    async def serve() -> list[str]:
        turns, order = ParsingTurns(), []
        done = asyncio.Event()

        def work(name: str, seconds: float) -> bool:
            order.append(name)
            busy(seconds)
            if len(order) == BURST + 1:
                done.set()
            return False

        known = Turn(partial(work, "known", 0.0001))
        for _ in range(100):  # with no other client there
            turns.ask(known)
            await asyncio.sleep(0)
        order.clear()
        burst = [Turn(partial(work, "new", 0.002)) for _ in range(BURST)]
        for turn in burst:
            turns.ask(turn)
        turns.ask(known)
        await asyncio.wait_for(done.wait(), patience())
        return order

    assert asyncio.run(serve()).index("known") <= 1


def test_what_the_machine_does_meanwhile_counts_for_no_connection() -> None:
    def work() -> bool:
        time.sleep(0.05)
        return False

    async def serve() -> float:
        turns, turn = ParsingTurns(), Turn(work)
        turns.ask(turn)
        return turn.used

    assert asyncio.run(serve()) < 0.04


def test_handshakes_of_an_address_take_turns_with_those_of_others() -> None:
    async def serve() -> list[str]:
        turns, order = ParsingTurns(), list[str]()
        ticks: list[int] = []

        async def come(host: str) -> None:
            await turns.open(Turn(bool), host)
            order.append(host)
            ticks[-1] += 1

        coming = [asyncio.ensure_future(come("many")) for _ in range(BURST)]
        coming[BURST // 2].cancel()
        coming += [asyncio.ensure_future(come("one")), asyncio.ensure_future(come("other"))]
        while not all(task.done() for task in coming):
            ticks.append(0)
            await asyncio.sleep(0)
        assert max(ticks) <= 3
        return order

    order = asyncio.run(serve())
    assert len(order) == BURST + 1
    assert max(order.index("one"), order.index("other")) <= 4


def test_what_takes_a_while_at_the_end_of_many_is_done_one_after_another() -> None:
    async def serve() -> list[int]:
        turns, ticks, done = ParsingTurns(), list[int](), list[None]()

        def end() -> None:
            done.append(None)
            ticks[-1] += 1

        ticks.append(0)
        for _ in range(BURST):
            turns.do(end)
        while len(done) < BURST:
            ticks.append(0)
            await asyncio.sleep(0)
        return ticks

    assert max(asyncio.run(serve())) <= 2


def test_a_burst_of_handshakes_does_not_fill_a_turn_of_the_loop(
    serve: Serve, monkeypatch: pytest.MonkeyPatch
) -> None:
    begun = [0]
    process = HandshakeHandler.process_request

    async def processed(*arguments: Any) -> Any:
        if not begun[-1]:
            asyncio.get_running_loop().call_soon(lambda: begun.append(0))
        begun[-1] += 1
        return await process(*arguments)

    monkeypatch.setattr(HandshakeHandler, "process_request", processed)
    server = serve()
    with ExitStack() as stack:
        host, port = "127.0.0.1", server.ports[0]
        opened = [stack.enter_context(socket.create_connection((host, port))) for _ in range(100)]
        eventually(lambda: len(tuple(server._sockets)) == len(opened), "all are accepted")
        for plain in opened:
            plain.sendall(request(port))
        for plain in opened:
            plain.settimeout(patience())
            assert plain.recv(12) == b"HTTP/1.1 101"
    assert sum(begun) == len(opened)
    assert max(begun) <= 4


def compressed(content: bytes) -> bytes:
    """Return the first frame of a compressed text that goes on."""
    plain = Frame(Opcode.TEXT, content, fin=False).serialize(mask=True)
    return bytes([plain[0] | 0x40]) + plain[1:]


LITTLE = Limits(message_bytes=MEGABYTE, total_memory_bytes=4 * MEGABYTE)
UNFINISHED = {
    "a frame that is not whole": frame(bytes(MEGABYTE - 10))[:-1],
    "fragments without the last": Frame(Opcode.TEXT, bytes(100_000), fin=False).serialize(mask=True)
    + Frame(Opcode.CONT, bytes(100_000), fin=False).serialize(mask=True) * 8,
    "compressed fragments without the last": compressed(packed(bytes(MEGABYTE - 10))),
}


@contextmanager
def compressing(port: int) -> Iterator[socket.socket]:
    """Yield a socket of a client that may compress what it sends."""
    with connect(f"ws://127.0.0.1:{port}/", ping_interval=None, close_timeout=0) as client:
        yield client.socket


@pytest.mark.parametrize("sent", UNFINISHED.values(), ids=UNFINISHED)
def test_unfinished_messages_of_many_are_counted_and_bounded_together(
    serve: Serve, sent: bytes
) -> None:
    server = serve(LITTLE, deflate=True)
    port = server.ports[0]
    with Talk(f"ws://127.0.0.1:{port}/") as other, ExitStack() as stack:
        for _ in range(2):
            stack.enter_context(compressing(port)).sendall(sent)
        eventually(lambda: server.held_octets > 1_700_000, "what two have sent is counted")
        for _ in range(14):
            with suppress(OSError):
                stack.enter_context(compressing(port)).sendall(sent)
            assert other.ask("List")
        assert server.held_octets < 2 * 4 * MEGABYTE + 16 * 65_536
        assert other.ask("Status")
        stack.close()
        eventually(lambda: server.held_octets < 100_000, "all of it was let go")


@pytest.mark.parametrize("sent", UNFINISHED.values(), ids=UNFINISHED)
def test_a_message_that_is_not_finished_in_time_ends_its_client_only(
    serve: Serve, sent: bytes
) -> None:
    # A pong would be taken for what is missing.
    limits = Limits(message_seconds=0.5 * slowness(), ping_seconds=patience())
    server = serve(limits, deflate=True)
    url = f"ws://127.0.0.1:{server.ports[0]}/"
    with Talk(url) as other, connect(url, ping_interval=None) as client:
        client.recv()
        client.socket.sendall(sent)
        with pytest.raises(ConnectionClosed, match="not finished within") as caught:
            client.recv(timeout=patience())  # its library answers pings meanwhile
        assert caught.value.rcvd is not None
        assert caught.value.rcvd.code == CloseCode.POLICY_VIOLATION
        assert other.ask("List")


def test_control_frames_within_an_unfinished_message_gain_no_time(serve: Serve) -> None:
    server = serve(Limits(message_seconds=0.5 * slowness()))
    with open_socket(server.ports[0]) as plain:
        plain.sendall(Frame(Opcode.TEXT, b"a", fin=False).serialize(mask=True))

        def is_closed() -> bool:
            try:
                plain.sendall(Frame(Opcode.CONT, b"", fin=False).serialize(mask=True))
                plain.sendall(frame(b"", Opcode.PONG))
                plain.settimeout(0.05)
                return b"not finished" in plain.recv(65536)
            except TimeoutError:
                return False
            except OSError:
                return True

        eventually(is_closed, "it is closed")


def test_a_head_that_does_not_end_is_cut_off_at_64_kib(server: Server) -> None:
    with socket.create_connection(("127.0.0.1", server.ports[0]), patience()) as plain:
        sent = 0
        with suppress(OSError):
            plain.sendall(b"GET / HTTP/1.1\r\n")
            for number in range(100):
                plain.sendall(b"x-%d: %s\r\n" % (number, b"a" * 8000))
                sent += 8000
            while plain.recv(65536):
                pass
        eventually(lambda: server.unread_octets < 70_000, "nothing is held of it")


def test_many_messages_one_after_another_are_never_late(serve: Serve) -> None:
    """The time is that of one message, not of a stream of them without a break."""
    seconds = 0.5 * slowness()
    server = serve(Limits(message_seconds=seconds))
    question = frame(b'{"op": "List", "type": "", "x-id": "a"}')
    first, rest = question[:20], question[20:]
    with open_socket(server.ports[0]) as steady:
        steady.settimeout(patience())
        steady.sendall(first)
        for _ in range(30):
            time.sleep(seconds / 10)
            steady.sendall(rest + first)  # at no moment is all that came whole
            assert steady.recv(65536), "it was cut off"


def test_small_messages_pass_where_all_memory_is_taken(serve: Serve) -> None:
    """`Stop` is never refused, nor its client cut off, for what others hold."""
    server = serve(Limits(total_memory_bytes=1024))
    with Talk(f"ws://127.0.0.1:{server.ports[0]}/") as client:
        for _ in range(100):
            client.answer(client.send("Stop"))


def test_one_that_answers_no_ping_is_cut_off_without_a_close_frame(
    serve: Serve, hurry: Hurry
) -> None:
    """As the page says, however slowly it reads: for a session that is kept it is a drop."""
    server = serve()
    with hurry(0.3 * slowness()):
        plain = open_socket(server.ports[0])
    with plain:
        came = b""
        with suppress(ConnectionError):
            while part := plain.recv(65536):
                came += part
        # Behind the hello: pings of four octets at random, which may be those of a close.
        pings = came[came.index(b"}}") + 2 :]
        assert set(pings[::6]) == set(frame(b"", Opcode.PING)[:1])
