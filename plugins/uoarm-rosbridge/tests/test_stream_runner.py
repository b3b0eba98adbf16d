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

    def __init__(self, sent: list[tuple[str | None, Message]]) -> None:
        self._sent = sent

    def structure(self, port: str | None) -> MessageStructure:
        return MessageStructure(schema=True)

    def send(
        self,
        message: Message,
        port: str | None,
        done: Done,
        octets: int,
        *,
        ends_motion: bool = False,
    ) -> None:
        assert ends_motion is (port == "cancel")
        self._sent.append((port, message.arguments if isinstance(message, Goal) else message))
        done(None)

    def close(self) -> None:
        """Nothing waits."""


@define
class Feeds:
    """A backend that has the feeds of one action."""

    feeds: dict[str, Emitting]
    limits: Limits = field(factory=Limits)
    sent: list[tuple[str | None, Message]] = field(factory=list)

    async def join(self, wanted: FeedKey) -> Feed:
        return cast("Feed", self.feeds[wanted.name.partition(".")[2]])

    def leave(self, feed: Feed) -> None:
        """Take it back."""

    def open_account(self) -> Account:
        return cast("Account", SimpleNamespace(close=lambda: None))

    def sender(self, connection: Connection, account: Account, read: Read) -> InputSender:
        return cast("InputSender", Taking(self.sent))


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


def test_a_goal_that_is_accepted_too_late_is_cancelled_and_no_one_elses() -> None:
    async def work() -> None:
        backend = Feeds(opened(), Limits(request_seconds=0.01))
        runner = StreamRunner("walk", cast("Backend", backend))
        failed, ended = asyncio.Event(), []

        def too_late(error: BaseException) -> None:
            backend.limits = Limits(request_seconds=patience())  # the answer comes within these
            ended.append(str(error))
            failed.set()

        runner.start(Goal("late", ended.append, lambda *_: None, too_late))
        runner.start(Goal("next", ended.append, lambda *_: None, lambda _: None))
        await failed.wait()
        assert ended == ["'walk' has not answered the goal in time"]
        assert backend.sent == [("goal", "late")]
        backend.feeds["status"].take({"goal_id": "1", "status": "accepted"})
        assert backend.sent[1:] == [("cancel", {"goal_id": "1"}), ("goal", "next")]
        backend.feeds["status"].take({"goal_id": "2", "status": "accepted"})
        backend.feeds["feedback"].take({"goal_id": "1", "feedback": "of the late one"})
        backend.feeds["feedback"].take({"goal_id": "2", "feedback": "of the next"})
        assert ended[1:] == ["of the next"]

    asyncio.run(asyncio.wait_for(work(), patience()))


def test_a_goal_that_is_never_answered_holds_up_the_next_for_a_while_only() -> None:
    async def work() -> None:
        backend = Feeds(opened(), Limits(request_seconds=0.01))
        runner = StreamRunner("walk", cast("Backend", backend))
        for name in ("never", "next"):
            runner.start(Goal(name, lambda _: None, lambda *_: None, lambda _: None))
        while len(backend.sent) < 2:  # noqa: ASYNC110 - of the runner's own timers
            await asyncio.sleep(0.001)
        assert backend.sent == [("goal", "never"), ("goal", "next")]

    asyncio.run(asyncio.wait_for(work(), patience()))


def test_a_goal_after_the_end_that_a_late_one_brought_is_not_cancelled() -> None:
    async def work() -> None:
        backend = Feeds(opened(), Limits(request_seconds=0.01))
        runner = StreamRunner("walk", cast("Backend", backend))
        failed = asyncio.Event()

        def end_all(_: BaseException) -> None:
            feeds, backend.feeds = backend.feeds, opened()
            backend.limits = Limits(request_seconds=patience())
            feeds["status"].finish("failed", "its client ended it")
            failed.set()

        runner.start(Goal("late", lambda _: None, lambda *_: None, end_all))
        await failed.wait()
        runner.start(Goal("next", lambda _: None, lambda *_: None, lambda _: None))
        await turns()
        backend.feeds["status"].take({"goal_id": "2", "status": "accepted"})
        assert backend.sent == [("goal", "late"), ("goal", "next")]

    asyncio.run(asyncio.wait_for(work(), patience()))
