"""The bridge: what of a rosbridge server stands behind each step of the contract."""

from __future__ import annotations

import threading
import time
from collections import defaultdict
from collections.abc import Mapping
from contextlib import suppress
from typing import Any, TypeVar
from weakref import WeakSet

from uoarm.bridge import (
    Bridge,
    Capabilities,
    Channel,
    Delivery,
    Description,
    Discovered,
    Handler,
    ServiceStructures,
    Sink,
    Source,
)
from uoarm.errors import BridgeError, BridgeTimeoutError, FailureReason
from uoarm.model import Endpoint, Health, Message, MessageStructure, Options, Role
from uoarm_rosbridge.client._channels import (
    ParameterSink,
    ParameterSource,
    ServedService,
    TopicSink,
    TopicSource,
    parameter,
)
from uoarm_rosbridge.client._connection import Fields, ServerConnection
from uoarm_rosbridge.client._options import (
    Address,
    Port,
    address_of,
    client_options,
    is_type,
    port_of,
)
from uoarm_rosbridge.client._types import RosType, read_types, reader, structure_of, writer

__all__ = ["RosbridgeBridge"]

C = TypeVar("C", bound=Channel)
_SUCCEEDED, _CANCELED, _ABORTED = 4, 5, 6
_OUTCOMES = {_CANCELED: "canceled", _ABORTED: "aborted"}
_FINITE = {"x-nonfinite": False}  # JSON, in which everything is published, has no NaN
_TICK_SECONDS = 0.25
_JOIN_SECONDS = 1.0
_DEEP = 16
_EVERYWHERE = frozenset({"/rosout", "/rosout_agg", "/parameter_events", "/clock"})
_OF_THE_SERVER = ("/rosapi", "/rosbridge_websocket")
_OF_EVERY_NODE = (
    "/get_loggers", "/set_logger_level", "/describe_parameters", "/get_parameter_types",
    "/get_parameters", "/list_parameters", "/set_parameters", "/set_parameters_atomically",
    "/get_type_description",
)  # fmt: skip


class RosbridgeBridge(Bridge):
    """One client of one rosbridge server."""

    capabilities = Capabilities(discover=True, call=True, serve=True)

    def __init__(self, name: str, options: Options) -> None:
        super().__init__(name, options)
        self._given = client_options(name, options)
        self._connection = ServerConnection(name, self._given, self.report)
        self._connection.watchers = (self._changed,)
        # rosbridge_suite works through what a client sends in order, and waits for each reply: a
        # call has a connection of its own, so that it holds up no message and no question.
        self._calls = ServerConnection(name, self._given, lambda *_: None)
        self._types: dict[tuple[str, str], RosType] = {}
        self._kinds: dict[Endpoint, str] = {}
        self._channels: WeakSet[Channel] = WeakSet()
        # Guards what is open and what was lost, between steps, the connection and the watch.
        self._table_lock = threading.Lock()
        self._lost: dict[str, tuple[str, str, frozenset[str] | None]] = {}
        self._closing, self._poked = threading.Event(), threading.Event()
        self._is_new = False
        self._watch = threading.Thread(
            target=self._look_around, name=f"uoarm-rosbridge-watch-{name}", daemon=True
        )
        self._watch.start()

    @property
    def process_id(self) -> int | None:
        """Return None: the server, and what is behind it, are anywhere."""
        return None

    def report(
        self,
        health: Health,
        cause: str,
        *,
        channel: Channel | None = None,
        component: str | None = None,
    ) -> None:
        """Report a change; what is lost is looked for from then on."""
        if health is Health.LOST and channel is not None:
            self._remember(channel.endpoint, is_silent=getattr(channel, "is_silent", False))
        super().report(health, cause, channel=channel, component=component)

    def _describe(self, endpoint: Endpoint) -> Description:
        address, port = address_of(endpoint), port_of(endpoint)
        self._connection.require_up()
        try:
            if address.is_parameter:
                value = parameter(self._connection, endpoint, address.name)
                return Description(MessageStructure(_schema_of(value, _DEEP)))
            if endpoint.role is Role.SERVICE:
                return self._describe_service(endpoint, address, port)
            made = self._message_type(endpoint, address)
            self._require_peer(endpoint, address, port)
        except BridgeError as error:
            if error.reason is FailureReason.NOT_FOUND:
                self._remember(endpoint)
            raise
        limits = _FINITE if endpoint.role is Role.INPUT else {}
        return Description(structure_of(made), limits=limits)

    def _describe_service(self, endpoint: Endpoint, address: Address, port: Port) -> Description:
        if address.is_action:
            if not endpoint.is_offered and port.peer_required:
                servers = self._ask("action_servers").get("action_servers", [])
                if address.name not in servers:
                    text = f"{endpoint}: there is no server of action {address.name}"
                    raise BridgeError(text, FailureReason.NOT_FOUND)
            kinds = self._action_types(address)
            if kinds is None:
                hint = (
                    "this server's rosapi does not describe actions: declare `structure` with the "
                    "request and the reply"
                )
                return Description(hint=hint)
        else:
            kinds = self._service_types(self._service_kind(endpoint, address))
        return Description(request=structure_of(kinds[0]), reply=structure_of(kinds[1]))

    def _message_type(self, endpoint: Endpoint, address: Address) -> RosType:
        actual = str(self._ask("topic_type", topic=_full(address.name)).get("type") or "")
        if address.type and actual and not _is_same_type(address.type, actual):
            text = f"{endpoint}: the topic has the type {actual}"
            raise BridgeError(text, FailureReason.BAD_ENDPOINT)
        if not (kind := actual or address.type):
            text = f"{endpoint}: no node publishes it, and its type is in no address"
            raise BridgeError(text, FailureReason.NOT_FOUND)
        return self._type("message_details", kind)

    def _service_kind(self, endpoint: Endpoint, address: Address) -> str:
        if endpoint.is_offered and address.type:
            return address.type
        actual = str(self._ask("service_type", service=_full(address.name)).get("type") or "")
        if not actual:
            raise BridgeError(f"{endpoint}: no node serves it", FailureReason.NOT_FOUND)
        if address.type and not _is_same_type(address.type, actual):
            text = f"{endpoint}: it is served as {actual}"
            raise BridgeError(text, FailureReason.BAD_ENDPOINT)
        return actual

    def _service_types(self, kind: str) -> tuple[RosType, RosType]:
        return (
            self._type("service_request_details", kind),
            self._type("service_response_details", kind),
        )

    def _action_types(self, address: Address) -> tuple[RosType, RosType] | None:
        """Return goal and result of an action; None: this server does not describe them."""
        try:
            return (
                self._type("action_goal_details", address.type),
                self._type("action_result_details", address.type),
            )
        except BridgeError as error:
            if error.reason is not FailureReason.UNSUPPORTED:
                raise
            return None

    def _type(self, details: str, kind: str) -> RosType:
        made = self._types.get((details, kind))
        if made is None:
            made = read_types(kind, self._ask(details, type=kind).get("typedefs"))
            self._types[details, kind] = made
        return made

    def _ask(self, service: str, /, **arguments: str) -> Fields:
        return self._connection.rosapi(service, **arguments)

    def _require_peer(self, endpoint: Endpoint, address: Address, port: Port) -> None:
        if not port.peer_required or self._peers(endpoint.role, address.name):
            return
        does = "publishes" if endpoint.role is Role.OUTPUT else "subscribes to"
        text = f"{endpoint}: no node {does} {_full(address.name)}"
        raise BridgeError(text, FailureReason.NOT_FOUND)

    def _peers(self, role: Role, name: str) -> frozenset[str]:
        """Return the nodes behind a topic, a service or an action."""
        if role is Role.SERVICE:
            server = self._ask("service_type", service=_full(name)).get("type")
            return frozenset({str(server)} if server else ())
        what = "publishers" if role is Role.OUTPUT else "subscribers"
        found = self._ask(what, topic=_full(name)).get(what)
        return frozenset(map(str, found)) if isinstance(found, list) else frozenset()

    def _open_source(
        self, endpoint: Endpoint, structure: MessageStructure, deliver: Delivery
    ) -> Source:
        del structure  # the server says the type
        address, port = address_of(endpoint), port_of(endpoint)
        if address.is_parameter:
            return self._keep(ParameterSource(endpoint, self._connection, address.name, deliver))
        made = self._message_type(endpoint, address)
        self._require_peer(endpoint, address, port)
        topic = _full(address.name)
        return self._keep(
            TopicSource(
                endpoint, self._connection, topic, made, port, deliver, self._report_channel
            )
        )

    def _open_sink(self, endpoint: Endpoint, structure: MessageStructure) -> Sink:
        del structure
        address, port = address_of(endpoint), port_of(endpoint)
        if address.is_parameter:
            return self._keep(ParameterSink(endpoint, self._connection, address.name))
        made = self._message_type(endpoint, address)
        self._require_peer(endpoint, address, port)
        topic = _full(address.name)
        return self._keep(
            TopicSink(endpoint, self._connection, topic, made, port, self._report_channel)
        )

    def _call(
        self, endpoint: Endpoint, structures: ServiceStructures, message: Message, timeout: float
    ) -> Message:
        address, deadline = address_of(endpoint), time.monotonic() + timeout
        try:
            if address.is_action:
                return self._call_action(endpoint, address, message, deadline, timeout)
            kind = self._kinds.get(endpoint) or self._service_kind(endpoint, address)
            request, reply = self._service_types(kind)
            fields = {
                "op": "call_service", "id": self._calls.new_id("call"), "type": kind,
                "service": _full(address.name), "args": writer(request)(message),
                "timeout": timeout,
            }  # fmt: skip
            answer = self._request(endpoint, fields, deadline, timeout)
        except BridgeError as error:
            self._kinds.pop(endpoint, None)
            if error.reason in {FailureReason.UNAVAILABLE, FailureReason.NOT_FOUND}:
                self._remember(endpoint)
            raise
        del structures
        if answer.get("result") is False:
            self._kinds.pop(endpoint, None)
            text = str(answer.get("values"))[:1000]
            raise BridgeError(f"{endpoint}: the service failed: {text}")
        self._kinds[endpoint] = kind
        return reader(reply)(answer.get("values") or {})

    def _request(
        self, endpoint: Endpoint, fields: dict[str, Any], deadline: float, timeout: float
    ) -> Fields:
        try:
            return self._calls.request(fields, max(0.0, deadline - time.monotonic()))
        except BridgeTimeoutError:
            text = f"{endpoint}: no reply within {timeout:g} s"
            raise BridgeTimeoutError(text) from None

    def _call_action(
        self,
        endpoint: Endpoint,
        address: Address,
        message: Message,
        deadline: float,
        timeout: float,
    ) -> Message:
        kinds = self._action_types(address)
        name, identity = _full(address.name), self._calls.new_id("goal")
        cancel = {"op": "cancel_action_goal", "id": identity, "action": name}
        fields = {
            "op": "send_action_goal", "id": identity, "action": name, "action_type": address.type,
            "args": message if kinds is None else writer(kinds[0])(message), "feedback": False,
        }  # fmt: skip
        try:
            with self.cancelling(lambda: self._calls.send(cancel)):
                answer = self._request(endpoint, fields, deadline, timeout)
        except BridgeTimeoutError:
            with suppress(BridgeError):
                self._calls.send(cancel)
            raise
        values, status = answer.get("values"), answer.get("status")
        if answer.get("result") is False or status != _SUCCEEDED:
            word = _OUTCOMES.get(status, "refused") if isinstance(status, int) else "refused"
            why = f": {values[:1000]}" if isinstance(values, str) else ""
            raise BridgeError(f"{endpoint}: the goal was {word}{why}")
        return values if kinds is None else reader(kinds[1])(values)

    def _serve(
        self, endpoint: Endpoint, structures: ServiceStructures, handler: Handler
    ) -> Channel:
        del structures
        address, port = address_of(endpoint), port_of(endpoint)
        if not address.type or address.is_action:
            what = "an action" if address.is_action else "a service without a type"
            text = f"{endpoint}: {what} cannot be served through rosbridge by this bridge"
            raise BridgeError(text, FailureReason.UNSUPPORTED)
        types, name = self._service_types(address.type), _full(address.name)
        return self._keep(
            ServedService(
                endpoint, self._connection, name, address.type, types, handler, port.at_once
            )
        )

    def _discover(self) -> tuple[Discovered, ...]:
        topics = self._ask("topics")
        kinds = dict(zip(topics.get("topics", ()), topics.get("types", ()), strict=False))
        found = []
        for node in self._ask("nodes").get("nodes", ()):
            if str(node).endswith(_OF_THE_SERVER):
                continue
            details = self._ask("node_details", node=str(node))
            ports = [
                (role, str(name))
                for role, part in (
                    (Role.OUTPUT, "publishing"),
                    (Role.INPUT, "subscribing"),
                    (Role.SERVICE, "services"),
                )
                for name in details.get(part, ())
                if name not in _EVERYWHERE and not str(name).endswith(_OF_EVERY_NODE)
            ]
            found.append(self._discovered(str(node), ports, kinds))
        return tuple(component for component in found if component.endpoints)

    def _discovered(
        self, node: str, ports: list[tuple[Role, str]], kinds: Mapping[str, str]
    ) -> Discovered:
        endpoints, missing = [], dict[str, None]()
        names: defaultdict[str, int] = defaultdict(int)
        for role, name in ports:
            kind = kinds.get(name, "") if role is not Role.SERVICE else ""
            port = name.strip("/").replace("/", "_")
            names[port] += 1
            at = (name, kind) if is_type(kind) else (name,)
            endpoint = Endpoint(self.name, node, role, at, port=port)
            try:
                description = self._describe(endpoint)
            except BridgeError as error:
                description = Description()
                missing[str(error)] = None
            endpoints.append((endpoint, description))
        return Discovered(node, tuple(endpoints), "; ".join(missing))

    def _close(self) -> None:
        self._closing.set()
        self._poked.set()
        self._calls.close()
        self._connection.close()
        self._watch.join(_JOIN_SECONDS)

    def _keep(self, channel: C) -> C:
        with self._table_lock:
            self._lost.pop(channel.endpoint.component, None)
            self._channels.add(channel)
        return channel

    def _report_channel(self, channel: Channel, health: Health, cause: str) -> None:
        self.report(health, cause, channel=channel)

    def _remember(self, endpoint: Endpoint, *, is_silent: bool = False) -> None:
        """Look from now on whether what stands behind an endpoint is back.

        What was there and said nothing for too long is back when others are there.
        """
        try:
            address = address_of(endpoint)
        except BridgeError:
            return
        if address.is_parameter or address.is_action or endpoint.is_offered:
            return
        before: frozenset[str] | None = None
        if is_silent:
            with suppress(BridgeError):
                before = self._peers(endpoint.role, address.name)
        with self._table_lock:
            self._lost[endpoint.component] = (endpoint.role.value, address.name, before)

    def _changed(self, cause: str) -> None:
        """Take note of a break, or of its end; in the connection's thread."""
        if not cause:
            self._types.clear()
            self._kinds.clear()
            self._is_new = True
            self._poked.set()
            return
        with self._table_lock:
            channels = tuple(self._channels)
        for channel in channels:
            if isinstance(channel, TopicSource | TopicSink):
                channel.lose(cause)
            elif isinstance(channel, ParameterSource | ParameterSink) and not channel.closed:
                self.report(Health.LOST, cause, channel=channel)

    def _look_around(self) -> None:
        """Watch who publishes, what was lost, and the silence of sources, until the close."""
        next_look = time.monotonic() + self._given.check
        while not self._closing.is_set():
            left = next_look - time.monotonic()
            self._poked.wait(max(0.0, min(_TICK_SECONDS, left)))
            if self._poked.is_set() or time.monotonic() >= next_look:
                self._poked.clear()
                next_look = time.monotonic() + self._given.check
                if self._connection.is_up and not self._closing.is_set():
                    with suppress(BridgeError):
                        self._look()
            with self._table_lock:
                channels = tuple(self._channels)
            for channel in channels:
                if isinstance(channel, TopicSource) and not channel.closed:
                    channel.tick()

    def _look(self) -> None:
        with self._table_lock:
            channels, lost = tuple(self._channels), dict(self._lost)
        is_new, self._is_new = self._is_new, False
        for channel in channels:
            if channel.closed:
                continue
            if isinstance(channel, ServedService) and is_new:
                channel.advertise()
            elif isinstance(channel, ParameterSource):
                channel.look()
            elif isinstance(channel, TopicSource | TopicSink):
                self._look_at_peers(channel)
        for component, (role, name, before) in lost.items():
            now = self._peers(Role(role), name)
            if now and now != before:
                with self._table_lock:
                    self._lost.pop(component, None)
                self.report(Health.OK, f"{name} is there again", component=component)

    def _look_at_peers(self, channel: TopicSource | TopicSink) -> None:
        role = channel.endpoint.role
        if port_of(channel.endpoint).peer_required and not self._peers(role, channel.topic):
            does = "publishes" if role is Role.OUTPUT else "subscribes to"
            channel.lose(f"no node {does} {channel.topic}")


def _full(name: str) -> str:
    return name if name.startswith("/") else f"/{name}"


def _is_same_type(one: str, other: str) -> bool:
    """Whether two names are of one type; ROS 1 leaves the kind out."""
    return one == other or _short(one) == _short(other)


def _short(name: str) -> str:
    package, _, own = name.partition("/")
    return f"{package}/{own.rpartition('/')[2]}"


def _schema_of(value: Any, depth: int) -> Any:
    if isinstance(value, bool):
        return {"type": "boolean"}
    if isinstance(value, int):
        return {"type": "integer"}
    if isinstance(value, float):
        return {"type": "number"}
    if isinstance(value, str):
        return {"type": "string"}
    if isinstance(value, dict) and depth:
        inner = {key: _schema_of(item, depth - 1) for key, item in value.items()}
        return {"type": "object", "properties": inner, "required": sorted(value)}
    return {"type": "array"} if isinstance(value, list) else True
