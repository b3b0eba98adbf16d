"""Does every message arrive whole, once, in order, and one at a time?"""

from __future__ import annotations

from typing import Any, ClassVar

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from uoarm.bridge import Bridge
from uoarm.model import Message
from uoarm.testing._collector import Collector, same
from uoarm.testing._instances import instances
from uoarm.testing.conformance._types import find_other_type, with_integers, with_length
from uoarm.testing.conformance._world import World, hold_bridge_idle, hold_idle_between, line, rules

__all__ = ["Flow"]

_MANY = 200
_SETTINGS: dict[str, Any] = {
    "deadline": None,
    "report_multiple_bugs": False,
    "suppress_health_check": (HealthCheck.too_slow, HealthCheck.data_too_large),
}


@rules("the-steps")
class Flow:
    """Messages on their way through one bridge, in and out."""

    kinds: ClassVar[tuple[str, ...]] = ()

    def test_every_message_of_the_structure_survives(
        self, world: World, bridge: Bridge, kind: str
    ) -> None:
        with line(world, bridge, kind) as through:

            @settings(**_SETTINGS)
            @given(instances(through.structure.schema))
            def survives(message: Message) -> None:
                through.carries_or_refuses(message)

            survives()

    def test_what_is_long_survives(self, world: World, bridge: Bridge, kind: str) -> None:
        """Texts and lists of three hundred, where the structure sets no limit."""
        with line(world, bridge, kind) as through:
            through.carries_or_refuses(with_length(through.structure.schema, through.example()))

    def test_values_arrive_with_their_types(self, world: World, bridge: Bridge, kind: str) -> None:
        """Octets as bytes, integers as int, truth values as bool."""
        with line(world, bridge, kind) as through:

            @settings(max_examples=20, **_SETTINGS)
            @given(instances(through.structure.schema))
            def keeps(message: Message) -> None:
                message = with_integers(through.structure.schema, message)
                if world.takes(kind, message):
                    (came,) = through.carries(message)
                    wrong = find_other_type(through.structure.schema, came)
                    assert not wrong, wrong

            keeps()

    def test_kinds_do_not_mix(self, world: World, bridge: Bridge, kind: str) -> None:
        others = [other for other in self.kinds if other != kind]
        if not others:
            pytest.skip("the world has one kind")
        with line(world, bridge, kind) as through, line(world, bridge, others[0]) as other:
            through.carries(through.example())
            other.carries(other.example())
            for item in (through, other):
                came = item.collector.messages
                assert len(came) == 1, f"what was sent elsewhere came, too: {came}"

    def test_a_retained_message_comes_first(self, world: World, bridge: Bridge) -> None:
        retained = world.retained()
        if retained is None:
            pytest.skip("the world retains nothing")
        message, collector = retained.emit(), Collector()
        structure = bridge.describe(retained.source).message
        assert structure is not None
        source = bridge.open_source(retained.source, structure, collector.deliver)
        came = collector.wait(1, world.patience)
        assert same(came[0], message), f"{message!r} is retained, {came[0]!r} came"
        assert source.latched, "what retains messages says so: `latched`"
        source.close()

    def test_bursts_keep_their_order(self, world: World, bridge: Bridge, kind: str) -> None:
        with line(world, bridge, kind) as through:
            kept: list[Message] = []

            @settings(max_examples=10, **_SETTINGS)
            @given(st.lists(instances(through.structure.schema), min_size=2, max_size=8))
            def keeps(messages: list[Message]) -> None:
                taken = [message for message in messages if world.takes(kind, message)]
                kept.extend(world.carried(kind, message) for message in taken)
                through.carries(*taken)

            keeps()
            assert through.collector.overlaps == 0
            # A consumer may keep a message: what comes later must not write over it.
            for sent, came in zip(kept, through.collector.messages, strict=True):
                assert same(came, sent), f"{sent!r} came, and became {came!r} afterwards"

    def test_recorded_samples_survive(self, world: World, bridge: Bridge, kind: str) -> None:
        samples = world.samples(kind)
        if not samples:
            pytest.skip("the world has no samples of this kind")
        with line(world, bridge, kind) as through:
            for message in samples:
                through.carries(message)

    def test_the_first_message_after_opening_arrives(
        self, world: World, bridge: Bridge, kind: str
    ) -> None:
        for _ in range(5):
            with line(world, bridge, kind) as through:
                through.carries(through.example())

    def test_a_line_opens_and_closes_many_times(
        self, world: World, bridge: Bridge, kind: str
    ) -> None:
        for _ in range(20):
            with line(world, bridge, kind) as through:
                assert bridge.open_channels == len({through.sink, through.source})
            assert bridge.open_channels == 0

    def test_nothing_is_lost_or_doubled_in_a_stream(
        self, world: World, bridge: Bridge, kind: str
    ) -> None:
        with line(world, bridge, kind) as through:
            message = through.example()
            for _ in range(_MANY // 10):
                through.carries(*[message] * 10)
            assert through.collector.overlaps == 0
            assert len(through.collector.messages) == _MANY

    def test_two_receivers_get_the_same(self, world: World, bridge: Bridge, kind: str) -> None:
        with line(world, bridge, kind) as first, line(world, bridge, kind) as second:
            world.await_receivers(kind, 2)
            first.send(first.example())
            for receiver in (first, second):
                receiver.collector.wait(1, world.patience)

    def test_what_waits_takes_hardly_any_processor_time(self, world: World, bridge: Bridge) -> None:
        """Before the first message, while few pass, after them, and after channels were closed."""
        with line(world, bridge, self.kinds[0]):
            hold_bridge_idle(world, bridge, "before the first message")
            with line(world, bridge, self.kinds[0]) as through:
                world.await_receivers(self.kinds[0], 2)
                through.carries(through.example())
                hold_idle_between(through, bridge)
                hold_bridge_idle(world, bridge, "after the last message")
            hold_bridge_idle(world, bridge, "after channels were closed")
