"""The bridge: what of a rosbridge server stands behind each step of the contract."""

from __future__ import annotations

import threading
import time
from contextlib import suppress
from typing import Any, TypeVar

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
    did_you_mean,
    renewed,
)
from uoarm.errors import BridgeError, BridgeTimeoutError, FailureReason, MessageError
from uoarm.model import Endpoint, Health, Message, MessageStructure, Role
from uoarm_rosbridge.client._calls import (
    ActionlibCaller,
    ActionlibTypes,
    AdvertisedAction,
    AdvertisedService,
    ServedTypes,
    call_action,
)
from uoarm_rosbridge.client._channels import (
    ParameterSink,
    ParameterSource,
    TopicSink,
    TopicSource,
    parameter,
)
from uoarm_rosbridge.client._connection import Fields, ServerConnection
from uoarm_rosbridge.client._discovery import discovered
from uoarm_rosbridge.client._health import PeerWatch
from uoarm_rosbridge.client._options import (
    Address,
    ClientOptions,
    Port,
    ServerAccess,
    address_of,
    port_of,
)
from uoarm_rosbridge.client._types import RosType, read_types, reader, structure_of, writer

C = TypeVar("C", bound=Channel)
_FINITE = {"x-nonfinite": False}  # JSON, in which everything is published, has no NaN
_NOTES = {
    Role.OUTPUT: "a rosbridge server does not say what it loses of a topic",
    Role.INPUT: "a rosbridge server does not say whether it publishes what it is sent",
}
_DEEP = 16


class RosbridgeBridge(Bridge):
    """One client of one rosbridge server."""

    capabilities = Capabilities(discover=True, call=True, serve=True)

    def __init__(self, name: str, options: ClientOptions) -> None:
        super().__init__(name, options)
        access = renewed(lambda: ServerAccess.of(name, options))
        # rosbridge_suite works through what a client sends in order, and waits for each reply, if
        # need be for ever: calls, and questions of rosapi, have connections of their own, so that
        # they hold up no message.
        self._calls, self._questions = (
            ServerConnection(name, options, access, lambda *_: None) for _ in range(2)
        )
        self._connection = ServerConnection(name, options, access, self.report, self._questions)
        self._connection.watchers = (self._changed,)
        self._types: dict[tuple[str, str], RosType] = {}
        self._kinds: dict[Endpoint, str] = {}
        # Guards the clients of actions of ROS 1, each of which is made once.
        self._callers_lock = threading.Lock()
        self._callers: dict[str, ActionlibCaller] = {}
        self._watch = PeerWatch(
            name, self._connection, options.check, self._peers, self._is_same, self.report
        )

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
        about: str = "",
    ) -> None:
        """Report a change; what is lost is looked for from then on."""
        if health is Health.LOST and channel is not None:
            is_silent = isinstance(channel, TopicSource) and channel.health.is_silent
            self._watch.remember(channel.endpoint, is_silent=is_silent)
        super().report(health, cause, channel=channel, component=component, about=about)

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
                self._watch.remember(endpoint)
            raise
        limits = _FINITE if endpoint.role is Role.INPUT else {}
        return Description(structure_of(made), note=_NOTES[endpoint.role], limits=limits)

    def _describe_service(self, endpoint: Endpoint, address: Address, port: Port) -> Description:
        is_action = address.is_action or address.is_actionlib
        if is_action and not endpoint.is_offered and port.peer_required:
            self._require_server(endpoint)
        if address.is_actionlib:
            types = self._actionlib_types(address)
            request, reply = types.request(), types.reply()
        elif address.is_action:
            kinds = self._action_types(address)
            if kinds is None:
                hint = (
                    "this server's rosapi does not describe actions: declare `structure` with the "
                    "request and the reply"
                )
                return Description(hint=hint)
            request, reply = kinds
        else:
            request, reply = self._service_types(self._service_kind(endpoint, address))
        return Description(request=structure_of(request), reply=structure_of(reply))

    def _require_server(self, endpoint: Endpoint) -> None:
        if not self._peers(endpoint):
            text = f"{endpoint}: there is no server of action {address_of(endpoint).name}"
            raise BridgeError(text, FailureReason.NOT_FOUND)

    def _message_type(self, endpoint: Endpoint, address: Address) -> RosType:
        actual = str(self._ask("topic_type", topic=_full(address.name)).get("type") or "")
        if address.type and actual and not _is_same_type(address.type, actual):
            text = f"{endpoint}: the topic has the type {actual}"
            raise BridgeError(text, FailureReason.BAD_ENDPOINT)
        if not (kind := actual or address.type):
            meant = self._near(address, "topics")
            text = f"{endpoint}: no node publishes it, and its type is in no address{meant}"
            raise BridgeError(text, FailureReason.NOT_FOUND)
        return self._type("message_details", kind)

    def _service_kind(self, endpoint: Endpoint, address: Address) -> str:
        if endpoint.is_offered and address.type:
            return address.type
        actual = str(self._ask("service_type", service=_full(address.name)).get("type") or "")
        if not actual:
            text = f"{endpoint}: no node serves it{self._near(address, 'services')}"
            raise BridgeError(text, FailureReason.NOT_FOUND)
        if address.type and not _is_same_type(address.type, actual):
            text = f"{endpoint}: it is served as {actual}"
            raise BridgeError(text, FailureReason.BAD_ENDPOINT)
        return actual

    def _near(self, address: Address, kind: str) -> str:
        """Ask in an error whether a name that the server lists is meant."""
        name, names = _full(address.name), None
        with suppress(BridgeError):  # it is about another one
            names = self._ask(kind).get(kind)
        return did_you_mean(name, map(str, names) if isinstance(names, list) else ())

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

    def _actionlib_types(self, address: Address) -> ActionlibTypes:
        return ActionlibTypes(
            *(
                self._type("message_details", kind)
                for kind in (
                    f"{address.type}Goal",
                    f"{address.type}Result",
                    "actionlib_msgs/GoalStatusArray",
                    "actionlib_msgs/GoalID",
                )
            )
        )

    def _type(self, details: str, kind: str) -> RosType:
        made = self._types.get((details, kind))
        if made is None:
            made = read_types(kind, self._ask(details, type=kind).get("typedefs"))
            self._types[details, kind] = made
        return made

    def _ask(self, service: str, /, **arguments: str) -> Fields:
        return self._connection.rosapi(service, **arguments)

    def _require_peer(self, endpoint: Endpoint, address: Address, port: Port) -> None:
        if not port.peer_required or self._peers(endpoint):
            return
        does = "publishes" if endpoint.role is Role.OUTPUT else "subscribes to"
        text = f"{endpoint}: no node {does} {_full(address.name)}{self._near(address, 'topics')}"
        raise BridgeError(text, FailureReason.NOT_FOUND)

    def _peers(self, endpoint: Endpoint) -> frozenset[str]:
        """Return the nodes behind an endpoint; of a parameter its name, where it is set."""
        address = address_of(endpoint)
        name = _full(address.name)
        if address.is_parameter:
            with suppress(BridgeError):
                parameter(self._connection, endpoint, address.name)
                return frozenset({name})
            return frozenset()
        if address.is_action:
            servers = self._ask("action_servers").get("action_servers")
            is_there = isinstance(servers, list) and {name, address.name} & set(servers)
            return frozenset({name} if is_there else ())
        if address.is_actionlib:
            return self._nodes("publishers", f"{name}/status") & self._nodes(
                "subscribers", f"{name}/goal"
            )
        if endpoint.role is Role.SERVICE:
            server = self._ask("service_type", service=name).get("type")
            return frozenset({str(server)} if server else ())
        return self._nodes("publishers" if endpoint.role is Role.OUTPUT else "subscribers", name)

    def _nodes(self, what: str, topic: str) -> frozenset[str]:
        found = self._ask(what, topic=topic).get(what)
        return frozenset(map(str, found)) if isinstance(found, list) else frozenset()

    def _open_source(
        self, endpoint: Endpoint, structure: MessageStructure, deliver: Delivery
    ) -> Source:
        del structure  # the server says the type
        address, port = address_of(endpoint), port_of(endpoint)
        if address.is_parameter:
            return self._keep(
                ParameterSource(
                    endpoint, self._connection, address.name, deliver, self.report_channel
                )
            )
        made = self._message_type(endpoint, address)
        self._require_peer(endpoint, address, port)
        topic = _full(address.name)
        return self._keep(
            TopicSource(endpoint, self._connection, topic, made, port, deliver, self.report_channel)
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
            TopicSink(endpoint, self._connection, topic, made, port, self.report_channel)
        )

    def _call(
        self, endpoint: Endpoint, structures: ServiceStructures, message: Message, timeout: float
    ) -> Message:
        address, deadline = address_of(endpoint), time.monotonic() + timeout
        try:
            if address.is_actionlib:
                caller = self._caller(endpoint, address)
                return caller.call(endpoint, message, timeout, self.cancelling)
            if address.is_action:
                name, kinds = _full(address.name), self._action_types(address)
                left = max(0.0, round(deadline - time.monotonic(), 2))
                return call_action(
                    self._calls, endpoint, name, address.type, kinds, message, left, self.cancelling
                )
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
                self._watch.remember(endpoint)
            raise
        del structures
        if answer.get("result") is False:
            self._kinds.pop(endpoint, None)
            text = str(answer.get("values"))[:1000]
            raise BridgeError(f"{endpoint}: the service failed: {text}")
        self._kinds[endpoint] = kind
        try:
            return reader(reply)(answer.get("values") or {})
        except MessageError as error:
            raise MessageError(f"{endpoint}: the reply: {error}") from error

    def _request(
        self, endpoint: Endpoint, fields: dict[str, Any], deadline: float, timeout: float
    ) -> Fields:
        try:
            return self._calls.request(fields, max(0.0, deadline - time.monotonic()))
        except BridgeTimeoutError:
            text = f"{endpoint}: no reply within {timeout:g} s"
            raise BridgeTimeoutError(text) from None

    def _caller(self, endpoint: Endpoint, address: Address) -> ActionlibCaller:
        name = _full(address.name)
        with self._callers_lock:
            if (caller := self._callers.get(name)) is None:
                self._require_server(endpoint)
                types = self._actionlib_types(address)
                caller = self._callers[name] = ActionlibCaller(self._connection, name, types)
            return caller

    def _serve(
        self, endpoint: Endpoint, structures: ServiceStructures, handler: Handler
    ) -> Channel:
        del structures
        address, port = address_of(endpoint), port_of(endpoint)
        if not address.type or address.is_actionlib:
            what = "an action of ROS 1" if address.type else "a service without a type"
            text = f"{endpoint}: {what} cannot be served through rosbridge by this bridge"
            raise BridgeError(text, FailureReason.UNSUPPORTED)
        is_action = address.is_action
        made = AdvertisedAction if is_action else AdvertisedService
        kinds = self._action_types(address) if is_action else self._service_types(address.type)
        return self._keep(
            made(
                endpoint,
                self._connection,
                _full(address.name),
                address.type,
                ServedTypes(kinds),
                handler,
                port.at_once,
                self.report_channel,
            )
        )

    def _discover(self) -> tuple[Discovered, ...]:
        return discovered(self.name, self._ask, self._describe)

    def _close(self) -> None:
        self._watch.stop()
        with self._callers_lock:
            for caller in self._callers.values():
                caller.fail("the bridge was closed")
        for connection in (self._calls, self._questions, self._connection):
            connection.close()
        self._watch.close()

    def _keep(self, channel: C) -> C:
        self._watch.keep(channel)
        return channel

    def _changed(self, cause: str) -> None:
        """Take note of a break, or of its end; in the connection's thread."""
        if cause:
            for caller in tuple(self._callers.values()):
                caller.fail(cause)
            return
        for connection in (self._calls, self._questions):
            connection.hurry()
        self._types.clear()
        self._kinds.clear()
        self._watch.look_anew()

    def _is_same(self, made: RosType) -> bool:
        """Say whether a type is the same in what may be another server than before."""
        return structure_of(self._type("message_details", made.name)) == structure_of(made)


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
