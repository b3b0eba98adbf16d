"""Deliberate bugs in a memory bridge, each with the rule of the conformance kit that catches it."""

from __future__ import annotations

import itertools
import os
import queue
import threading
from collections.abc import Callable
from contextlib import suppress
from itertools import repeat
from typing import Any

from attrs import evolve, frozen
from tests.testing.test_memory_conformance import OPTIONS, MemoryWorld, at

from uoarm.bridge import (
    Bridge,
    BridgeType,
    Channel,
    Delivery,
    Description,
    Discovered,
    HealthEvent,
    Registry,
    Sink,
    Source,
)
from uoarm.errors import BridgeError, FailureReason, UoarmError
from uoarm.model import Deliver, Endpoint, Health, Message, MessageStructure, Options, Role
from uoarm.testing import Background, MemoryBridge
from uoarm.testing.conformance._describing import Declaring, Describing
from uoarm.testing.conformance._ending import EndingRules
from uoarm.testing.conformance._failures import Breaking, DisturbanceRules
from uoarm.testing.conformance._flow import Flow, ServiceRules
from uoarm.testing.conformance._world import rule_of

__all__ = ["BUGS", "RULED_OUT", "BadWorld", "Bug", "table"]


class BadWorld(MemoryWorld):
    """A world whose bridges have one bug; what hangs in them ends with the world."""

    def __init__(self, spoil: Spoil, patience: float) -> None:
        super().__init__()
        self._patience = patience
        self.spoil = spoil
        self.ended = threading.Event()
        self.leaks: list[tuple[int, int]] = []
        self.bridges: list[MemoryBridge] = []
        self.declared = BridgeType(
            "memory", "for tests", self.create, OPTIONS, _check_address, contract=2
        )
        if spoil.__name__.startswith("declares"):
            spoil(self, None)  # type: ignore[arg-type] # before there is a bridge

    @property
    def patience(self) -> float:
        """Short, since most bugs show in that nothing comes."""
        return self._patience

    def registry(self) -> Registry:
        made = Registry([])
        made.add(self.declared)
        return made

    def create(self, name: str, options: Options) -> Bridge:
        made = super().create(name, options)
        assert isinstance(made, MemoryBridge)
        self.bridges.append(made)
        if not self.spoil.__name__.startswith("declares"):
            self.spoil(self, made)
        return made

    def close(self) -> None:
        super().close()
        self.ended.set()
        for ends in self.leaks:
            for end in ends:
                os.close(end)


Spoil = Callable[[BadWorld, MemoryBridge], object]


@frozen
class Bug:
    """One deliberate bug.

    Args:
        kind: the class of mistakes that it belongs to.
        name: what the bridge does, after "it".
        spoil: puts the bug into a bridge of a world.
        caught: the test of the suite that fails.
        says: a part of what it says then.
        pair: the kind of pair that the test is run with.
    """

    kind: str
    name: str
    spoil: Spoil
    caught: Callable[..., None]
    says: str
    pair: str = "byte"


def _check_address(address: tuple[str, ...], options: Options) -> str:
    return "" if len(address) == 1 else "expected one name"


# How a bug gets into a bridge: by replacing one of its steps, or what these take and return.


def step(name: str, replace: Callable[[BadWorld, MemoryBridge, Any], Any]) -> Spoil:
    def spoil(world: BadWorld, bridge: MemoryBridge) -> None:
        setattr(bridge, name, replace(world, bridge, getattr(bridge, name)))

    return spoil


def delivering(wrap: Callable[[Deliver], Deliver]) -> Spoil:
    def replace(world: BadWorld, bridge: MemoryBridge, opens: Any) -> Any:
        def opened(endpoint: Endpoint, structure: MessageStructure, deliver: Any) -> Source:
            given = wrap(deliver)
            if isinstance(deliver, Delivery) and not isinstance(given, Delivery):
                given = Altered(deliver, given)
            return opens(endpoint, structure, given)  # type: ignore[no-any-return]

        return opened

    return step("_open_source", replace)


def changing(change: Callable[[Any], Any]) -> Spoil:
    """Change the value of each message that is delivered."""
    return delivering(lambda deliver: lambda message: deliver({"value": change(message["value"])}))


def source(change: Callable[[BadWorld, MemoryBridge, Any], object]) -> Spoil:
    def replace(world: BadWorld, bridge: MemoryBridge, opens: Any) -> Any:
        def opened(endpoint: Endpoint, structure: MessageStructure, deliver: Deliver) -> Source:
            made: Source = opens(endpoint, structure, deliver)
            change(world, bridge, made)
            return made

        return opened

    return step("_open_source", replace)


def sink(change: Callable[[BadWorld, MemoryBridge, Any], object]) -> Spoil:
    def replace(world: BadWorld, bridge: MemoryBridge, opens: Any) -> Any:
        def opened(endpoint: Endpoint, structure: MessageStructure) -> Sink:
            made: Sink = opens(endpoint, structure)
            change(world, bridge, made)
            return made

        return opened

    return step("_open_sink", replace)


def sending(wrap: Callable[[Callable[[Any], None]], Callable[[Any], None]]) -> Spoil:
    return sink(lambda _, __, made: setattr(made, "_send", wrap(made._send)))


def reporting(change: Callable[[HealthEvent], HealthEvent | None]) -> Spoil:
    """Change what is reported; None: it is not."""

    def replace(world: BadWorld, bridge: MemoryBridge, report: Any) -> Any:
        def reported(health: Health, cause: str, **about: Any) -> None:
            event = change(HealthEvent(bridge.name, health, cause, **about))
            if event is not None:
                report(event.health, event.cause, channel=event.channel, component=event.component)

        return reported

    return step("report", replace)


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


def unwraps(send: Callable[[Any], None]) -> Callable[[Any], None]:
    def sent(message: Any) -> None:
        try:
            send(message)
        except UoarmError as error:
            raise TypeError("not what this framework takes") from error

    return sent


class Altered:
    """A delivery that does something else with messages, or where one cannot be read."""

    def __init__(
        self,
        delivery: Delivery,
        give: Deliver | None = None,
        unreadable: Callable[[str], object] | None = None,
    ) -> None:
        self._delivery = delivery
        self._give = give
        self._unreadable = unreadable or delivery.unreadable

    def __call__(self, message: Message, writer: str = "") -> None:
        if self._give is None:
            self._delivery(message, writer)
        else:
            self._give(message)

    def let_go(self, writer: str = "") -> None:
        self._delivery.let_go(writer)

    def unreadable(self, why: str) -> None:
        self._unreadable(why)

    def readable(self) -> None:
        self._delivery.readable()


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


# Describing.


def boasts(world: BadWorld, bridge: MemoryBridge, describe: Any) -> Any:
    def described(endpoint: Endpoint) -> Description:
        try:
            return describe(endpoint)  # type: ignore[no-any-return]
        except BridgeError:
            return Description(MessageStructure({"type": "integer"}))

    return described


def refusing(text: str, reason: FailureReason) -> Spoil:
    def replace(world: BadWorld, bridge: MemoryBridge, describe: Any) -> Any:
        def described(endpoint: Endpoint) -> Description:
            try:
                return describe(endpoint)  # type: ignore[no-any-return]
            except BridgeError:
                raise BridgeError(text, reason) from None

        return described

    return step("_describe", replace)


def opens_nothing(world: BadWorld, bridge: MemoryBridge, opens: Any) -> Any:
    def opened(endpoint: Endpoint, structure: MessageStructure, deliver: Deliver) -> Source:
        try:
            return opens(endpoint, structure, deliver)  # type: ignore[no-any-return]
        except BridgeError:
            return Source(endpoint, lambda: None)

    return opened


def forgets_what_it_said(world: BadWorld, bridge: MemoryBridge, describe: Any) -> Any:
    count = iter(range(10**9))

    def described(endpoint: Endpoint) -> Description:
        said: Description = describe(endpoint)
        assert said.message is not None
        return evolve(said, message=evolve(said.message, native_type=f"Type{next(count)}"))

    return described


def schema_of(schema: Any) -> Spoil:
    said = Description(MessageStructure(schema))
    return step("_describe", lambda *_: lambda endpoint: said)


def takes_the_first_part(world: BadWorld, bridge: MemoryBridge, describe: Any) -> Any:
    return lambda endpoint: endpoint.address[0] and describe(endpoint)


def ghost(world: BadWorld, bridge: MemoryBridge, discover: Any) -> Any:
    seen = Discovered("ghost", ((at("ghost", Role.OUTPUT), Description()),))
    return lambda: (*discover(), seen)


def other_structure(world: BadWorld, bridge: MemoryBridge, discover: Any) -> Any:
    def discovered() -> tuple[Discovered, ...]:
        return tuple(
            evolve(
                component, endpoints=tuple((end, Description()) for end, _ in component.endpoints)
            )
            for component in discover()
        )

    return discovered


# Closing.


def joins_its_delivery(world: BadWorld, bridge: MemoryBridge) -> None:
    delivering_now = threading.Event()

    def wrap(deliver: Deliver) -> Deliver:
        def busy(message: Message) -> None:
            delivering_now.set()
            deliver(message)
            delivering_now.clear()

        return busy

    def change(_: BadWorld, __: MemoryBridge, made: Source) -> None:
        def close() -> None:
            while delivering_now.is_set() and not world.ended.wait(0.01):
                pass

        made._close = close  # type: ignore[method-assign]

    delivering(wrap)(world, bridge)
    source(change)(world, bridge)


def never_lets_go(world: BadWorld, bridge: MemoryBridge, made: Channel) -> None:
    made._close = world.ended.wait  # type: ignore[method-assign,assignment]


def closes_all(world: BadWorld, bridge: MemoryBridge, made: Source) -> None:
    def close() -> None:
        for channel in bridge._channels():
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
        for channel in bridge._channels():
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


def waits_for_the_link(world: BadWorld, bridge: MemoryBridge, made: Channel) -> None:
    close = made._close

    def closed() -> None:
        while bridge._is_cut and not world.ended.wait(0.01):
            pass
        close()

    made._close = closed  # type: ignore[method-assign]


# Declarations.


def declares(**changed: Any) -> Spoil:
    def declares_otherwise(world: BadWorld, _: MemoryBridge) -> None:
        made = {key: value(world) if callable(value) else value for key, value in changed.items()}
        world.declared = evolve(world.declared, **made)

    return declares_otherwise


OPEN = {**OPTIONS, "additionalProperties": True}
ANYTHING = {**OPTIONS, "properties": {"links": {}}}


def _crashes(_: BadWorld) -> Any:
    return lambda address, options: "" if address[0] else "empty"


def _forgets_options(world: BadWorld) -> Any:
    return lambda name, options: MemoryBridge(name)


# Services.


def describes_no_reply(world: BadWorld, bridge: MemoryBridge, describe: Any) -> Any:
    return lambda endpoint: evolve(describe(endpoint), reply=None)


def answers_others(world: BadWorld, bridge: MemoryBridge, call: Any) -> Any:
    """Give every caller the first reply."""
    kept: list[Message] = []

    def called(*given: Any) -> Message:
        kept.append(call(*given))
        return kept[0]

    return called


def serves_errors(world: BadWorld, bridge: MemoryBridge, serve: Any) -> Any:
    def served(endpoint: Endpoint, structures: Any, handler: Any) -> Any:
        def handle(request: Message) -> Message:
            try:
                return handler(request)
            except ArithmeticError:
                return {}

        return serve(endpoint, structures, handle)

    return served


def serves_on(world: BadWorld, bridge: MemoryBridge, serve: Any) -> Any:
    def served(*given: Any) -> Channel:
        serve(*given)
        return Channel(given[0], lambda: None)

    return served


def _only_once(close: Callable[[], None]) -> Callable[[], None]:
    closes = [close]

    def close_once() -> None:
        closes.pop()()

    return close_once


MESSAGES, ERRORS, WORDS = "messages", "errors", "what is there"
CLOSING, BLOCKING, HEALTH, WAITING = "closing", "blocking", "deaths", "waiting"
LINKS, OPTIONS_KIND, SERVICES = "reconnecting", "options", "services"

BUGS: tuple[Bug, ...] = (
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
    Bug(
        ERRORS,
        "swallows the refusal of what does not fit",
        sending(swallows),
        DisturbanceRules.test_a_message_that_fits_nothing_is_refused_in_words_or_carried,
        "was taken and vanished",
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
    Bug(
        WORDS,
        "describes what is not there",
        step("_describe", boasts),
        Describing.test_what_is_not_there_is_named,
        "DID NOT RAISE",
    ),
    Bug(
        WORDS,
        "does not name what is not there",
        refusing("not found", FailureReason.NOT_FOUND),
        Describing.test_what_is_not_there_is_named,
        "does not name it",
    ),
    Bug(
        WORDS,
        "gives a wrong reason for what is not there",
        refusing("nowhere: 404", FailureReason.RAISED),
        Describing.test_what_is_not_there_is_named,
        "expected NOT_FOUND or UNAVAILABLE",
    ),
    Bug(
        WORDS,
        "has the framework's own exception for an address without parts",
        step("_describe", takes_the_first_part),
        Describing.test_an_address_without_parts_is_refused,
        "expected NOT_FOUND or UNAVAILABLE or BAD_ENDPOINT",
    ),
    Bug(
        WORDS,
        "opens what is not there",
        step("_open_source", opens_nothing),
        Describing.test_what_is_not_there_does_not_open,
        "DID NOT RAISE",
    ),
    Bug(
        WORDS,
        "describes an endpoint anew each time",
        step("_describe", forgets_what_it_said),
        Describing.test_describing_twice_says_the_same,
        "was described by",
    ),
    Bug(
        WORDS,
        "describes with what is no JSON Schema",
        schema_of({"type": "byte"}),
        Describing.test_structures_are_valid_schemas_with_messages,
        "'byte' is not valid",
    ),
    Bug(
        WORDS,
        "describes what no message fits",
        schema_of({"type": "integer", "enum": []}),
        Describing.test_structures_are_valid_schemas_with_messages,
        "no message fits",
    ),
    Bug(
        WORDS,
        "discovers what cannot be described",
        step("_discover", ghost),
        Describing.test_discovered_components_can_be_described,
        "no component at ['ghost']",
    ),
    Bug(
        WORDS,
        "discovers other structures than it describes",
        step("_discover", other_structure),
        Describing.test_discovered_components_can_be_described,
        "is described by",
    ),
    Bug(
        WORDS,
        "has an attribute with the name of a step",
        step("_link", lambda *_: "a link"),
        Declaring.test_no_attribute_hides_a_step,
        "hide what `Bridge` has under these names: ['_link']",
    ),
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
        OPTIONS_KIND,
        "takes options that it does not know",
        declares(bridge_options=OPEN),
        Declaring.test_an_option_that_is_not_known_is_refused,
        "DID NOT RAISE",
    ),
    Bug(
        OPTIONS_KIND,
        "takes any value of an option",
        declares(bridge_options=ANYTHING),
        Declaring.test_an_option_of_a_wrong_type_is_refused,
        "'links' takes whatever it is given",
    ),
    Bug(
        OPTIONS_KIND,
        "does not hand its options on",
        declares(create=_forgets_options),
        Declaring.test_the_options_reach_the_bridge,
        ", got {}",
    ),
    Bug(
        OPTIONS_KIND,
        "fails at an address without parts",
        declares(check_endpoint=_crashes),
        Declaring.test_addresses_are_checked_in_words_without_the_framework,
        "index out of range",
    ),
    Bug(
        OPTIONS_KIND,
        "takes any address",
        declares(check_endpoint=lambda w: lambda address, options: ""),
        Declaring.test_addresses_are_checked_in_words_without_the_framework,
        "an address without parts is taken for right",
    ),
    Bug(
        SERVICES,
        "returns the request for the reply",
        step("_call", lambda *_: lambda endpoint, structures, message, timeout: message),
        ServiceRules.test_a_call_returns_the_reply,
        "the reply is {'value': 21}",
    ),
    Bug(
        SERVICES,
        "does not describe a reply",
        step("_describe", describes_no_reply),
        ServiceRules.test_a_service_is_described_by_request_and_reply,
        "it is described without a reply",
    ),
    Bug(
        SERVICES,
        "gives a caller the reply to another request",
        step("_call", answers_others),
        ServiceRules.test_several_threads_may_call_at_once,
        "the reply to {'value'",
    ),
    Bug(
        SERVICES,
        "ends a call that is late with an error of another class",
        step("_call", late_in_other_words),
        ServiceRules.test_a_service_that_is_silent_ends_in_time,
        "no reply came",
    ),
    Bug(
        SERVICES,
        "answers with nothing when a served function raises",
        step("_serve", serves_errors),
        ServiceRules.test_a_served_function_that_raises_fails_its_caller,
        "DID NOT RAISE",
    ),
    Bug(
        SERVICES,
        "serves on after the close",
        step("_serve", serves_on),
        ServiceRules.test_a_served_function_answers_until_it_is_closed,
        "DID NOT RAISE",
    ),
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
"""What a careful engineer gets wrong, and the kit finds."""

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


def table() -> str:
    """Return the table of the page: bug, the rule that catches it, what the test says."""
    rows = [f"| {bug.kind} | {bug.name} | {rule_of(bug.caught)} | `{bug.says}` |" for bug in BUGS]
    head = "| class | the bridge | the rule that catches it | the test says |"
    return "\n".join([head, "|---|---|---|---|", *rows])
