"""A world whose bridges have one deliberate bug, and how a bug gets into one of its steps."""

from __future__ import annotations

import os
import threading
from collections.abc import Callable
from typing import Any

from attrs import frozen
from tests.testing.test_memory_conformance import OPTIONS, MemoryWorld, check

from uoarm.bridge import Bridge, BridgeType, Delivery, HealthEvent, Registry, Sink, Source
from uoarm.model import Deliver, Endpoint, Health, Message, MessageStructure, Options
from uoarm.testing import MemoryBridge


class BadWorld(MemoryWorld):
    """A world whose bridges have one bug; what hangs in them ends with the world."""

    def __init__(self, spoil: Spoil, patience: float) -> None:
        super().__init__()
        self._patience = patience
        self.spoil = spoil
        self.ended = threading.Event()
        self.leaks: list[tuple[int, int]] = []
        self.bridges: list[MemoryBridge] = []
        self.declared = BridgeType("memory", "for tests", self.create, OPTIONS, check, contract=2)
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


def noting_deliveries(world: BadWorld, bridge: MemoryBridge) -> threading.Event:
    """Return what is set while a message is delivered."""
    delivering_now = threading.Event()

    def wrap(deliver: Deliver) -> Deliver:
        def busy(message: Message) -> None:
            delivering_now.set()
            deliver(message)
            delivering_now.clear()

        return busy

    delivering(wrap)(world, bridge)
    return delivering_now


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


MESSAGES, ERRORS, WORDS = "messages", "errors", "what is there"


CLOSING, BLOCKING, HEALTH, WAITING = "closing", "blocking", "deaths", "waiting"


LINKS, OPTIONS_KIND, SERVICES = "reconnecting", "options", "services"
