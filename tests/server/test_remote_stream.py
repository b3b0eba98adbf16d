"""Reading a function of a robot elsewhere: time limits and cancellation."""

from __future__ import annotations

import asyncio
from typing import Any

import pytest

from uoarm.client._stream import RemoteStream
from uoarm.model import OverflowPolicy, QueuePolicy
from uoarm.testing import patience


async def _never(*_: object, **__: object) -> Any:
    raise AssertionError("nothing is asked here")


async def _diagnose(connection: str) -> tuple[str, ...]:
    return (f"nothing feeds {connection}", "it waits")


def _stream() -> RemoteStream:
    opened = {"connection": "c1", "inputs": [], "warnings": []}
    return RemoteStream(opened, {}, _never, _diagnose, QueuePolicy(8))


async def test_nothing_in_time_is_a_timeout() -> None:
    stream = _stream()
    text = r"^no message within 0\.01 s; nothing feeds c1; it waits$"
    with pytest.raises(TimeoutError, match=text):
        await stream.get(0.01)
    assert stream.trouble == ("nothing feeds c1", "it waits")
    stream.take(1, 5)
    assert await stream.get(0.01) == 5
    assert not stream.trouble


def test_what_comes_while_it_is_asked_why_nothing_came_is_given() -> None:
    async def play() -> object:
        async def diagnose(_: str) -> tuple[str, ...]:
            stream.take(1, 5)
            return ("nothing came",)

        stream = RemoteStream(
            {"connection": "c1", "inputs": [], "warnings": []}, {}, _never, diagnose, QueuePolicy(8)
        )
        return await stream.get(0.01)

    assert asyncio.run(play()) == 5


def test_what_is_there_needs_no_time() -> None:
    async def play() -> object:
        stream = _stream()
        stream.take(1, 5)
        return await stream.get(0)

    assert asyncio.run(play()) == 5


@pytest.mark.parametrize("turns", range(6))
async def test_a_cancellation_is_never_lost_and_takes_no_message_with_it(turns: int) -> None:
    stream = _stream()
    reading = asyncio.ensure_future(stream.get(patience()))
    await asyncio.sleep(0)
    stream.take(1, 5)
    for _ in range(turns):
        await asyncio.sleep(0)
    asked = reading.cancel()
    await asyncio.wait({reading})
    assert reading.cancelled() is asked
    assert (await stream.get(patience()) if asked else reading.result()) == 5


@pytest.mark.parametrize(
    ("queue", "left"),
    [
        (None, [3, 4, 5, 6, 7, 8, 9, 10]),
        (QueuePolicy(3), [8, 9, 10]),
        (QueuePolicy(policy=OverflowPolicy.LATEST), [10]),
        (QueuePolicy(100, octets=1), [10]),
    ],
)
async def test_what_the_application_does_not_read_is_bounded_and_counted(
    queue: QueuePolicy | None, left: list[int]
) -> None:
    stream = _stream()
    stream.take(1, 1)  # it may come before the caller has woken
    stream.give_as(None, queue)
    for number in range(2, 11):
        stream.take(number, number)
    assert [await stream.get(0) for _ in left] == left
    assert stream.lost == 10 - len(left)
