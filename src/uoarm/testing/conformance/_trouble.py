"""Is death noticed, and is a bad message an error instead of a catastrophe?"""

from __future__ import annotations

import threading

import pytest

from uoarm.bridge import Bridge, Channel, HealthEvent, Sink
from uoarm.errors import UoarmError
from uoarm.model import Endpoint, Health, Message
from uoarm.testing._collector import Background
from uoarm.testing._patience import wait
from uoarm.testing._same import same
from uoarm.testing.conformance._breaking import HealthLog
from uoarm.testing.conformance._line import Line, hold_idle, line, structure_of
from uoarm.testing.conformance._rules import rules
from uoarm.testing.conformance._world import World

__all__ = ["DisturbanceRules"]

_NONSENSE: tuple[Message, ...] = (
    None,
    "nonsense",
    {"no_such_field_anywhere": object()},
    [[[]]],
)


@rules("reporting-what-happens")
class DisturbanceRules:
    """What goes wrong outside the bridge."""

    def test_a_death_is_reported_with_its_cause(self, world: World, bridge: Bridge) -> None:
        victim = world.victim()
        if victim is None:
            pytest.skip("nothing in this world dies alone")
        component = victim.source.component
        events: list[HealthEvent] = []
        opened: list[Channel] = []
        notified = threading.Event()

        def is_it(event: HealthEvent) -> bool:
            about = event.channel in opened or event.component == component
            return about and event.health is Health.LOST

        def listen(event: HealthEvent) -> None:
            events.append(event)
            if is_it(event):
                notified.set()

        bridge.watch(listen)
        structure = bridge.describe(victim.source).message
        assert structure is not None
        channel = bridge.open_source(victim.source, structure, lambda _: None)
        opened.append(channel)
        victim.kill()
        assert notified.wait(world.patience), f"a killed component was not reported: {events}"
        event = next(filter(is_it, events))
        assert event.cause, f"{event} has no cause"
        assert event.bridge == bridge.name
        hold_idle(world, bridge, "after a death")
        Background(channel.close).result(world.patience)

    def test_each_death_is_reported_of_its_own_component(
        self, world: World, bridge: Bridge
    ) -> None:
        victims = world.victims()
        if len(victims) < 2:  # noqa: PLR2004 - several
            pytest.skip("the world has not several components that die alone")
        report = HealthLog(world, bridge)
        channels = [_open(bridge, victim.source) for victim in victims]
        for victim, channel in zip(victims, channels, strict=True):
            early = [
                health_event
                for health_event in report.of(victim.source, channel)
                if health_event.health is Health.LOST
            ]
            assert not early, f"{victim.source} was told to be lost while it lived: {early}"
            victim.kill()
            report.wait(victim.source, channel, lambda item: item.health is Health.LOST)
        for channel in channels:
            Background(channel.close).result(world.patience)

    def test_a_message_that_fits_nothing_is_refused_in_words_or_carried(
        self, world: World, bridge: Bridge, kind: str
    ) -> None:
        """It may not vanish, break anything, nor hang."""
        with line(world, bridge, kind) as through:
            for nonsense in _NONSENSE:
                before = _refused(through.sink)
                try:
                    through.sink.send(nonsense)
                except UoarmError:
                    continue
                if nonsense is not None:
                    _came_or_counted(through, before, nonsense)
            message = through.example()
            wanted = world.carried(kind, message)
            through.send(message)
            through.collector.wait_for(lambda came: same(came, wanted), world.patience)

    def test_what_cannot_be_read_is_said_and_ends_nothing(
        self, world: World, bridge: Bridge, kind: str
    ) -> None:
        emit = world.unreadable(kind)
        if emit is None:
            pytest.skip("nothing in this world can be made unreadable")
        report = HealthLog(world, bridge)
        with line(world, bridge, kind) as through:
            emit()
            wait(
                lambda: through.source.unreadable or through.collector.messages,
                "of a payload that cannot be read nothing was said: `deliver.unreadable(why)`",
                world.patience,
            )
            assert not through.collector.messages, "the payload was delivered"
            through.carries(through.example())
            assert len(through.collector.messages) == 1, "the payload was delivered"
            assert through.source.unreadable == 1, "it was said of a message that can be read"
            lost = [event for event in report.events if event.health is Health.LOST]
            assert not lost, f"one payload ended the channel: {lost}"

    def test_another_channel_opens_while_a_consumer_is_stuck(
        self, world: World, bridge: Bridge, kind: str
    ) -> None:
        pair, opened = world.pair(kind), list[Channel]()
        with line(world, bridge, kind) as stuck, stuck.collector.held():
            sending = Background(lambda: stuck.send(stuck.example()))
            stuck.collector.wait_begun(1, world.patience)
            structure = structure_of(bridge, pair, incoming=False)
            try:
                for opening in (
                    lambda: bridge.open_source(pair.source, structure, lambda _: None),
                    lambda: bridge.open_sink(pair.sink, structure),
                ):
                    opened.append(Background(opening).result(world.patience))
            finally:
                stuck.source.close()
        sending.result(world.patience)
        for channel in opened:
            channel.close()

    def test_a_sink_that_does_not_block_returns_while_a_consumer_is_stuck(
        self, world: World, bridge: Bridge, kind: str
    ) -> None:
        with line(world, bridge, kind) as stuck:
            if stuck.sink.blocking:
                pytest.skip("the sink says that it blocks")
            with stuck.collector.held():
                for _ in range(2):
                    Background(lambda: stuck.send(stuck.example())).result(world.patience)

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


def _came_or_counted(through: Line, refused: int, nonsense: Message) -> None:
    wait(
        lambda: through.collector.messages or _refused(through.sink) > refused,
        f"{nonsense!r} was taken and vanished: raise, or count it in `facts`",
        through.world.patience,
    )


def _refused(sink: Sink) -> int:
    """Return how many messages a sink counts as refused, where it learns of that later."""
    facts = sink.facts().items()
    words = ("failed", "invalid", "lost", "refused")
    return sum(
        count for name, count in facts if isinstance(count, int) and any(map(name.count, words))
    )


def _open(bridge: Bridge, endpoint: Endpoint) -> Channel:
    structure = bridge.describe(endpoint).message
    assert structure is not None, f"{endpoint} is described without a message"
    return bridge.open_source(endpoint, structure, lambda _: None)
