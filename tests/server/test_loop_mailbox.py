"""The way from other threads into the server's loop."""

from __future__ import annotations

import asyncio
import logging
import weakref
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
