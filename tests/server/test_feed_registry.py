"""Feeds that clients share, as the server stops."""

from __future__ import annotations

import asyncio

import pytest

from uoarm import RobotManager
from uoarm.config import loads
from uoarm.server import Limits
from uoarm.server.streams import FeedKey, FeedRegistry


def test_a_client_that_waits_for_a_feed_as_the_server_stops_is_cancelled(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    async def play(robot: RobotManager) -> None:
        registry = FeedRegistry(robot, Limits())
        never = asyncio.Event()

        async def hang(*_: object) -> None:
            await never.wait()

        monkeypatch.setattr(registry, "_open", hang)
        waiting = asyncio.ensure_future(registry.join(FeedKey("camera", receive=False)))
        await asyncio.sleep(0)
        await registry.close()
        waiting.cancel()
        with pytest.raises(asyncio.CancelledError):
            await waiting
        never.set()
        await asyncio.sleep(0)

    with RobotManager(loads("version: 1\nbridges: {}\nfunctions: {}")) as robot:
        asyncio.run(play(robot))
