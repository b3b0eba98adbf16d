"""Long messages are written beside the loop, and every client still gets them in order."""

from __future__ import annotations

import asyncio
import json
import threading
from array import array
from types import SimpleNamespace
from typing import Any

import cbor2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from tests.structures import Quits

from uoarm._wire import BINARY_FORM, TEXT_FORM
from uoarm.model import Message
from uoarm.server import Limits
from uoarm.server.streams import Account, MessageForm, Outbox, Subscription
from uoarm.server.streams._feed import Encoder, Envelope, Feed, takes_long
from uoarm.server.streams._memory import ServerMemory
from uoarm.server.streams._workers import LoopMailbox
from uoarm.testing import patience

LONG = [0.5] * 5_000
LOST = object()
"""A long message without a form; `takes_long` knows it by its list."""


class Tagged(bytes):
    """Octets of a class of their own, as libraries have them."""


@pytest.mark.parametrize(
    ("message", "expected"),
    [
        ({"a": 1, "b": [1.0, 2.0]}, False),
        (LONG, True),
        ([[1] * 2_000] * 3, True),
        ({"a": {"b": {"c": {"d": LONG}}}}, True),
        ("x" * 900_000, False),
        ("x" * 2_000_000, True),
        ({"data": bytes(900_000)}, False),
        ({"data": np.zeros(900_000, np.uint8)}, False),
        ({"data": np.zeros((640, 480, 3), np.uint8)}, True),  # no octets: numbers, in JSON
        (array("d", [0.0] * 5_000), True),
        (np.zeros(5_000), True),
        (np.float64(1), False),
        (object(), False),
        ({"data": Tagged(b"ab")}, False),
        ({"data": SimpleNamespace(size=(640, 480))}, True),  # as a picture of Pillow has it
        (Quits(SystemExit), True),
    ],
)
def test_what_takes_long_is_known_beforehand(message: Message, *, expected: bool) -> None:
    assert takes_long(message) is expected


class Reader(Subscription):
    """A subscription that takes down what it is handed, and in which thread that was written."""

    def __init__(self) -> None:
        self.account: Account = ServerMemory(10**9, 10**9).open()
        self.limits = Limits()
        self.outbox = Outbox(10**6, 10, self.account)
        self.took: list[int | str] = []
        self.threads: list[threading.Thread] = []
        form = MessageForm("one form", self._write_number, text=True, frames=self._take)
        super().__init__(self, form, on_refused=lambda _: None, on_end=self._ended)

    def offer(self, envelope: Envelope) -> None:
        lost = self.lane.dropped
        super().offer(envelope)
        if self.lane.dropped > lost:
            self.took.append(envelope.number)

    def _write_number(self, number: int, message: Message) -> bytes:
        self.threads.append(threading.current_thread())
        if isinstance(message, list) and message[-1] is LOST:
            raise SystemExit("it has no form")
        return str(number).encode()

    def _take(self, frame: bytes, number: int) -> list[bytes]:
        assert int(frame) == number
        self.took.append(number)
        return []

    def _ended(self, state: str, cause: str) -> None:
        self.took.append(f"{state} {cause}")


MESSAGES = {"short": 1, "long": LONG, "lost": [*LONG, LOST]}
STEPS = st.lists(
    st.sampled_from([*MESSAGES, "turn", "add", "remove"]).map(str), min_size=1, max_size=30
)


@given(STEPS)
def test_every_listener_gets_every_message_in_order_and_the_end_last(steps: list[str]) -> None:
    async def run() -> None:
        encoder = Encoder()
        feed = Feed(LoopMailbox(asyncio.get_running_loop()), Limits(), encoder)
        first = Reader()
        first.begin(feed)
        others: list[Reader] = []
        gone: list[tuple[Reader, int]] = []
        for step in steps:
            if step in MESSAGES:
                feed.take(MESSAGES[step])
            elif step == "turn":
                await asyncio.sleep(0)
            elif step == "add":
                others.append(Reader())
                others[-1].begin(feed)
            elif others:
                feed.remove(others[-1])
                gone.append((others.pop(), 0))
        gone = [(reader, len(reader.took)) for reader, _ in gone]
        feed.finish("closed", "kill")
        end = asyncio.get_running_loop().time() + patience()
        while "closed kill" not in first.took:
            await asyncio.sleep(0)
            assert asyncio.get_running_loop().time() < end
        encoder.close()
        assert first.took == [*range(1, feed.number + 1), "closed kill"]
        for reader in others:
            assert reader.took == first.took[len(first.took) - len(reader.took) :]
        assert all(len(reader.took) == count for reader, count in gone)
        late = Reader()
        late.begin(feed)
        assert late.took == ["closed kill"]

    asyncio.run(run())


async def test_a_long_message_is_written_once_for_each_form_and_beside_the_loop() -> None:
    encoder, loop = Encoder(), asyncio.get_running_loop()
    feed = Feed(LoopMailbox(loop), Limits(), encoder)
    readers = [Reader() for _ in range(3)]
    for reader in readers:
        reader.begin(feed)
    feed.take(LONG)
    end = loop.time() + patience()
    while not all(reader.took for reader in readers):
        await asyncio.sleep(0)
        assert loop.time() < end
    [thread] = [thread for reader in readers for thread in reader.threads]
    assert thread is not threading.current_thread()
    encoder.close()
    feed.take(LONG)  # what comes while the server stops is written in the loop
    feed.finish("closed", "kill")
    assert all(reader.took == [1, 2, "closed kill"] for reader in readers)


async def test_an_array_larger_than_any_memory_is_refused_and_not_written() -> None:
    encoder, loop = Encoder(), asyncio.get_running_loop()
    feed, reader = Feed(LoopMailbox(loop), Limits(), encoder), Reader()
    reader.begin(feed)
    feed.take({"mask": np.broadcast_to(np.uint8(0), (2**20, 2**20))})  # it repeats one octet
    feed.take(2)
    end = loop.time() + patience()
    while len(reader.took) < 2:
        await asyncio.sleep(0)
        assert loop.time() < end
    encoder.close()
    assert reader.lane.dropped == 1
    assert len(reader.threads) == 1


def _plain(value: Any) -> Any:
    """Return a value as JSON text has it."""
    if isinstance(value, list):
        return [_plain(item) for item in value]
    if isinstance(value, float) and value != value:  # noqa: PLR0124 - so is NaN
        return "NaN"
    if isinstance(value, int) and abs(value) >= 2**53:
        return str(value)
    return value


@pytest.mark.parametrize(
    "value",
    [
        array("d", [1.5, float("nan")] * 9_000),
        array("q", [1, 2**60] * 9_000),
        array("i"),
        np.array([1, 2**60] * 9_000),
        np.array([1.5, float("nan")] * 9_000),
        np.arange(20_000, dtype=">i4"),
        np.arange(40_000)[::2],
        np.arange(40_000).reshape(2, 20_000),
        np.array([True, False] * 9_000),
    ],
    ids=lambda value: f"{type(value).__name__} {getattr(value, 'dtype', '')}",
)
def test_long_arrays_of_numbers_are_the_same_text_in_pieces(value: Any) -> None:
    assert json.loads(TEXT_FORM.write({"v": value}))["v"] == _plain(value.tolist())


@pytest.mark.parametrize("count", [4_095, 4_096, 4_097, 8_192, 70_000])
def test_long_lists_are_the_same_octets_in_pieces(count: int) -> None:
    message = {"v": [[number, str(number)] for number in range(count)], "w": {"x": [1] * count}}
    assert BINARY_FORM.write(message) == cbor2.dumps(message)
