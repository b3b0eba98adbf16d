"""The way from other threads into the server's loop."""

from __future__ import annotations

import asyncio
import gc
import logging
import os
import threading
import weakref
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from typing import NoReturn

import pytest

from uoarm.server.streams._workers import LoopMailbox
from uoarm.testing import patience


def test_an_action_that_fails_holds_up_none_after_it(caplog: pytest.LogCaptureFixture) -> None:
    def fail() -> NoReturn:
        raise ValueError("a mistake of ours")

    async def work() -> None:
        hop, done = LoopMailbox(asyncio.get_running_loop()), asyncio.Event()
        hop.put(fail)
        hop.put(done.set)
        await done.wait()

    with caplog.at_level(logging.ERROR, "uoarm.server"):
        asyncio.run(asyncio.wait_for(work(), patience()))
    assert "a mistake of ours" in caplog.text


def test_what_is_to_be_done_soon_is_done_after_all_that_came(
    caplog: pytest.LogCaptureFixture,
) -> None:
    """In the same turn of the loop, whatever fails."""

    async def work() -> None:
        mailbox, done = LoopMailbox(asyncio.get_running_loop()), list[str]()
        ended = asyncio.Event()

        def first() -> None:
            mailbox.soon(fail)
            mailbox.soon(lambda: done.append("soon"))
            asyncio.get_running_loop().call_soon(ended.set)
            done.append("first")

        def fail() -> NoReturn:
            raise ValueError("a mistake of ours")

        mailbox.put(first)
        mailbox.put(lambda: done.append("second"))
        await ended.wait()
        assert done == ["first", "second", "soon"]
        mailbox.soon(done.clear)
        assert done
        await asyncio.sleep(0)
        assert not done

    with caplog.at_level(logging.ERROR, "uoarm.server"):
        asyncio.run(asyncio.wait_for(work(), patience()))
    assert "a mistake of ours" in caplog.text


def test_after_the_end_of_the_loop_nothing_is_kept() -> None:
    loop = asyncio.new_event_loop()
    mailbox = LoopMailbox(loop)
    loop.close()
    kept: list[weakref.ref[object]] = []
    for _ in range(3):

        def action() -> None:
            pass

        kept.append(weakref.ref(action))
        mailbox.put(action)
        del action
    assert [reference_type() for reference_type in kept] == [None] * 3


def test_what_many_threads_put_runs_in_the_order_of_each() -> None:
    threads, each = 4, 500
    ran: dict[int, list[int]] = {number: [] for number in range(threads)}

    async def work() -> None:
        mailbox, ended = LoopMailbox(asyncio.get_running_loop()), asyncio.Event()
        all_begin = threading.Barrier(threads)

        def put(number: int) -> None:
            all_begin.wait(patience())
            for count in range(each):
                mailbox.put(partial(ran[number].append, count))

        with ThreadPoolExecutor(threads) as pool:
            loop = asyncio.get_running_loop()
            await asyncio.gather(
                *(loop.run_in_executor(pool, put, number) for number in range(threads))
            )
            mailbox.put(ended.set)
            await ended.wait()

    asyncio.run(asyncio.wait_for(work(), patience()))
    assert ran == {number: list(range(each)) for number in range(threads)}


@pytest.mark.skipif(not hasattr(os, "eventfd"), reason="the kernel has no such events")
def test_what_wakes_the_loop_is_closed_with_it_or_before() -> None:
    def event_of(mailbox: LoopMailbox) -> int:
        assert mailbox._event is not None, "it is asyncio's loop"
        os.fstat(mailbox._event)
        return mailbox._event

    def is_closed(event: int) -> bool:
        gc.collect()
        try:
            os.fstat(event)
        except OSError:
            return True
        return False

    async def work() -> None:
        mailbox, done = LoopMailbox(asyncio.get_running_loop()), asyncio.Event()
        event = event_of(mailbox)
        begun = threading.Thread(target=mailbox.put, args=(done.set,))
        begun.start()
        begun.join()
        mailbox.close()  # what was put before is done all the same
        await done.wait()
        done.clear()
        mailbox.put(done.set)
        await done.wait()
        del mailbox
        await asyncio.sleep(0)
        assert is_closed(event)

    asyncio.run(asyncio.wait_for(work(), patience()))
    loop = asyncio.new_event_loop()
    left_open = LoopMailbox(loop)
    event = event_of(left_open)
    loop.close()
    del left_open, loop
    assert is_closed(event)
