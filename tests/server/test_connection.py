"""A client's socket is read in small turns: floods of tiny frames cost the others little."""

from __future__ import annotations

import socket
import threading
from contextlib import suppress

from tests.server.conftest import Connect, Serve
from tests.server.talk import Talk, eventually, frame, open_socket
from websockets.frames import Opcode

from uoarm.server import Limits, Server
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


def test_one_that_floods_with_pings_and_reads_nothing_is_cut_off_in_time(serve: Serve) -> None:
    silence = 2 * slowness()  # the other one must keep to it
    server = serve(Limits(ping_seconds=silence / 4, stall_seconds=silence))
    url = f"ws://127.0.0.1:{server.ports[0]}/"
    with Talk(url) as other, open_socket(server.ports[0]) as plain:
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
        asked = [frame(b'{"op":"List","id":"%d"}' % number) for number in range(2000)]
        sending = threading.Thread(target=plain.sendall, args=(b"".join(asked),), daemon=True)
        sending.start()
        plain.settimeout(patience())
        told = b""
        while told.count(b'"op":"Reply"') < 2000:
            told += plain.recv(65536)
        ids = [int(part.split(b'"')[1]) for part in told.split(b'"id"')[1:]]
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
