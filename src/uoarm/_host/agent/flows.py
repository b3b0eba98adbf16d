"""The channels that a host has open for its manager, by number, and their flows."""

from __future__ import annotations

import logging
import threading
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager

from attrs import astuple, define, field

from uoarm._host.transport import keys
from uoarm._host.transport.codec import pack
from uoarm._host.transport.flow import FlowEnding, FlowReceiver, FlowSender
from uoarm._host.transport.shared_counters import HANDLING, SharedCounter, SharedCounters
from uoarm._host.transport.transport import Transport
from uoarm._raised import LimitedLog, Log, contained, foreign, is_raised, on_failure, text_of
from uoarm.bridge import Channel, NativeLink, Sink, Source, message_check
from uoarm.errors import BridgeError, UoarmError
from uoarm.model import Endpoint, Message, MessageStructure, to_json

_PATIENCE_SECONDS = 1.0
_log = Log("uoarm")


class OutboundFlow:
    """The messages of one source on their way to the manager.

    Args:
        counter: where how many messages the source has delivered is written down.

    Attributes:
        channel: the source, from when it is open.
        taken: how many messages the source has delivered, or tried to once it was closed.
    """

    def __init__(
        self, endpoint: Endpoint, outgoing: FlowSender, counter: SharedCounter | None
    ) -> None:
        self.endpoint = endpoint
        self._counter = counter
        self.taken = 0
        self.channel: Source | None = None
        self._outgoing = outgoing
        self._closed = False
        self._records = LimitedLog(_log)

    @property
    def sent(self) -> int:
        return self._outgoing.sent

    @property
    def skipped(self) -> int:
        """How many messages found no room."""
        return self._outgoing.skipped

    def deliver(self, message: Message, writer: str = "") -> None:
        """Send one message. Never raises: what cannot be sent is counted as lost."""
        self.count()
        try:
            self._outgoing.send(message, writer)
        except UoarmError as error:
            self._outgoing.skip()
            if not self._closed:
                self._records.write(logging.WARNING, f"{self.endpoint}: a message is lost: {error}")

    __call__ = deliver

    def let_go(self, writer: str = "") -> None:
        """Have nothing of a writer stand any more, behind the messages that were sent."""
        try:
            self._outgoing.let_go(writer)
        except BridgeError as error:
            if not self._closed:
                _log.warning("%s: what stands no more was not sent: %s", self.endpoint, error)

    def unreadable(self, why: str) -> None:
        """Have the manager take in that a message could not be read, as far as there is room."""
        try:
            self._outgoing.send_read(why)
        except BridgeError as error:
            if not self._closed:
                text = f"{self.endpoint}: what cannot be read was not reported: {why}: {error}"
                self._records.write(logging.WARNING, text)

    def readable(self) -> None:
        """Have the manager take in that something could be read."""
        self.unreadable("")

    def count(self) -> None:
        """Count one message as taken, whether it is sent or came too late.

        A death from here on finds both sides counted: what came of a message may wait long to be
        sent, and the message would be lost as well as what came of it delivered.
        """
        self.taken += 1
        if self._counter is not None:
            self._counter.set(self.taken)
            HANDLING.answered()

    def finish(self, ending: FlowEnding) -> None:
        """Send to the manager, behind the last message, that the source has ended."""
        try:
            self._outgoing.finish(ending)
        except BridgeError as error:
            _log.warning("%s: its end was not sent: %s", self.endpoint, error)

    def close(self) -> None:
        """Send nothing more."""
        self._closed = True
        self._outgoing.close()


class RaisedLog:
    """Logs here what a component raised: the manager gets its text, and not its traceback."""

    def __init__(self, endpoint: Endpoint, what: str) -> None:
        self._text = f"component {endpoint.component}: {what} raised"
        self._records = LimitedLog(f"uoarm.component.{endpoint.component}")

    def write(self, error: Exception) -> None:
        """Write what a step raised where that is the component's."""
        if is_raised(error):
            raised = error.__cause__ or error
            self._records.write(logging.WARNING, f"{self._text} {text_of(raised)}", raised)


@define
class _Open:
    channel: Channel
    outbound: OutboundFlow | None = None
    inbound: FlowReceiver | None = None
    facts: Mapping[str, object] = field(factory=dict)


class OpenFlows:
    """Opens, lists and closes flows. All methods may be called from any thread."""

    def __init__(self, transport: Transport, counters: SharedCounters | None) -> None:
        self._transport = transport
        self._counters = counters
        self._lock = threading.Lock()
        self._open: dict[int, _Open] = {}
        # Until it is closed, an input may move: what takes its place has it held here before.
        self._closing: dict[int, _Open] = {}
        # What may report before its opening has returned, by its ends; with the flow of a source.
        self._opening: dict[int, tuple[tuple[Endpoint, ...], OutboundFlow | None]] = {}

    @contextmanager
    def opening(
        self, number: int, *ends: Endpoint, outbound: OutboundFlow | None = None
    ) -> Iterator[None]:
        """Know a channel by its ends while the caller opens and lists it."""
        with self._lock:
            self._opening[number] = ends, outbound
        try:
            yield
        finally:
            with self._lock:
                del self._opening[number]

    @contextmanager
    def outbound(self, number: int, slot: int | None, endpoint: Endpoint) -> Iterator[OutboundFlow]:
        """Make the flow of a source, which the caller opens meanwhile and sets `channel` to."""
        outgoing = FlowSender(self._transport, keys.flow(number), _PATIENCE_SECONDS)
        outbound = OutboundFlow(endpoint, outgoing, self._counter(slot))
        with self.opening(number, endpoint, outbound=outbound):
            try:
                with on_failure(outbound.close):
                    yield outbound
            finally:
                if outbound.channel is not None:
                    outbound.channel.watch_refused(outbound.count)
                    outgoing.patience = max(_PATIENCE_SECONDS, outbound.channel.patience)
                    with self._lock:
                        self._open[number] = _Open(outbound.channel, outbound=outbound)

    def inbound(
        self, number: int, slot: int | None, sink: Sink, structure: MessageStructure
    ) -> None:
        """Feed a sink with the messages of a flow, of this structure, from now on."""
        name = f"{sink.endpoint.component}.{sink.endpoint.port}"
        moves = sink.endpoint.command is not None
        records = RaisedLog(sink.endpoint, f"its input {sink.endpoint.port!r}")

        def take(message: Message) -> None:
            try:
                sink.send(message, age=incoming.latency if moves else 0.0)
            except BaseException as error:
                # What is wrong itself is the failure of what gave it: most messages are unchecked.
                if is_raised(contained(error)):
                    message_check(structure, name)(message)
                records.write(contained(error))
                raise

        incoming = FlowReceiver(
            self._transport,
            keys.flow(number),
            name=name,
            take=take,
            ended=lambda _: None,
            counter=self._counter(slot),
        )
        with self._lock:
            self._open[number] = _Open(sink, inbound=incoming)

    def plain(self, number: int, channel: Channel) -> None:
        with self._lock:
            self._open[number] = _Open(channel)

    def sent(self, number: int) -> int:
        """Return how many messages of a source were sent."""
        found = self._open.get(number)
        return 0 if found is None or found.outbound is None else found.outbound.sent

    def handled(self, number: int, sent: int, timeout: float) -> bool:
        """Wait until a sink was handed the messages up to the number `sent`."""
        found = self._found(number)
        return found is None or found.inbound is None or found.inbound.drain(sent, timeout)

    def drain(self, number: int, sent: int, timeout: float) -> bool:
        """Wait until what a sink was sent, up to the number `sent`, has arrived."""
        deadline, found = time.monotonic() + timeout, self._found(number)
        if not self.handled(number, sent, timeout):
            return False
        return found is None or found.channel.drain(max(0.0, deadline - time.monotonic()))

    def sink(self, number: int) -> Sink | None:
        """Return an input that is open or being closed, None where this number has none."""
        found = self._found(number)
        return found.channel if found is not None and isinstance(found.channel, Sink) else None

    def _found(self, number: int) -> _Open | None:
        with self._lock:
            return self._open.get(number) or self._closing.get(number)

    def number_of(self, channel: Channel) -> int | None:
        """Return the number of a channel, also of one whose opening has not returned yet."""
        with self._lock:
            for number, value in self._open.items():
                if value.channel is channel:
                    return number
            opening = self._opening.items()
            return next((number for number, (ends, _) in opening if ends == _ends(channel)), None)

    def outbound_of(self, channel: Channel) -> OutboundFlow | None:
        """Return the flow of a source, also of one whose opening has not returned yet."""
        with self._lock:
            for open_ in self._open.values():
                if open_.channel is channel:
                    return open_.outbound
            opening = self._opening.values()
            return next((flow for ends, flow in opening if ends == _ends(channel)), None)

    def heartbeat(
        self,
    ) -> list[tuple[int, tuple[int, int, str, int, int, int] | None, Mapping[str, object]]]:
        """Return for every channel its number, how far a sink is, and the facts last looked at."""
        with self._lock:
            found = list(self._open.items())
        return [
            (n, None if open_.inbound is None else astuple(open_.inbound.handled()), _facts(open_))
            for n, open_ in found
        ]

    def look_at_facts(self) -> None:
        """Ask every channel for its facts; what one raises stands in their place."""
        with self._lock:
            found = list(self._open.values())
        for open_ in found:
            open_.facts = packable_facts(open_.channel.facts)

    def close(self, number: int, sent: int, timeout: float) -> int:
        """Close a channel and end its flow; return how many messages a source took. Idempotent.

        A sink is given a second to handle the messages up to the number `sent`.

        Raises:
            BridgeError: the framework failed while closing; the flow has ended all the same.
        """
        with self._lock:
            found = self._open.pop(number, None)
            if found is None:
                return 0
            self._closing[number] = found
        try:
            if found.inbound is not None:
                found.inbound.drain(sent, min(_PATIENCE_SECONDS, timeout / 2))
                found.inbound.close()
            found.channel.close(timeout=timeout)
        finally:
            with self._lock:
                del self._closing[number]
            if found.outbound is not None:
                found.outbound.close()
        return 0 if found.outbound is None else found.outbound.taken

    def _counter(self, slot: int | None) -> SharedCounter | None:
        return (
            None if slot is None or self._counters is None else SharedCounter(self._counters, slot)
        )


def packable_facts(look: Callable[[], Mapping[str, object]]) -> Mapping[str, object]:
    """Return what a bridge or channel knows; what it raises instead stands in its place."""
    try:
        facts = dict(foreign(look))
        pack(facts)
    except Exception as error:  # noqa: BLE001 - a framework may raise anything
        return {"facts": text_of(error)}
    return facts


def _ends(channel: Channel) -> tuple[Endpoint, ...]:
    if isinstance(channel, NativeLink):
        return channel.endpoint, channel.sink
    return (channel.endpoint,)


def _facts(one: _Open) -> Mapping[str, object]:
    """Return the facts last looked at; as they are now, the status of commands and what is lost."""
    if one.outbound is not None and one.outbound.skipped:
        return {**one.facts, keys.SKIPPED: one.outbound.skipped}
    command = one.channel.command_status() if isinstance(one.channel, Sink) else None
    return one.facts if command is None else {**one.facts, keys.COMMAND: to_json(command)}
