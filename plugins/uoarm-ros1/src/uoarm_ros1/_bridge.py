"""The bridge: which thing of ROS 1 stands behind each step of the contract."""

from __future__ import annotations

import logging
import os
import threading
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, suppress
from functools import partial
from typing import TypeVar
from weakref import WeakSet

from uoarm.bridge import (
    Bridge,
    Capabilities,
    Channel,
    Delivery,
    Description,
    Discovered,
    Handler,
    LimitedLog,
    NativeLink,
    ServiceStructures,
    Sink,
    Source,
    did_you_mean,
    on_failure,
)
from uoarm.errors import BridgeError, FailureReason
from uoarm.model import Endpoint, Health, Message, MessageStructure, Role
from uoarm_ros1._actions import ActionCaller, ServedAction, described_action
from uoarm_ros1._channels import (
    Relay,
    Ros1TopicSink,
    Ros1TopicSource,
    SameTopic,
    TopicPlace,
)
from uoarm_ros1._definitions import DefinitionError, RosRecord, RosService, record_of
from uoarm_ros1._discovery import Graph, discovered
from uoarm_ros1._health import LostComponents, MasterHealth
from uoarm_ros1._node import Clock, Node, Rosout
from uoarm_ros1._options import (
    NodeIdentity,
    Ros1Address,
    Ros1BridgeOptions,
    Ros1Options,
    address_of,
    port_of,
)
from uoarm_ros1._parameters import Ros1ParameterSink, Ros1ParameterSource, parameter_structure
from uoarm_ros1._services import Caller, ServedService, probe_service
from uoarm_ros1._subscription import PublisherHeader
from uoarm_ros1._types import TypeStore, described_service

_log = logging.getLogger("uoarm.ros1")
_TICK_SECONDS = 0.25
_JOIN_SECONDS = 1.0
_LATELY_SECONDS = 1.0
_AWAY = frozenset({FailureReason.NOT_FOUND, FailureReason.UNAVAILABLE})
C = TypeVar("C", bound=Channel)
T = TypeVar("T")
_Ticking = Ros1TopicSource | Ros1TopicSink | Relay | SameTopic


class Ros1Bridge(Bridge):
    """One node of ROS 1, of our own making.

    Messages are delivered in the thread of the connection on which they come, requests to what is
    offered in one for each client. One thread watches sockets, one the master.
    """

    capabilities = Capabilities(discover=True, call=True, serve=True, link=True)

    def __init__(self, name: str, options: Ros1BridgeOptions) -> None:
        super().__init__(name, options)
        self._options = options
        self._types = TypeStore(options.definitions)
        identity = NodeIdentity.of(name, options, os.environ)
        self._node = Node(identity, options, self._asked_to_end)
        self._master_health, self._lost = MasterHealth(), LostComponents()
        self._master_identity: object = None  # of the one that has all registrations
        self._callers: dict[tuple[str, str], Caller | ActionCaller] = {}
        # Guards the callers, and what was lost, between steps and the watch.
        self._table_lock = threading.Lock()
        self._ticking: WeakSet[_Ticking] = WeakSet()
        self._served: WeakSet[ServedService] = WeakSet()
        self._closing = threading.Event()
        self._records = LimitedLog(_log)
        self._watch = threading.Thread(
            target=self._look_around, name=f"uoarm-ros1-watch-{name}", daemon=True
        )
        with on_failure(self._node.close):  # a bridge that was never made is never closed
            self._rosout = Rosout(self._node, self._types) if options.rosout else None
            self._clock = Clock(self._node, self._types) if options.use_sim_time else None
            self._watch.start()

    def report(
        self,
        health: Health,
        cause: str,
        *,
        channel: Channel | None = None,
        component: str | None = None,
        about: str = "",
    ) -> None:
        """Report a change, and say it on /rosout."""
        if health is Health.LOST and channel is not None:
            end, is_silent = channel.endpoint, getattr(channel, "is_silent", False)
            if isinstance(channel, NativeLink) and component == channel.sink.component:
                end, is_silent = channel.sink, False
            self._remember(end, may_answer=not is_silent)
        super().report(health, cause, channel=channel, component=component, about=about)
        if self._rosout is not None:
            self._rosout.say(health, cause)

    def facts(self) -> Mapping[str, object]:
        """Return how often the thread that watches sockets turned for nothing."""
        return {"empty_turns": self._node.loop.turns.empty}

    def _describe(self, endpoint: Endpoint) -> Description:
        try:
            return self._seeing(partial(self._described, endpoint))
        except BridgeError as error:
            if error.reason in _AWAY:
                self._remember(endpoint)
            raise

    def _seeing(self, step: Callable[[Graph], T]) -> T:
        """Do a step with what the master has said lately; where that does not do, ask it anew.

        A robot of hundreds of topics would be asked for all of them by each that opens.
        """
        began = time.monotonic()
        graph = Graph(self._node, began - _LATELY_SECONDS)
        try:
            return step(graph)
        except BridgeError as error:
            if error.reason not in _AWAY or graph.is_since(began):
                raise
        return step(Graph(self._node))

    def _described(self, endpoint: Endpoint, graph: Graph) -> Description:
        address, port = address_of(endpoint), port_of(endpoint)
        if address.is_parameter:
            return Description(parameter_structure(self._node, endpoint, address))
        if endpoint.role is Role.SERVICE:
            return self._describe_service(endpoint, address, port, graph)
        topic = self._node.resolve(address.name)
        record = self._record(endpoint, topic, address, port, graph)
        self._require_peer(endpoint, topic, port, graph)
        return Description(record.structure)

    def _describe_service(
        self, endpoint: Endpoint, address: Ros1Address, port: Ros1Options, graph: Graph
    ) -> Description:
        name = self._node.resolve(address.name)
        if self._is_action(endpoint, address, name, graph):
            return described_action(graph, self._types, endpoint, name, address, port)
        if endpoint.is_offered or not port.peer_required:
            if not address.type:
                return Description()
            return described_service(self._types.require_service(address.type, port.definition))
        return described_service(self._service(endpoint, name, address, port))

    def _is_action(self, endpoint: Endpoint, address: Ros1Address, name: str, graph: Graph) -> bool:
        if endpoint.role is not Role.SERVICE:
            return False
        if address.type:
            return address.is_action
        return not endpoint.is_offered and f"{name}/goal" in graph.types

    def _service(
        self, endpoint: Endpoint, name: str, address: Ros1Address, port: Ros1Options
    ) -> RosService:
        """Return the type of a service that is there; what its server says of it must be ours."""
        kind, md5 = probe_service(self._node, name)
        if address.type and kind and kind != address.type:
            text = f"{endpoint}: {name} is served as {kind}"
            raise BridgeError(text, FailureReason.BAD_ENDPOINT)
        kind = kind or address.type
        if not kind:
            text = f"{endpoint}: the server of {name} does not say its type: add it to the address"
            raise BridgeError(text, FailureReason.UNSUPPORTED)
        found = self._types.require_service(kind, port.definition)
        if md5 not in {"*", found.md5}:
            text = (
                f"{endpoint}: {name} is served as {kind} with md5sum {md5}, and the definition "
                f"here has {found.md5}: name a folder with that of the server in `definitions`"
            )
            raise BridgeError(text, FailureReason.UNSUPPORTED)
        return found

    def _record(
        self,
        endpoint: Endpoint,
        topic: str,
        address: Ros1Address,
        port: Ros1Options,
        graph: Graph,
    ) -> RosRecord:
        """Return the type of a topic: as its publishers have it, else as it is defined here."""
        if endpoint.is_offered and address.type:
            return self._types.require(address.type, port.definition)
        header = self._publisher_header(endpoint, topic, address, port, graph)
        if header is None:
            kind = address.type or graph.types.get(topic, "")
            if not kind:
                text = f"{endpoint}: no node publishes {topic}, and its type is in no address"
                raise BridgeError(text, FailureReason.NOT_FOUND)
            return self._types.require(kind, port.definition)
        reasons = []
        if header.definition and not port.definition:
            try:
                record = record_of(header.kind, header.definition)
                if record.md5 == header.md5:
                    return record
                reasons.append(f"its definition as it sends it has {record.md5}")
            except DefinitionError as error:
                reasons.append(f"what it sends as definition cannot be read: {error}")
        # Nodes of some makes send none, or one that does not fit: the sum says which is meant.
        try:
            record = self._types.require(header.kind, port.definition)
        except BridgeError as error:
            if not reasons:
                raise
            reasons.append(str(error))
        else:
            if record.md5 == header.md5:
                return record
            reasons.append(f"its definition here has {record.md5}")
        text = (
            f"{endpoint}: {header.node} publishes {header.kind} with md5sum {header.md5}, and "
            f"{'; '.join(reasons)}"
        )
        raise BridgeError(text, FailureReason.UNSUPPORTED)

    def _publisher_header(
        self, endpoint: Endpoint, topic: str, address: Ros1Address, port: Ros1Options, graph: Graph
    ) -> PublisherHeader | None:
        """Return what a publisher of a topic says, None where an endpoint can do without.

        Raises:
            BridgeError: none is there that is required, or none of them answers.
        """
        publishers = graph.state.publishers.get(topic, ())
        is_output = endpoint.role is Role.OUTPUT
        if is_output and port.node:
            meant = self._node.resolve(port.node)
            publishers = tuple(name for name in publishers if name == meant)
        failures = []
        # Of those that were registered last first: who was killed stays registered before them.
        for name in reversed(publishers):
            header = graph.header(name, topic, address.type)
            if isinstance(header, PublisherHeader):
                return header
            failures.append(f"{name}: {header}")
        if not is_output or not port.peer_required:
            return None
        if failures:
            text = f"{endpoint}: no publisher of {topic} answers: {'; '.join(failures)}"
            raise BridgeError(text, FailureReason.UNAVAILABLE)
        who = f"node {port.node} does not publish" if port.node else "no node publishes"
        known = graph.state.publishers
        text = f"{endpoint}: {who} {topic}"
        text += graph.seen_as(topic, address.type, () if port.node else known)
        if port.node:
            text += did_you_mean(self._node.resolve(port.node), known.get(topic, ()))
        raise BridgeError(text, FailureReason.NOT_FOUND)

    def _require_peer(
        self, endpoint: Endpoint, topic: str, port: Ros1Options, graph: Graph
    ) -> None:
        """Refuse an input to which no node that lives subscribes."""
        if endpoint.role is not Role.INPUT or not port.peer_required:
            return
        subscribers = graph.state.subscribers.get(topic, ())
        if port.node:
            meant = self._node.resolve(port.node)
            subscribers = tuple(name for name in subscribers if name == meant)
        if not subscribers:
            who = f"node {port.node} does not subscribe" if port.node else "no node subscribes"
            known = graph.state.subscribers
            text = f"{endpoint}: {who} to {topic}"
            text += graph.seen_as(topic, address_of(endpoint).type, () if port.node else known)
            if port.node:
                text += did_you_mean(self._node.resolve(port.node), known.get(topic, ()))
            raise BridgeError(text, FailureReason.NOT_FOUND)
        if not graph.living(subscribers):
            text = (
                f"{endpoint}: of the subscribers of {topic} none answers: {', '.join(subscribers)}"
            )
            raise BridgeError(text, FailureReason.UNAVAILABLE)

    def _open_source(
        self, endpoint: Endpoint, structure: MessageStructure, deliver: Delivery
    ) -> Source:
        del structure  # the type is in the address, or its publishers say it
        address, port = address_of(endpoint), port_of(endpoint)
        if address.is_parameter:
            parameter = Ros1ParameterSource(
                self._node, endpoint, address, deliver, self.report_channel
            )
            return self._opened_at(parameter)
        topic = self._node.resolve(address.name)
        record = self._seeing(partial(self._record, endpoint, topic, address, port))
        return self._opened_at(Ros1TopicSource(self._place(endpoint, topic, port), record, deliver))

    def _open_sink(self, endpoint: Endpoint, structure: MessageStructure) -> Sink:
        del structure
        address, port = address_of(endpoint), port_of(endpoint)
        if address.is_parameter:
            return self._opened_at(Ros1ParameterSink(self._node, endpoint, address))
        topic = self._node.resolve(address.name)
        record = self._seeing(partial(self._record, endpoint, topic, address, port))
        return self._opened_at(Ros1TopicSink(self._place(endpoint, topic, port), record))

    def _call(
        self, endpoint: Endpoint, structures: ServiceStructures, message: Message, timeout: float
    ) -> Message:
        del structures
        address, port = address_of(endpoint), port_of(endpoint)
        name = self._node.resolve(address.name)
        with self._table_lock:
            caller = self._callers.get((name, address.type))
        if caller is None:
            caller = self._new_caller(endpoint, name, address, port)
        try:
            return caller.call(endpoint, message, timeout, self.cancelling)
        except BridgeError as error:
            if error.reason is FailureReason.UNAVAILABLE:  # another may serve it by then
                self._forget_caller(name, address.type, caller)
                self._remember(endpoint)
            raise

    def _new_caller(
        self, endpoint: Endpoint, name: str, address: Ros1Address, port: Ros1Options
    ) -> Caller | ActionCaller:
        made: Caller | ActionCaller
        if self._is_action(endpoint, address, name, Graph(self._node)):
            made = ActionCaller(self._node, self._types, endpoint, name, address, port)
        else:
            made = Caller(self._node, name, self._service(endpoint, name, address, port))
        with self._table_lock:
            known = self._callers.setdefault((name, address.type), made)
        if known is not made:
            made.close()
        return known

    def _forget_caller(self, name: str, kind: str, caller: Caller | ActionCaller) -> None:
        with self._table_lock:
            if self._callers.get((name, kind)) is caller:
                del self._callers[name, kind]
        caller.close()

    def _serve(
        self, endpoint: Endpoint, structures: ServiceStructures, handler: Handler
    ) -> Channel:
        del structures
        address, port = address_of(endpoint), port_of(endpoint)
        if not address.type:
            text = f"{endpoint}: serving needs a type, as package/Name, in the address"
            raise BridgeError(text, FailureReason.UNSUPPORTED)
        name = self._node.resolve(address.name)
        if address.is_action:
            kinds = self._types.action(address.type)
            return ServedAction(
                endpoint,
                self._node,
                self._types,
                name,
                kinds,
                handler,
                port.at_once,
                self.report_channel,
            )
        kind = self._types.require_service(address.type, port.definition)
        served = ServedService(
            endpoint, self._node, name, kind, handler, port.at_once, self.report_channel
        )
        self._served.add(served)
        return served

    def _link(self, source: Endpoint, sink: Endpoint) -> NativeLink | None:
        ends = [(end, address_of(end), port_of(end)) for end in (source, sink)]
        if any(address.is_parameter for _, address, _ in ends):
            return None
        topics = [self._node.resolve(address.name) for _, address, _ in ends]
        places = [
            self._place(end, topic, port)
            for (end, _, port), topic in zip(ends, topics, strict=True)
        ]
        if topics[0] == topics[1]:
            return self._opened_at(SameTopic(places[0], places[1]))
        records = [
            self._seeing(partial(self._record, end, topic, address, port))
            for (end, address, port), topic in zip(ends, topics, strict=True)
        ]
        if records[0].md5 != records[1].md5 or records[0].name != records[1].name:
            return None
        return self._opened_at(Relay(places[0], places[1], records[0]))

    def _discover(self) -> tuple[Discovered, ...]:
        return discovered(self.name, self._node, self._described)

    def _close(self) -> None:
        self._closing.set()
        for caller in tuple(self._callers.values()):
            caller.close()
        if self._rosout is not None:
            self._rosout.close()
        if self._clock is not None:
            self._clock.close()
        self._node.close()
        self._watch.join(_JOIN_SECONDS)

    def _place(self, endpoint: Endpoint, topic: str, port: Ros1Options) -> TopicPlace:
        wait = self._options.wait if port.wait is None else port.wait
        clock: Callable[[], float] = time.monotonic if self._clock is None else self._clock.now
        report = partial(self.report_channel, component=endpoint.component)
        return TopicPlace(self._node, endpoint, topic, port, wait, report, clock)

    def _opened_at(self, channel: C) -> C:
        with self._table_lock:
            self._lost.forget(channel.endpoint.component)
            if isinstance(channel, NativeLink):
                self._lost.forget(channel.sink.component)
        if isinstance(channel, _Ticking):
            self._ticking.add(channel)
        return channel

    def _remember(self, endpoint: Endpoint, *, may_answer: bool = True) -> None:
        """Look from now on whether what stands behind an endpoint is back.

        A node that lives and said nothing for too long is not back by answering.
        """
        try:
            address = address_of(endpoint)
        except BridgeError:
            return
        if address.is_parameter or endpoint.is_offered:
            return
        kind = {Role.OUTPUT: "publishers", Role.INPUT: "subscribers"}.get(endpoint.role, "services")
        name = self._node.resolve(address.name)
        if kind == "services" and address.is_action:
            kind, name = "publishers", f"{name}/status"
        with self._table_lock:
            self._lost.remember((endpoint.component, kind, name), may_answer=may_answer)

    def _asked_to_end(self, reason: str) -> None:
        why = reason or "no reason is given"
        self.report(
            Health.LOST, f"the ROS master, or an operator, ends node {self._node.name}: {why}"
        )

    def _look_around(self) -> None:
        """Watch the master, what was lost, and the silence of channels, until the close."""
        next_look = next_graph = 0.0
        graph = Graph(self._node)
        while not self._closing.is_set():
            if time.monotonic() >= next_look:
                next_look = time.monotonic() + self._options.check
                with self._contained():
                    self._look_at_master()
            if time.monotonic() >= next_graph:
                # For a second, and for all: links of hundreds of topics may be those of two nodes.
                next_graph = (now := time.monotonic()) + _LATELY_SECONDS
                graph = Graph(self._node, now)
            self._tick(graph)
            left = next_look - time.monotonic()
            self._closing.wait(max(0.0, min(_TICK_SECONDS, left)))

    def _tick(self, graph: Graph) -> None:
        # Apart from what waits: its frame would keep the last channel, closed or not.
        channels = [channel for channel in tuple(self._ticking) if not channel.closed]
        with self._contained(), suppress(BridgeError):
            links = (channel for channel in channels if isinstance(channel, SameTopic))
            graph.living(node for link in links for node in link.nodes(graph))
        for channel in channels:
            with self._contained():
                channel.tick(graph)

    @contextmanager
    def _contained(self) -> Iterator[None]:
        try:
            yield
        except Exception as error:  # noqa: BLE001 - one failure ends no other look
            if not self._closing.is_set():
                self._records.write(logging.ERROR, "looking after a ROS 1 node failed", error)

    def _look_at_master(self) -> None:
        node, health = self._node, self._master_health
        try:
            identity = node.master.identity()
            # What was opened since a master was started again is known to it, and nothing else.
            # One that was away is another, whatever it says of itself.
            before = self._master_identity
            is_another = before is not None and (before != identity or not health.is_up)
            if node.is_registered and (is_another or not node.is_known()):
                node.register_again()
            self._master_identity = identity
            for own in (self._rosout, self._clock):
                if own is not None:
                    own.open()
            report = health.answered()
        except BridgeError as error:
            report = health.failed(str(error), is_used=node.has_registered)
        if self._closing.is_set():
            return
        if report is not None:
            self.report(*report)
        if health.is_up:
            self._look_at_graph()

    def _look_at_graph(self) -> None:
        """See who answers our services, and whether what was lost is back."""
        with self._table_lock:
            keys = self._lost.keys
        served = [channel for channel in tuple(self._served) if not channel.closed]
        if not keys and not served:
            return
        # Each node is asked once, whatever is lost of it: one that hangs would hold up all others.
        graph = Graph(self._node)
        places = [*(key[1:] for key in keys), *(("services", channel.name) for channel in served)]
        try:
            state = graph.state  # after the list of ours: all of these are registered
            graph.living(
                node for kind, name in places for node in getattr(state, kind).get(name, ())
            )
        except BridgeError:
            return
        for channel in served:
            channel.look(graph)
        for key in keys:
            _, kind, name = key
            nodes = getattr(state, kind).get(name, ())
            registered = [(other, uri) for other in nodes if (uri := graph.address(other))]
            answers = any(graph.is_alive(other) for other, _ in registered)
            with self._table_lock:
                component = self._lost.look(key, registered, answers=answers)
            if component:
                self.report(Health.OK, f"{name} is there again", component=component)
