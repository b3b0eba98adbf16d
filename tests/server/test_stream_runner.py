"""The goals of all clients to one function, with feeds that the test ends."""

from __future__ import annotations

import asyncio
from types import SimpleNamespace
from typing import cast

from attrs import define, field
from tests.server.robot import CONFIGURATION

from uoarm.config import loads
from uoarm.manager import Connection
from uoarm.server import Limits
from uoarm.server._desk import Desk, Wanted
from uoarm.server._feed import Feed
from uoarm.server._hop import Hop
from uoarm.server.rosbridge._goal import Goal
from uoarm.server.rosbridge._stream_runner import StreamRunner

OUTPUTS = ("status", "feedback", "result")
WALKER = loads(CONFIGURATION).functions["navigate"].components[0]


@define
class Feeds:
    """A desk that has the feeds of one action."""

    feeds: dict[str, Feed]
    limits: Limits = field(factory=Limits)
    workers: None = None

    async def join(self, wanted: Wanted) -> Feed:
        return self.feeds[wanted.name.partition(".")[2]]

    def leave(self, feed: Feed) -> None:
        """Take it back."""


def test_an_action_that_ended_while_it_opened_is_let_go_whole() -> None:
    async def work() -> None:
        hop = Hop(asyncio.get_running_loop())
        feeds = {name: Feed(hop, 8) for name in OUTPUTS}
        for feed in feeds.values():
            plan = SimpleNamespace(provider=SimpleNamespace(component=WALKER))
            feed.connection = cast("Connection", SimpleNamespace(plan=plan))
        feeds["status"].finish("failed", "gone")
        failed = asyncio.Event()
        runner = StreamRunner("walk", cast("Desk", Feeds(feeds)))
        goal = Goal({}, lambda _: None, lambda *_: None, lambda _: failed.set())
        runner.start(goal)
        await failed.wait()
        await asyncio.sleep(0)
        listening = [name for name, feed in feeds.items() if not feed.remove(_NOBODY)]
        assert listening == []

    asyncio.run(asyncio.wait_for(work(), 5))


class _Nobody:
    """A listener that no feed has."""

    def offer(self, parcel: object) -> None:
        """Take nothing."""

    def refuse(self, parcel: object, error: Exception) -> None:
        """Take nothing."""

    def ended(self, state: str, cause: str) -> None:
        """Take nothing."""


_NOBODY = _Nobody()
