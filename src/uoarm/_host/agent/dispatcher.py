"""The host's side of the contract: requests from the link become calls of the bridge."""

from __future__ import annotations

import time
from collections.abc import Callable, Hashable, Mapping
from functools import lru_cache
from threading import Event
from typing import Any, TypeVar, cast

from uoarm._host.agent.flows import OpenFlows, RaisedLog, packable_facts
from uoarm._host.transport import keys
from uoarm._host.transport.codec import pack, unpack
from uoarm._host.transport.flow import FlowEnding
from uoarm._host.transport.shared_counters import SharedCounters
from uoarm._host.transport.transport import ANSWER_SECONDS, Reply, RequestWorkers, Transport
from uoarm._raised import Log
from uoarm._support.workers import WorkerPool
from uoarm._version import __version__
from uoarm.bridge import CONTRACT_VERSION, Bridge, HealthEvent, ServiceStructures, Source
from uoarm.errors import BridgeError, FailureReason, UoarmError
from uoarm.model import Endpoint, Health, Message, MessageStructure, from_json, to_json

_log = Log("uoarm")

Request = Mapping[str, Any]
T = TypeVar("T")
_REMEMBERED = 256  # 1 MiB of what was written at most, and what was read of it
_REMEMBERED_OCTETS = 4096


class RequestDispatcher:
    """Answers a manager's requests with a bridge, each in a thread of its own.

    Args:
        end: called when the manager has closed the bridge.
        counters: where flows are counted; None where the manager shares no memory.
        before_moving: called before an input is opened that must be stopped when all else ends.
    """

    def __init__(
        self,
        bridge: Bridge,
        transport: Transport,
        end: Callable[[], object],
        counters: SharedCounters | None = None,
        *,
        before_moving: Callable[[], object] = lambda: None,
    ) -> None:
        self._bridge = bridge
        self._transport = transport
        self._flows = OpenFlows(transport, counters)
        self._workers = RequestWorkers("uoarm-ask")
        self._reporter = WorkerPool("uoarm-report", 1)
        self._looker = WorkerPool("uoarm-look", 1)
        self._looking = Event()
        self._raised: dict[str, RaisedLog] = {}  # of services, by component
        self._facts: Mapping[str, object] = {}
        self._end = end
        self._before_moving = before_moving
        self._operations: dict[str, Callable[[Request], Any]] = {
            "hello": self._hello,
            "describe": self._describe,
            "discover": self._discover,
            "source": self._source,
            "sink": self._sink,
            "call": self._call,
            "cancel_call": lambda request: self._bridge.cancel_call(request["call"]),
            "serve": self._serve,
            "link": self._native_link,
            "sent": lambda request: self._flows.sent(request["flow"]),
            "drain": lambda request: self._flows.drain(
                request["flow"], request["sent"], request["timeout"]
            ),
            "hold": self._hold,
            "halt": self._halt,
            "release": self._release,
            "stop_all": self._stop_all,
            "close_channel": lambda request: self._flows.close(
                request["flow"], request["sent"], request["timeout"]
            ),
            "close": lambda request: self._bridge.close(timeout=request["timeout"]),
        }

    def begin(self) -> None:
        """Answer from now on, then show that the host is alive."""
        self._bridge.watch(self._noticed)
        self._transport.answer(keys.ASK, self._take)
        self._transport.listen(keys.CLOSING, self._begin_close)
        self._transport.answer(keys.HEARTBEAT, self._beat)
        self._transport.show_alive(keys.ALIVE)

    def end(self) -> None:
        """Take no more requests; those under way end alone."""
        self._workers.close()
        self._reporter.close()
        self._looker.close()

    def _beat(self, _: Any, reply: Reply) -> None:
        """Answer a heartbeat at once; facts, which may take their time, are for the next one."""
        reply([*self._flows.heartbeat(), (keys.BRIDGE, None, self._facts)])
        if not self._looking.is_set():
            self._looking.set()
            self._looker.submit(self._look)

    def _look(self) -> None:
        try:
            self._flows.look_at_facts()
            self._facts = packable_facts(self._bridge.facts)
        finally:
            self._looking.clear()

    def _take(self, request: Request, reply: Reply) -> None:
        operation = self._operations.get(request["op"])
        if operation is None:
            text = f"the bridge host knows no operation {request['op']!r}"
            raise BridgeError(text, FailureReason.CONTRACT)
        last = request["op"] == "close"

        def answer(value: Any) -> None:
            reply(value)
            if last:
                self._end()

        self._workers.answer(answer, lambda: operation(request))

    def _hello(self, request: Request) -> Any:
        del request
        return {
            "protocol": keys.PROTOCOL_VERSION,
            "contract": CONTRACT_VERSION,
            "version": __version__,
            "capabilities": to_json(self._bridge.capabilities),
        }

    def _describe(self, request: Request) -> Any:
        endpoint = _read(request["endpoint"], Endpoint)
        return to_json(self._bridge.describe(endpoint, timeout=ANSWER_SECONDS))

    def _discover(self, request: Request) -> Any:
        del request
        return [to_json(component) for component in self._bridge.discover(timeout=ANSWER_SECONDS)]

    def _source(self, request: Request) -> Any:
        endpoint, structure = _port(request)
        with self._flows.outbound(request["flow"], request["slot"], endpoint) as outbound:
            outbound.channel = source = self._bridge.open_source(
                endpoint, structure, outbound, timeout=ANSWER_SECONDS
            )
        return [source.latched, source.depth]

    def _sink(self, request: Request) -> Any:
        """Open a sink; return the queue that belongs before it, None: it does not block."""
        endpoint, structure = _port(request)
        if endpoint.command is not None and endpoint.command.stop is not None:
            self._before_moving()
        with self._flows.opening(request["flow"], endpoint):
            sink = self._bridge.open_sink(endpoint, structure, timeout=ANSWER_SECONDS)
            self._flows.inbound(request["flow"], request["slot"], sink, structure)
        return to_json(sink.default_queue) if sink.blocking else None

    def _call(self, request: Request) -> Message:
        endpoint = _read(request["endpoint"], Endpoint)
        structures = _read(request["structures"], ServiceStructures)
        message, limit, number = request["message"], request["timeout"], request["call"]
        try:
            return self._bridge.call(endpoint, message, structures, timeout=limit, number=number)
        except BridgeError as error:
            records = self._raised.get(endpoint.component)
            if records is None:
                records = self._raised[endpoint.component] = RaisedLog(endpoint, "the service")
            records.write(error)
            raise

    def _serve(self, request: Request) -> None:
        endpoint = _read(request["endpoint"], Endpoint)
        structures = _read(request["structures"], ServiceStructures)
        key = keys.service(request["flow"])

        def handle(message: Message) -> Message:
            return self._transport.ask(key, message)

        with self._flows.opening(request["flow"], endpoint):
            channel = self._bridge.serve(endpoint, handle, structures, timeout=ANSWER_SECONDS)
            self._flows.plain(request["flow"], channel)

    def _native_link(self, request: Request) -> bool:
        source = _read(request["source"], Endpoint)
        sink = _read(request["sink"], Endpoint)
        with self._flows.opening(request["flow"], source, sink):
            channel = self._bridge.link(source, sink, timeout=ANSWER_SECONDS)
            if channel is not None:
                self._flows.plain(request["flow"], channel)
        return channel is not None

    def _hold(self, request: Request) -> Any:
        sink = self._flows.sink(request["flow"])
        return None if sink is None else to_json(sink.hold(request["timeout"]))

    def _halt(self, request: Request) -> Any:
        """Stop at once, and again after the commands that the manager sent before it asked."""
        flow, timeout = request["flow"], request["timeout"]
        sink = self._flows.sink(flow)
        if sink is None:
            return None
        deadline = time.monotonic() + timeout
        sink.halt(timeout)
        self._flows.handled(flow, request["sent"], max(0.0, deadline - time.monotonic()))
        return to_json(sink.halt(max(0.0, deadline - time.monotonic())))

    def _release(self, request: Request) -> None:
        sink = self._flows.sink(request["flow"])
        if sink is not None:
            sink.release()

    def _stop_all(self, request: Request) -> Any:
        outcomes = self._bridge.stop_all(release=request["release"], timeout=request["timeout"])
        return [to_json(outcome) for outcome in outcomes]

    def _begin_close(self, number: bytes) -> None:
        sink = self._flows.sink(int.from_bytes(number, "big"))
        if sink is not None:
            sink.begin_close()

    def _noticed(self, event: HealthEvent) -> None:
        """Take an event in the bridge's thread; what concerns a source goes with its messages."""
        channel = event.channel
        if channel is not None and channel.closed:
            return
        if isinstance(channel, Source) and event.health in {Health.FINISHED, Health.LOST}:
            outbound = self._flows.outbound_of(channel)
            if outbound is not None:
                outbound.finish(FlowEnding(event.health.value, event.cause))
                return
        reports = {
            "health": event.health.value,
            "cause": event.cause,
            "flow": None if channel is None else self._flows.number_of(channel),
            "component": event.component or (channel and channel.endpoint.component),
            "about": event.about,
        }
        self._reporter.submit(self._report, reports)

    def _report(self, report: Mapping[str, Any]) -> None:
        try:
            self._transport.ask(keys.HEALTH, report, timeout=5.0)
        except UoarmError as error:
            _log.warning("the manager has no report of %s: %s", report, error)


def _port(request: Request) -> tuple[Endpoint, MessageStructure]:
    endpoint = _read(request["endpoint"], Endpoint)
    return endpoint, _read(request["structure"], MessageStructure)


def _read(data: Any, kind: type[T]) -> T:
    """Return what `from_json` returns; of what came before, the very same value.

    A manager asks for the same few ports and services again and again.
    """
    written = pack(data)
    if len(written) > _REMEMBERED_OCTETS:
        return from_json(data, kind)
    found: T = _read_once(written, cast("Hashable", kind))
    return found


@lru_cache(_REMEMBERED)
def _read_once(written: bytes, kind: Any) -> Any:
    return from_json(unpack(written), kind)
