"""What is open at the other manager: what comes before it is known that it fits."""

from __future__ import annotations

import asyncio
import threading
from concurrent.futures import Future
from typing import Any

import pytest
from robots import ServedRobot
from tests.processes import signal_beside  # type: ignore[import-not-found]
from uoarm_remote import _channels
from uoarm_remote._channels import FunctionStreams, _Stream
from uoarm_remote._link import ManagerLink
from uoarm_remote._options import ManagerOptions

from uoarm.client import RemoteStream
from uoarm.model import QueuePolicy
from uoarm.testing import patience

KEPT = 1024
OPENED = {"connection": "c1", "inputs": [], "warnings": [], "number": 0}


async def nothing(*_: object, **__: object) -> Any:
    raise AssertionError("nothing is asked here")


def test_what_has_no_room_until_the_proof_is_counted() -> None:
    async def prove() -> None:
        await asyncio.Event().wait()

    async def play() -> None:
        link = ManagerLink("robot3", ManagerOptions(), str, lambda *_: None)
        streams, shared = FunctionStreams(link), _Stream()
        stream: RemoteStream = RemoteStream(OPENED, {}, nothing, nothing, QueuePolicy(KEPT))
        stream.hand_over(lambda message: shared.hand_on(stream, message), str)
        for session in range(2):
            stream.renew(OPENED)
            streams._begin_to_prove(shared, stream, prove)
            assert stream.lost == session * (KEPT + 6)
            for number in range(1, KEPT + 7):
                stream.take(number, number)
            assert stream.lost == session * (KEPT + 6) + 6
            assert shared.unproven is not None
            assert list(shared.unproven) == list(range(7, KEPT + 7))
        link.close()

    asyncio.run(play())


def test_a_signal_that_came_in_another_thread_is_handled_while_an_answer_is_awaited(
    robot: ServedRobot,
) -> None:
    link = ManagerLink("robot3", ManagerOptions(robot.url), str, lambda *_: None)
    link.require(patience())
    answer: Future[str] = Future()

    async def ask(_: object) -> str:
        return await asyncio.wrap_future(answer)

    places = threading.Condition.wait, ManagerLink.run
    with signal_beside(lambda: answer.set_result("handled"), *places):
        assert link.run(ask, patience(), "nothing") == "handled"
    link.close()


@pytest.mark.parametrize("latched", [False, True])
def test_what_waits_for_the_proof_or_for_who_joins_has_a_bound_of_memory(
    latched: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(_channels, "_HELD_OCTETS", 2_500)
    shared, stream = (
        _Stream(),
        RemoteStream({**OPENED, "latched": latched}, {}, nothing, nothing, QueuePolicy(KEPT)),
    )
    kept = shared.standing
    if not latched:
        kept = shared.unproven = _channels._NewestMessages(KEPT)
    for number in range(5):
        shared.hand_on(stream, bytes([number]) * 1_000)
    assert [bytes(message)[0] for message in kept] == [3, 4]
    assert stream.lost == (0 if latched else 3)
    shared.hand_on(stream, bytes([5]) * 10_000)
    assert [bytes(message)[0] for message in kept] == [5]
