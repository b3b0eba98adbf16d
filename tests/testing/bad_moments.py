"""Bugs that show at one moment only: once something has failed, closed, or is held up."""

from __future__ import annotations

import threading
from collections import Counter
from collections.abc import Callable
from typing import Any

from attrs import evolve
from tests.testing.bad_descriptions import declares
from tests.testing.bad_endings import one_lock
from tests.testing.bad_worlds import (
    BLOCKING,
    CLOSING,
    ERRORS,
    LINKS,
    MESSAGES,
    OPTIONS_KIND,
    WORDS,
    Altered,
    Bug,
    delivering,
    noting_deliveries,
    sending,
    source,
    step,
)

from uoarm.bridge import Channel, Description, Sink, Source
from uoarm.errors import BridgeError, UoarmError
from uoarm.model import Deliver, Endpoint, Health, Message
from uoarm.testing.conformance._describing import Declaring, Describing
from uoarm.testing.conformance._ending import EndingRules
from uoarm.testing.conformance._failures import Breaking, DisturbanceRules
from uoarm.testing.conformance._flow import Flow

# Describing and declaring.


def describes_what_came(world: Any, bridge: Any) -> None:
    """Describe something else once a message has come, as one does who looks at messages."""
    came = threading.Event()

    def wrap(deliver: Deliver) -> Deliver:
        def noting(message: Message) -> None:
            came.set()
            deliver(message)

        return noting

    def replace(_: Any, __: Any, describe: Any) -> Any:
        def described(endpoint: Endpoint) -> Description:
            found: Description = describe(endpoint)
            if not came.is_set() or found.message is None:
                return found
            return evolve(found, message=evolve(found.message, native_type="WhatCame"))

        return described

    delivering(wrap)(world, bridge)
    step("_describe", replace)(world, bridge)


def sends_to_nothing(world: Any, bridge: Any, opens: Any) -> Any:
    def opened(endpoint: Endpoint, *more: Any) -> Sink:
        try:
            return opens(endpoint, *more)  # type: ignore[no-any-return]
        except BridgeError:
            return Sink(endpoint, lambda _: None, lambda: None)

    return opened


def leaves_a_thread_when_it_fails(world: Any, bridge: Any, opens: Any) -> Any:
    def opened(*given: Any) -> Any:
        try:
            return opens(*given)
        except BridgeError:
            threading.Thread(target=world.ended.wait, daemon=True).start()
            raise

    return opened


def _refuses_its_default(world: Any) -> Any:
    schema = world.declared.options_schema
    more = {"type": "integer", "minimum": 1, "default": 0}
    return {**schema, "properties": {**schema["properties"], "more": more}}


def _takes_any_option_of_a_port(world: Any) -> Any:
    return lambda address, options: "" if len(address) == 1 and address[0] else "expected a name"


# Messages and errors.


def each_once_for_each(world: Any, bridge: Any) -> None:
    """Deliver as often as there are receivers of an endpoint."""
    opened: Counter[tuple[str, ...]] = Counter()

    def replace(_: Any, __: Any, opens: Any) -> Any:
        def opening(endpoint: Endpoint, structure: Any, deliver: Any) -> Source:
            def several(message: Message) -> None:
                for _ in range(opened[endpoint.address]):
                    deliver(message)

            opened[endpoint.address] += 1
            made: Source = opens(endpoint, structure, Altered(deliver, several))
            return made

        return opening

    step("_open_source", replace)(world, bridge)


def says_no_why(world: Any, bridge: Any, opens: Any) -> Any:
    def opened(endpoint: Endpoint, structure: Any, deliver: Any) -> Source:
        silent = Altered(deliver, unreadable=lambda _: deliver.unreadable(""))
        return opens(endpoint, structure, silent)  # type: ignore[no-any-return]

    return opened


def exits(send: Callable[[Any], None]) -> Callable[[Any], None]:
    def sent(message: Any) -> None:
        try:
            send(message)
        except UoarmError as error:
            raise SystemExit(1) from error

    return sent


def exits_where_it_reads(world: Any, bridge: Any, opens: Any) -> Any:
    def opened(endpoint: Endpoint, structure: Any, deliver: Any) -> Source:
        def gives_up(_: str) -> None:
            threading.current_thread().name = "dead"  # as a thread that has ended

        return opens(endpoint, structure, Altered(deliver, unreadable=gives_up))  # type: ignore[no-any-return]

    return opened


# Closing.


def leaves_a_thread_of_a_channel(world: Any, bridge: Any, made: Channel) -> None:
    def stay() -> None:
        while not (bridge.closed or world.ended.wait(0.01)):
            pass

    threading.Thread(target=stay, daemon=True).start()


def joins_in_the_close_of_the_bridge(world: Any, bridge: Any) -> None:
    delivering_now = noting_deliveries(world, bridge)

    def replace(_: Any, __: Any, close: Any) -> Any:
        def closed() -> None:
            while delivering_now.is_set() and not world.ended.wait(0.01):
                pass
            close()

        return closed

    step("_close", replace)(world, bridge)


def reports_its_own_close(world: Any, bridge: Any, made: Channel) -> None:
    close = made._close

    def closed() -> None:
        close()
        bridge.report(Health.LOST, "unsubscribed", channel=made)

    made._close = closed  # type: ignore[method-assign]


# What is asked beside what hangs.


def facts_wait(world: Any, bridge: Any) -> None:
    """Have the facts of a source wait for what it delivers."""
    turn = threading.Lock()

    def wrap(deliver: Deliver) -> Deliver:
        def locked(message: Message) -> None:
            with turn:
                deliver(message)

        return locked

    def change(_: Any, __: Any, made: Source) -> None:
        facts = made.facts

        def waiting() -> Any:
            while not turn.acquire(timeout=0.01):
                if world.ended.is_set():
                    return {}
            turn.release()
            return facts()

        made.facts = waiting  # type: ignore[method-assign]

    delivering(wrap)(world, bridge)
    source(change)(world, bridge)


def reports_under_a_lock(world: Any, bridge: Any) -> None:
    """Report while a lock is held that facts take, too."""
    lock = threading.Lock()

    def replace(_: Any, __: Any, report: Any) -> Any:
        def reported(*given: Any, **about: Any) -> None:
            with lock:
                report(*given, **about)

        return reported

    def change(_: Any, __: Any, made: Source) -> None:
        def facts() -> Any:
            while not lock.acquire(timeout=0.01):
                if world.ended.is_set():
                    return {}
            lock.release()
            return {}

        made.facts = facts  # type: ignore[method-assign]

    step("report", replace)(world, bridge)
    source(change)(world, bridge)


MOMENT_BUGS: tuple[Bug, ...] = (
    Bug(
        WORDS,
        "describes what came last",
        describes_what_came,
        Describing.test_describing_says_the_same_while_messages_pass,
        "was described by",
    ),
    Bug(
        WORDS,
        "opens an input of what is not there",
        step("_open_sink", sends_to_nothing),
        Describing.test_what_is_not_there_does_not_open,
        "DID NOT RAISE",
    ),
    Bug(
        WORDS,
        "leaves a thread behind where an output does not open",
        step("_open_source", leaves_a_thread_when_it_fails),
        Describing.test_what_does_not_open_leaves_nothing_behind,
        "threads are left over",
    ),
    Bug(
        WORDS,
        "leaves a thread behind where nothing is described",
        step("_describe", leaves_a_thread_when_it_fails),
        Describing.test_what_does_not_open_leaves_nothing_behind,
        "threads are left over",
    ),
    Bug(
        OPTIONS_KIND,
        "refuses its own default",
        declares(bridge_options=_refuses_its_default),
        Declaring.test_each_default_is_what_may_be_written,
        "more: its default is refused",
    ),
    Bug(
        OPTIONS_KIND,
        "takes an option of a port that it does not know",
        declares(endpoint_options=None, check_endpoint=_takes_any_option_of_a_port),
        Declaring.test_an_option_of_a_port_that_is_not_known_is_refused,
        "it is taken",
    ),
    Bug(
        MESSAGES,
        "delivers each message as often as there are receivers",
        each_once_for_each,
        Flow.test_two_receivers_get_the_same,
        "1 were sent, 2 came",
    ),
    Bug(
        ERRORS,
        "does not say why something cannot be read",
        step("_open_source", says_no_why),
        DisturbanceRules.test_what_cannot_be_read_is_said_and_ends_nothing,
        "it was not said why",
    ),
    Bug(
        ERRORS,
        "exits where a message does not fit",
        sending(exits),
        DisturbanceRules.test_a_message_that_fits_nothing_is_refused_in_words_or_carried,
        "",
    ),
    Bug(
        ERRORS,
        "has the thread end that reads what cannot be read",
        step("_open_source", exits_where_it_reads),
        DisturbanceRules.test_what_cannot_be_read_is_said_and_ends_nothing,
        "nothing was said",
    ),
    Bug(
        CLOSING,
        "keeps a thread of each channel for as long as it lives",
        source(leaves_a_thread_of_a_channel),
        EndingRules.test_no_thread_and_no_descriptor_of_a_channel_outlives_it,
        "threads are left over",
    ),
    Bug(
        CLOSING,
        "waits in its own close for a delivery that lasts",
        joins_in_the_close_of_the_bridge,
        EndingRules.test_a_bridge_closes_while_a_delivery_is_held_up,
        "still running",
    ),
    Bug(
        CLOSING,
        "reports a channel lost that was closed",
        source(reports_its_own_close),
        EndingRules.test_what_is_well_and_what_is_closed_in_order_is_reported_as_no_fault,
        "nothing was wrong, and this was reported",
    ),
    Bug(
        BLOCKING,
        "has facts wait for a consumer",
        facts_wait,
        DisturbanceRules.test_a_delivery_that_lasts_does_not_stop_others,
        "still running",
    ),
    Bug(
        BLOCKING,
        "discovers nothing while a consumer is stuck",
        one_lock("_discover"),
        DisturbanceRules.test_a_delivery_that_lasts_does_not_stop_others,
        "still running",
    ),
    Bug(
        LINKS,
        "reports under a lock that its facts take",
        reports_under_a_lock,
        Breaking.test_a_break_is_reported_of_an_output_that_is_open_alone,
        "still running",
    ),
)
