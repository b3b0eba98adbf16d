"""The way from other threads into the server's loop."""

from __future__ import annotations

import asyncio
import logging
from typing import NoReturn

import pytest

from uoarm.server.streams._loop_mailbox import LoopMailbox


def test_an_action_that_fails_holds_up_none_after_it(caplog: pytest.LogCaptureFixture) -> None:
    def fail() -> NoReturn:
        raise ValueError("a mistake of ours")

    async def work() -> None:
        hop, done = LoopMailbox(asyncio.get_running_loop()), asyncio.Event()
        hop.put(fail)
        hop.put(done.set)
        await done.wait()

    with caplog.at_level(logging.ERROR, "uoarm.server"):
        asyncio.run(asyncio.wait_for(work(), 5))
    assert "a mistake of ours" in caplog.text
