"""Live edges: an output that feeds an input, through a route of ours or a native link."""

from __future__ import annotations

import logging
import threading
from collections.abc import Callable
from functools import partial

from attrs import define, evolve, field

from uoarm._adapt import transfer
from uoarm._control.live.bridges import facts_of
from uoarm._control.live.component import LiveComponent
from uoarm._dataplane import Clock, Route
from uoarm.bridge import Channel
from uoarm.errors import BridgeError
from uoarm.model import Edge, Input, Message, RouteStatus, ValidationMode

__all__ = ["LiveEdge"]

_DRAIN_SECONDS = 5.0
_log = logging.getLogger("uoarm")


@define(eq=False)
class LiveEdge:
    """An edge between two open components.

    Args:
        edge: of the plan.
        producer: the open component at its beginning.
        consumer: the open component at its end.
        strictness: gives how many messages its strictest user wishes to be checked now.
        held: whether messages wait for `release`, because another edge feeds the input still;
            those that come meanwhile are dropped and counted.
    """

    edge: Edge
    producer: LiveComponent
    consumer: LiveComponent
    strictness: Callable[[], ValidationMode]
    held: bool = False
    route: Route | None = field(default=None, init=False)
    link: Channel | None = field(default=None, init=False)
    _input: Input = field(init=False)
    _ready: threading.Lock = field(factory=threading.Lock, init=False)
    _checking: threading.Lock = field(factory=threading.Lock, init=False)

    @_input.default
    def _find_input(self) -> Input:
        return self.consumer.component.input(self.edge.input)

    @property
    def key(self) -> tuple[str, str]:
        """The input that it feeds."""
        return self.edge.consumer, self.edge.input

    @property
    def origin(self) -> tuple[str, str]:
        """The output that feeds it."""
        return self.edge.producer, self.edge.output

    def open(self, clock: Clock) -> None:
        """Open it where it is not open yet; a native link that is held is left for `release`.

        Raises:
            BridgeError: a bridge could not open the input, or not link both ends.
        """
        with self._ready:
            if self.route is None and self.link is None:
                if not self._is_native:
                    self._open_route(clock)
                elif not self.held:
                    self._open_link(clock)
            self.renew_check()

    def release(self, clock: Clock) -> None:
        """Let messages through from now on.

        Raises:
            BridgeError: a bridge could not link both ends.
        """
        if self.route is not None:
            with self.producer.outlets[self.edge.output].letting_through(self.route):
                self.held = False
        self.held = False
        self.open(clock)
        if self.route is not None:
            self.producer.open_output(self.edge.output)

    def renew_check(self) -> None:
        """Check messages as its users wish now; never those of a native link. Any thread."""
        self._check()

    def _check(self, *, is_suspected: bool = False) -> None:
        if self.route is None:
            return
        with self._checking:
            self.route.check = self.producer.check(
                self.edge.output,
                self.edge.producer_structure,
                self.strictness(),
                is_suspected=is_suspected,
            )

    def status(self) -> RouteStatus | None:
        """Return what the status map shows; None while the edge is being opened."""
        if self.route is not None:
            status = self.route.status()
            later = self.consumer.watch(self.edge.input).refusal
            return evolve(status, refusal=later) if later and not status.refusal else status
        if self.link is None:
            return None
        ends = ".".join(self.origin), ".".join(self.key)
        return RouteStatus(*ends, 0, 0, native=True, facts=facts_of(self.link))

    def finish(self) -> None:
        """Take nothing more from the producer, let what waits pass, then close."""
        if self.route is not None:
            self.producer.outlets[self.edge.output].detach(self.route)
            self.route.drain(_DRAIN_SECONDS)
        self.close()

    def close(self) -> None:
        """Close it, also for the second time."""
        if self.route is not None:
            self.consumer.watch(self.edge.input).suspect.pop(self, None)
            self.producer.outlets[self.edge.output].detach(self.route)
            self.route.close()
        if self.link is not None:
            try:
                self.link.close()
            except BridgeError as error:
                _log.warning("%s", error)

    @property
    def _is_native(self) -> bool:
        """Whether the bridge may connect both ends itself: they are its own, of one structure.

        Commands never go past the watchdog of their input.
        """
        bridge = self.producer.bridge
        return (
            bridge.capabilities.link
            and bridge is self.consumer.bridge
            and self.edge.mapping is None
            and self._input.endpoint.command is None
            and self.edge.producer_structure == self.edge.consumer_structure
        )

    def _judge(self, message: Message, is_adapted: bool) -> None:  # noqa: FBT001 - a callback
        edge = self.edge
        structure = edge.consumer_structure if is_adapted else edge.producer_structure
        self.producer.judge(edge.output, structure, message)

    def _open_link(self, clock: Clock) -> None:
        output = self.producer.component.output(self.edge.output)
        assert output is not None, "the resolver checked every output"
        self.link = self.producer.bridge.link(output.endpoint, self._input.endpoint)
        if self.link is None:
            self._open_route(clock)

    def _open_route(self, clock: Clock) -> None:
        send, default_queue = self.consumer.open_input(self.edge.input, lambda: route.closed)
        queue = self._input.queue or default_queue

        def hand(message: Message) -> None:
            if self.held:
                route.take_back("replaced")
            else:
                send(message)

        route = self.route = Route(
            ".".join(self.origin),
            ".".join(self.key),
            hand if self.held else send,
            clock=clock,
            transfer=transfer(self.edge),
            queue=queue,
            watch=self.consumer.watch(self.edge.input),
        )
        route.judge = self._judge
        suspect = self.consumer.watch(self.edge.input).suspect
        suspect[self] = partial(self._check, is_suspected=True)
        self.producer.outlets[self.edge.output].attach(route)
