"""Is death noticed, and is a bad message an error instead of a catastrophe?"""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager, suppress
from functools import partial

import pytest

from uoarm.bridge import Bridge, Channel, HealthEvent, Sink
from uoarm.bridge._border import UNSAID
from uoarm.errors import BridgeError, FailureReason, MessageError, UoarmError
from uoarm.model import Endpoint, Health, Message
from uoarm.testing._waiting import Background, Collector, same, wait
from uoarm.testing.conformance._world import (
    Line,
    LinkVictim,
    World,
    examples_of_service,
    hold_bridge_idle,
    line,
    of_paths,
    rules,
    structure_of,
    supplied,
    with_half,
)

_AGAIN = 3
_SHORT_SECONDS = 0.5


class HealthLog:
    """What a bridge reported, in order, and of which channel or component."""

    def __init__(self, world: World, bridge: Bridge) -> None:
        self.patience = world.patience
        self.events: list[HealthEvent] = []
        bridge.watch(self._take)

    def _take(self, event: HealthEvent) -> None:
        # Facts may be asked for from any thread, so also from the one that reports.
        _ = None if event.channel is None else event.channel.facts()
        self.events.append(event)

    def of(self, endpoint: Endpoint, channel: Channel | None = None) -> list[HealthEvent]:
        """Return what concerns an endpoint: its channel, its component, or the whole bridge."""
        return [
            event
            for event in tuple(self.events)
            if (event.channel is not None and event.channel is channel)
            or (event.channel is None and event.component in {None, endpoint.component})
        ]

    def wait(
        self, endpoint: Endpoint, channel: Channel | None, fits: Callable[[HealthEvent], bool]
    ) -> HealthEvent:
        """Wait for an event that fits and return the first.

        Raises:
            AssertionError: none came in time.
        """
        wait(
            lambda: any(map(fits, self.of(endpoint, channel))),
            lambda: f"{endpoint}: it was not reported; what was: {self.events}",
            self.patience,
        )
        return next(filter(fits, self.of(endpoint, channel)))


@contextmanager
def _broken(world: World) -> Iterator[None]:
    """Break the world for a while, or skip the test where it cannot be broken."""
    if not Background(world.broken).result(world.patience):
        pytest.skip("nothing in this world can be broken and mended")
    try:
        yield
    finally:
        world.mended()


@rules("reporting-what-happens")
class Breaking:
    """Breaking what the bridge stands on (a link, a broker, a device) and mending it."""

    @of_paths
    def test_a_break_is_reported_with_its_cause_and_so_is_its_end(
        self, world: World, bridge: Bridge, kind: str
    ) -> None:
        log = HealthLog(world, bridge)
        with line(world, bridge, kind) as through:
            through.carries(through.example())
            with _broken(world):
                event = _worse(log, through)
                assert event.cause, f"{event} has no cause"
                hold_bridge_idle(world, bridge, "while the link is broken")
                early = [item for item in _about(log, through) if item.health is Health.OK]
                assert not early, f"it was reported to be well while it was broken: {early}"
            if event.health is Health.DEGRADED:
                log.wait(*_end(log, through), lambda item: item.health in {Health.OK, Health.LOST})
            _once(log)

    @of_paths
    def test_a_break_is_reported_of_an_output_that_is_open_alone(
        self, world: World, bridge: Bridge, kind: str
    ) -> None:
        """Nothing is sent to it that could fail: without a report its silence goes unnoticed."""
        log, pair = HealthLog(world, bridge), world.pair(kind)
        structure = structure_of(bridge, pair, incoming=False)
        source = bridge.open_source(pair.source, structure, lambda _: None)
        try:
            with _broken(world):
                log.wait(pair.source, source, lambda item: item.health is not Health.OK)
        finally:
            with suppress(BridgeError):  # it may have been lost
                source.close()

    @of_paths
    def test_what_is_asked_while_it_is_broken_ends_in_words(
        self, world: World, bridge: Bridge, kind: str
    ) -> None:
        """It may be answered, too: from what the bridge knows, or by what is not broken."""
        log, pair, served = HealthLog(world, bridge), world.pair(kind), world.served()
        limit = world.patience
        with line(world, bridge, kind) as through, _broken(world):
            _worse(log, through)
            asked: list[Callable[[], object]] = [
                lambda: bridge.describe(pair.source, timeout=limit),
                lambda: through.sink.drain(_SHORT_SECONDS),
            ]
            if served is not None:
                endpoint, request = served.endpoint, served.request
                asked.append(lambda: bridge.call(endpoint, request, timeout=_SHORT_SECONDS))
            for ask in asked:
                _hold_refused_in_words(ask, limit)

    @of_paths
    def test_a_served_function_answers_again_once_it_is_mended(
        self, world: World, bridge: Bridge, kind: str
    ) -> None:
        offered, called = supplied(world.servable(), "the bridge does not serve")
        log = HealthLog(world, bridge)
        replies: list[Message] = []
        serving = closing(bridge.serve(offered, lambda _: replies[0]))
        with serving as channel, line(world, bridge, kind) as through:
            request, reply = examples_of_service(bridge, called)
            replies.append(reply)
            with _broken(world):
                is_lost = _worse(log, through).health is Health.LOST
            if is_lost or any(item.health is Health.LOST for item in log.of(offered, channel)):
                return  # what was lost is served anew by the manager
            _well(log, through)

            def answers() -> bool:
                try:
                    return same(bridge.call(called, request, timeout=_SHORT_SECONDS), reply)
                except BridgeError:
                    return False

            wait(answers, f"{offered} is not served again", world.patience)

    def test_messages_pass_again_once_it_is_mended_each_once(
        self, world: World, bridge: Bridge, kind: str
    ) -> None:
        log = HealthLog(world, bridge)
        with line(world, bridge, kind) as through:
            with _broken(world):
                is_lost = _worse(log, through).health is Health.LOST
            if not is_lost:
                _well(log, through)
                for _ in range(_AGAIN):
                    through.carries(*[through.example()] * _AGAIN)
                came = len(through.collector.messages)
                assert came == _AGAIN * _AGAIN, "a message came more than once"
                return
        again = world.bridge()
        try:
            with line(world, again, kind) as through:
                through.carries(through.example())
        finally:
            again.close()

    def test_what_is_sent_while_it_is_broken_is_refused_or_counted_or_arrives(
        self, world: World, bridge: Bridge, kind: str
    ) -> None:
        log = HealthLog(world, bridge)
        with line(world, bridge, kind) as through:
            with _broken(world):
                _worse(log, through)
                before = _lost(through)
                try:
                    Background(lambda: through.send(through.example())).result(world.patience)
                except UoarmError:
                    return
            wait(
                lambda: through.collector.messages or _lost(through) > before,
                "a message that was sent while the link was broken vanished: raise, keep it until "
                "the link is mended, or count it as `lost_on_link`",
                world.patience,
            )

    @of_paths
    def test_what_is_broken_can_be_closed(self, world: World, bridge: Bridge, kind: str) -> None:
        log = HealthLog(world, bridge)
        with line(world, bridge, kind) as through, _broken(world):
            _worse(log, through)
            for channel in (through.source, through.sink):
                with suppress(BridgeError):  # that it could not say goodbye
                    Background(channel.close).result(world.patience)
                assert not channel.is_in_use, f"{channel.endpoint} was not let go"

    @of_paths
    def test_what_opens_while_it_is_broken_carries_once_it_is_mended(
        self, world: World, bridge: Bridge, kind: str
    ) -> None:
        """Refusing to open is right; opening something that never carries is not."""
        log, pair, collector = HealthLog(world, bridge), world.pair(kind), Collector()
        structure = structure_of(bridge, pair, incoming=False)
        with line(world, bridge, kind) as through:
            with _broken(world):
                _worse(log, through)
                try:
                    source = Background(
                        lambda: bridge.open_source(pair.source, structure, collector.deliver)
                    ).result(world.patience)
                except BridgeError:
                    return
            _well(log, through)
            through.send(through.example())
            collector.wait(1, world.patience)

            def is_well() -> bool:
                last = [item.health for item in tuple(log.events) if item.channel is source][-1:]
                return last in ([], [Health.OK])

            wait(
                is_well,
                lambda: f"it carries and was not reported to be well: {log.events}",
                world.patience,
            )
            source.close()


def _hold_refused_in_words(ask: Callable[[], object], limit: float) -> None:
    """Hold that a step ends, with whatever it returns or with a refusal of the bridge's own."""
    try:
        Background(ask).result(limit + _SHORT_SECONDS)
    except BridgeError as error:
        if error.reason is FailureReason.RAISED:
            text = f"{error} came by itself, and not of the bridge"
            raise AssertionError(text) from error


def _worse(log: HealthLog, through: Line) -> HealthEvent:
    """Wait until a break of either end was reported."""
    bad = {Health.DEGRADED, Health.LOST}
    wait(
        lambda: any(health_event.health in bad for health_event in _about(log, through)),
        lambda: f"a break was not reported, of neither end; what was: {log.events}",
        log.patience,
    )
    return next(health_event for health_event in _about(log, through) if health_event.health in bad)


def _well(log: HealthLog, through: Line) -> None:
    """Wait until all that was degraded of a line is reported to be well."""

    def all_well() -> bool:
        last = {
            _subject(health_event): health_event.health for health_event in _about(log, through)
        }
        return all(health is Health.OK for health in last.values())

    wait(
        all_well,
        lambda: f"what was degraded was not reported to be well again: {log.events}",
        log.patience,
    )


def _end(log: HealthLog, through: Line) -> tuple[Endpoint, Channel]:
    """Return the end of a line of which a break was reported."""
    for channel in (through.source, through.sink):
        if log.of(channel.endpoint, channel):
            return channel.endpoint, channel
    return through.source.endpoint, through.source


def _about(log: HealthLog, through: Line) -> list[HealthEvent]:
    ends = (through.source, through.sink)
    return [
        event for event in log.events if any(event in log.of(end.endpoint, end) for end in ends)
    ]


def _once(log: HealthLog) -> None:
    """Hold that nothing was reported twice in a row of one subject."""
    last: dict[object, Health] = {}
    for event in log.events:
        assert last.get(_subject(event)) is not event.health, f"reported again: {event}"
        last[_subject(event)] = event.health


def _subject(event: HealthEvent) -> object:
    return event.component if event.channel is None else id(event.channel)


def _hold_blamed(world: World, bridge: Bridge, victim: LinkVictim) -> None:
    """Link a pair, kill one end, and hold that this one is reported to be lost, and no other."""
    log, pair, dead = HealthLog(world, bridge), victim.pair, victim.endpoint.component
    link = bridge.link(pair.source, pair.sink)
    assert link is not None, f"{pair.source} and {pair.sink} are not linked"

    def lost() -> set[str]:
        events = [event for event in tuple(log.events) if event.health is Health.LOST]
        found = {event.component or (event.channel or link).endpoint.component for event in events}
        return found.intersection((pair.source.component, pair.sink.component))

    victim.kill()
    wait(lost, lambda: f"{dead} died, and this was reported: {log.events}", world.patience)
    assert lost() == {dead}, f"{dead} died, and this was reported: {log.events}"
    Background(link.close).result(world.patience)


def _lost(through: Line) -> int:
    facts = [end.facts() for end in (through.sink, through.source)]
    # Of a hosted bridge, what its sink refused is counted on this side under a name of its own.
    counts = [fact.get(name, 0) for fact in facts for name in ("lost_on_link", "failed_in_host")]
    return sum(count for count in counts if isinstance(count, int))


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
        victim = supplied(world.victim(), "nothing in this world dies alone")
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
        hold_bridge_idle(world, bridge, "after a death")
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
            assert not early, f"{victim.source} was reported to be lost while it lived: {early}"
            victim.kill()
            report.wait(victim.source, channel, lambda item: item.health is Health.LOST)
        for channel in channels:
            Background(channel.close).result(world.patience)

    def test_a_death_at_one_end_of_a_link_is_reported_of_that_component_alone(
        self, world: World, bridge: Bridge
    ) -> None:
        victims = world.link_victims()
        if not victims:
            pytest.skip("no end of a link dies in the world")
        for victim in victims:
            _hold_blamed(world, bridge, victim)

    def test_a_message_that_fits_nothing_is_refused_in_words_or_carried(
        self, world: World, bridge: Bridge, kind: str
    ) -> None:
        """It may not vanish, break anything, nor hang."""
        with line(world, bridge, kind) as through:
            for nonsense in _NONSENSE:
                before = _came(through)
                try:
                    through.sink.send(nonsense)
                except MessageError:  # of any other error its sender is not blamed
                    continue
                if nonsense is not None:
                    text = f"{nonsense!r} was taken and vanished: raise, or count it in `facts`"
                    wait(partial(_is_more, through, before), text, world.patience)
            message = through.example()
            wanted = world.carried(kind, message)
            through.send(message)
            through.collector.wait_for(lambda came: same(came, wanted), world.patience)

    def test_text_that_cannot_be_encoded_is_refused_in_words_or_carried_as_it_is(
        self, world: World, bridge: Bridge, kind: str
    ) -> None:
        with line(world, bridge, kind) as through:
            example = through.example()
            broken = with_half(through.structure.schema, example)
            carried, refused = world.carried(kind, broken), _refused(through.sink)

            def is_known() -> bool:
                came = through.collector.messages
                return any(same(item, carried) for item in came) or (
                    _refused(through.sink) > refused
                )

            try:
                through.send(broken)
            except UoarmError as error:
                str(error).encode()
            else:
                wait(is_known, f"{broken!r} was taken and vanished or changed", world.patience)
            wanted = world.carried(kind, example)
            through.send(example)
            through.collector.wait_for(lambda came: same(came, wanted), world.patience)

    def test_what_cannot_be_read_is_said_and_ends_nothing(
        self, world: World, bridge: Bridge, kind: str
    ) -> None:
        emit = supplied(world.unreadable(kind), "nothing in this world can be made unreadable")
        report = HealthLog(world, bridge)
        with line(world, bridge, kind) as through:
            emit()
            wait(
                lambda: through.source.unreadable or through.collector.messages,
                "of a payload that cannot be read nothing was said: `deliver.unreadable(why)`",
                world.patience,
            )
            assert not through.collector.messages, "the payload was delivered"
            why = through.source.refusal.replace(UNSAID, "")
            through.carries(through.example())
            assert len(through.collector.messages) == 1, "the payload was delivered"
            assert why, "it was not said why: `deliver.unreadable(why)`"
            assert through.source.unreadable == 1, "it was said of a message that can be read"
            about = _about(report, through)  # a component of another test may end meanwhile
            lost = [event for event in about if event.health is Health.LOST]
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
        """What is asked of the bridge and of its channels is answered meanwhile."""
        asked: list[Callable[[], object]] = [
            bridge.facts,
            lambda: bridge.describe(world.pair(kind).sink),
        ]
        if bridge.capabilities.discover:
            asked.append(bridge.discover)
        with line(world, bridge, kind) as stuck, stuck.collector.held():
            sending = Background(lambda: stuck.send(stuck.example()))
            stuck.collector.wait_begun(1, world.patience)
            try:
                for ask in (*asked, stuck.source.facts, stuck.sink.facts):
                    Background(ask).result(world.patience)
            finally:
                stuck.source.close()
        sending.result(world.patience)


def _came(through: Line) -> int:
    """Return how many messages came or were counted as refused."""
    return len(through.collector.messages) + _refused(through.sink)


def _is_more(through: Line, before: int) -> bool:
    return _came(through) > before


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
