"""What is special about a link over two connected sockets: its frames, its fullness and its end."""

from __future__ import annotations

import socket
import threading
from collections.abc import Iterator
from queue import SimpleQueue
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from uoarm._host.transport import frames, socket_transport
from uoarm._host.transport.codec import Frame
from uoarm._host.transport.socket_transport import SocketTransport
from uoarm.errors import BridgeError, BridgeTimeoutError, FailureReason
from uoarm.testing import patience, wait

LONG = 2**16 + 5
LARGE = bytes(range(256)) * 2**14  # 4 MiB, more than any kernel holds for a socket


@pytest.fixture
def bare() -> Iterator[tuple[SocketTransport, socket.socket]]:
    """An end, and the bare socket at its other end."""
    one, other = socket.socketpair()
    near = SocketTransport(one, "near")
    yield near, other
    other.close()
    near.close()


@given(
    st.lists(
        st.tuples(
            st.sampled_from([0, 1, 100, 2**14 - 1, 2**14, 2**16 - 40, 2**16, LONG, 300_000]),
            st.sampled_from([0, 16, 28, 2**16 - 20]),
        ),
        min_size=1,
        max_size=12,
    )
)
def test_frames_of_every_length_arrive_whole_and_in_order(sizes: list[tuple[int, int]]) -> None:
    one, other = socket.socketpair()
    near, far = SocketTransport(one, "near"), SocketTransport(other, "far")
    try:
        receive, _ = far.subscribe("test/frames", len(sizes))
        sent = [
            (bytes([n]) * length, bytes([n + 1]) * header)
            for n, (length, header) in enumerate(sizes)
        ]

        def write() -> None:
            for payload, header in sent:
                near.publish("test/frames", payload, header, must_arrive=True)

        writing = threading.Thread(target=write)
        writing.start()
        got = [receive() for _ in sent]
        writing.join(patience())
        assert got == sent
    finally:
        near.close()
        far.close()


def _fill(near: SocketTransport, monkeypatch: pytest.MonkeyPatch) -> None:
    """Begin a frame that the kernel takes only in part, while nobody reads."""
    monkeypatch.setattr(socket_transport, "_FULL_SECONDS", 0.0)
    near.publish("test/frames", LARGE, b"first")


def test_a_frame_that_finds_a_full_link_is_dropped_whole(
    bare: tuple[SocketTransport, socket.socket], monkeypatch: pytest.MonkeyPatch
) -> None:
    near, other = bare
    _fill(near, monkeypatch)
    near.publish("test/frames", b"second", b"")
    monkeypatch.setattr(socket_transport, "_MUST_ARRIVE_SECONDS", 0.0)
    with pytest.raises(BridgeTimeoutError, match="the link has been full"):
        near.publish("test/frames", b"third", b"", must_arrive=True)
    monkeypatch.setattr(socket_transport, "_FULL_SECONDS", patience())
    far = SocketTransport(other.dup(), "far")
    receive, _ = far.subscribe("test/frames", 4)
    near.publish("test/frames", b"fourth", b"last")
    assert receive() == (LARGE, b"first")
    assert receive() == (b"fourth", b"last")
    far.close()


def test_whoever_writes_next_ends_what_was_begun(
    bare: tuple[SocketTransport, socket.socket], monkeypatch: pytest.MonkeyPatch
) -> None:
    near, other = bare
    _fill(near, monkeypatch)
    monkeypatch.setattr(socket_transport, "_FULL_SECONDS", patience())
    far = SocketTransport(other.dup(), "far")
    far.answer("test/ask", lambda request, reply: reply(request))
    receive, _ = far.subscribe("test/frames", 4)
    assert near.ask("test/ask", "behind it", timeout=patience()) == "behind it"
    assert receive() == (LARGE, b"first")
    far.close()


class _Interrupted:
    """A socket in whose writing a signal's handler raises, after the octets have gone."""

    def __init__(self, real: socket.socket) -> None:
        self._real = real

    def send(self, *given: Any) -> int:
        self._real.send(*given)
        raise KeyboardInterrupt

    def __getattr__(self, name: str) -> Any:
        return getattr(self._real, name)


def test_a_write_that_a_signal_interrupts_ends_the_link_and_garbles_nothing(
    bare: tuple[SocketTransport, socket.socket], monkeypatch: pytest.MonkeyPatch
) -> None:
    near, other = bare
    far = SocketTransport(other.dup(), "far")
    receive, _ = far.subscribe("test/frames", 4)
    writer = near._writer
    real: Any = writer._socket
    monkeypatch.setattr(writer, "_socket", _Interrupted(real))
    with pytest.raises(KeyboardInterrupt):
        near.publish("test/frames", b"one", b"")
    monkeypatch.setattr(writer, "_socket", real)
    with pytest.raises(BridgeError, match="the link is closed"):
        near.publish("test/frames", b"two", b"")
    assert receive() == (b"one", b"")
    far.close()


@pytest.mark.parametrize(
    "told",
    [b"\xff" * 16, frames._HEAD.pack(2, 0, 4, 0, 0, 2**31) + b"name"],
    ids=["noise", "a frame of 2 GiB"],
)
def test_what_is_no_frame_ends_the_link_for_both(
    bare: tuple[SocketTransport, socket.socket], told: bytes
) -> None:
    near, other = bare
    other.settimeout(patience())
    other.sendall(told)
    assert other.recv(1) == b""
    with pytest.raises(BridgeError, match="the link is closed") as caught:
        near.ask("test/ask", None, timeout=patience())
    assert caught.value.reason is FailureReason.UNAVAILABLE


def test_a_frame_for_which_there_is_no_memory_ends_the_link(
    bare: tuple[SocketTransport, socket.socket], monkeypatch: pytest.MonkeyPatch
) -> None:
    near, other = bare
    other.settimeout(patience())

    def none_left(size: int) -> bytearray:
        raise MemoryError

    monkeypatch.setattr(frames, "bytearray", none_left, raising=False)
    other.sendall(frames._HEAD.pack(2, 0, 4, 0, 0, LONG) + b"name")
    assert other.recv(1) == b""
    with pytest.raises(BridgeError, match="the link is closed"):
        near.publish("test/frames", b"", b"")


def test_who_waits_for_an_answer_hears_of_the_end_at_once(
    bare: tuple[SocketTransport, socket.socket],
) -> None:
    near, other = bare
    said: SimpleQueue[BaseException] = SimpleQueue()

    def ask() -> None:
        try:
            near.ask("test/ask", None, timeout=1000.0)
        except BridgeError as error:
            said.put(error)

    asking = threading.Thread(target=ask)
    asking.start()
    assert other.recv(1)  # it has asked
    other.shutdown(socket.SHUT_RDWR)
    assert isinstance(said.get(timeout=patience()), BridgeError)
    asking.join(patience())


def test_late_questions_that_nobody_answers_are_forgotten(
    bare: tuple[SocketTransport, socket.socket],
) -> None:
    near, _ = bare
    for _ in range(100):
        near.ask_later("test/ask", None, lambda answer: None, timeout=0.0)
    assert len(near._asked) == len(near._late) == 1


def test_the_oldest_frames_of_a_subscription_are_lost_first(
    bare: tuple[SocketTransport, socket.socket],
) -> None:
    near, other = bare
    far = SocketTransport(other.dup(), "far")
    receive, _ = near.subscribe("test/frames", 2)
    got: SimpleQueue[Frame] = SimpleQueue()
    near.listen("test/last", got.put)
    for number in range(5):
        far.publish("test/frames", bytes([number]), b"")
    far.publish("test/last", b"", b"now")
    assert got.get(timeout=patience()) == b"now"
    assert [receive(), receive()] == [(b"\x03", b""), (b"\x04", b"")]
    far.close()


def test_nothing_is_heard_after_an_end(bare: tuple[SocketTransport, socket.socket]) -> None:
    near, other = bare
    far = SocketTransport(other.dup(), "far")
    seen: list[bytes] = []
    near.listen("test/one", seen.append)()
    near.answer("test/ask", lambda request, reply: reply(request))()
    with pytest.raises(BridgeError, match="nobody answers at test/ask"):
        far.ask("test/ask", None, timeout=patience())
    far.publish("test/one", b"", b"late")
    near.answer("test/ask", lambda request, reply: reply(request))
    assert far.ask("test/ask", "told", timeout=patience()) == "told"
    assert seen == []
    far.close()
    wait(lambda: not far._thread.is_alive())
