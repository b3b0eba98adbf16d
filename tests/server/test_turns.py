"""Openings and ends side by side: many that wait, few that compute, no more than allowed.

And what grows with clients, or with what one of them has: the loop does a little of it at a time.
"""

from __future__ import annotations

import asyncio
import sys
import threading
from asyncio import Handle
from collections import Counter
from collections.abc import Callable
from functools import partial
from typing import Any

import pytest
from tests.server.conftest import Connect
from tests.server.robot import many_functions
from tests.server.serving import servers
from tests.server.talk import Talk, eventually

from uoarm import RobotManager
from uoarm.config import loads
from uoarm.server._failures import BusyError
from uoarm.server._server import _in_turns
from uoarm.server.session._native import NativeSession
from uoarm.server.streams._feed_registry import FeedRegistry
from uoarm.server.streams._memory import acting
from uoarm.server.streams._workers import LoopMailbox, ThreadTurns, Workers
from uoarm.testing import patience

LIMIT = 8
LOOK = ThreadTurns.look_seconds
MANY = 200


def begin_all(turns: ThreadTurns, now: float, first: int) -> int:
    """Begin what may begin at a time; returns how many it were."""
    count = 0
    while turns.may_begin:
        turns.begin(first + count, now)
        count += 1
    return count


def test_few_begin_at_once_and_the_next_as_one_ends() -> None:
    turns = ThreadTurns(LIMIT)
    assert begin_all(turns, 0.0, 0) == 2
    turns.end(0)
    assert begin_all(turns, 0.001, 2) == 1


def test_those_that_wait_make_room_up_to_the_limit() -> None:
    turns = ThreadTurns(LIMIT)
    begun, now, rounds = 0, 0.0, []
    for _ in range(6):
        rounds.append(begin_all(turns, now, begun))
        begun += rounds[-1]
        now += 1.1 * LOOK
        turns.look(now, now)
    assert rounds == [2, 2, 2, 2, 0, 0]
    turns.end(0)
    assert begin_all(turns, now, begun) == 1


def test_where_the_loop_itself_is_late_nothing_is_taken_for_waiting() -> None:
    turns = ThreadTurns(LIMIT)
    begin_all(turns, 0.0, 0)
    turns.look(LOOK, LOOK + 1.0)
    assert not turns.may_begin
    turns.look(1.0 + 2 * LOOK, 1.0 + 2 * LOOK)
    assert turns.may_begin


def test_one_that_began_just_now_is_not_taken_for_waiting() -> None:
    turns = ThreadTurns(LIMIT)
    turns.begin("old", 0.0)
    turns.begin("new", 0.9 * LOOK)
    turns.look(LOOK, LOOK)
    assert begin_all(turns, LOOK, 1) == 1


def made() -> Workers:
    return Workers(1, LIMIT, LoopMailbox(asyncio.get_running_loop()))


@pytest.mark.parametrize("kind", [Workers.open, Workers.free])
async def test_what_hangs_keeps_nothing_behind_it_waiting(kind: Callable[..., Any]) -> None:
    gate, workers = threading.Event(), made()
    hanging = [kind(workers, lambda: gate.wait(patience())) for _ in range(LIMIT - 1)]
    assert await asyncio.wait_for(kind(workers, lambda: "done"), patience()) == "done"
    assert workers.busy == LIMIT - 1
    gate.set()
    assert all(await asyncio.wait_for(asyncio.gather(*hanging), patience()))
    workers.close()


@pytest.mark.parametrize("kind", [Workers.open, Workers.free])
async def test_what_hangs_for_one_client_keeps_no_other_waiting(kind: Callable[..., Any]) -> None:
    gate, workers = threading.Event(), made()
    acting.set("one")
    hanging = [kind(workers, lambda: gate.wait(patience())) for _ in range(MANY)]
    acting.set("another")
    assert await asyncio.wait_for(kind(workers, lambda: "done"), patience()) == "done"
    gate.set()
    assert all(await asyncio.wait_for(asyncio.gather(*hanging), patience()))
    workers.close()


async def test_of_what_computes_two_are_freed_at_once() -> None:
    """More take the interpreter's lock from the loop, which has a stop to read meanwhile."""
    begun, gate, workers = [], threading.Event(), made()

    def free(number: int) -> None:
        begun.append(number)
        gate.wait(patience())

    freed = [workers.free(partial(free, number)) for number in range(MANY)]
    names = Counter(thread.name for thread in threading.enumerate())
    assert names["uoarm-serve-free"] == 2
    gate.set()
    await asyncio.wait_for(asyncio.gather(*freed), patience())
    assert sorted(begun) == list(range(MANY))
    workers.close()


async def test_those_that_a_client_moved_are_stopped_by_a_few_threads(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """A thread for each of a thousand took the loop a tenth of a second to start."""
    begun: list[str] = []
    start = threading.Thread.start

    def noted(thread: threading.Thread) -> None:
        begun.append(threading.current_thread().name)
        start(thread)

    monkeypatch.setattr(threading.Thread, "start", noted)
    gate, workers, left = threading.Event(), made(), threading.Semaphore(0)

    def leave() -> None:
        gate.wait(patience())
        left.release()

    for _ in range(MANY):
        workers.leave(leave)
    assert begun.count(threading.current_thread().name) == 17  # with the one that watches them
    gate.set()
    for _ in range(MANY):
        assert await asyncio.to_thread(left.acquire, timeout=patience())
    workers.close()


@pytest.mark.parametrize("kind", [Workers.open, Workers.free, Workers.start])
async def test_where_the_system_gives_no_threads_each_is_refused_and_the_next_is_done(
    kind: Callable[..., Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    workers = made()
    with monkeypatch.context() as patch:
        patch.setattr(threading.Thread, "start", _refuse)
        for _ in range(3 * LIMIT):
            with pytest.raises(BusyError, match="no more threads"):
                await asyncio.wait_for(kind(workers, lambda: "done"), patience())
        workers.leave(lambda: None)  # raises nothing: what comes after it is to be done
    assert workers.busy == 0
    assert await asyncio.wait_for(kind(workers, lambda: "done"), patience()) == "done"
    workers.close()


def _refuse(thread: threading.Thread) -> None:
    raise RuntimeError("can't start new thread")


def test_what_could_not_be_ended_for_want_of_a_thread_is_ended_later(
    robot: RobotManager, talk: Connect, monkeypatch: pytest.MonkeyPatch
) -> None:
    refused = threading.Event()
    start = threading.Thread.start

    def refuse_once(thread: threading.Thread) -> None:
        if thread.name == "uoarm-serve-free" and not refused.is_set():
            refused.set()
            _refuse(thread)
        start(thread)

    monkeypatch.setattr(threading.Thread, "start", refuse_once)
    client = talk()
    client.ask("Request", "echo")
    client.close()
    eventually(lambda: not robot.connections(), "its connection has ended")
    assert refused.is_set()


def test_of_a_client_that_leaves_few_connections_are_ended_in_one_step_of_the_loop(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    killed: Counter[int] = Counter()
    steps = 0
    run, kill = Handle._run, FeedRegistry.kill

    def counted(handle: Handle) -> None:
        nonlocal steps
        steps += threading.current_thread().name == "uoarm-serve"
        run(handle)

    def noted(*arguments: Any) -> Any:
        killed[steps] += 1
        return kill(*arguments)

    monkeypatch.setitem(sys.modules, "uvloop", None)  # its loop reports no steps
    with RobotManager(loads(many_functions(MANY))) as large, servers(large) as serve:
        client = Talk(f"ws://127.0.0.1:{serve().ports[0]}/")
        for number in range(MANY):
            client.ask("Request", f"f{number}")
        monkeypatch.setattr(Handle, "_run", counted)
        monkeypatch.setattr(FeedRegistry, "kill", noted)
        client.close()
        eventually(lambda: not large.connections(), "all of its connections have ended")
    assert sum(killed.values()) == MANY
    assert max(killed.values()) <= 20


async def test_the_loop_goes_over_many_clients_in_turns() -> None:
    others = 0

    def go() -> None:
        nonlocal others
        others += 1
        asyncio.get_running_loop().call_soon(go)

    go()
    assert [number async for number in _in_turns(range(250))] == list(range(250))
    assert others >= 2


def test_who_is_connected_is_found_out_beside_the_loop(
    talk: Connect, monkeypatch: pytest.MonkeyPatch
) -> None:
    threads: list[str] = []
    who = NativeSession.who

    def noted(session: NativeSession) -> dict[str, Any]:
        threads.append(threading.current_thread().name)
        return who(session)

    monkeypatch.setattr(NativeSession, "who", noted)
    client = talk()
    connection = client.ask("Request", "echo")["connection"]
    (shown,) = client.ask("Status", "", {"clients": True})["clients"]
    assert shown["connections"] == [connection]
    assert threads == ["uoarm-serve-view"]


def test_what_waited_for_its_turn_is_done_after_the_close() -> None:
    gate = threading.Event()
    done: list[int] = []

    async def work() -> None:
        workers = Workers(1, 1, LoopMailbox(asyncio.get_running_loop()))
        first = workers.open(lambda: gate.wait(patience()))
        last = workers.open(lambda: done.append(1))
        workers.close()
        gate.set()
        await asyncio.wait_for(asyncio.gather(first, last), patience())

    asyncio.run(work())
    assert done == [1]
