"""The remote bridge: the bridge contract on the manager's side of a host."""

from __future__ import annotations

import itertools
import logging
import threading
from collections.abc import Callable, Mapping
from contextlib import suppress
from functools import partial
from typing import TYPE_CHECKING, Any, final

from uoarm._host.process_connection import HostSettings, ProcessConnection
from uoarm._host.transport import keys
from uoarm._host.transport.flow import FlowEnding, FlowReceiver, FlowSender, Handled
from uoarm._host.transport.keys import COMMAND, SKIPPED
from uoarm._host.transport.shared_counters import SharedCounter
from uoarm._host.transport.transport import Reply, RequestWorkers, Transport
from uoarm._raised import on_failure
from uoarm._support import deadlines
from uoarm.bridge import (
    Bridge,
    Capabilities,
    Channel,
    Delivery,
    Description,
    Discovered,
    Handler,
    NativeLink,
    Outcomes,
    ServiceStructures,
    Sink,
    Source,
)
from uoarm.errors import BridgeError, FailureReason, UoarmError
from uoarm.model import (
    BridgeSpec,
    CommandStatus,
    Endpoint,
    Health,
    Message,
    MessageStructure,
    QueuePolicy,
    StopOutcome,
    from_json,
    to_json,
)

AskChannel = Callable[..., object]
"""Asks the host: an operation, then named values."""
if TYPE_CHECKING:
    from uoarm._host.machines import MachineConnection, MachineRegistry

_BLOCKING_SECONDS = 10.0
_PROMPT_SECONDS = 0.2
_CLOSE_SECONDS = 5.0
_CLOSE_SHARE = 0.4
_log = logging.getLogger("uoarm")


def _close_seconds() -> float:
    """Return what the host has to close something: a part of what who closes it waits."""
    return _CLOSE_SHARE * deadlines.left(_CLOSE_SECONDS)


class RemoteChannel(Channel):
    """A channel in a host through which no message of ours passes, such as a service.

    Args:
        number: its number in the host.
        when_closed: what else ends with it.
        given: what else its kind of channel takes.
    """

    def __init__(
        self,
        endpoint: Endpoint,
        number: int,
        ask: AskChannel,
        when_closed: Callable[[], None] = lambda: None,
        **given: Any,
    ) -> None:
        super().__init__(endpoint, **given)
        self.number = number
        self._ask = ask
        self._finally = when_closed
        self.host_facts: Mapping[str, object] = {}
        self._taken: int | None = None  # by its source in the host, once that is closed

    def facts(self) -> Mapping[str, object]:
        """Return what the host's framework knew of the link a second ago at most."""
        return self.host_facts

    def _close(self) -> None:
        try:
            taken = self._ask("close_channel", flow=self.number, sent=self._sent())
            self._taken = taken if isinstance(taken, int) else None
        finally:
            self._finally()

    def _sent(self) -> int:
        return 0

    def _lost_in_host(self) -> int:
        """Return what the bridge in the host says to have lost between it and its framework."""
        lost = self.host_facts.get("lost_on_link", 0)
        return lost if isinstance(lost, int) else 0


class RemoteLink(RemoteChannel, NativeLink):
    """A native link in a host."""


class RemoteSource(RemoteChannel, Source):
    """An output in a host; its messages arrive in a thread of their own.

    Attributes:
        counter: of the messages that the host took from its component; None: not known.
        given: how many were handed on.
    """

    incoming: FlowReceiver
    counter: SharedCounter | None = None
    given: int = 0

    def facts(self) -> Mapping[str, object]:
        """Return the host's facts, and what was lost on the link; latency in seconds."""
        given, lost = self.given, self.incoming.lost
        # Those at the end of a burst, after which nothing has come: known by a heartbeat only.
        skipped = self.host_facts.get(SKIPPED, 0)
        lost += max(0, skipped - self.incoming.skipped) if isinstance(skipped, int) else 0
        # Of one on another machine that is known at its end only.
        taken = self._taken or 0 if self.counter is None else self.counter.read()
        ours = {
            "under_way": max(0, taken - given - lost),
            "lost_on_link": lost + self._lost_in_host(),
            "link_latency": self.incoming.latency,
        }
        return {**{k: v for k, v in self.host_facts.items() if k != SKIPPED}, **ours}

    def drain(self, timeout: float) -> bool:
        """Wait until every message that the host has sent by now is delivered."""
        try:
            sent = self._ask("sent", flow=self.number, timeout=timeout)
        except UoarmError:
            return False
        return not isinstance(sent, int) or self.incoming.drain(sent, timeout)

    def _close(self) -> None:
        self.incoming.close()
        super()._close()


class RemoteSink(RemoteChannel, Sink):
    """An input in a host.

    `send` waits for room for 10 s at most where the host's own sink may block, else for 0.2 s.

    Attributes:
        counter: of the messages that the component in the host took; None: not known at once.
    """

    outgoing: FlowSender
    transport: Transport
    counter: SharedCounter | None = None

    def facts(self) -> Mapping[str, object]:
        """Return the host's facts, and what became of the messages sent."""
        outgoing = self.outgoing
        under_way = outgoing.unconfirmed
        if self.counter is not None:
            under_way = max(0, outgoing.sent - outgoing.lost - self.counter.read())
        ours = {
            "under_way": under_way,
            "lost_on_link": outgoing.lost + self._lost_in_host(),
            "failed_in_host": outgoing.failed,
            "last_error_in_host": outgoing.last_error,
        }
        return {**{k: v for k, v in self.host_facts.items() if k != COMMAND}, **ours}

    def watch(self, report: Outcomes) -> bool:
        """Have reported what the host says became of messages."""
        self.outgoing.watch(report)
        return True

    def hold(self, timeout: float) -> CommandStatus | None:
        """Have the host stop it; raises what becomes of asking it.

        Raises:
            BridgeError: the host did not answer: it may move until its lifetime is over.
        """
        held = self._ask("hold", flow=self.number, timeout=timeout)
        return None if held is None else from_json(held, CommandStatus)

    def halt(self, timeout: float) -> CommandStatus | None:
        """Have the host stop it, behind the commands that were sent by now, too.

        Raises:
            BridgeError: the host did not answer: it may move until its lifetime is over.
        """
        sent = self.outgoing.sent
        halted = self._ask("halt", flow=self.number, sent=sent, timeout=timeout)
        return None if halted is None else from_json(halted, CommandStatus)

    def begin_close(self) -> None:
        """Have the host stop what moves, and take no more; waits for nothing."""
        if self.endpoint.command is not None:
            with suppress(BridgeError):  # it is gone, or stands still: `close` finds that out
                self.transport.notify(keys.CLOSING, self.number.to_bytes(8, "big"))

    def release(self) -> None:
        """Have the host let commands through again."""
        self._ask("release", flow=self.number)

    def command_status(self) -> CommandStatus | None:
        """Return what the host said of it with its last heartbeat."""
        report = self.host_facts.get(COMMAND)
        return None if report is None else from_json(report, CommandStatus)

    def drain(self, timeout: float) -> bool:
        """Wait until the component has taken every message that was sent by now."""
        try:
            sent = self.outgoing.sent
            return bool(self._ask("drain", flow=self.number, sent=sent, timeout=timeout))
        except UoarmError:
            return False

    def _close(self) -> None:
        try:
            super()._close()
        finally:
            self.outgoing.close()

    def _send(self, message: Message) -> None:
        """Send one message to the host, where it is handed to the component."""
        self.outgoing.send(message)

    def _sent(self) -> int:
        return self.outgoing.sent


@final
class RemoteBridge(Bridge):
    """A bridge that runs in a process of its own, which this object starts and ends.

    One on another machine is only taken up and let go: its process is not this object's.

    Args:
        spec: name, plugin and options of the bridge; `spec.host` are the settings of its host.
        registry: where other machines join; for a host that has a `machine`.
        origin: the configuration file, which the host's command line shows.

    Raises:
        UoarmError: what the plugin raised when it was started in the host.
        BridgeError: the host could not be started, or is of another version.
        BridgeTimeoutError: it was not ready in time.
    """

    _is_last_hop = False

    def __init__(
        self, spec: BridgeSpec, registry: MachineRegistry | None = None, *, origin: str = ""
    ) -> None:
        super().__init__(spec.name, spec.options)
        self._numbers = itertools.count(1)
        self._channels: dict[int, RemoteChannel] = {}
        self._facts: Mapping[str, object] = {}
        # How the bridge in the host is by its own word, whether that answers or not.
        self._reported = Health.OK, ""
        self._services = RequestWorkers(f"uoarm-serve-{spec.name}")
        # Held while it is reported, as who asks meanwhile fails only after that: what opens
        # is then known to have died, and is replaced (`test_manager_hosts.py`).
        self._reporting_death = threading.RLock()
        self._has_reported_death = False
        settings = HostSettings.read(spec.host or {})
        connect: Callable[..., ProcessConnection | MachineConnection] = partial(
            ProcessConnection, origin=origin
        )
        if settings.machine is not None:
            if registry is None:
                text = f"bridge {spec.name!r} is on machine {settings.machine!r}: ask its manager"
                raise BridgeError(text, FailureReason.UNSUPPORTED)
            # Of the extra `machines`, which hosts on this machine do without.
            from uoarm._host.machines import MachineConnection  # noqa: PLC0415

            connect = partial(MachineConnection, registry, settings.machine)
        self._host = connect(
            spec,
            settings,
            on_answer=self._on_answer,
            on_doubt=self._on_doubt,
            on_death=self._on_death,
            on_health=self._on_health_event,
        )
        with on_failure(self._host.close, None):
            self.capabilities = from_json(self._host.greeting["capabilities"], Capabilities)

    @property
    def process(self) -> int:
        """The id of the host's process.

        Raises:
            BridgeError: it is another machine's.
        """
        return self._host.process

    @property
    def process_id(self) -> int | None:
        """The id of the host's process; None where it is another machine's."""
        return self._host.process if isinstance(self._host, ProcessConnection) else None

    def facts(self) -> Mapping[str, object]:
        """Return what the bridge in the host knew at the last heartbeat."""
        return self._facts

    def _describe(self, endpoint: Endpoint) -> Description:
        return from_json(self._ask("describe", endpoint=to_json(endpoint)), Description)

    def _discover(self) -> tuple[Discovered, ...]:
        return tuple(from_json(item, Discovered) for item in self._ask("discover"))

    def _open_source(
        self, endpoint: Endpoint, structure: MessageStructure, deliver: Delivery
    ) -> Source:
        number = next(self._numbers)
        channel = RemoteSource(endpoint, number, self._ask_to_close, lambda: self._drop(number))

        def ended(ending: FlowEnding) -> None:
            self.report(Health(ending.health), ending.cause, channel=channel)

        def give(message: Message, writer: str = "") -> None:
            channel.given += 1
            deliver(message, writer)

        def read(why: str) -> None:
            if why:
                deliver.unreadable(why)
            else:
                deliver.readable()

        channel.counter = self._counter()
        channel.incoming = FlowReceiver(
            self._host.transport,
            keys.flow(number),
            name=f"{endpoint.component}.{endpoint.port}",
            take=give,
            let_go=deliver.let_go,
            read=read,
            ended=ended,
        )
        self._channels[number] = channel
        try:
            opening = _opening(number, channel.counter, endpoint, structure)
            channel.latched, channel.depth = self._ask("source", **opening)
        except BaseException:
            if self._host.dead and channel.counter is not None and channel.counter.read():
                return channel  # it emitted: it was open, and died with what was under way
            channel.incoming.close()
            self._drop(number)
            raise
        return channel

    def _open_sink(self, endpoint: Endpoint, structure: MessageStructure) -> Sink:
        number = next(self._numbers)
        channel = RemoteSink(endpoint, number, self._ask_to_close, lambda: self._drop(number))
        channel.counter, channel.transport = self._counter(), self._host.transport
        channel.outgoing = FlowSender(self._host.transport, keys.flow(number), _PROMPT_SECONDS)
        if endpoint.command is not None and endpoint.command.stop is not None:
            self._host.moves = True
        self._channels[number] = channel  # before it is open: it may report while it opens
        with on_failure(self._drop, number), on_failure(channel.outgoing.close):
            opening = _opening(number, channel.counter, endpoint, structure)
            queue = self._ask("sink", **opening)
            channel.blocking = queue is not None
            if queue is not None:
                channel.default_queue = from_json(queue, QueuePolicy)
                channel.outgoing.patience = _BLOCKING_SECONDS
        if self._host.dead:
            channel.outgoing.cut(self._host.dead)
        return channel

    def _call(
        self, endpoint: Endpoint, structures: ServiceStructures, message: Message, timeout: float
    ) -> Message:
        number = next(self._numbers)
        with self.cancelling(lambda: self._ask("cancel_call", call=number)):
            return self._ask(
                "call",
                call=number,
                endpoint=to_json(endpoint),
                structures=to_json(structures),
                message=message,
                timeout=timeout,
            )

    def _serve(
        self, endpoint: Endpoint, structures: ServiceStructures, handler: Handler
    ) -> Channel:
        number = next(self._numbers)

        def take(message: Message, reply: Reply) -> None:
            self._services.answer(reply, lambda: handler(message))

        end = self._host.transport.answer(keys.service(number), take)

        def closed() -> None:
            end()
            self._drop(number)

        channel = RemoteChannel(endpoint, number, self._ask_to_close, closed)
        self._channels[number] = channel  # before it is open: it may report while it opens
        with on_failure(closed):
            self._ask(
                "serve",
                flow=number,
                endpoint=to_json(endpoint),
                structures=to_json(structures),
            )
        return channel

    def _link(self, source: Endpoint, sink: Endpoint) -> NativeLink | None:
        number = next(self._numbers)
        link = RemoteLink(source, number, self._ask_to_close, lambda: self._drop(number), sink=sink)
        self._channels[number] = link  # before it is open: it may report while it opens
        with on_failure(self._drop, number):
            if self._ask("link", flow=number, source=to_json(source), sink=to_json(sink)):
                return link
        self._drop(number)
        return None

    def _stop_all(self, release: bool, timeout: float) -> tuple[StopOutcome, ...]:  # noqa: FBT001
        outcomes = self._ask("stop_all", release=release, timeout=timeout)
        return tuple(from_json(outcome, StopOutcome) for outcome in outcomes)

    def _close(self) -> None:
        self._services.close()
        limit = _close_seconds()  # asked for in another thread
        self._host.close(lambda: self._ask("close", timeout=limit))

    def _ask(self, operation: str, **values: Any) -> Any:
        try:
            return self._host.ask(operation, values)
        finally:
            if self._host.dead:
                self._report_death()

    def _ask_to_close(self, operation: str, **values: Any) -> Any:
        """Ask about an open channel; one of a dead host is closed already."""
        try:
            if not self._host.dead:
                return self._host.ask(operation, {"timeout": _close_seconds(), **values})
        except UoarmError:
            if not self._host.dead:
                raise
        return None

    def _drop(self, number: int) -> None:
        channel = self._channels.pop(number, None)
        if isinstance(channel, RemoteSource | RemoteSink) and not self._host.dead:
            self._release(channel.counter)

    def _counter(self) -> SharedCounter | None:
        counters = self._host.counters
        return None if counters is None else counters.counter()

    def _release(self, counter: SharedCounter | None) -> None:
        if self._host.counters is not None:
            self._host.counters.take_back(counter)

    def _on_answer(self, answer: list[Any]) -> None:
        for number, handled, facts in answer:
            if number == keys.BRIDGE:
                self._facts = facts
            channel = self._channels.get(number)
            if channel is not None:
                channel.host_facts = facts
            if isinstance(channel, RemoteSink) and handled is not None:
                channel.outgoing.confirm(Handled(*handled))

    def _on_doubt(self, in_doubt: bool, cause: str) -> None:  # noqa: FBT001 - a callback
        if in_doubt:
            self.report(Health.DEGRADED, cause)
        else:
            health, why = self._reported
            self.report(health, cause if health is Health.OK else why)

    def _on_death(self, cause: str) -> None:
        for channel in list(self._channels.values()):
            if isinstance(channel, RemoteSink):
                channel.outgoing.cut(f"bridge host {self.name!r} died: {cause}")
        self._report_death()

    def _report_death(self) -> None:
        """Report the death once, when there is a listener; return when that was done."""
        with self._reporting_death:
            if self._listener is not None and not self._has_reported_death:
                self._has_reported_death = True
                self.report(Health.LOST, f"its bridge host died: {self._host.dead}")

    def _on_health_event(self, event: Mapping[str, Any], reply: Reply) -> None:
        health, cause = Health(event["health"]), event["cause"]
        if event["flow"] is None and event["component"] is None:
            self._reported = health, cause
        channel = self._channels.get(event["flow"])
        if channel is not None or event["flow"] is None:  # of one that is closed it is no news
            component, about = event["component"], event["about"]
            self.report(health, cause, channel=channel, component=component, about=about)
        reply(None)


def _opening(
    number: int, counter: SharedCounter | None, endpoint: Endpoint, structure: MessageStructure
) -> dict[str, Any]:
    return {
        "flow": number,
        "slot": None if counter is None else counter.slot,
        "endpoint": to_json(endpoint),
        "structure": to_json(structure),
    }
