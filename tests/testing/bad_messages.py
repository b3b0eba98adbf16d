"""Bugs of messages: lost, changed, refused by no error, and waited for with a busy loop."""

from __future__ import annotations

import itertools
import json
import threading
from collections.abc import Callable
from contextlib import suppress
from itertools import repeat
from typing import Any

from tests.testing.bad_worlds import (
    ERRORS,
    MESSAGES,
    WAITING,
    Altered,
    BadWorld,
    Bug,
    Spoil,
    changing,
    delivering,
    sending,
    sink,
    source,
    step,
)

from uoarm.bridge import Delivery, Sink, Source
from uoarm.errors import BridgeError, FailureReason, MessageError, UoarmError
from uoarm.model import Deliver, Health, Message
from uoarm.testing import Background, MemoryBridge
from uoarm.testing.conformance._ending import EndingRules
from uoarm.testing.conformance._failures import DisturbanceRules
from uoarm.testing.conformance._flow import Flow, ServiceRules

# Waiting.


def spin(world: BadWorld) -> None:
    """Turn without a pause until the world ends."""
    threading.Thread(target=lambda: all(not world.ended.is_set() for _ in repeat(None))).start()


def spins_once_open(world: BadWorld, bridge: MemoryBridge, made: Source) -> None:
    del bridge, made
    spin(world)


def spins_after_a_message(world: BadWorld, bridge: MemoryBridge, made: Sink) -> None:
    del bridge
    send, spinning = made._send, threading.Event()

    def sent(message: Message) -> None:
        send(message)
        if not spinning.is_set():
            spinning.set()
            spin(world)

    made._send = sent  # type: ignore[method-assign]


def spins_after_a_death(world: BadWorld, bridge: MemoryBridge, report: Any) -> Any:
    def reported(health: Health, cause: str, **about: Any) -> None:
        if health is Health.LOST:
            spin(world)
        report(health, cause, **about)

    return reported


# Messages.


def drops(deliver: Deliver) -> Deliver:
    count = iter(range(10**9))
    return lambda message: None if next(count) % 7 == 6 else deliver(message)


def doubles(deliver: Deliver) -> Deliver:
    def twice(message: Message) -> None:
        deliver(message)
        deliver(message)

    return twice


def swaps(deliver: Deliver) -> Deliver:
    kept: list[Message] = []

    def swap(message: Message) -> None:
        kept.append(message)
        if len(kept) == 2:
            deliver(kept.pop())
            deliver(kept.pop())

    return swap


def loses_the_first(deliver: Deliver) -> Deliver:
    count = iter(range(10**9))
    return lambda message: deliver(message) if next(count) else None


def loses_what_is_falsy(deliver: Deliver) -> Deliver:
    return lambda message: deliver(message) if message["value"] else None


def one_buffer(deliver: Deliver) -> Deliver:
    buffer: dict[str, Any] = {}

    def fill(message: Any) -> None:
        buffer.update(message)
        deliver(buffer)

    return fill


def few_buffers(deliver: Deliver) -> Deliver:
    """Write into nine buffers in turn: a burst has eight messages at most."""
    buffers = itertools.cycle([dict[str, Any]() for _ in range(9)])

    def fill(message: Any) -> None:
        buffer = next(buffers)
        buffer.clear()
        buffer.update(message)
        deliver(buffer)

    return fill


def steals(world: BadWorld, bridge: MemoryBridge) -> None:
    newest: list[Deliver] = []

    def wrap(deliver: Deliver) -> Deliver:
        newest.append(deliver)
        return lambda message: deliver(message) if newest[-1] is deliver else None

    delivering(wrap)(world, bridge)


def mixes(world: BadWorld, bridge: MemoryBridge) -> None:
    everyone: list[Deliver] = []

    def wrap(deliver: Deliver) -> Deliver:
        everyone.append(deliver)

        def give(message: Message) -> None:
            for callback in everyone:
                callback(message)

        return give

    delivering(wrap)(world, bridge)


def spends(send: Callable[[Any], None]) -> Callable[[Any], None]:
    def sent(message: Any) -> None:
        send(message)
        if isinstance(message, dict):
            message.clear()

    return sent


# Errors.


def swallows(send: Callable[[Any], None]) -> Callable[[Any], None]:
    def sent(message: Any) -> None:
        with suppress(UoarmError):
            send(message)

    return sent


def blames_itself(send: Callable[[Any], None]) -> Callable[[Any], None]:
    def sent(message: Any) -> None:
        try:
            send(message)
        except MessageError as error:
            raise BridgeError(f"cannot send: {error}", FailureReason.BAD_MESSAGE) from error

    return sent


def unwraps(send: Callable[[Any], None]) -> Callable[[Any], None]:
    def sent(message: Any) -> None:
        try:
            send(message)
        except UoarmError as error:
            raise TypeError("not what this framework takes") from error

    return sent


def encodes(send: Callable[[Any], None]) -> Callable[[Any], None]:
    def sent(message: Any) -> None:
        json.dumps(message, ensure_ascii=False).encode()
        send(message)

    return sent


def replaces(send: Callable[[Any], None]) -> Callable[[Any], None]:
    def sent(message: Any) -> None:
        send(json.loads(json.dumps(message, ensure_ascii=False).encode(errors="replace")))

    return sent


def reading(does: Callable[[MemoryBridge, Delivery, str], object]) -> Spoil:
    def spoil(world: BadWorld, bridge: MemoryBridge) -> None:
        def wrap(deliver: Any) -> Any:
            return Altered(deliver, None, lambda why: does(bridge, deliver, why))

        delivering(wrap)(world, bridge)

    return spoil


def reports_unreadable(bridge: MemoryBridge, delivery: Delivery, why: str) -> None:
    bridge.report(Health.DEGRADED, why)


def delivers_unreadable(bridge: MemoryBridge, delivery: Delivery, why: str) -> None:
    delivery.unreadable(why)
    delivery(None)


def ends_at_unreadable(bridge: MemoryBridge, delivery: Delivery, why: str) -> None:
    delivery.unreadable(why)
    bridge.report(Health.LOST, why)


def empty_reply(world: BadWorld, bridge: MemoryBridge, call: Any) -> Any:
    def called(*given: Any) -> Message:
        try:
            return call(*given)
        except (UoarmError, RuntimeError):
            return {}

    return called


def late_in_other_words(world: BadWorld, bridge: MemoryBridge, call: Any) -> Any:
    def called(*given: Any) -> Message:
        calling, timeout = Background(lambda: call(*given)), given[-1]
        try:
            return calling.result(timeout)
        except AssertionError:
            raise BridgeError("no reply came") from None

    return called


def fails_to_close(*_: Any) -> Any:
    def close() -> None:
        raise OSError("bad file descriptor")

    return close


MESSAGE_BUGS: tuple[Bug, ...] = (
    Bug(
        MESSAGES,
        "loses every seventh message",
        delivering(drops),
        Flow.test_nothing_is_lost_or_doubled_in_a_stream,
        "of 10 messages came",
    ),
    Bug(
        MESSAGES,
        "delivers each message twice",
        delivering(doubles),
        Flow.test_nothing_is_lost_or_doubled_in_a_stream,
        "10 were sent, 20 came",
    ),
    Bug(
        MESSAGES,
        "swaps two messages",
        delivering(swaps),
        Flow.test_bursts_keep_their_order,
        "bursts keep their order",
    ),
    Bug(
        MESSAGES,
        "delivers -1 for 255",
        changing(lambda value: -1 if value == 255 else value),
        Flow.test_every_message_of_the_structure_survives,
        "sent {'value': 255}, came",
    ),
    Bug(
        MESSAGES,
        "loses the first message after opening",
        delivering(loses_the_first),
        Flow.test_the_first_message_after_opening_arrives,
        "0 of 1 messages came",
    ),
    Bug(
        MESSAGES,
        "takes zeros and empty texts for no message",
        delivering(loses_what_is_falsy),
        Flow.test_every_message_of_the_structure_survives,
        "messages came within",
    ),
    Bug(
        MESSAGES,
        "hands out one buffer that the next message overwrites",
        delivering(one_buffer),
        Flow.test_bursts_keep_their_order,
        "sent",
    ),
    Bug(
        MESSAGES,
        "hands out few buffers that later messages overwrite",
        delivering(few_buffers),
        Flow.test_bursts_keep_their_order,
        "afterwards",
    ),
    Bug(
        MESSAGES,
        "gives each message to the newest receiver only",
        steals,
        Flow.test_two_receivers_get_the_same,
        "0 of 1 messages came",
    ),
    Bug(
        MESSAGES,
        "delivers what comes on any channel to all",
        mixes,
        Flow.test_kinds_do_not_mix,
        "what was sent elsewhere came, too",
    ),
    Bug(
        MESSAGES,
        "empties the message that it was given to send",
        sending(spends),
        Flow.test_every_message_of_the_structure_survives,
        "sending changed the message",
    ),
    Bug(
        MESSAGES,
        "delivers octets as a list",
        changing(list),
        Flow.test_values_arrive_with_their_types,
        "octets came as list, expected bytes",
        "octets",
    ),
    Bug(
        MESSAGES,
        "delivers integers as floats",
        changing(float),
        Flow.test_values_arrive_with_their_types,
        "a float where the structure says integer",
    ),
    Bug(
        MESSAGES,
        "delivers truth values as 0 and 1",
        changing(lambda value: [*map(int, value)]),
        Flow.test_every_message_of_the_structure_survives,
        "sent {'value': [",
        "list",
    ),
    Bug(
        MESSAGES,
        "cuts texts after four characters",
        changing(lambda value: value[:4]),
        Flow.test_what_is_long_survives,
        "sent {'value': 'long",
        "text",
    ),
    Bug(
        MESSAGES,
        "writes texts in ASCII",
        changing(lambda value: value.encode("ascii", "replace").decode()),
        Flow.test_every_message_of_the_structure_survives,
        "came {'value': '?'}",
        "text",
    ),
    Bug(
        MESSAGES,
        "rounds numbers",
        changing(round),
        Flow.test_every_message_of_the_structure_survives,
        "sent",
        "number",
    ),
    Bug(
        MESSAGES,
        "delivers the first three items only",
        changing(lambda value: value[:3]),
        Flow.test_what_is_long_survives,
        "sent {'value': [",
        "list",
    ),
    Bug(
        MESSAGES,
        "does not say that an output retains its last message",
        source(lambda _, __, made: setattr(made, "latched", False)),
        Flow.test_a_retained_message_comes_first,
        "what retains messages says so: `latched`",
    ),
    Bug(
        MESSAGES,
        "does not hand over the message that is retained",
        delivering(loses_the_first),
        Flow.test_a_retained_message_comes_first,
        "0 of 1 messages came",
    ),
)


ERROR_BUGS: tuple[Bug, ...] = (
    Bug(
        ERRORS,
        "swallows the refusal of what does not fit",
        sending(swallows),
        DisturbanceRules.test_a_message_that_fits_nothing_is_refused_in_words_or_carried,
        "was taken and vanished",
    ),
    Bug(
        ERRORS,
        "refuses what does not fit as if its component had failed",
        sending(blames_itself),
        DisturbanceRules.test_a_message_that_fits_nothing_is_refused_in_words_or_carried,
        "cannot send: ",
    ),
    Bug(
        ERRORS,
        "lets the framework's own exception out of send",
        sending(unwraps),
        DisturbanceRules.test_a_message_that_fits_nothing_is_refused_in_words_or_carried,
        "not what this framework takes",
    ),
    Bug(
        ERRORS,
        "lets an encoder's own exception out of send",
        sending(encodes),
        DisturbanceRules.test_text_that_cannot_be_encoded_is_refused_in_words_or_carried_as_it_is,
        "surrogates not allowed",
        "text",
    ),
    Bug(
        ERRORS,
        "writes a question mark for what it cannot encode",
        sending(replaces),
        DisturbanceRules.test_text_that_cannot_be_encoded_is_refused_in_words_or_carried_as_it_is,
        "was taken and vanished or changed",
        "text",
    ),
    Bug(
        ERRORS,
        "drops what it cannot read, and says nothing",
        reading(lambda *_: None),
        DisturbanceRules.test_what_cannot_be_read_is_said_and_ends_nothing,
        "nothing was said",
    ),
    Bug(
        ERRORS,
        "reports what it cannot read as degraded, and nothing else",
        reading(reports_unreadable),
        DisturbanceRules.test_what_cannot_be_read_is_said_and_ends_nothing,
        "nothing was said",
    ),
    Bug(
        ERRORS,
        "delivers None for what it cannot read",
        reading(delivers_unreadable),
        DisturbanceRules.test_what_cannot_be_read_is_said_and_ends_nothing,
        "the payload was delivered",
    ),
    Bug(
        ERRORS,
        "ends the channel for one payload that it cannot read",
        reading(ends_at_unreadable),
        DisturbanceRules.test_what_cannot_be_read_is_said_and_ends_nothing,
        "one payload ended the channel",
    ),
    Bug(
        ERRORS,
        "answers with nothing when a service fails",
        step("_call", empty_reply),
        ServiceRules.test_a_service_that_fails_is_a_bridge_error,
        "DID NOT RAISE",
    ),
    Bug(
        ERRORS,
        "answers for a service that is not there",
        step("_call", empty_reply),
        ServiceRules.test_a_call_to_what_is_not_there_is_an_error,
        "DID NOT RAISE",
    ),
    Bug(
        ERRORS,
        "fails when a channel is closed",
        source(lambda _, __, made: setattr(made, "_close", fails_to_close())),
        EndingRules.test_closing_twice_is_closing_once,
        "bad file descriptor",
    ),
    Bug(
        ERRORS,
        "closes with the bridge what was closed with its channels",
        step("_close", fails_to_close),
        EndingRules.test_a_closed_bridge_refuses_everything,
        "bad file descriptor",
    ),
)


WAITING_BUGS: tuple[Bug, ...] = (
    Bug(
        WAITING,
        "looks without a pause whether something came",
        source(spins_once_open),
        Flow.test_what_waits_takes_hardly_any_processor_time,
        "a loop turns for nothing before the first message",
    ),
    Bug(
        WAITING,
        "waits for what it never takes after the first message",
        sink(spins_after_a_message),
        Flow.test_what_waits_takes_hardly_any_processor_time,
        "a loop turns for nothing between messages",
    ),
    Bug(
        WAITING,
        "reads without a pause from what is gone",
        step("report", spins_after_a_death),
        DisturbanceRules.test_a_death_is_reported_with_its_cause,
        "a loop turns for nothing after a death",
    ),
)
