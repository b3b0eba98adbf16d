"""Bugs of ends: closing, steps that block, deaths that are not reported, links that break."""

from __future__ import annotations

import os
import queue
import threading
from collections.abc import Callable
from typing import Any

from attrs import evolve
from tests.testing.bad_descriptions import _only_once
from tests.testing.bad_messages import swallows
from tests.testing.bad_worlds import (
    BLOCKING,
    CLOSING,
    HEALTH,
    LINKS,
    BadWorld,
    Bug,
    Spoil,
    delivering,
    noting_deliveries,
    reporting,
    sending,
    sink,
    source,
    step,
)

from uoarm.bridge import Channel, HealthEvent, NativeLink, Sink, Source
from uoarm.errors import BridgeError
from uoarm.model import Deliver, Endpoint, Health, Message, MessageStructure
from uoarm.testing import MemoryBridge
from uoarm.testing.conformance._ending import EndingRules
from uoarm.testing.conformance._failures import Breaking, DisturbanceRules
from uoarm.testing.conformance._flow import ServiceRules


def _channels(bridge: MemoryBridge) -> list[Channel]:
    components = tuple(bridge._components.values())
    return [channel for port in components for channel in getattr(port, "channels", tuple)()]


# Closing.


def joins_its_delivery(world: BadWorld, bridge: MemoryBridge) -> None:
    delivering_now = noting_deliveries(world, bridge)

    def change(_: BadWorld, __: MemoryBridge, made: Source) -> None:
        def close() -> None:
            while delivering_now.is_set() and not world.ended.wait(0.01):
                pass

        made._close = close  # type: ignore[method-assign]

    source(change)(world, bridge)


def never_lets_go(world: BadWorld, bridge: MemoryBridge, made: Channel) -> None:
    made._close = world.ended.wait  # type: ignore[method-assign,assignment]


def closes_all(world: BadWorld, bridge: MemoryBridge, made: Source) -> None:
    def close() -> None:
        for channel in _channels(bridge):
            for component in bridge._components.values():
                getattr(component, "leave", lambda _: None)(channel)

    made._close = close  # type: ignore[method-assign]


def closes_others(world: BadWorld, bridge: MemoryBridge, close: Any) -> Any:
    def closed() -> None:
        for memory_bridge in world.bridges:
            memory_bridge._components.clear()

    return closed


def leaks_a_thread(world: BadWorld, bridge: MemoryBridge, close: Any) -> Any:
    def closed() -> None:
        close()
        threading.Thread(target=world.ended.wait, daemon=True).start()

    return closed


def keeps_receivers(world: BadWorld, bridge: MemoryBridge) -> None:
    table: list[Deliver] = []

    def wrap(deliver: Deliver) -> Deliver:
        table.append(deliver)
        return deliver

    delivering(wrap)(world, bridge)


def keeps_handlers(world: BadWorld, bridge: MemoryBridge, serve: Any) -> Any:
    table: list[Any] = []

    def served(endpoint: Endpoint, structures: Any, handler: Any) -> Any:
        table.append(handler)
        return serve(endpoint, structures, handler)

    return served


def leaks_a_descriptor(world: BadWorld, bridge: MemoryBridge, made: Source) -> None:
    world.leaks.append(os.pipe())


def facts_end(world: BadWorld, bridge: MemoryBridge, made: Channel) -> None:
    def facts() -> dict[str, object]:
        if made.closed:
            raise OSError("bad file descriptor")
        return {}

    made.facts = facts  # type: ignore[method-assign]


def queued(*, drains: Callable[[BadWorld, float], bool], pause: float = 0.02) -> Spoil:
    """Have a thread of its own send, which ends with the channel, whatever waits then."""

    def change(world: BadWorld, bridge: MemoryBridge, made: Sink) -> None:
        waiting: queue.SimpleQueue[Message] = queue.SimpleQueue()
        send, over, close = made._send, threading.Event(), made._close

        def work() -> None:
            while not over.wait(pause):
                try:
                    send(waiting.get(timeout=0.01))
                except queue.Empty:
                    continue

        def end() -> None:
            over.set()
            close()

        threading.Thread(target=work, daemon=True).start()
        made._send = waiting.put  # type: ignore[method-assign,assignment]
        made._close = end  # type: ignore[method-assign]
        made.drain = lambda timeout: drains(world, timeout)  # type: ignore[method-assign]

    return sink(change)


# Blocking.


def one_lock(*steps: str) -> Spoil:
    """Have steps wait for whatever is being delivered."""

    def spoil(world: BadWorld, bridge: MemoryBridge) -> None:
        lock = threading.Lock()

        def wrap(deliver: Deliver) -> Deliver:
            def locked(message: Message) -> None:
                with lock:
                    deliver(message)

            return locked

        def waiting(_: BadWorld, __: MemoryBridge, original: Any) -> Any:
            def waits(*given: Any) -> Any:
                while not lock.acquire(timeout=0.01):
                    if world.ended.is_set():
                        raise BridgeError("the test has ended")
                lock.release()
                return original(*given)

            return waits

        delivering(wrap)(world, bridge)
        for name in steps:
            step(name, waiting)(world, bridge)

    return spoil


def one_call_at_a_time(world: BadWorld, bridge: MemoryBridge, call: Any) -> Any:
    lock = threading.Lock()

    def called(*given: Any) -> Any:
        while not lock.acquire(timeout=0.01):
            if world.ended.is_set():
                raise BridgeError("the test has ended")
        try:
            return call(*given)
        finally:
            lock.release()

    return called


# Health.


def whole_bridge(event: HealthEvent) -> HealthEvent:
    return evolve(event, channel=None) if event.health is Health.LOST else event


def other_end(event: HealthEvent) -> HealthEvent:
    link = event.channel
    if not isinstance(link, NativeLink):
        return event
    is_sink = event.component == link.sink.component
    return evolve(event, component=(link.endpoint if is_sink else link.sink).component)


def only_once() -> Callable[[HealthEvent], HealthEvent | None]:
    reports: list[HealthEvent] = []

    def change(event: HealthEvent) -> HealthEvent | None:
        reports.append(event)
        return event if len(reports) == 1 else None

    return change


def first_only(world: BadWorld, bridge: MemoryBridge) -> None:
    reporting(only_once())(world, bridge)


# Links that break.


def deaf_after(world: BadWorld, bridge: MemoryBridge, mend: Any) -> Any:
    def mended() -> None:
        for channel in _channels(bridge):
            for component in bridge._components.values():
                getattr(component, "leave", lambda _: None)(channel)
            bridge.report(Health.OK, "connected again", channel=channel)
        bridge._is_cut = ""

    return mended


def subscribes_again(world: BadWorld, bridge: MemoryBridge) -> None:
    again = threading.Event()

    def wrap(deliver: Deliver) -> Deliver:
        def twice(message: Message) -> None:
            deliver(message)
            if again.is_set():
                deliver(message)

        return twice

    delivering(wrap)(world, bridge)

    def replace(_: BadWorld, __: MemoryBridge, mend: Any) -> Any:
        def mended() -> None:
            mend()
            again.set()

        return mended

    step("mend", replace)(world, bridge)


def each_retry(world: BadWorld, bridge: MemoryBridge, cut: Any) -> Any:
    def cut_off() -> None:
        cut()
        cut("still not there")

    return cut_off


def dead_source(world: BadWorld, bridge: MemoryBridge, opens: Any) -> Any:
    def opened(endpoint: Endpoint, structure: MessageStructure, deliver: Deliver) -> Source:
        if bridge._is_cut:
            return Source(endpoint, lambda: None)
        return opens(endpoint, structure, deliver)  # type: ignore[no-any-return]

    return opened


def stays_degraded(world: BadWorld, bridge: MemoryBridge) -> None:
    late: list[Channel | None] = []

    def replace(_: BadWorld, __: MemoryBridge, opens: Any) -> Any:
        def opened(*given: Any) -> Source:
            cause, bridge._is_cut = bridge._is_cut, ""
            made: Source = opens(*given)
            bridge._is_cut = cause
            if cause:
                bridge.report(Health.DEGRADED, "it waits for the link", channel=made)
                late.append(made)
            return made

        return opened

    step("_open_source", replace)(world, bridge)
    reporting(lambda event: None if event.channel in late else event)(world, bridge)


def waits_for_the_link(world: BadWorld, bridge: MemoryBridge, made: Channel) -> None:
    close = made._close

    def closed() -> None:
        while bridge._is_cut and not world.ended.wait(0.01):
            pass
        close()

    made._close = closed  # type: ignore[method-assign]


CLOSING_BUGS: tuple[Bug, ...] = (
    Bug(
        CLOSING,
        "waits in closing for a delivery that lasts",
        joins_its_delivery,
        EndingRules.test_closing_ends_while_a_delivery_is_held_up,
        "still running",
    ),
    Bug(
        CLOSING,
        "waits in closing for the delivery that closes",
        joins_its_delivery,
        EndingRules.test_a_source_can_be_closed_from_its_own_delivery,
        "did not finish within 5 s",
    ),
    Bug(
        CLOSING,
        "never lets go of a channel",
        sink(never_lets_go),
        EndingRules.test_closing_while_messages_flow_ends_in_time,
        "still running",
    ),
    Bug(
        CLOSING,
        "closes all channels with one",
        source(closes_all),
        EndingRules.test_nothing_is_delivered_after_closing,
        "1 of 2 messages came",
    ),
    Bug(
        CLOSING,
        "closes all bridges with one",
        step("_close", closes_others),
        EndingRules.test_bridges_live_side_by_side,
        "there is no component",
    ),
    Bug(
        CLOSING,
        "keeps in a table what its closed channels delivered to",
        keeps_receivers,
        EndingRules.test_what_is_closed_keeps_nothing_of_who_used_it,
        "the bridge still holds",
    ),
    Bug(
        CLOSING,
        "keeps in a table the functions that it served",
        step("_serve", keeps_handlers),
        EndingRules.test_what_is_closed_keeps_nothing_of_who_used_it,
        "the bridge still holds",
    ),
    Bug(
        CLOSING,
        "leaves a thread behind",
        step("_close", leaks_a_thread),
        EndingRules.test_no_thread_and_no_descriptor_stays_behind,
        "threads are left over",
    ),
    Bug(
        CLOSING,
        "leaves file descriptors behind",
        source(leaks_a_descriptor),
        EndingRules.test_no_thread_and_no_descriptor_stays_behind,
        "file descriptors are left over",
    ),
    Bug(
        CLOSING,
        "fails when asked for facts after the close",
        source(facts_end),
        EndingRules.test_facts_can_be_asked_for_after_the_close,
        "bad file descriptor",
    ),
    Bug(
        CLOSING,
        "says that it is drained while messages wait",
        queued(drains=lambda _, __: True),
        EndingRules.test_what_drain_says_to_have_arrived_arrives,
        "messages came",
    ),
    Bug(
        CLOSING,
        "sends from a thread and does not wait for it in drain",
        queued(drains=lambda _, __: True),
        EndingRules.test_what_was_sent_before_an_orderly_end_arrives,
        "of 5 messages came",
    ),
    Bug(
        CLOSING,
        "drains for ever",
        queued(drains=lambda world, _: world.ended.wait()),
        EndingRules.test_what_drain_says_to_have_arrived_arrives,
        "still running",
    ),
)


BLOCKING_BUGS: tuple[Bug, ...] = (
    Bug(
        BLOCKING,
        "says that send returns at once, and blocks",
        sink(lambda _, __, made: setattr(made, "blocking", False)),
        DisturbanceRules.test_a_sink_that_does_not_block_returns_while_a_consumer_is_stuck,
        "still running",
    ),
    Bug(
        BLOCKING,
        "describes nothing while a consumer is stuck",
        one_lock("_describe"),
        DisturbanceRules.test_a_delivery_that_lasts_does_not_stop_others,
        "still running",
    ),
    Bug(
        BLOCKING,
        "opens no source while a consumer is stuck",
        one_lock("_open_source"),
        DisturbanceRules.test_another_channel_opens_while_a_consumer_is_stuck,
        "still running",
    ),
    Bug(
        BLOCKING,
        "opens no sink while a consumer is stuck",
        one_lock("_open_sink"),
        DisturbanceRules.test_another_channel_opens_while_a_consumer_is_stuck,
        "still running",
    ),
    Bug(
        BLOCKING,
        "makes one call at a time",
        step("_call", one_call_at_a_time),
        ServiceRules.test_a_service_that_is_silent_ends_in_time,
        "still running",
    ),
)


HEALTH_BUGS: tuple[Bug, ...] = (
    Bug(
        HEALTH,
        "says nothing of a death",
        reporting(lambda _: None),
        DisturbanceRules.test_a_death_is_reported_with_its_cause,
        "a killed component was not reported",
    ),
    Bug(
        HEALTH,
        "says no cause of a death",
        reporting(lambda event: evolve(event, cause="")),
        DisturbanceRules.test_a_death_is_reported_with_its_cause,
        "has no cause",
    ),
    Bug(
        HEALTH,
        "says of a death that it is degraded",
        reporting(lambda event: evolve(event, health=Health.DEGRADED)),
        DisturbanceRules.test_a_death_is_reported_with_its_cause,
        "a killed component was not reported",
    ),
    Bug(
        HEALTH,
        "says that all is lost when one component dies",
        reporting(whole_bridge),
        DisturbanceRules.test_each_death_is_reported_of_its_own_component,
        "was reported to be lost while it lived",
    ),
    Bug(
        HEALTH,
        "reports the first death only",
        first_only,
        DisturbanceRules.test_each_death_is_reported_of_its_own_component,
        "it was not reported",
    ),
    Bug(
        HEALTH,
        "blames the other end of a link for a death",
        reporting(other_end),
        DisturbanceRules.test_a_death_at_one_end_of_a_link_is_reported_of_that_component_alone,
        "died, and this was reported",
    ),
)


LINK_BUGS: tuple[Bug, ...] = (
    Bug(
        LINKS,
        "does not report that the link is broken",
        reporting(lambda _: None),
        Breaking.test_a_break_is_reported_with_its_cause_and_so_is_its_end,
        "a break was not reported",
    ),
    Bug(
        LINKS,
        "says no cause of the break",
        reporting(lambda event: evolve(event, cause="")),
        Breaking.test_a_break_is_reported_with_its_cause_and_so_is_its_end,
        "has no cause",
    ),
    Bug(
        LINKS,
        "does not report that the link is mended",
        reporting(lambda event: None if event.health is Health.OK else event),
        Breaking.test_a_break_is_reported_with_its_cause_and_so_is_its_end,
        "it was not reported",
    ),
    Bug(
        LINKS,
        "reports the break with each retry",
        step("cut", each_retry),
        Breaking.test_a_break_is_reported_with_its_cause_and_so_is_its_end,
        "reported again",
    ),
    Bug(
        LINKS,
        "connects again and does not subscribe again",
        step("mend", deaf_after),
        Breaking.test_messages_pass_again_once_it_is_mended_each_once,
        "messages came",
    ),
    Bug(
        LINKS,
        "subscribes again to what it is subscribed to",
        subscribes_again,
        Breaking.test_messages_pass_again_once_it_is_mended_each_once,
        "3 were sent, 6 came",
    ),
    Bug(
        LINKS,
        "loses what is sent while the link is broken",
        sending(swallows),
        Breaking.test_what_is_sent_while_it_is_broken_is_refused_or_counted_or_arrives,
        "vanished",
    ),
    Bug(
        LINKS,
        "closes only once the link is mended",
        source(waits_for_the_link),
        Breaking.test_what_is_broken_can_be_closed,
        "still running",
    ),
    Bug(
        LINKS,
        "opens while the link is broken, for nothing",
        step("_open_source", dead_source),
        Breaking.test_what_opens_while_it_is_broken_carries_once_it_is_mended,
        "0 of 1 messages came",
    ),
    Bug(
        LINKS,
        "leaves degraded what opened while the link was broken",
        stays_degraded,
        Breaking.test_what_opens_while_it_is_broken_carries_once_it_is_mended,
        "it carries and was not reported to be well",
    ),
)


RULED_OUT: tuple[Bug, ...] = (
    Bug(
        CLOSING,
        "goes on delivering after the close",
        source(lambda _, __, made: setattr(made, "_close", lambda: None)),
        EndingRules.test_nothing_is_delivered_after_closing,
        "",
    ),
    Bug(
        CLOSING,
        "goes on sending after the close",
        sink(lambda _, __, made: setattr(made, "_close", lambda: None)),
        EndingRules.test_a_closed_sink_refuses_messages,
        "",
    ),
    Bug(
        CLOSING,
        "fails when it is closed a second time",
        source(lambda _, __, made: setattr(made, "_close", _only_once(made._close))),
        EndingRules.test_closing_twice_is_closing_once,
        "",
    ),
)
"""What used to be bugs: the core sees to it, and the suite passes."""
