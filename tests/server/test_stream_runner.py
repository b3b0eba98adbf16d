"""The goals of all clients to one function, with feeds that the test ends."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from types import SimpleNamespace
from typing import TypeVar, cast

from attrs import define, field
from tests.server.robot import CONFIGURATION

from uoarm._control import Connection
from uoarm.config import loads
from uoarm.model import MessageStructure
from uoarm.server import Limits
from uoarm.server._desk import Desk, Wanted
from uoarm.server._feed import Feed
from uoarm.server._hop import Hop
from uoarm.server._memory import Memory
from uoarm.server.rosbridge._goal import Goal
from uoarm.server.rosbridge._stream_runner import StreamRunner

OUTPUTS = ("status", "feedback", "result")
WALKER = loads(CONFIGURATION).functions["navigate"].components[0]
T = TypeVar("T")


class Workers:
    """Work that is done at once."""

    def start(self, action: Callable[[], T], *, always: bool = False) -> asyncio.Future[T]:
        del always
        done: asyncio.Future[T] = asyncio.get_running_loop().create_future()
        done.set_result(action())
        return done


@define
class Feeds:
    """A desk that has the feeds of one action."""

    feeds: dict[str, Feed]
    limits: Limits = field(factory=Limits)
    workers: Workers = field(factory=Workers)
    memory: Memory = field(factory=lambda: Memory(10**6, 10**6))

    async def join(self, wanted: Wanted) -> Feed:
        return self.feeds[wanted.name.partition(".")[2]]

    def leave(self, feed: Feed) -> None:
        """Take it back."""


def opened() -> dict[str, Feed]:
    """Return the feeds of an action whose function is open."""
    hop = Hop(asyncio.get_running_loop())
    feeds = {name: Feed(hop, 8) for name in OUTPUTS}
    structures = {"input.goal": MessageStructure(schema=True)}
    provider = SimpleNamespace(component=WALKER, structures=structures)
    connection = SimpleNamespace(
        id="c1", plan=SimpleNamespace(provider=provider), send=lambda *_: None
    )
    for feed in feeds.values():
        feed.connection = cast("Connection", connection)
    return feeds


async def turns() -> None:
    for _ in range(10):
        await asyncio.sleep(0)


def test_what_came_early_is_forgotten_with_the_provider_that_sent_it() -> None:
    async def work() -> None:
        desk = Feeds(opened())
        runner = StreamRunner("walk", cast("Desk", desk))
        heard: list[object] = []
        for feedback in ("before", "after"):
            runner.start(Goal({}, heard.append, lambda *_: None, lambda _: None))
            await turns()
            desk.feeds["feedback"].take({"goal_id": "1", "feedback": feedback})
            await turns()
            if feedback == "before":
                desk.feeds["status"].finish("failed", "gone")
                desk.feeds = opened()
        desk.feeds["status"].take({"goal_id": "1", "status": "accepted"})
        await turns()
        assert heard == ["after"]

    asyncio.run(asyncio.wait_for(work(), 5))


def test_an_action_that_ended_while_it_opened_is_let_go_whole() -> None:
    async def work() -> None:
        feeds = opened()
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
