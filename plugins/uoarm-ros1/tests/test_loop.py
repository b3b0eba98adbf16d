"""The loop over sockets never turns without work: what ends a wait is taken, or it rests."""

from __future__ import annotations

import itertools
import resource
import socket
import threading
import time
import weakref
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import partial

import pytest
from endpoints import bridge_to, output
from peers import Master, Peer
from uoarm_ros1._definitions import record_of
from uoarm_ros1._publication import TopicPublication
from uoarm_ros1._server import Handler, NodeServer, SocketLoop
from uoarm_ros1._tcpros import encode_header

from uoarm.model import MessageStructure
from uoarm.testing import Collector, patience, wait

FEW = 2
"""Turns for nothing that one cause may cost."""
INT = "std_msgs/Int32"
RECORD = record_of(INT, "int32 data")


@pytest.fixture
def loop() -> Iterator[SocketLoop]:
    made = SocketLoop("loop")
    yield made
    made.close()


class Reading(Handler):
    """Counts the octets that come."""

    def __init__(self, connection: socket.socket) -> None:
        super().__init__(connection)
        self.octets = 0

    def readable(self) -> None:
        octets = self.socket.recv(65_536)
        if not octets:
            raise ConnectionError("closed")
        self.octets += len(octets)

    def wait_for(self, octets: int) -> None:
        wait(lambda: self.octets == octets)


class Deaf(Handler):
    """Never takes what is there."""

    def readable(self) -> None:
        raise BlockingIOError


def pair(loop: SocketLoop, make: Callable[[socket.socket], Handler]) -> socket.socket:
    ours, theirs = socket.socketpair()
    loop.add(make(ours))
    return theirs


def pass_through(loop: SocketLoop) -> None:
    """Return when the loop has done all that was posted before."""
    done = threading.Event()
    loop.post(done.set)
    assert done.wait(patience())


def test_what_is_posted_and_what_is_due_cost_no_turn(loop: SocketLoop) -> None:
    for _ in range(100):
        pass_through(loop)
    came: list[int] = []

    def plan() -> None:
        for number in range(21):
            loop.later(0.001 * number, partial(came.append, number))

    loop.post(plan)
    wait(lambda: len(came) == 21)
    pass_through(loop)
    assert loop.turns.empty == 0


def test_octets_in_pieces_and_an_end_cost_no_turn(loop: SocketLoop) -> None:
    made: list[Reading] = []

    def make(connection: socket.socket) -> Handler:
        made.append(Reading(connection))
        return made[0]

    with pair(loop, make) as peer:
        for number in range(1, 101):
            peer.sendall(b"x" * 1000)
            made[0].wait_for(1000 * number)
    wait(lambda: made[0].socket.fileno() < 0)
    assert loop.turns.empty == 0


def test_a_subscriber_that_does_not_read_costs_no_turn(loop: SocketLoop) -> None:
    """What it did not take waits for its socket, which takes nothing, then a little, then all."""
    publication = TopicPublication(loop, "/node", "/topic", RECORD, limits=(10_000, 1 << 28))
    ours, theirs = socket.socketpair()
    with theirs:
        header = {
            "callerid": "/peer", "topic": "/topic", "type": INT, "md5sum": RECORD.md5,
            "message_definition": "",
        }  # fmt: skip
        loop.post(partial(publication.arrived, ours, header))
        wait(lambda: publication.callers == ["/peer"])
        for _ in range(20):
            publication.send((1 << 16).to_bytes(4, "little") + bytes(1 << 16))
        wait(lambda: publication.waiting > 0)
        turns = loop.turns.all
        for _ in range(20):
            pass_through(loop)
        assert loop.turns.all <= turns + 2 * 20 + FEW
        theirs.setblocking(False)

        def drained() -> bool:
            theirs.recv(1 << 14)
            return not publication.waiting

        wait(drained)
        publication.close()
        pass_through(loop)
    assert loop.turns.empty <= FEW


def test_a_peer_that_is_gone_before_it_is_taken_costs_one_turn(loop: SocketLoop) -> None:
    server = NodeServer(loop, "127.0.0.1", lambda *_: [1, "", 0], lambda *_: None)
    for _ in range(10):
        with socket.create_connection(("127.0.0.1", server.port)) as connection:
            connection.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, b"\1\0\0\0\0\0\0\0")
    pass_through(loop)
    assert loop.turns.empty <= 10 * FEW


@contextmanager
def no_more_files() -> Iterator[None]:
    before = resource.getrlimit(resource.RLIMIT_NOFILE)
    with socket.socket() as highest:
        least = highest.fileno()
    resource.setrlimit(resource.RLIMIT_NOFILE, (least, before[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_NOFILE, before)


def test_a_process_that_may_open_no_more_files_waits(loop: SocketLoop) -> None:
    arrived = threading.Event()

    def take(connection: socket.socket, _: dict[str, str]) -> None:
        connection.close()
        arrived.set()

    server = NodeServer(loop, "127.0.0.1", lambda *_: [1, "", 0], take)
    pass_through(loop)
    with socket.socket() as peer:
        with no_more_files():
            began, turns = time.monotonic(), loop.turns.all
            peer.connect(("127.0.0.1", server.port))
            peer.sendall(encode_header({"callerid": "/peer"}))
            wait(lambda: loop.turns.all >= turns + 6)
            assert time.monotonic() - began > 0.1
        assert arrived.wait(patience())


def test_what_ends_every_wait_and_is_never_taken_makes_the_loop_rest(loop: SocketLoop) -> None:
    made: list[Reading] = []

    def make(connection: socket.socket) -> Handler:
        made.append(Reading(connection))
        return made[0]

    with pair(loop, Deaf) as deaf, pair(loop, make) as peer:
        deaf.sendall(b"x")
        began = time.monotonic()
        wait(lambda: loop.turns.empty > 20)
        empty, seconds = loop.turns.empty, time.monotonic() - began
        assert empty <= 10 + seconds / 0.02
        peer.sendall(b"x")
        wait(lambda: made[0].octets == 1)


_names = itertools.count(1)


def test_a_bridge_turns_no_more_than_its_messages_need(master: Master, lasting: Peer) -> None:
    topic = f"/loop/idle{next(_names)}"
    lasting.do("advertise", topic=topic, type=INT)
    inbox = Collector()
    with bridge_to(master) as bridge:
        channel = bridge.open_source(output(topic, INT), MessageStructure(True), inbox.deliver)
        for number in range(50):
            lasting.publish(topic, type=INT, values={"data": number})
            inbox.wait(number + 1)
        assert bridge.facts() == {"empty_turns": 0}
        channel.close()
    assert bridge.facts() == {"empty_turns": 0}


def test_what_came_over_a_connection_that_has_ended_is_not_kept(loop: SocketLoop) -> None:
    server = NodeServer(loop, "127.0.0.1", lambda *_: [1, "", 0], lambda *_: None)
    held = server._unidentified._held
    with socket.create_connection(("127.0.0.1", server.api_port)) as connection:
        connection.sendall(b"POST / HTTP/1.1\r\nContent-Length: 2000000\r\n\r\n" + bytes(1000))
        wait(lambda: any(held.values()))
        (kept,) = map(weakref.ref, held)

    def is_gone() -> bool:
        loop.post(lambda: None)  # the thread refers to what it read last until its next turn
        return kept() is None

    wait(is_gone)
