"""What is open of a plan: components with their channels, and the edges between them."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterable, Iterator, Mapping
from functools import partial
from typing import Any

from attrs import define, evolve, field

from uoarm._adapt import transfer
from uoarm._bridges import close_logged, facts_of
from uoarm._dataplane import (
    Clock,
    FailureWatch,
    InputWatch,
    MessageCheck,
    Outlet,
    OutputWatch,
    Route,
    make_check,
)
from uoarm._raised import Log, foreign, text_of
from uoarm._safety import EmergencyStop, InputLease
from uoarm.bridge import Bridge, Channel, NativeLink, Sink, Source
from uoarm.errors import BridgeError, ConnectionClosedError, UoarmError
from uoarm.model import (
    ChannelStatus,
    CommandStatus,
    Component,
    Edge,
    Input,
    Message,
    MessageStructure,
    OverflowPolicy,
    QueuePolicy,
    RouteStatus,
    Step,
    ValidationMode,
)

_log = Log("uoarm")
_BUSY_SECONDS = 60.0
_OPEN_SECONDS = 60.0
_CLOSE_SECONDS = 2.0
_TURN_SECONDS = 0.1
_GLANCE_SECONDS = 0.005
_STOP_SECONDS = 0.5
_DRAIN_SECONDS = 5.0
_NEWEST = QueuePolicy(length=1, policy=OverflowPolicy.LATEST)
_LOSSES = frozenset({"under_way", "lost_on_link"})


class LiveComponent:
    """One component that at least one connection uses.

    Channels are opened when they are first needed and closed together. `close` never waits
    for a thread that is opening: that thread closes everything when it comes out.

    Args:
        step: of the first plan that needs it.
        failures: watches what it raises.
        emergency_stop: holds its inputs that move something.
        announce: called, with a sentence, when an input has another holder of its lease.

    Attributes:
        leases: of the inputs that one sender at a time may command, by name.
        watches: of the inputs, to which routes into them report what became of messages.
    """

    def __init__(
        self,
        step: Step,
        bridge: Bridge,
        failures: FailureWatch,
        emergency_stop: EmergencyStop,
        announce: Callable[[str], None],
    ) -> None:
        self._emergency_stop = emergency_stop
        self.component: Component = step.component
        # Guards what was replaced: a command that is sent here, in any thread, waits until all of
        # it has stopped; what is recalled is never stopped late by what had taken its place.
        self._stopping_replaced = threading.Lock()
        self._replaced: tuple[LiveComponent, ...] = ()
        self._are_replaced_stopped = True
        self.bridge = bridge
        self.structures = step.structures
        self.failures = failures
        self.outlets: dict[str, Outlet] = {}
        self.leases: dict[str, InputLease] = {}
        self._output_watches: dict[str, OutputWatch] = {}
        self.watches: dict[str, InputWatch] = {}
        for output in self.component.outputs:
            watch = self._output_watches[output.name] = OutputWatch(failures, output.name)
            self.outlets[output.name] = Outlet(watch)
        for input_ in self.component.inputs:
            name, policy = input_.name, input_.endpoint.command
            self.watches[name] = InputWatch(failures, name)
            if policy is not None and policy.lease is not None:
                place = f"{self.component.name}.{name}"
                self.leases[name] = InputLease(policy.lease, place, announce)
        self._sources: dict[str, Source] = {}
        self._sinks: dict[str, Sink] = {}
        # One for each input: where the component hangs in a message, no second thread enters it.
        self._turns: dict[str, threading.Lock] = {}
        self._closed: list[Channel] = []
        # Held while a channel opens, and while all are closed. What dooms it waits for no
        # opening: the thread that opens closes all as it comes out.
        self._busy = threading.Lock()
        self._doomed = False

    @property
    def is_closed(self) -> bool:
        """Whether it was closed, after its last user or its death."""
        return self._doomed

    @property
    def is_over(self) -> bool:
        """Whether it was closed, and none of its channels is open or opens any more."""
        return self._doomed and not self._busy.locked() and not self.channels

    def wait_over(self, timeout: float) -> None:
        """Wait until it `is_over`, but not for longer. Any thread but one that opens it."""
        deadline = time.monotonic() + timeout
        # By looking: to notify would cost each component an event, for a wait that seldom comes.
        pause = threading.Event()
        while not self.is_over and time.monotonic() < deadline:
            pause.wait(_GLANCE_SECONDS)

    @property
    def is_hanging(self) -> bool:
        """Whether a thread is still inside its code, in a message or in closing a channel."""
        return any(turn.locked() for turn in tuple(self._turns.values())) or any(
            channel.is_in_use for channel in tuple(self._closed)
        )

    @property
    def lost(self) -> int:
        """How many messages were lost with it, as known now.

        What its closed channels took and did not deliver, what came when they were closed, and
        what it emitted while no route took it, as it was being let go.
        """
        undelivered = sum(outlet.undelivered for outlet in self.outlets.values())
        return undelivered + sum(_lost(channel) for channel in tuple(self._closed))

    @property
    def channels(self) -> tuple[Channel, ...]:
        return (*self._sources.values(), *self._sinks.values())

    def open_output(self, name: str) -> None:
        """Have the output's messages delivered to its outlet.

        Raises:
            BridgeError: the bridge could not open it.
        """
        self._take_turn()
        try:
            if name not in self._sources:
                output = self.component.output(name)
                assert output is not None, "the resolver checked every output"
                source = self._sources[name] = self.bridge.open_source(
                    output.endpoint,
                    self.structures[f"output.{name}"],
                    self.outlets[name],
                    timeout=_OPEN_SECONDS,
                    on_late=self._closed.append,
                )
                self.outlets[name].retain(source.latched, source.depth)
        finally:
            self._end_turn()

    def open_input(
        self,
        port: Input,
        is_over: Callable[[], bool],
        admit: Callable[[Any], tuple[Message, float]] = lambda message: (message, 0.0),
    ) -> tuple[Callable[[Any], None], QueuePolicy | None]:
        """Return a send for one of its inputs, which connections share, and the queue it needs.

        None is needed where sending does not block. `admit` is asked of each command when its turn
        has come, and refuses it by raising, or gives what is to be sent and its age in seconds.

        One call at a time; one that waits for its turn ends with a ConnectionClosedError once
        `is_over`: where the component hangs, only one thread stays in it.

        Raises:
            BridgeError: the bridge could not open it.
        """
        name = port.name
        self._take_turn()
        try:
            if name not in self._sinks:
                self._turns[name] = threading.Lock()
                sink = self._sinks[name] = self.bridge.open_sink(
                    port.endpoint,
                    self.structures[f"input.{name}"],
                    timeout=_OPEN_SECONDS,
                )
                self._emergency_stop.enter(sink, self.component.function)
                watch = self.watches[name]
                watch.is_later = sink.watch(watch.reported)
            sink, turn = self._sinks[name], self._turns[name]
        finally:
            self._end_turn()

        if sink.endpoint.command is None:
            send = _in_turn(turn, is_over, sink.send)
            return send, sink.default_queue if sink.blocking else None

        def send_command(given: Any) -> None:
            self._emergency_stop.refuse(sink)
            message, age = admit(given)
            if not self._are_replaced_stopped:
                self._stop_replaced()
            sink.send(message, age)

        # Of commands that wait, only the newest one is worth sending.
        return _in_turn(turn, is_over, send_command), _NEWEST if sink.blocking else None

    def _stop_replaced(self) -> None:
        """Stop what was replaced; any other thread with a command for here waits for that."""
        with self._stopping_replaced:
            if not self._are_replaced_stopped:
                for live in self._replaced:
                    live.hold_inputs()
                self._are_replaced_stopped = True

    def recall(self, replaced: Iterable[LiveComponent], others: Iterable[LiveComponent]) -> None:
        """Take commands again after this was replaced, as it is used again. Bounded in time.

        Args:
            replaced: what runs now and is replaced by this.
            others: that may have come in its place, and would stop it with their first command.
        """
        # First: the first command of one that came in its place would stop it late, maybe after it
        # has been released below.
        for live in others:
            live.forget_replaced(self)
        # Also where nothing has stopped it yet: what the plan before commanded ends here.
        self.hold_inputs()
        self.replace(replaced)
        self.release_inputs()

    def replace(self, running: Iterable[LiveComponent]) -> None:
        """Come in the place of those of the same function.

        They are stopped, and take no commands any more, before the first one is sent here.

        Args:
            running: what runs now.
        """
        function = self.component.function
        with self._stopping_replaced:
            self._replaced = tuple(
                live for live in running if live is not self and live.component.function == function
            )
            self._are_replaced_stopped = not self._replaced

    def forget_replaced(self, live: LiveComponent) -> None:
        """Neither stop nor release a component any more in whose place this came."""
        with self._stopping_replaced:
            self._replaced = tuple(item for item in self._replaced if item is not live)

    def hold_inputs(self) -> None:
        """Stop the inputs that move something and have them refuse commands. Bounded in time."""
        for sink in tuple(self._sinks.values()):
            if sink.endpoint.command is not None:
                try:
                    sink.hold(_STOP_SECONDS)
                except UoarmError as error:  # it is gone, or its host is, which stops by itself
                    _log.warning("%s was replaced and not stopped: %s", sink.endpoint, error)

    def release_inputs(self) -> None:
        """Have the inputs take commands again, unless the emergency stop holds them."""
        for sink in tuple(self._sinks.values()):
            if sink.endpoint.command is not None and not self._emergency_stop.is_held:
                try:
                    sink.release()
                    # A stop that began since then has held it before, and would be undone.
                    if self._emergency_stop.held() is not None:
                        sink.hold(_STOP_SECONDS)
                except UoarmError as error:
                    _log.warning("%s goes on refusing commands: %s", sink.endpoint, error)

    def require_released(self, name: str) -> None:
        """Refuse a command to an open input while the emergency stop holds it.

        One that is closed takes nothing anyway, and says so itself.

        Raises:
            CommandRefusedError: it does.
        """
        sink = self._sinks.get(name)
        if sink is not None:
            self._emergency_stop.refuse(sink)

    def halt(self, name: str, timeout: float) -> CommandStatus | None:
        """Have an input stopped where a command lives still; see `Sink.halt`.

        None where it moves nothing, or is closed and was stopped with that.
        """
        sink = self._sinks.get(name)
        return None if sink is None else sink.halt(timeout)

    def check(
        self,
        output: str,
        structure: MessageStructure,
        mode: ValidationMode,
        *,
        is_suspected: bool = False,
    ) -> MessageCheck | None:
        """Return what checks messages of an output for one route, and blames this component."""
        place = f"{self.component.name}.{output}"
        watch = self._output_watches[output]
        return make_check(structure, mode, place, watch, is_suspected=is_suspected)

    def judge(self, output: str, structure: MessageStructure, message: Message) -> None:
        """Blame this component for a message of an output that does not match a structure.

        Raises:
            MessageError: it does not.
        """
        check = self.check(output, structure, ValidationMode.ALWAYS)
        assert check is not None, "only with OFF there is none"
        check(message)

    def drain(self, timeout: float) -> None:
        """Wait until what is under way in its channels has arrived; inputs first. Never raises.

        Waits `timeout` seconds for each channel at most.
        """
        for channel in (*self._sinks.values(), *self._sources.values()):
            try:
                foreign(channel.drain, timeout)
            except Exception as error:  # noqa: BLE001 - the others are drained all the same
                _log.warning("%s: draining failed: %s", channel.endpoint, text_of(error))

    def begin_close(self) -> None:
        """Have every input that moves something stopped, and take no more; waits for nothing."""
        for sink in tuple(self._sinks.values()):
            sink.begin_close()

    def close(self) -> None:
        """Close every channel; failures are logged. Bounded in time.

        Inputs first: what comes of the messages that were taken arrives, and is counted.
        """
        # Before the look for who opens: a thread that lets go of `_busy` after this look finds it,
        # and closes all itself (`_end_turn`). So one of the two does, and none waits for the other.
        self._doomed = True
        self._sweep()
        # Where opening it failed, what it was to replace goes on.
        with self._stopping_replaced:
            replaced, self._replaced = self._replaced, ()
        for live in replaced:
            if not live.is_closed:
                live.release_inputs()

    def channel_statuses(self) -> tuple[ChannelStatus, ...]:
        """Return what the status map shows of its channels."""
        return (
            *_channel_statuses("output", self._sources, {}, self.outlets),
            *_channel_statuses("input", self._sinks, self.leases, {}),
        )

    def _take_turn(self) -> None:
        """Open nothing beside another thread that does so already; end it with `_end_turn`."""
        if not self._busy.acquire(timeout=_BUSY_SECONDS):
            raise BridgeError(f"component {self.component.name!r} is still being opened")
        if self._doomed:
            self._end_turn()
            raise ConnectionClosedError(f"component {self.component.name!r} was closed")

    def _end_turn(self) -> None:
        self._busy.release()
        if self._doomed:
            self._sweep()

    def _sweep(self) -> None:
        while self._doomed and self.channels and self._busy.acquire(blocking=False):
            try:
                self._close_all()
            finally:
                self._busy.release()

    def _close_all(self) -> None:
        for channels in (self._sinks, self._sources):
            while channels:
                name, channel = next(iter(channels.items()))
                close_logged(partial(channel.close, timeout=_CLOSE_SECONDS))
                # Not before: what comes in its place asks here whether it has stopped.
                del channels[name]
                self._closed.append(channel)


def _in_turn(
    turn: threading.Lock, is_over: Callable[[], bool], send: Callable[[Any], None]
) -> Callable[[Any], None]:
    """Return a send that waits for its turn, but not when its caller waits no more."""

    def send_in_turn(given: Any) -> None:
        while not turn.acquire(timeout=_TURN_SECONDS):
            if is_over():
                raise ConnectionClosedError("the connection has ended")
        try:
            send(given)
        finally:
            turn.release()

    return send_in_turn


def _lost(channel: Channel) -> int:
    counts = (value for name, value in facts_of(channel) if name in _LOSSES)
    refused = channel.refused if isinstance(channel, Source) else 0
    return refused + sum(count for count in counts if isinstance(count, int))


def _channel_statuses(
    direction: str,
    channels: Mapping[str, Channel],
    leases: Mapping[str, InputLease],
    outlets: Mapping[str, Outlet],
) -> Iterator[ChannelStatus]:
    # A copy at once: channels open and close meanwhile.
    for name, channel in tuple(channels.items()):
        facts = facts_of(channel)
        if name in outlets and outlets[name].undelivered:
            facts = (*facts, ("undelivered", outlets[name].undelivered))
        if isinstance(channel, Source) and channel.unreadable:
            facts = (*facts, ("unreadable", channel.unreadable))
        lost = dict(facts).get("lost_on_link", 0)
        command = channel.command_status() if isinstance(channel, Sink) else None
        lost = lost if isinstance(lost, int) else 0
        policy = channel.endpoint.command
        lifetime, limits = (None, ()) if policy is None else (policy.lifetime, policy.limits)
        lease = leases[name].status() if name in leases else None
        yield ChannelStatus(f"{direction}.{name}", facts, lost, command, lifetime, limits, lease)


@define(eq=False)
class LiveEdge:
    """An edge between two open components.

    Args:
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
    link: NativeLink | None = field(default=None, init=False)
    _input: Input = field(init=False)
    # Guards the making of route and link: a switchover releases an edge that its batch opens.
    _ready: threading.Lock = field(factory=threading.Lock, init=False)
    # Held from the wish of the users to the check that follows from it, from the owner of the state
    # against threads that bring messages: of two that change it, the later one reads later.
    _checking: threading.Lock = field(factory=threading.Lock, init=False)

    @_input.default
    def _find_input(self) -> Input:
        return self.consumer.component.input(self.edge.input)

    @property
    def _ends(self) -> tuple[str, str]:
        edge = self.edge
        return f"{edge.producer}.{edge.output}", f"{edge.consumer}.{edge.input}"

    def open(self, clock: Clock) -> None:
        """Open it where it is not open yet, unchecked until `renew_check`.

        A native link that is held is left for `release`.

        Raises:
            BridgeError: a bridge could not open the input, or not link both ends.
        """
        with self._ready:
            if self.route is None and self.link is None:
                if not self._is_native:
                    self._open_route(clock)
                elif not self.held:
                    self._open_link(clock)

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
        self.renew_check()
        if self.route is not None:
            self.producer.open_output(self.edge.output)

    def renew_check(self, *, is_suspected: bool = False) -> None:
        """Check messages as its users wish now; never those of a native link. Any thread."""
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
            later = self.consumer.watches[self.edge.input].refusal
            return evolve(status, refusal=later) if later and not status.refusal else status
        if self.link is None:
            return None
        return RouteStatus(*self._ends, 0, 0, native=True, facts=facts_of(self.link))

    def finish(self) -> None:
        """Take nothing more from the producer, let what waits pass, then close."""
        if self.route is not None:
            self.producer.outlets[self.edge.output].detach(self.route)
            self.route.drain(_DRAIN_SECONDS)
        self.close()

    def close(self) -> None:
        """Close it, also for the second time."""
        if self.route is not None:
            self.consumer.watches[self.edge.input].suspect.pop(self, None)
            self.producer.outlets[self.edge.output].detach(self.route)
            self.route.close()
        if self.link is not None:
            close_logged(self.link.close)

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
        send, default_queue = self.consumer.open_input(self._input, lambda: route.closed)
        queue = self._input.queue or default_queue

        def hand(message: Message) -> None:
            if self.held:
                route.take_back("replaced")
            else:
                send(message)

        route = self.route = Route(
            *self._ends,
            hand if self.held else send,
            clock=clock,
            transfer=transfer(self.edge),
            queue=queue,
            watch=self.consumer.watches[self.edge.input],
        )
        route.judge = self._judge
        suspect = self.consumer.watches[self.edge.input].suspect
        suspect[self] = partial(self.renew_check, is_suspected=True)
        self.producer.outlets[self.edge.output].attach(route)
