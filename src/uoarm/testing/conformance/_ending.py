"""Does everything end when it is closed, from any thread, and leave nothing behind?"""

from __future__ import annotations

import gc
import threading
import weakref
from collections.abc import Callable, Mapping
from contextlib import suppress
from typing import ClassVar

import pytest

from uoarm.bridge import Bridge, Channel, HealthEvent
from uoarm.errors import BridgeError, FailureReason, UoarmError
from uoarm.model import Endpoint, Health, Message
from uoarm.testing._resources import ResourceSnapshot
from uoarm.testing._waiting import Background, Collector, wait
from uoarm.testing.conformance._world import (
    World,
    example_of,
    line,
    of_paths,
    rules,
    structure_of,
)

_CYCLES = 10
_PROCESSES = 3  # of bridges that are each a process: what one of them leaves is seen, too
_BACKLOG = 5
_SHORT_SECONDS = 0.2


@rules("the-steps")
class EndingRules:
    """Closing channels and bridges."""

    kinds: ClassVar[tuple[str, ...]] = ()
    hosted: ClassVar[bool] = False

    def test_closing_twice_is_closing_once(self, world: World, bridge: Bridge, kind: str) -> None:
        with line(world, bridge, kind) as through:
            for channel in (through.sink, through.source):
                channel.close()
                channel.close()
                assert channel.closed

    def test_a_closed_sink_refuses_messages(self, world: World, bridge: Bridge, kind: str) -> None:
        with line(world, bridge, kind) as through:
            message = through.example()
            through.sink.close()
            with pytest.raises(BridgeError) as caught:
                through.send(message)
            assert caught.value.reason is FailureReason.CLOSED

    def test_nothing_is_delivered_after_closing(
        self, world: World, bridge: Bridge, kind: str
    ) -> None:
        world.await_receivers(kind, 0)
        with line(world, bridge, kind) as closing, line(world, bridge, kind) as witness:
            world.await_receivers(kind, 2)
            message = witness.example()
            witness.send(message)
            for item in (closing, witness):
                item.collector.wait(1, world.patience)
            closing.source.close()
            witness.send(message)
            witness.collector.wait(2, world.patience)
            assert len(closing.collector.messages) == 1

    def test_a_source_can_be_closed_from_its_own_delivery(
        self, world: World, bridge: Bridge, kind: str
    ) -> None:
        pair, channels, done = world.pair(kind), list[Channel](), threading.Event()
        failures: list[UoarmError] = []

        def close(_: Message) -> None:
            try:
                channels[0].close()
            except UoarmError as error:  # a `deliver` never raises
                failures.append(error)
            done.set()

        world.await_receivers(kind, 0)
        with line(world, bridge, kind) as through:
            structure = structure_of(bridge, pair, incoming=False)
            channels.append(bridge.open_source(pair.source, structure, close))
            world.await_receivers(kind, 2)
            through.carries(through.example())
            assert done.wait(world.patience), "closing from within a delivery did not return"
            assert not failures, failures[0]
            through.carries(through.example())

    def test_closing_while_messages_flow_ends_in_time(
        self, world: World, bridge: Bridge, kind: str
    ) -> None:
        with line(world, bridge, kind) as through:
            message, stop = through.example(), threading.Event()
            closing = threading.Event()

            def stream() -> None:
                while not stop.is_set():
                    try:
                        through.send(message)
                    except UoarmError:
                        return
                    except Exception:
                        if closing.is_set():  # what a framework says of a channel that goes
                            return
                        raise

            flowing = Background(stream)
            try:
                through.collector.wait(1, world.patience)
                closing.set()
                Background(through.source.close).result(world.patience)
                Background(through.sink.close).result(world.patience)
            finally:
                stop.set()
            flowing.result(world.patience)

    def test_closing_ends_while_a_delivery_is_held_up(
        self, world: World, bridge: Bridge, kind: str
    ) -> None:
        with line(world, bridge, kind) as through:
            with through.collector.held():
                sending = Background(lambda: through.send(through.example()))
                through.collector.wait_begun(1, world.patience)
                Background(through.source.close).result(world.patience)
            # Before the sink is closed: what began may be an earlier message, come late.
            sending.result(world.patience)

    @of_paths
    def test_a_bridge_closes_while_a_delivery_is_held_up(self, world: World, kind: str) -> None:
        bridge, pair, collector = world.bridge(), world.pair(kind), Collector()
        structure = structure_of(bridge, pair, incoming=False)
        bridge.open_source(pair.source, structure, collector.deliver)
        sink = bridge.open_sink(pair.sink, structure_of(bridge, pair, incoming=True))
        with collector.held():
            sending = Background(lambda: sink.send(example_of(structure)))
            collector.wait_begun(1, world.patience)
            Background(bridge.close).result(world.patience)
        with suppress(BridgeError):  # the sink was closed under it
            sending.result(world.patience)

    def test_what_is_well_and_what_is_closed_in_order_is_reported_as_no_fault(
        self, world: World, bridge: Bridge, kind: str
    ) -> None:
        """The input may miss its last receiver; nothing is wrong with an output that is closed."""
        faults: list[HealthEvent] = []
        ignored: list[Channel] = []

        def listen(event: HealthEvent) -> None:
            if event.health is not Health.OK and event.channel not in ignored:
                faults.append(event)

        with line(world, bridge, kind) as through:
            bridge.watch(listen)
            through.carries(through.example())
            ignored.append(through.sink)
            through.source.close()
            bridge.watch(None)
        assert not faults, f"nothing was wrong, and this was reported: {faults}"

    @of_paths
    def test_a_closed_bridge_refuses_everything(self, world: World, kind: str) -> None:
        bridge, pair = world.bridge(), world.pair(kind)
        structure = structure_of(bridge, pair, incoming=True)
        collector = Collector()
        source = bridge.open_source(pair.source, structure, collector.deliver)
        sink = bridge.open_sink(pair.sink, structure)
        bridge.close()
        bridge.close()
        assert (source.closed, sink.closed, bridge.open_channels) == (True, True, 0)
        for refused in (
            lambda: bridge.describe(pair.sink),
            lambda: bridge.open_sink(pair.sink, structure),
            lambda: bridge.open_source(pair.source, structure, collector.deliver),
        ):
            with pytest.raises(BridgeError) as caught:
                refused()
            assert caught.value.reason is FailureReason.CLOSED

    def test_facts_can_be_asked_for_after_the_close(
        self, world: World, bridge: Bridge, kind: str
    ) -> None:
        with line(world, bridge, kind) as through:
            for channel in (through.sink, through.source):
                assert isinstance(channel.facts(), Mapping)
                channel.close()
                assert isinstance(channel.facts(), Mapping)

    def test_what_drain_says_to_have_arrived_arrives(
        self, world: World, bridge: Bridge, kind: str
    ) -> None:
        """A backlog before a receiver that is slow enough to see; drained, then closed."""
        taken: list[Message] = []
        with line(world, bridge, kind) as through:

            def send() -> None:
                for _ in range(_BACKLOG):
                    through.send(message)
                    taken.append(message)

            message = through.example()
            with through.collector.held():
                sending = Background(send)
                through.collector.wait_begun(1, world.patience)
                _settle(taken)
                before = len(taken)
                is_drained = Background(lambda: through.sink.drain(_SHORT_SECONDS)).result(
                    world.patience
                )
                if is_drained:
                    with suppress(BridgeError):
                        through.sink.close()
            if is_drained:
                through.collector.wait(before, world.patience)
            with suppress(BridgeError):  # the sink was closed under it
                sending.result(world.patience)

    def test_what_was_sent_before_an_orderly_end_arrives(
        self, world: World, bridge: Bridge, kind: str
    ) -> None:
        with line(world, bridge, kind) as through:
            message = through.example()
            for _ in range(_BACKLOG):
                through.send(message)
            assert through.sink.drain(world.patience), "not drained though nothing is stuck"
            through.sink.close()
            through.collector.wait(_BACKLOG, world.patience)

    @of_paths
    def test_bridges_live_side_by_side(self, world: World, kind: str) -> None:
        first, second = world.bridge(), world.bridge()
        try:
            with line(world, first, kind) as through:
                through.carries(through.example())
            first.close()
            with line(world, second, kind) as through:
                through.carries(through.example())
        finally:
            first.close()
            second.close()

    def test_what_is_closed_keeps_nothing_of_who_used_it(
        self, world: World, bridge: Bridge, kind: str
    ) -> None:
        """A receiver that stays in a table after its close is there for as long as the bridge."""
        receivers: list[Callable[[], object]] = [
            weakref.ref(_received_by_a_line(world, bridge, kind)) for _ in range(2)
        ]
        places = world.servable()
        if places is not None:
            receivers.append(weakref.ref(_served_and_closed(bridge, places[0])))

        def are_gone() -> bool:
            gc.collect()
            return not any(receiver() for receiver in receivers)

        text = "the bridge still holds what a closed channel delivered to, or called"
        wait(are_gone, text, world.patience)

    def test_no_thread_and_no_descriptor_of_a_channel_outlives_it(
        self, world: World, bridge: Bridge, kind: str
    ) -> None:
        """While its bridge lives, which opens channels for as long as a robot runs."""
        with line(world, bridge, kind) as lasting:
            lasting.carries(lasting.example())

            def cycle() -> None:
                with line(world, bridge, kind) as through:
                    through.carries(through.example())

            def cycles() -> ResourceSnapshot:
                before = ResourceSnapshot()
                for _ in range(_CYCLES):
                    cycle()
                return before

            cycles()  # until pools of threads, also those of the world, are full
            snapshot = cycles()
            # What lasts may get a thread of its own meanwhile, as a flow does whose consumer was
            # slow for a moment: once, and until it ends. What each cycle leaves is there again.
            try:
                snapshot.check(world.patience / 8)
            except AssertionError:
                cycles().check(world.patience)
        snapshot.check(world.patience)

    def test_no_thread_and_no_descriptor_stays_behind(self, world: World) -> None:
        def cycle() -> None:
            bridge = world.bridge()
            try:
                for kind in self.kinds:
                    with line(world, bridge, kind) as through:
                        through.carries(through.example())
            finally:
                bridge.close()

        cycle()
        snapshot = ResourceSnapshot()
        for _ in range(_PROCESSES if self.hosted else _CYCLES):
            cycle()
        snapshot.check(world.patience)


def _received_by_a_line(world: World, bridge: Bridge, kind: str) -> Collector:
    """Return what a source delivered to until it was closed; nothing else holds it."""
    pair, receiver = world.pair(kind), Collector()
    world.await_receivers(kind, 0)  # those of the line before are not there any more
    structure = structure_of(bridge, pair, incoming=False)
    source = bridge.open_source(pair.source, structure, receiver)
    with line(world, bridge, kind) as through:
        world.await_receivers(kind, 2)
        through.carries(through.example())
        receiver.wait(1, world.patience)
    source.close()
    return receiver


class _Handler:
    """A function that is served, and that nothing else holds."""

    def __call__(self, request: Message) -> Message:
        return request


def _served_and_closed(bridge: Bridge, offered: Endpoint) -> _Handler:
    handler = _Handler()
    bridge.serve(offered, handler).close()
    return handler


def _settle(taken: list[Message]) -> None:
    """Wait until a sender that gets stuck is stuck: twice the same count."""
    pause, before = threading.Event(), -1
    while before != len(taken):
        before = len(taken)
        pause.wait(_SHORT_SECONDS)
