"""Components that raise what is no `Exception`, in this process and in a host."""

from __future__ import annotations

import asyncio
import os
import sys
import time
from collections.abc import AsyncIterator, Iterator
from pathlib import Path


class Own(BaseException):
    """A kind of a component's own."""


def quit_with(kind: str) -> None:
    if kind == "exit":
        sys.exit(3)
    raise {
        "cancelled": asyncio.CancelledError,
        "generator": GeneratorExit,
        "interrupt": KeyboardInterrupt,
        "own": Own,
    }[kind]("it quits")


def ticks() -> Iterator[int]:
    number = 0
    while True:
        yield number
        number += 1
        time.sleep(0.02)


def same(value: int) -> int:
    return value


def step(value: int, *, kind: str) -> int:
    quit_with(kind)
    return value


async def async_step(value: int, *, kind: str) -> int:
    await asyncio.sleep(0)
    quit_with(kind)
    return value


def steps(value: int, *, kind: str) -> Iterator[int]:
    quit_with(kind)
    yield value


def wrong(value: int) -> int:
    return f"{value}"  # type: ignore[return-value]


def wrongs() -> Iterator[int]:
    for value in ticks():
        yield f"{value}"  # type: ignore[misc]


class Built:
    def __init__(self, *, kind: str) -> None:
        quit_with(kind)

    def __call__(self, value: int) -> int:
        return value


class Closed:
    def __init__(self, *, kind: str) -> None:
        self.kind = kind

    def __call__(self, value: int) -> int:
        return value

    def close(self) -> None:
        quit_with(self.kind)


def source(*, kind: str, when: str) -> Iterator[int]:
    while not Path(when).exists():
        yield 1
        time.sleep(0.02)
    quit_with(kind)


async def async_source(*, kind: str, when: str) -> AsyncIterator[int]:
    while not os.path.exists(when):  # noqa: ASYNC240 - in a test's own loop
        yield 1
        await asyncio.sleep(0.02)
    quit_with(kind)


async def parent(value: int, *, kind: str) -> int:
    """Leave a task behind that quits, in the loop that is everyone's."""

    async def child() -> None:
        quit_with(kind)

    asyncio.get_running_loop().create_task(child())
    await asyncio.sleep(0)
    return value
