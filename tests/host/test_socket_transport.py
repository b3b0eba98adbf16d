"""What is special about a link over two connected sockets: its frames, its fullness and its end."""

from __future__ import annotations

import socket
import threading
import tracemalloc
from collections.abc import Iterator
from queue import SimpleQueue
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from uoarm._host.transport import frames, socket_transport
from uoarm._host.transport.codec import Frame
from uoarm._host.transport.frames import LinkSockets
from uoarm._host.transport.socket_transport import SocketTransport
from uoarm.errors import BridgeError, BridgeTimeoutError, FailureReason
from uoarm.testing import patience, wait

LONG = 2**16 + 5
LARGE = bytes(range(256)) * 2**14  # 4 MiB, more than any kernel holds for a socket


@pytest.fixture
def bare() -> Iterator[tuple[SocketTransport, LinkSockets]]:
    """An end, and the bare sockets at its other end."""
    one, other = LinkSockets.make()
    near = SocketTransport(one, "near")
    yield near, other
    other.close()
    near.close()


class _Taken:
    """The frames that come at one end."""

    def __init__(self, end: SocketTransport, length: int = 4) -> None:
        self.got: SimpleQueue[tuple[Frame, bytes]] = SimpleQueue()
        end.subscribe("test/frames", length, lambda *frame: self.got.put(frame), "test")

    def next(self) -> tuple[Frame, bytes]:
        return self.got.get(timeout=patience())


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
    one, other = LinkSockets.make()
    near, far = SocketTransport(one, "near"), SocketTransport(other, "far")
    try:
        taken = _Taken(far, len(sizes))
        sent = [
            (bytes([n]) * length, bytes([n + 1]) * header)
            for n, (length, header) in enumerate(sizes)
        ]

        def write() -> None:
            for payload, header in sent:
                near.publish("test/frames", payload, header, must_arrive=True)

        writing = threading.Thread(target=write)
        writing.start()
        got = [taken.next() for _ in sent]
        writing.join(patience())
        assert got == sent
    finally:
        near.close()
        far.close()


def _fill(near: SocketTransport, monkeypatch: pytest.MonkeyPatch) -> None:
    """Begin a frame that the kernel takes only in part, while it is not read."""
    monkeypatch.setattr(socket_transport, "_FULL_SECONDS", 0.0)
    near.publish("test/frames", LARGE, b"first")


def test_a_frame_that_finds_a_full_link_is_dropped_whole(
    bare: tuple[SocketTransport, LinkSockets], monkeypatch: pytest.MonkeyPatch
) -> None:
    near, other = bare
    _fill(near, monkeypatch)
    near.publish("test/frames", b"second", b"")
    monkeypatch.setattr(socket_transport, "_MUST_ARRIVE_SECONDS", 0.0)
    with pytest.raises(BridgeTimeoutError, match="the link has been full"):
        near.publish("test/frames", b"third", b"", must_arrive=True)
    monkeypatch.setattr(socket_transport, "_FULL_SECONDS", patience())
    far = SocketTransport(other, "far")
    taken = _Taken(far)
    near.publish("test/frames", b"fourth", b"last")
    assert taken.next() == (LARGE, b"first")
    assert taken.next() == (b"fourth", b"last")
    far.close()


def test_the_next_caller_writes_on_at_what_was_begun(
    bare: tuple[SocketTransport, LinkSockets], monkeypatch: pytest.MonkeyPatch
) -> None:
    near, other = bare
    _fill(near, monkeypatch)
    far = SocketTransport(other, "far")
    far.answer("test/ask", lambda request, reply: reply(request))
    taken = _Taken(far)
    while taken.got.empty():  # as heartbeats do, over a socket of their own
        assert near.ask("test/ask", "anything", timeout=patience()) == "anything"
    assert taken.next() == (LARGE, b"first")
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
    bare: tuple[SocketTransport, LinkSockets], monkeypatch: pytest.MonkeyPatch
) -> None:
    near, other = bare
    far = SocketTransport(other, "far")
    taken = _Taken(far)
    writer = near._flows._writer
    real: Any = writer._socket
    monkeypatch.setattr(writer, "_socket", _Interrupted(real))
    with pytest.raises(KeyboardInterrupt):
        near.publish("test/frames", b"one", b"")
    monkeypatch.setattr(writer, "_socket", real)
    with pytest.raises(BridgeError, match="the link is closed"):
        near.publish("test/frames", b"two", b"")
    assert taken.next() == (b"one", b"")
    far.close()


@pytest.mark.parametrize(
    "garbage",
    [b"\xff" * 16, frames._HEAD.pack(2, 0, 4, 0, 0, 2**31) + b"name"],
    ids=["noise", "a frame of 2 GiB"],
)
@pytest.mark.parametrize("place", ["requests", "outgoing"])
def test_what_is_no_frame_ends_the_link_for_both(
    bare: tuple[SocketTransport, LinkSockets], garbage: bytes, place: str
) -> None:
    near, other = bare
    for item in (other.requests, other.incoming):
        item.settimeout(patience())
    getattr(other, place).sendall(garbage)
    assert other.requests.recv(1) == other.incoming.recv(1) == b""
    with pytest.raises(BridgeError, match="the link is closed") as caught:
        near.ask("test/ask", None, timeout=patience())
    assert caught.value.reason is FailureReason.UNAVAILABLE


def test_a_frame_for_which_there_is_no_memory_ends_the_link(
    bare: tuple[SocketTransport, LinkSockets], monkeypatch: pytest.MonkeyPatch
) -> None:
    near, other = bare
    other.requests.settimeout(patience())

    def none_left(size: int) -> bytearray:
        raise MemoryError

    monkeypatch.setattr(frames, "bytearray", none_left, raising=False)
    other.outgoing.sendall(frames._HEAD.pack(0, 0, 4, 0, 0, LONG) + b"name")
    assert other.requests.recv(1) == b""

    def is_refused() -> bool:
        try:
            near.publish("test/frames", b"", b"")
        except BridgeError as error:
            return "the link is closed" in str(error)
        return False

    wait(is_refused)  # the sockets of a link are shut one after the other


def test_a_caller_that_waits_for_an_answer_sees_the_end_at_once(
    bare: tuple[SocketTransport, LinkSockets],
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
    assert other.requests.recv(1)  # it has asked
    other.requests.shutdown(socket.SHUT_RDWR)
    assert isinstance(said.get(timeout=patience()), BridgeError)
    asking.join(patience())


def test_late_questions_without_an_answer_are_forgotten(
    bare: tuple[SocketTransport, LinkSockets],
) -> None:
    near, _ = bare
    for _ in range(100):
        near.ask_later("test/ask", lambda answer: None, timeout=0.0)
    assert len(near._asked) == len(near._late) == 1


def test_the_oldest_frames_of_a_subscription_are_lost_first(
    bare: tuple[SocketTransport, LinkSockets],
) -> None:
    near, other = bare
    far = SocketTransport(other, "far")
    got: list[Frame] = []
    gate, last = threading.Event(), threading.Event()

    def take(payload: Frame, header: bytes) -> None:
        gate.wait(patience())
        got.append(payload)

    near.subscribe("test/frames", 2, take, "test")
    near.subscribe("test/last", 2, lambda *_: last.set(), "test")
    for number in range(5):
        far.publish("test/frames", bytes([number]), b"")
    far.publish("test/last", b"", b"")
    assert last.wait(patience())
    gate.set()
    wait(lambda: len(got) == 3)
    assert got == [b"\x00", b"\x03", b"\x04"]
    far.close()


def test_nothing_is_received_after_an_end(bare: tuple[SocketTransport, LinkSockets]) -> None:
    near, other = bare
    far = SocketTransport(other, "far")
    seen: list[bytes] = []
    near.listen("test/one", seen.append)()
    near.answer("test/ask", lambda request, reply: reply(request))()
    with pytest.raises(BridgeError, match="there is no answer at test/ask"):
        far.ask("test/ask", None, timeout=patience())
    far.notify("test/one", b"late")
    near.answer("test/ask", lambda request, reply: reply(request))
    assert far.ask("test/ask", "echoed", timeout=patience()) == "echoed"
    assert seen == []
    far.close()
    wait(lambda: not far._thread.is_alive())


def test_what_a_frame_says_of_its_length_takes_no_memory_before_it_comes() -> None:
    near, far = socket.socketpair()
    with near, far:
        head = frames._HEAD.pack(1, 0, 0, 1, 0, frames._MOST_OCTETS)
        far.sendall(head)
        far.close()
        tracemalloc.start()
        try:
            assert frames.FrameReader(near).read() is None
            _, most = tracemalloc.get_traced_memory()
        finally:
            tracemalloc.stop()
    assert most < 2 * frames._CLAIMED_OCTETS


@pytest.mark.parametrize(("header", "length"), [(2**16 + 1, 0), (0, 2**30 + 1)])
def test_a_frame_that_says_it_is_too_long_is_refused(header: int, length: int) -> None:
    near, far = socket.socketpair()
    with near, far:
        far.sendall(frames._HEAD.pack(1, 0, 0, 1, header, length))
        with pytest.raises(ValueError, match=f"{length:,} octets long, its header {header:,}"):
            frames.FrameReader(near).read()


def test_a_frame_longer_than_what_is_claimed_at_once_arrives_whole() -> None:
    length = 2 * frames._CLAIMED_OCTETS + 3
    payload = bytes(range(251)) * (length // 251 + 1)
    payload = payload[:length]
    near, far = socket.socketpair()
    with near, far:
        head = frames._HEAD.pack(1, 0, 1, 7, 0, length)
        sender = threading.Thread(target=far.sendall, args=(head + b"k" + payload,))
        sender.start()
        received = frames.FrameReader(near).read()
        sender.join(patience())
    assert received is not None
    assert (received.key, received.number, bytes(received.payload)) == ("k", 7, payload)
