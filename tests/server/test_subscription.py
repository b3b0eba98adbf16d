"""What hands a feed's messages to a client: its rate, what it holds, and a feed that ends."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Iterator
from typing import Any

import pytest

from uoarm.errors import MessageError
from uoarm.server import Limits
from uoarm.server.streams import (
    Account,
    Feed,
    FeedKey,
    MessageForm,
    Outbox,
    Subscription,
    Throttle,
    _subscription,
)
from uoarm.server.streams._feed import Encoder
from uoarm.server.streams._memory import MemoryUse, ServerMemory
from uoarm.server.streams._workers import LoopMailbox
from uoarm.testing import ManualClock

LONG = 3600.0


class Reader:
    """A client, with what it can have, and the feeds that it joins."""

    def __init__(self) -> None:
        self.memory = ServerMemory(10**9, 10**9)
        self.account: Account = self.memory.open()
        self.limits = Limits()
        self.outbox = Outbox(10**6, 10, self.account)
        self.encoder = Encoder()
        self.joined: list[Feed] = []
        self.left: list[Feed] = []
        self.has_joined = asyncio.Event()

    async def join(self, wanted: FeedKey, on_absent: Callable[[str], None] | None = None) -> Feed:
        assert on_absent is not None
        on_absent(f"{wanted.name} is not there")
        self.joined.append(self.feed())
        self.has_joined.set()
        return self.joined[-1]

    def leave(self, feed: Feed) -> None:
        self.left.append(feed)

    def feed(self) -> Feed:
        return Feed(LoopMailbox(asyncio.get_running_loop()), self.limits, self.encoder)

    async def frames(self, count: int) -> list[bytes]:
        frames: list[bytes] = []
        while len(frames) < count:
            frames += [frame for frame, _ in await self.outbox.next()]
        assert self.outbox.empty
        return frames


@pytest.fixture
def reader() -> Iterator[Reader]:
    reader = Reader()
    yield reader
    reader.encoder.close()


def write(number: int, message: object) -> bytes:
    return f"{number} {message}".encode()


def subscription(
    reader: Reader,
    clock: ManualClock,
    throttle: Throttle | None = None,
    *,
    text: bool = True,
    **options: Any,
) -> Subscription:
    options = {"on_refused": pytest.fail, "on_end": pytest.fail, **options}
    form = MessageForm("test", write, text=text)
    return Subscription(reader, form, throttle=throttle, clock=clock, **options)


def _fail(error: BaseException) -> None:
    pytest.fail(str(error))


async def test_the_newest_are_held_and_go_first_when_the_rate_is_lifted(reader: Reader) -> None:
    made = subscription(reader, ManualClock(), Throttle(LONG, is_even=False))
    made.set_rate(LONG, 2)
    feed = reader.feed()
    made.begin(feed)
    for message in "abcd":
        feed.take(message)
    assert await reader.frames(1) == [b"1 a"]
    # `a` may be written before `d` has come this far, of which nothing gives notice.
    while (made.skipped, len(reader.account.charges)) != (1, 4):  # noqa: ASYNC110
        await asyncio.sleep(0)
    assert reader.memory.kinds[MemoryUse.THROTTLED] > 0
    made.set_rate(0.0, 2)
    feed.take("e")
    assert await reader.frames(2) == [b"4 d", b"5 e"]
    assert made.skipped == 2
    assert reader.memory.kinds[MemoryUse.THROTTLED] == 0
    made.close()


@pytest.mark.parametrize("is_even", [True, False], ids=["waiting", "held"])
async def test_the_end_goes_after_all_that_waits_or_is_held(reader: Reader, is_even: bool) -> None:
    throttle = None if is_even else Throttle(LONG, is_even=False)

    def end(state: str, cause: str) -> None:
        made.finish(f"{state} {cause}".encode())

    made = subscription(reader, ManualClock(), throttle, text=False, on_end=end)
    if not is_even:
        made.set_rate(LONG, 10)
    feed = reader.feed()
    made.begin(feed)
    for message in "abc":
        feed.take(message)
    feed.finish("finished", "by itself")
    frames: list[tuple[bytes, bool]] = []
    while not reader.outbox.empty:
        frames += await reader.outbox.next()
    messages = [(b"1 a", False), (b"2 b", False), (b"3 c", False)]
    assert frames == [*messages, (b"finished by itself", True)]
    assert reader.memory.kinds[MemoryUse.THROTTLED] == 0


async def test_a_higher_rate_counts_from_now_and_not_from_when_the_next_was_due(
    reader: Reader,
) -> None:
    clock = ManualClock()
    made = subscription(reader, clock, Throttle(LONG, is_even=False))
    feed = reader.feed()
    made.begin(feed)
    feed.take("a")
    assert await reader.frames(1) == [b"1 a"]
    made.set_rate(0.1, 0)
    clock.advance(0.2)
    feed.take("b")
    assert await reader.frames(1) == [b"2 b"]


async def test_a_feed_whose_provider_failed_is_joined_again_until_it_is_killed(
    reader: Reader,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(_subscription, "_AGAIN_SECONDS", 0.0)

    texts: list[str] = []
    ends: list[tuple[str, str]] = []
    made = subscription(reader, ManualClock(), on_end=lambda *end: ends.append(end))
    made.follow(reader, FeedKey("f"), on_waiting=texts.append, on_failed=_fail)
    for number in (1, 2):
        await reader.has_joined.wait()
        reader.has_joined.clear()
        feed = reader.joined[-1]
        feed.take("a")
        assert await reader.frames(1) == [b"1 a"]
        feed.finish("failed" if number == 1 else "closed", "broken")
    assert reader.left == reader.joined
    assert (len(reader.joined), ends, made.feed) == (2, [("closed", "broken")], None)
    waits = "unavailable: f is not there; it is waited for"
    assert texts == [waits, "has failed: broken; it is waited for", waits]


async def test_a_feed_that_is_refused_when_it_opens_is_given_back(reader: Reader) -> None:
    failed: asyncio.Future[BaseException] = asyncio.get_running_loop().create_future()

    def refuse(feed: Feed) -> None:
        raise MessageError(f"{feed.number} messages of another type")

    made = subscription(reader, ManualClock())
    made.follow(
        reader,
        FeedKey("f"),
        on_open=refuse,
        on_waiting=lambda _: None,
        on_failed=failed.set_result,
    )
    assert str(await failed) == "0 messages of another type"
    assert reader.left == reader.joined


async def test_one_that_is_closed_while_its_feed_opens_joins_nothing(reader: Reader) -> None:
    made = subscription(reader, ManualClock())
    made.follow(reader, FeedKey("f"), on_waiting=pytest.fail, on_failed=_fail)
    made.close()
    for _ in range(5):
        await asyncio.sleep(0)
    assert reader.joined == []
