"""A line: both ends of a pair open on one bridge, and what came through it."""

from __future__ import annotations

import copy
import threading
from collections.abc import Iterator
from contextlib import contextmanager

import pytest
from attrs import frozen

from uoarm.bridge import Bridge, Sink, Source
from uoarm.errors import MessageError
from uoarm.model import Message, MessageStructure
from uoarm.schema import check
from uoarm.testing import _census
from uoarm.testing._collector import Background, Collector
from uoarm.testing._same import same
from uoarm.testing.conformance._types import with_octets
from uoarm.testing.conformance._world import Pair, World

__all__ = ["Line", "example_of", "hold_idle", "hold_idle_between", "line", "structure_of"]

_TRICKLE_SECONDS = 0.2


@frozen
class Line:
    """Messages go in at `sink` and arrive at `collector`."""

    world: World
    kind: str
    structure: MessageStructure
    sink: Sink
    source: Source
    collector: Collector

    def send(self, message: Message) -> None:
        """Send one message, its octets as bytes."""
        given = with_octets(self.structure.schema, message)
        before = copy.deepcopy(given)
        self.sink.send(given)
        assert same(given, before), f"sending changed the message from {before!r} to {given!r}"

    def example(self) -> Message:
        """Return a simple message of the structure."""
        return example_of(self.structure)

    def carries_or_refuses(self, message: Message) -> None:
        """Hold that a message comes out, or is refused in words where it cannot be sent."""
        if self.world.takes(self.kind, message):
            self.carries(message)
            return
        with pytest.raises(MessageError):
            self.send(message)

    def carries(self, *messages: Message) -> list[Message]:
        """Send messages, hold that they come out, each once and in order, and return them."""
        before = len(self.collector.messages)
        for message in messages:
            self.send(message)
        came = self.collector.wait(before + len(messages), self.world.patience)[before:]
        wanted = [self.world.carried(self.kind, message) for message in messages]
        for sent, got in zip(wanted, came, strict=False):
            assert same(got, sent), f"sent {sent!r}, came {got!r}"
        assert len(came) == len(wanted), f"{len(wanted)} were sent, {len(came)} came"
        return came


@contextmanager
def line(world: World, bridge: Bridge, kind: str) -> Iterator[Line]:
    """Open both ends, the receiving one first, and close them at the end."""
    pair = world.pair(kind)
    collector = Collector()
    structure = structure_of(bridge, pair, incoming=False)
    source = bridge.open_source(pair.source, structure, collector.deliver)
    try:
        sink = bridge.open_sink(pair.sink, structure_of(bridge, pair, incoming=True))
        try:
            yield Line(world, kind, structure, sink, source, collector)
        finally:
            sink.close()
    finally:
        source.close()


def hold_idle(world: World, bridge: Bridge, moment: str) -> None:
    """Hold that the bridge takes hardly any processor time, in this process and in its host."""
    others = () if bridge.process_id is None else (bridge.process_id,)
    _census.hold_idle(moment, *others, timeout=world.patience)


def hold_idle_between(through: Line, bridge: Bridge) -> None:
    """Hold the same while a message passes every now and then."""
    stop = threading.Event()

    def send() -> None:
        message = through.example()
        while not stop.wait(_TRICKLE_SECONDS):
            through.send(message)

    trickling = Background(send)
    try:
        hold_idle(through.world, bridge, "between messages")
    finally:
        stop.set()
    trickling.result(through.world.patience)


def structure_of(bridge: Bridge, pair: Pair, *, incoming: bool) -> MessageStructure:
    """Return what the bridge says of one end of a pair.

    Raises:
        AssertionError: it describes no message there.
    """
    endpoint = pair.sink if incoming else pair.source
    description = bridge.describe(endpoint)
    assert description.message is not None, f"{endpoint} is described without a message"
    return description.message


def example_of(structure: MessageStructure) -> Message:
    """Return a simple message of a structure: the one that shows that some message fits it.

    Raises:
        AssertionError: none does, or none is found.
    """
    verdict = check(structure.schema, False)
    assert verdict.compatible is False, f"no message fits {structure.schema}: {verdict}"
    return verdict.build_counterexample()
