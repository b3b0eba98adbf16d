"""The goals of all clients to one function, with feeds that the test ends."""

from __future__ import annotations

import asyncio
from types import SimpleNamespace
from typing import cast

from attrs import define, field
from components import CONFIGURATION

from uoarm import Connection
from uoarm.config import loads
from uoarm.model import Message, MessageStructure
from uoarm.server import Limits
from uoarm.server.front_end import (
    Account,
    Backend,
    Done,
    Envelope,
    Feed,
    FeedKey,
    Goal,
    InputSender,
    Listener,
    Read,
    StreamRunner,
)
from uoarm.testing import patience

OUTPUTS = ("status", "feedback", "result")
WALKER = loads(CONFIGURATION).functions["navigate"].components[0]


class Emitting:
    """A feed whose messages and end come from the test."""

    def __init__(self, connection: Connection) -> None:
        self.connection = connection
        self.listeners: list[Listener] = []
        self.end: tuple[str, str] | None = None

    def add(self, listener: Listener) -> None:
        self.listeners.append(listener)
        if self.end is not None:
            listener.ended(*self.end)

    def remove(self, listener: Listener) -> bool:
        if listener in self.listeners:
            self.listeners.remove(listener)
        return not self.listeners

    def take(self, message: Message) -> None:
        for listener in tuple(self.listeners):
            listener.offer(Envelope(1, message))

    def finish(self, state: str, cause: str) -> None:
        self.end = (state, cause)
        for listener in tuple(self.listeners):
            listener.ended(state, cause)


class Taking:
    """Hands goals over at once."""

    def structure(self, port: str | None) -> MessageStructure:
        return MessageStructure(schema=True)

    def send(self, message: Message, port: str | None, done: Done, octets: int) -> None:
        done(None)

    def close(self) -> None:
        """Nothing waits."""


@define
class Feeds:
    """A backend that has the feeds of one action."""

    feeds: dict[str, Emitting]
    limits: Limits = field(factory=Limits)

    async def join(self, wanted: FeedKey) -> Feed:
        return cast("Feed", self.feeds[wanted.name.partition(".")[2]])

    def leave(self, feed: Feed) -> None:
        """Take it back."""

    def open_account(self) -> Account:
        return cast("Account", SimpleNamespace(close=lambda: None))

    def sender(self, connection: Connection, account: Account, read: Read) -> InputSender:
        return cast("InputSender", Taking())


def opened() -> dict[str, Emitting]:
    """Return the feeds of an action whose function is open."""
    provider = SimpleNamespace(component=WALKER)
    connection = SimpleNamespace(plan=SimpleNamespace(provider=provider))
    return {name: Emitting(cast("Connection", connection)) for name in OUTPUTS}


async def turns() -> None:
    for _ in range(10):
        await asyncio.sleep(0)


def test_what_came_early_is_forgotten_with_the_provider_that_sent_it() -> None:
    async def work() -> None:
        backend = Feeds(opened())
        runner = StreamRunner("walk", cast("Backend", backend))
        received: list[object] = []
        for feedback in ("before", "after"):
            runner.start(Goal({}, received.append, lambda *_: None, lambda _: None))
            await turns()
            backend.feeds["feedback"].take({"goal_id": "1", "feedback": feedback})
            await turns()
            if feedback == "before":
                backend.feeds["status"].finish("failed", "gone")
                backend.feeds = opened()
        backend.feeds["status"].take({"goal_id": "1", "status": "accepted"})
        await turns()
        assert received == ["after"]

    asyncio.run(asyncio.wait_for(work(), patience()))


def test_an_action_that_ended_while_it_opened_is_let_go_whole() -> None:
    async def work() -> None:
        feeds = opened()
        feeds["status"].finish("failed", "gone")
        failed = asyncio.Event()
        runner = StreamRunner("walk", cast("Backend", Feeds(feeds)))
        goal = Goal({}, lambda _: None, lambda *_: None, lambda _: failed.set())
        runner.start(goal)
        await failed.wait()
        await asyncio.sleep(0)
        assert not [name for name, feed in feeds.items() if feed.listeners]

    asyncio.run(asyncio.wait_for(work(), patience()))
