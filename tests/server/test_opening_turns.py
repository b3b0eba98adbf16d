"""Openings side by side: many that wait, few that compute, and no more of either than allowed."""

from __future__ import annotations

import asyncio
import threading

from uoarm.server.streams._workers import LoopMailbox, OpeningTurns, Workers
from uoarm.testing import patience

LIMIT = 8
LOOK = OpeningTurns.look_seconds


def begin_all(turns: OpeningTurns, now: float, first: int) -> int:
    """Begin what may begin at a time; returns how many it were."""
    count = 0
    while turns.may_begin:
        turns.begin(first + count, now)
        count += 1
    return count


def test_few_begin_at_once_and_the_next_as_one_ends() -> None:
    turns = OpeningTurns(LIMIT)
    assert begin_all(turns, 0.0, 0) == 2
    turns.end(0)
    assert begin_all(turns, 0.001, 2) == 1


def test_those_that_wait_make_room_up_to_the_limit() -> None:
    turns = OpeningTurns(LIMIT)
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
    turns = OpeningTurns(LIMIT)
    begin_all(turns, 0.0, 0)
    turns.look(LOOK, LOOK + 1.0)
    assert not turns.may_begin
    turns.look(1.0 + 2 * LOOK, 1.0 + 2 * LOOK)
    assert turns.may_begin


def test_one_that_began_just_now_is_not_taken_for_waiting() -> None:
    turns = OpeningTurns(LIMIT)
    turns.begin("old", 0.0)
    turns.begin("new", 0.9 * LOOK)
    turns.look(LOOK, LOOK)
    assert begin_all(turns, LOOK, 1) == 1


async def test_what_hangs_keeps_nothing_behind_it_waiting() -> None:
    gate = threading.Event()

    workers = Workers(1, LIMIT, LoopMailbox(asyncio.get_running_loop()))
    hanging = [workers.open(lambda: gate.wait(patience())) for _ in range(LIMIT - 1)]
    assert await asyncio.wait_for(workers.open(lambda: "opened"), patience()) == "opened"
    assert workers.busy == LIMIT - 1
    gate.set()
    assert all(await asyncio.wait_for(asyncio.gather(*hanging), patience()))
    workers.close()


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
