"""The conformance kit is worth its name: each way of being a bad bridge makes a test of it fail."""

from __future__ import annotations

import inspect
import threading
from collections.abc import Callable
from typing import Any

import pytest
from hypothesis.errors import Flaky
from tests.testing.test_memory_conformance import MemoryWorld

from uoarm.bridge import Bridge, Sink, Source
from uoarm.errors import BridgeError
from uoarm.model import Deliver, Endpoint, Message, MessageStructure
from uoarm.testing import MemoryBridge
from uoarm.testing.conformance._describing import Describing
from uoarm.testing.conformance._ending import Ending
from uoarm.testing.conformance._flow import Flow
from uoarm.testing.conformance._trouble import Trouble

Wrap = Callable[[Deliver], Deliver]


class BadWorld(MemoryWorld):
    """A memory bridge whose deliveries, or other steps, are spoilt."""

    patience = 0.3

    def __init__(self, spoil: Callable[[MemoryBridge], None]) -> None:
        super().__init__()
        self._spoil = spoil

    def bridge(self) -> Bridge:
        made = super().bridge()
        assert isinstance(made, MemoryBridge)
        self._spoil(made)
        return made


def delivering(wrap: Wrap) -> Callable[[MemoryBridge], None]:
    def spoil(bridge: MemoryBridge) -> None:
        original = bridge._open_source

        def opened(endpoint: Endpoint, structure: MessageStructure, deliver: Deliver) -> Source:
            return original(endpoint, structure, wrap(deliver))

        bridge._open_source = opened  # type: ignore[method-assign] # on purpose

    return spoil


def sinking(change: Callable[[Sink], None]) -> Callable[[MemoryBridge], None]:
    def spoil(bridge: MemoryBridge) -> None:
        original = bridge._open_sink

        def opened(endpoint: Endpoint, structure: MessageStructure) -> Sink:
            sink = original(endpoint, structure)
            change(sink)
            return sink

        bridge._open_sink = opened  # type: ignore[method-assign] # on purpose

    return spoil


def dropping(deliver: Deliver) -> Deliver:
    count = iter(range(10**9))
    return lambda message: None if next(count) % 7 == 6 else deliver(message)


def doubling(deliver: Deliver) -> Deliver:
    def twice(message: Message) -> None:
        deliver(message)
        deliver(message)

    return twice


def swapping(deliver: Deliver) -> Deliver:
    kept: list[Message] = []

    def swap(message: Message) -> None:
        kept.append(message)
        if len(kept) == 2:
            deliver(kept.pop())
            deliver(kept.pop())

    return swap


def changing(deliver: Deliver) -> Deliver:
    def change(message: Any) -> None:
        deliver({"value": message["value"] if message["value"] != 255 else -1})

    return change


def deaf_to_close(sink: Sink) -> None:
    sink.send = lambda message: None  # type: ignore[method-assign,misc] # on purpose


def slow_to_close(sink: Sink) -> None:
    def wait() -> None:
        threading.Event().wait(1.0)

    sink._close = wait  # type: ignore[method-assign] # on purpose


leave = threading.Event()


def leaking(bridge: MemoryBridge) -> None:
    original = bridge._close

    def close() -> None:
        original()
        threading.Thread(target=leave.wait, daemon=True).start()

    bridge._close = close  # type: ignore[method-assign] # on purpose


def mute(bridge: MemoryBridge) -> None:
    bridge.report = lambda *_, **__: None  # type: ignore[method-assign] # on purpose


def boasting(bridge: MemoryBridge) -> None:
    made = bridge.emitter("forgetful", {"type": "integer"})
    original = bridge._describe

    def describe(endpoint: Endpoint) -> Any:
        try:
            return original(endpoint)
        except BridgeError:
            return made.structure

    bridge._describe = describe  # type: ignore[method-assign] # on purpose


CASES: dict[str, tuple[Callable[[MemoryBridge], None], Callable[..., None]]] = {
    "drops": (delivering(dropping), Flow.test_nothing_is_lost_or_doubled_in_a_stream),
    "doubles": (delivering(doubling), Flow.test_nothing_is_lost_or_doubled_in_a_stream),
    "swaps": (delivering(swapping), Flow.test_bursts_keep_their_order),
    "changes": (delivering(changing), Flow.test_every_message_of_the_structure_survives),
    "deaf": (sinking(deaf_to_close), Ending.test_a_closed_sink_refuses_messages),
    "slow": (sinking(slow_to_close), Ending.test_closing_while_messages_flow_ends_in_time),
    "mute": (mute, Trouble.test_a_death_is_told_with_its_cause),
    "boasts": (boasting, Describing.test_what_is_not_there_is_named),
}


def run(test: Callable[..., None], spoil: Callable[[MemoryBridge], None]) -> None:
    world = BadWorld(spoil)
    bridge = world.bridge()
    given = {"self": Flow(), "world": world, "bridge": bridge, "kind": "byte"}
    try:
        test(**{name: given[name] for name in inspect.signature(test).parameters})
    finally:
        world.close()
        bridge.close()


@pytest.mark.parametrize("case", CASES)
def test_a_bad_bridge_is_found_out(case: str) -> None:
    spoil, test = CASES[case]
    # A bridge that errs now and then fails two runs of one example in two ways: Flaky.
    with pytest.raises((AssertionError, pytest.fail.Exception, Flaky)):
        run(test, spoil)


@pytest.mark.parametrize("case", CASES)
def test_a_good_bridge_passes_the_same_tests(case: str) -> None:
    run(CASES[case][1], lambda _: None)


def test_a_leak_is_found_out() -> None:
    world = BadWorld(leaking)
    leave.clear()
    try:
        with pytest.raises(AssertionError, match="threads are left over"):
            Ending().test_no_thread_and_no_descriptor_stays_behind(world, "byte")
    finally:
        leave.set()
