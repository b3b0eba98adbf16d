"""Bugs of what is asked of a bridge while a link is broken, and of functions that are served."""

from __future__ import annotations

import threading
from collections.abc import Callable
from typing import Any

from tests.testing.bad_worlds import (
    LINKS,
    SERVICES,
    Bug,
    Spoil,
    delivering,
    reporting,
    sink,
    step,
)

from uoarm.bridge import Channel, HealthEvent, Sink, Source
from uoarm.errors import BridgeError, BridgeTimeoutError, UoarmError
from uoarm.model import Deliver, Endpoint, Health, Message
from uoarm.testing.conformance._failures import Breaking
from uoarm.testing.conformance._flow import ServiceRules


class Breaks(threading.Event):
    """Set while a link is broken; `ever` says whether one was."""

    ever = False


def noting_breaks(bridge: Any) -> Breaks:
    """Return what is set while the bridge has reported a break to its one listener."""
    broken, watch = Breaks(), bridge.watch

    def watched(listener: Callable[[HealthEvent], None]) -> None:
        def notice(event: HealthEvent) -> None:
            (broken.clear if event.health is Health.OK else broken.set)()
            broken.ever = broken.ever or broken.is_set()
            listener(event)

        watch(notice)

    bridge.watch = watched
    return broken


def while_broken(name: str, does: Callable[[Any], object]) -> Spoil:
    """Have a step do something else while the link is broken."""

    def spoil(world: Any, bridge: Any) -> None:
        broken, original = noting_breaks(bridge), getattr(bridge, name)

        def stepping(*given: Any) -> Any:
            return does(world) if broken.is_set() else original(*given)

        setattr(bridge, name, stepping)

    return spoil


def _fails(_: Any) -> object:
    raise ConnectionError("errno 107")


def drains_with(does: Callable[[Any], object]) -> Spoil:
    def spoil(world: Any, bridge: Any) -> None:
        broken = noting_breaks(bridge)

        def change(_: Any, __: Any, made: Sink) -> None:
            drain = made.drain

            def drained(timeout: float) -> Any:
                return does(world) if broken.is_set() else drain(timeout)

            made.drain = drained  # type: ignore[method-assign]

        sink(change)(world, bridge)

    return spoil


def says_ok_early(world: Any, bridge: Any, report: Any) -> Any:
    def reported(health: Health, cause: str, **about: Any) -> None:
        report(health, cause, **about)
        if health is Health.DEGRADED:
            report(Health.OK, "connecting again", **about)

    return reported


def not_of_outputs(event: HealthEvent) -> HealthEvent | None:
    return None if isinstance(event.channel, Source) else event


def forgets_what_it_served(world: Any, bridge: Any) -> None:
    broken, serve = noting_breaks(bridge), bridge._serve

    def served(endpoint: Endpoint, structures: Any, handler: Any) -> Any:
        def handle(request: Message) -> Message:
            if broken.ever:
                raise ArithmeticError("it is not served")
            return handler(request)

        return serve(endpoint, structures, handle)

    bridge._serve = served


# Services.


def raises_for_a_request(world: Any, bridge: Any, call: Any) -> Any:
    def called(*given: Any) -> Message:
        try:
            return call(*given)
        except UoarmError as error:
            raise TypeError("not serializable") from error

    return called


def hangs_with_text_of_no_encoding(world: Any, bridge: Any, call: Any) -> Any:
    def called(*given: Any) -> Message:
        if any("\\ud800" in repr(item) for item in given):
            raise BridgeTimeoutError("no reply came in time")
        reply: Message = call(*given)
        return reply

    return called


def hangs_with_a_bad_reply(world: Any, bridge: Any, serve: Any) -> Any:
    """Have the thread end that answers, so that no later request is answered."""
    ended = threading.Event()

    def served(endpoint: Endpoint, structures: Any, handler: Any) -> Any:
        def handle(request: Message) -> Message:
            if ended.is_set():
                raise ArithmeticError("what answered has ended")
            reply = handler(request)
            if isinstance(reply, dict) and "no_such_field_anywhere" in reply:
                ended.set()
                raise ArithmeticError("not serializable")
            return reply

        return serve(endpoint, structures, handle)

    return served


def serves_in_the_thread_that_reads(world: Any, bridge: Any) -> None:
    turn = threading.Lock()

    def wrap(deliver: Deliver) -> Deliver:
        def locked(message: Message) -> None:
            while not turn.acquire(timeout=0.01):
                if world.ended.is_set():
                    return
            turn.release()
            deliver(message)

        return locked

    def replace(_: Any, __: Any, serve: Any) -> Any:
        def served(endpoint: Endpoint, structures: Any, handler: Any) -> Any:
            def handle(request: Message) -> Message:
                with turn:
                    return handler(request)

            return serve(endpoint, structures, handle)

        return served

    delivering(wrap)(world, bridge)
    step("_serve", replace)(world, bridge)


def serves_once(world: Any, bridge: Any, serve: Any) -> Any:
    served: set[tuple[str, ...]] = set()

    def serving(endpoint: Endpoint, *more: Any) -> Any:
        if endpoint.address in served:
            raise BridgeError(f"{endpoint} is served already")
        served.add(endpoint.address)
        return serve(endpoint, *more)

    return serving


def calls_what_is_closed(world: Any, bridge: Any, serve: Any) -> Any:
    def served(endpoint: Endpoint, structures: Any, handler: Any) -> Any:
        is_closed = threading.Event()

        def handle(request: Message) -> Message:
            reply = handler(request)
            if is_closed.is_set():
                raise ArithmeticError("it is closed")
            return reply

        under = serve(endpoint, structures, handle)
        world.ended.under = under  # held, as the bridge still calls it
        return Channel(endpoint, is_closed.set)

    return served


def takes_its_time(world: Any, bridge: Any, call: Any) -> Any:
    def called(endpoint: Endpoint, structures: Any, message: Message, timeout: float) -> Message:
        try:
            return call(endpoint, structures, message, timeout)
        except BridgeError:
            world.ended.wait()
            raise

    return called


def goes_on_after_the_close(world: Any, bridge: Any, call: Any) -> Any:
    def called(*given: Any) -> Message:
        try:
            reply: Message = call(*given)
        except BridgeError:
            if bridge.closed:
                world.ended.wait()
            raise
        return reply

    return called


def holds_up_its_caller(world: Any, bridge: Any) -> None:
    """Say that a call keeps its limit, so that the core ends none: a close ends none either."""
    bridge._keeps_time = lambda _: True
    step("_call", goes_on_after_the_close)(world, bridge)


CALL_BUGS: tuple[Bug, ...] = (
    Bug(
        SERVICES,
        "goes on with a call after the close",
        step("_call", goes_on_after_the_close),
        ServiceRules.test_a_call_that_waits_for_its_reply_ends_as_its_bridge_closes,
        "`_call` goes on after the close",
    ),
    Bug(
        SERVICES,
        "goes on with a call after its time",
        step("_call", takes_its_time),
        ServiceRules.test_a_call_that_is_late_ends_in_the_bridge_too,
        "`_call` goes on after its timeout",
    ),
    Bug(
        SERVICES,
        "refuses a request with an exception of its own",
        step("_call", raises_for_a_request),
        ServiceRules.test_a_request_that_fits_nothing_is_refused_in_words,
        "came by itself",
    ),
    Bug(
        SERVICES,
        "does not end a call whose request it cannot encode",
        step("_call", hangs_with_text_of_no_encoding),
        ServiceRules.test_a_request_with_text_that_cannot_be_encoded_ends_in_words,
        "no reply came in time",
    ),
)
"""Of bridges whose services are not functions of their own process."""

BROKEN_BUGS: tuple[Bug, ...] = (
    Bug(
        LINKS,
        "reports a break of inputs alone",
        reporting(not_of_outputs),
        Breaking.test_a_break_is_reported_of_an_output_that_is_open_alone,
        "it was not reported",
    ),
    Bug(
        LINKS,
        "reports that all is well while it still connects",
        step("report", says_ok_early),
        Breaking.test_a_break_is_reported_with_its_cause_and_so_is_its_end,
        "it was reported to be well while it was broken",
    ),
    Bug(
        LINKS,
        "describes with an exception of the framework while the link is broken",
        while_broken("_describe", _fails),
        Breaking.test_what_is_asked_while_it_is_broken_ends_in_words,
        "came by itself",
    ),
    Bug(
        LINKS,
        "calls with an exception of the framework while the link is broken",
        while_broken("_call", _fails),
        Breaking.test_what_is_asked_while_it_is_broken_ends_in_words,
        "came by itself",
    ),
    Bug(
        LINKS,
        "drains with an exception of the framework while the link is broken",
        drains_with(_fails),
        Breaking.test_what_is_asked_while_it_is_broken_ends_in_words,
        "errno 107",
    ),
    Bug(
        LINKS,
        "drains once the link is mended",
        drains_with(lambda world: world.ended.wait()),
        Breaking.test_what_is_asked_while_it_is_broken_ends_in_words,
        "still running",
    ),
    Bug(
        LINKS,
        "connects again and serves nothing again",
        forgets_what_it_served,
        Breaking.test_a_served_function_answers_again_once_it_is_mended,
        "is not served again",
    ),
    Bug(
        SERVICES,
        "answers nothing more after a reply that fits nothing",
        step("_serve", hangs_with_a_bad_reply),
        ServiceRules.test_a_served_function_whose_reply_fits_nothing_fails_its_caller,
        "what answered has ended",
    ),
    Bug(
        SERVICES,
        "has a caller wait after the close",
        holds_up_its_caller,
        ServiceRules.test_a_call_that_waits_for_its_reply_ends_as_its_bridge_closes,
        "still running",
    ),
    Bug(
        SERVICES,
        "calls served functions in the thread that reads",
        serves_in_the_thread_that_reads,
        ServiceRules.test_a_served_function_that_takes_its_time_holds_up_nothing_else,
        "",
    ),
    Bug(
        SERVICES,
        "serves a name but once",
        step("_serve", serves_once),
        ServiceRules.test_a_function_can_be_served_again,
        "is served already",
    ),
    Bug(
        SERVICES,
        "calls a served function after its close",
        step("_serve", calls_what_is_closed),
        ServiceRules.test_a_served_function_answers_until_it_is_closed,
        "the function was called after the close",
    ),
)
