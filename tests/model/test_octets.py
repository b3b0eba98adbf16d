"""What a message takes in memory, as budgets count it."""

from __future__ import annotations

import json
import tracemalloc
from array import array
from types import MappingProxyType

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from tests.structures import Quits

from uoarm.model import message_octets
from uoarm.testing import Background

SCALARS = st.none() | st.booleans() | st.integers() | st.floats() | st.text() | st.binary()
MESSAGES = st.recursive(
    SCALARS,
    lambda inner: st.lists(inner, max_size=40) | st.dictionaries(st.text(), inner),
    max_leaves=80,
)


@pytest.mark.parametrize(
    ("text", "slack"),
    [
        ("[" + ",".join(str(index * 1000) for index in range(20_000)) + "]", 1.1),
        ("[" + ",".join(["[]"] * 20_000) + "]", 1.1),
        ("[" + ",".join(f'"{index}"' for index in range(20_000)) + "]", 1.1),
        ("[" + ",".join(['{"a":[]}'] * 20_000) + "]", 1.3),  # the name is one object, often counted
    ],
    ids=["numbers", "empty lists", "texts", "objects"],
)
def test_it_is_what_the_interpreter_allocates(text: str, slack: float) -> None:
    tracemalloc.start()
    try:
        before = tracemalloc.get_traced_memory()[0]
        message = json.loads(text)
        allocated = tracemalloc.get_traced_memory()[0] - before
    finally:
        tracemalloc.stop()
    assert 0.95 * allocated <= message_octets(message) <= slack * allocated


@given(MESSAGES, MESSAGES)
def test_more_takes_more(one: object, other: object) -> None:
    both = message_octets([one, other])
    assert both > message_octets(one) + message_octets(other)
    assert message_octets({"a": one}) > message_octets(one)


@given(MESSAGES, st.integers(0, 10_000))
def test_counting_stops_beyond_the_most_that_matters(message: object, most: int) -> None:
    whole = message_octets(message)
    counted = message_octets(message, most=most)
    assert counted == whole if whole <= most else most < counted <= whole


def test_buffers_count_with_what_they_hold() -> None:
    octets = bytes(100_000)
    for item in (octets, bytearray(octets), memoryview(octets), array("B", octets)):
        assert 100_000 <= message_octets(item) <= 110_000
    for buffer in (np.zeros((100, 100)), np.zeros(20_000)[::2], np.frombuffer(bytes(80_000))):
        assert 80_000 <= message_octets({"data": buffer}) <= 80_800


def test_depth_and_foreign_values_do_it_no_harm() -> None:
    deep: list[object] = []
    for _ in range(100_000):
        deep = [deep]
    assert message_octets(deep) > 100_000 * 56
    assert message_octets(object()) > 0
    assert message_octets(MappingProxyType({"a": bytes(1000)})) > 1000
    assert message_octets((bytes(1000), {1, 2})) > 1000
    while deep:  # taken apart without recursion, which a Python of today survives anyway
        deep = deep.pop()  # type: ignore[assignment] # a list of lists


@pytest.mark.parametrize("kind", [SystemExit, RuntimeError])
def test_what_raises_as_it_is_counted_costs_nothing_else(kind: type[BaseException]) -> None:
    counts = Background(lambda: message_octets([bytes(5000), Quits(kind), bytes(5000)]))
    assert counts.result() > 10_000


def test_a_message_within_itself_has_an_end() -> None:
    itself: list[object] = [bytes(5000)]
    itself += [itself] * 100
    shared: list[object] = []
    for _ in range(100):
        shared = [shared, shared]
    assert message_octets({"itself": itself, "shared": shared}) > 5000
