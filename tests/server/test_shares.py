"""What all clients share is divided among them: who comes late finds a part of it."""

from __future__ import annotations

import asyncio
import socket
import threading
from contextlib import ExitStack
from contextvars import copy_context

import pytest
from hypothesis import given
from hypothesis import strategies as st
from tests.server.conftest import Between, Serve
from tests.server.robot import script
from tests.server.serving import url
from tests.server.talk import Talk, eventually
from tests.server.test_serving import figures
from websockets.exceptions import InvalidStatus
from websockets.sync.client import connect

from uoarm.server import Limits, Server
from uoarm.server._failures import BusyError
from uoarm.server.streams import Shares, acting
from uoarm.server.streams._workers import LoopMailbox, Workers
from uoarm.testing import patience


@given(st.integers(1, 30), st.lists(st.tuples(st.integers(0, 6), st.booleans()), max_size=200))
def test_no_one_below_an_equal_share_is_refused_and_twice_is_the_most(
    most: int, moves: list[tuple[int, bool]]
) -> None:
    shares = Shares(most)
    owners = {owner for owner, _ in moves}
    for owner, takes in moves:
        if not takes:
            if shares.of(owner):
                shares.take(owner, -1)
        elif shares.admits(owner):
            shares.take(owner)
        else:
            assert shares.total >= most
            assert shares.of(owner) + 1 > most // len(owners)
        assert 0 <= shares.total <= 2 * most


def test_calls_that_hang_leave_threads_to_who_comes_later(serve: Serve) -> None:
    server = serve(Limits(workers=4, calls=4))
    with Talk(url(server)) as greedy, Talk(url(server)) as late:
        hanging = [greedy.send("Call", "slow", {"value": 1}) for _ in range(4)]
        eventually(lambda: "uoarm_serve_workers_busy 4.0" in figures(server), "all are taken")
        assert greedy.ask("List")
        assert late.ask("Call", "add", {"a": 1, "b": 2})
        script.gate.set()
        assert all(greedy.answer(name)["op"] == "Reply" for name in hanging)


def in_name_of(owner: str, workers: Workers, gate: threading.Event) -> asyncio.Future[bool]:
    context = copy_context()
    context.run(acting.set, owner)
    return context.run(workers.open, lambda: gate.wait(patience()))


async def test_openings_that_hang_leave_some_to_who_comes_later() -> None:
    gate, opened = threading.Event(), threading.Event()
    opened.set()

    workers = Workers(1, 4, LoopMailbox(asyncio.get_running_loop()))
    hanging = [in_name_of("greedy", workers, gate) for _ in range(10)]
    late = in_name_of("late", workers, opened)
    assert await asyncio.wait_for(late, patience())
    gate.set()
    assert all(await asyncio.wait_for(asyncio.gather(*hanging), patience()))
    workers.close()


async def test_a_worker_is_given_back_whatever_becomes_of_who_waited() -> None:
    workers = Workers(1, 1, LoopMailbox(asyncio.get_running_loop()))
    for _ in range(5):
        with pytest.raises(ZeroDivisionError):
            await workers.start(lambda: 1 // 0)
    gate = threading.Event()
    given_up = workers.start(lambda: gate.wait(patience()))
    given_up.cancel()
    with pytest.raises(BusyError, match="all 1 workers"):
        workers.start(lambda: None)
    gate.set()
    await asyncio.to_thread(eventually, lambda: not workers.busy, "it is given back")
    workers.close()


def test_addresses_share_the_connections(serve: Serve) -> None:
    server = serve(Limits(connections=4))
    with ExitStack() as stack:
        for _ in range(4):
            stack.enter_context(Talk(url(server)))
        with pytest.raises(InvalidStatus, match="503"):
            connect(url(server))
        for _ in range(2):
            stack.enter_context(Talk(url(server), source_address=("127.0.0.2", 0)))
        with pytest.raises(InvalidStatus, match="503"):
            connect(url(server), source_address=("127.0.0.2", 0))


def test_handshakes_that_hang_give_way_to_another_address(serve: Serve) -> None:
    server = serve(Limits(connections=1, handshake_seconds=patience()))
    with ExitStack() as stack:
        for _ in range(70):  # 64 more than the connections
            plain = socket.create_connection(("127.0.0.1", server.ports[0]), patience())
            stack.enter_context(plain).sendall(b"GET / HTTP/1.1\r\n")
        with Talk(url(server), source_address=("127.0.0.2", 0)) as other:
            assert other.ask("List")


def drop_many(count: int, stack: ExitStack, server: Server, between: Between) -> None:
    """Leave so many sessions behind that do nothing."""
    proxy = between(server)
    for _ in range(count):
        stack.enter_context(Talk(f"ws://127.0.0.1:{proxy.port}/")).ask("Resume")
    proxy.cut()


def test_sessions_without_use_give_way_to_one_that_is_used(serve: Serve, between: Between) -> None:
    server = serve(Limits(kept_sessions=5))
    with ExitStack() as stack:
        drop_many(7, stack, server, between)
        eventually(lambda: "uoarm_serve_kept_sessions 5.0" in figures(server), "all are taken")
        proxy = between(server)
        honest = stack.enter_context(Talk(f"ws://127.0.0.1:{proxy.port}/"))
        key = honest.ask("Resume")["key"]
        honest.open("numbers")
        proxy.cut()
        eventually(lambda: "uoarm_serve_clients 0.0" in figures(server), "it has dropped")
        drop_many(7, stack, server, between)
        eventually(lambda: "uoarm_serve_clients 0.0" in figures(server), "they have dropped")
        again = stack.enter_context(Talk(url(server)))
        assert again.ask("Resume", message={"key": key})["session"] == honest.hello["session"]
