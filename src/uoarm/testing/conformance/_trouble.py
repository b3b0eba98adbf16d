"""Is death noticed, and is a bad message an error instead of a catastrophe?"""

from __future__ import annotations

import threading
from contextlib import suppress

import pytest

from uoarm.bridge import Bridge, Channel, HealthEvent
from uoarm.errors import UoarmError
from uoarm.model import Health, Message
from uoarm.testing._collector import Background
from uoarm.testing._same import same
from uoarm.testing.conformance._line import line
from uoarm.testing.conformance._world import World

__all__ = ["Trouble"]

_NONSENSE: tuple[Message, ...] = (
    None,
    "nonsense",
    {"no_such_field_anywhere": object()},
    [[[]]],
)


class Trouble:
    """What goes wrong outside the bridge."""

    def test_a_death_is_told_with_its_cause(self, world: World, bridge: Bridge) -> None:
        victim = world.victim()
        if victim is None:
            pytest.skip("nothing in this world dies alone")
        component = victim.source.component
        events: list[HealthEvent] = []
        opened: list[Channel] = []
        told = threading.Event()

        def is_it(event: HealthEvent) -> bool:
            about = event.channel in opened or event.component == component
            return about and event.health is Health.LOST

        def listen(event: HealthEvent) -> None:
            events.append(event)
            if is_it(event):
                told.set()

        bridge.watch(listen)
        structure = bridge.describe(victim.source).message
        assert structure is not None
        channel = bridge.open_source(victim.source, structure, lambda _: None)
        opened.append(channel)
        victim.kill()
        assert told.wait(world.patience), f"a killed component was not reported: {events}"
        event = next(filter(is_it, events))
        assert event.cause
        assert event.bridge == bridge.name
        Background(channel.close).result(world.patience)

    def test_a_message_that_fits_nothing_harms_nothing(
        self, world: World, bridge: Bridge, kind: str
    ) -> None:
        """A bridge may refuse such a message, or carry it; it may not break, nor hang."""
        with line(world, bridge, kind) as through:
            for nonsense in _NONSENSE:
                with suppress(UoarmError):
                    through.sink.send(nonsense)
            message = through.example()
            wanted = world.carried(kind, message)
            through.send(message)
            through.collector.wait_for(lambda came: same(came, wanted), world.patience)

    def test_a_delivery_that_lasts_does_not_stop_others(
        self, world: World, bridge: Bridge, kind: str
    ) -> None:
        """Another channel still opens and describes while one consumer is stuck."""
        with line(world, bridge, kind) as stuck, stuck.collector.held():
            sending = Background(lambda: stuck.send(stuck.example()))
            stuck.collector.wait_begun(1, world.patience)
            try:
                Background(lambda: bridge.describe(world.pair(kind).sink)).result(world.patience)
            finally:
                stuck.source.close()
        sending.result(world.patience)
