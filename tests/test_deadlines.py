"""Waiting with a deadline loses neither results nor cancellations."""

from __future__ import annotations

import ast
import asyncio
import time
from pathlib import Path

import pytest

import uoarm
from uoarm._support import deadlines
from uoarm._support.aio_deadlines import result_within


async def test_a_result_in_time_an_error_and_a_late_one() -> None:
    async def fail() -> None:
        raise ValueError("no")

    assert await result_within(20, asyncio.sleep(0, "done")) == "done"
    with pytest.raises(ValueError, match="no"):
        await result_within(20, fail())
    never = asyncio.get_running_loop().create_future()
    with pytest.raises(asyncio.TimeoutError):
        await result_within(0.001, never)
    assert never.cancelled()


@pytest.mark.parametrize("turns", range(6))
async def test_a_cancellation_at_the_moment_of_the_result_is_not_lost(turns: int) -> None:
    """Whatever turn of the loop it comes in: before, with or after the result."""

    future: asyncio.Future[str] = asyncio.get_running_loop().create_future()
    waiting = asyncio.ensure_future(result_within(20, future))
    await asyncio.sleep(0)
    await asyncio.sleep(0)
    future.set_result("done")
    for _ in range(turns):
        await asyncio.sleep(0)
    was_pending = waiting.cancel()
    await asyncio.wait({waiting})
    assert waiting.cancelled() == was_pending


async def test_a_cancelled_waiter_cancels_what_it_waits_for() -> None:
    future: asyncio.Future[str] = asyncio.get_running_loop().create_future()
    waiting = asyncio.ensure_future(result_within(20, future))
    await asyncio.sleep(0)
    waiting.cancel()
    await asyncio.wait({waiting})
    assert waiting.cancelled()
    assert future.cancelled()


def test_an_inner_step_that_ends_in_its_grace_does_not_have_the_outer_one_given_up() -> None:
    job = deadlines._Job("outer", 60.0, lambda: "done", None, None, 0.0)
    outer = job.deadline, job.grace

    class Waited:
        """The end of the outer step, for which the third look waits long enough."""

        looks = 0

        def acquire(self, *, timeout: float) -> bool:
            del timeout
            self.looks += 1
            if self.looks == 1:
                job.deadline, job.grace = time.monotonic(), 60.0
            elif self.looks == 2:
                job.deadline, job.grace = outer
            return self.looks == 3

    job.work()
    job._finished = Waited()  # type: ignore[assignment]
    job._is_over = False
    job._wait()  # raises nothing
    assert job._result == "done"
    assert not job.given_up


def test_nothing_uses_wait_for() -> None:
    """It loses cancellations before CPython 3.12."""
    uses = [
        f"{path.name}:{node.lineno}"
        for path in Path(uoarm.__file__).parent.rglob("*.py")
        if "wait_for" in (source := path.read_text(encoding="utf-8"))
        for node in ast.walk(ast.parse(source))
        if isinstance(node, ast.Attribute)
        and node.attr == "wait_for"
        and isinstance(node.value, ast.Name)
        and node.value.id == "asyncio"
    ]
    assert not uses
