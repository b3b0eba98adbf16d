"""Services: operations of components that we call, and functions of ours that they call.

A call goes to the object behind a provider's port. Functions are offered to a port that requires
them, or at a port of our own component.
"""

from __future__ import annotations

import logging
import threading
from collections.abc import Callable, Mapping
from typing import Any

from _uoarm_rtm_stubs import RTC
from attrs import define, field
from omniORB import CORBA

from uoarm.bridge import Channel, Description, LimitedLog, foreign, on_failure, text_of
from uoarm.errors import BridgeError, BridgeTimeoutError, FailureReason, MessageError
from uoarm.model import Endpoint, Message, MessageStructure, closed_object
from uoarm_rtm._descriptors import RETURN, IdlInterface, IdlOperation
from uoarm_rtm._orb import GONE, Orb, corba_errors, limit, narrowed
from uoarm_rtm._peer import (
    Connections,
    Connector,
    PeerComponent,
    PeerPort,
    PortInterface,
    properties_of,
)
from uoarm_rtm._port_servant import PortServant
from uoarm_rtm._types import IDL, REQUEST, plain_name
from uoarm_rtm.errors import IdlError


def described(interface: IdlInterface, operation: str) -> Description:
    """Return the structures of an operation; of all, marked by `operation`, for an empty one.

    Raises:
        BridgeError: there is no such operation.
    """
    if operation:
        request, reply = interface.operation(operation).structures
        return Description(request=request, reply=reply)
    several = []
    replies = []
    for declared in interface.operations.values():
        request, reply = declared.structures
        properties = {"operation": {"const": declared.name}, "arguments": request.schema}
        several.append(closed_object(properties))
        replies.append(reply.schema)
    return Description(
        request=MessageStructure({"oneOf": several}), reply=MessageStructure({"anyOf": replies})
    )


def split(
    interface: IdlInterface, operation: str, message: Message
) -> tuple[IdlOperation, Message]:
    """Return the operation that a request means, and its arguments.

    Raises:
        MessageError: the request does not say.
        BridgeError: there is no such operation.
    """
    if operation:
        return interface.operation(operation), message
    if not isinstance(message, Mapping) or set(message) != {"operation", "arguments"}:
        raise MessageError("$: expected an object with operation and arguments")
    return interface.operation(str(message["operation"])), message["arguments"]


def offered(peer: PeerComponent, port: PeerPort, wanted: str, *, provided: bool) -> PortInterface:
    """Return the interface of a port that a type means; a port with one is not asked for names.

    Type names at ports are free text: `MyService`, or `SimpleService::MyService`.

    Raises:
        BridgeError: BAD_ENDPOINT, with what there is.
    """
    there = [interface for interface in port.interfaces if interface.provided is provided]
    if len(there) == 1:
        return there[0]
    last = plain_name(wanted).split("/")[-1]
    for port_interface in there:
        if plain_name(port_interface.type).split("/")[-1] == last:
            return port_interface
    side = "provided" if provided else "required"
    names = ", ".join(port_interface.type for port_interface in there) or "none"
    text = f"port {port.name!r} of {peer.path!r}: no {side} interface {wanted!r}; it has {names}"
    raise BridgeError(text, FailureReason.BAD_ENDPOINT)


@define(eq=False)
class OperationCaller:
    """A connection to one provided interface, made with the first call and ended with a loss.

    Used from any thread. A provider answers only while its component is ACTIVE. Once it has ended,
    as `ended` says, it connects no more, so that no connection is left behind without a caller.

    Args:
        interface: as our IDL has it.
        offer: as the port has it.
        operation: the one to call; empty for that which each request names.
        seconds: limit of connecting.
    """

    _orb: Orb
    _peer: PeerComponent
    _port: PeerPort
    _interface: IdlInterface
    _offer: PortInterface
    _operation: str
    _seconds: float
    _connections: Connections
    # Guards connector and object: one call connects, `end` of another thread disconnects.
    _lock: threading.Lock = field(factory=threading.Lock, init=False)
    _connector: Connector | None = field(default=None, init=False)
    _reference: str = field(default="", init=False)
    ended: bool = field(default=False, init=False)

    @property
    def _where(self) -> str:
        return f"port {self._port.name!r} of component {self._peer.path!r}"

    def call(self, message: Message, seconds: float, whose: str) -> Message:
        """Call the operation and return its reply, in so many seconds; `whose` names their limit.

        Raises:
            MessageError: the request does not fit.
            IdlError: the service raised an exception that its IDL declares.
            BridgeError: the component is gone, inactive, or failed, and this has ended; or, with
                CLOSED, it had before, or what it knew is there no more, and nothing was called.
            BridgeTimeoutError: no reply in time.
        """
        chosen, arguments = split(self._interface, self._operation, message)
        natives = chosen.arguments(arguments)
        what = f"{self._where}: {self._interface.name}::{chosen.name}"
        try:
            reached, is_new = self._reach()
            # A reference of this call alone, as its limit holds for all calls through it.
            target = limit(reached, seconds)
        except BridgeTimeoutError:
            raise
        except BridgeError:
            self.end()
            raise
        try:
            with corba_errors(what):
                try:
                    result = getattr(target, chosen.name)(*natives)
                except GONE as error:
                    if not is_new and error.completed == CORBA.COMPLETED_NO:
                        # Of a component that has come back elsewhere, or serves another object.
                        text = f"{what}: what it was connected to is gone"
                        raise BridgeError(text, FailureReason.CLOSED) from error
                    if not isinstance(error, CORBA.OBJECT_NOT_EXIST):
                        raise
                    text = f"{what}: the service is not there; is its component active?"
                    raise BridgeError(text, FailureReason.UNAVAILABLE) from error
                except CORBA.UserException as error:
                    raise _declared(chosen, error, what) from error
        except IdlError:
            raise  # the connection is as good as before
        except BridgeTimeoutError as error:  # likewise
            raise BridgeTimeoutError(f"{what}: no answer within {seconds:g} s, {whose}") from error
        except BridgeError:
            self.end()
            raise
        return chosen.reply(result)

    def end(self) -> None:
        """Disconnect for good: a call that has not begun yet fails, and connects no more."""
        with self._lock:
            self.ended = True
            connector, self._connector, self._reference = self._connector, None, ""
        if connector is not None:
            connector.disconnect()

    def _reach(self) -> tuple[Any, bool]:
        """Return a reference to the object, and whether this has connected to it."""
        with self._lock:
            if self.ended:
                text = f"{self._where}: the connection has ended, or the bridge was closed"
                raise BridgeError(text, FailureReason.CLOSED)
            is_new = not self._reference
            if is_new:
                connector = self._connections.connect(self._where, {}, self._port)
                names = f"{self._offer.type}.{self._offer.name}"
                long = f"{self._peer.instance}.port.{self._port.name}.provided.{names}"
                ior = connector.published(long, f"port.{names}")
                with on_failure(connector.disconnect):
                    reference = self._orb.reference(ior)
                    narrowed(reference, self._interface.stub, self._seconds, self._where)
                self._orb.called(ior)
                self._connector, self._reference = connector, ior
            reached = self._orb.reference(self._reference)
            narrow = reached._unchecked_narrow(self._interface.stub)  # noqa: SLF001 - of CORBA's API
            return narrow, is_new


def _declared(operation: IdlOperation, error: Any, what: str) -> BridgeError:
    identifier = str(getattr(error, "_NP_RepositoryId", type(error).__name__))
    part = operation.raised.get(identifier)
    if part is None:
        return BridgeError(f"{what} raised {identifier}", FailureReason.RAISED)
    members = operation.members(part, error)
    return IdlError(f"{what} raised {part.name}: {members}", identifier, members)


_log = logging.getLogger("uoarm.rtm")
Handler = Callable[[Message], Message]


def servant_of(interface: IdlInterface, operation: str, handler: Handler) -> Any:
    """Return a CORBA servant whose operations call a handler.

    Args:
        interface: what it serves.
        operation: the only one that it answers, its arguments being the request; empty for all,
            as `{operation, arguments}`.
        handler: called in threads of the ORB, several at a time. Where it raises OBJECT_NOT_EXIST,
            so does the operation.

    Raises:
        BridgeError: there is no such operation, or it is refused.
    """
    methods = {
        name: _method(declared, _named(name, handler))
        for name, declared in interface.operations.items()
    }
    if operation:
        methods = {operation: _method(interface.operation(operation), handler)}
    return type("Served", (interface.skeleton,), methods)()


def unwrapped(handler: Handler) -> Handler:
    """Return a handler for the operation of a derived interface, whose parts are the messages."""

    def handle(message: Message) -> Message:
        assert isinstance(message, Mapping)
        reply = handler(message.get(REQUEST))
        return {} if reply is None else {RETURN: reply}

    return handle


def _named(name: str, handler: Handler) -> Handler:
    return lambda message: handler({"operation": name, "arguments": message})


def _method(operation: IdlOperation, handler: Handler) -> Callable[..., Any]:
    records = LimitedLog(_log)

    def method(servant: Any, *arguments: Any) -> Any:
        del servant
        try:
            reply = foreign(handler, operation.message(arguments))
            return foreign(operation.result, reply)
        except IdlError as error:
            raised = operation.exception(error.exception, error.members)
            if raised is not None:
                raise raised from error
            text = f"{operation.name} raised {error.exception}, which it does not declare"
            records.write(logging.WARNING, text)
        except MessageError as error:
            text = f"a reply of {operation.name} does not fit its IDL: {error}"
            records.write(logging.ERROR, text, error)
        except CORBA.OBJECT_NOT_EXIST:
            raise
        except Exception as error:  # noqa: BLE001 - the caller gets UNKNOWN, whatever it was
            text = f"a function that serves {operation.name} failed: {text_of(error)}"
            records.write(logging.ERROR, text, error)
        raise CORBA.UNKNOWN(0, CORBA.COMPLETED_MAYBE)

    return method


class ServicePortChannel(Channel):
    """A function of ours, connected to a port of a component that requires it.

    Args:
        wanted: the required interface, as the port has it.

    Raises:
        BridgeError: the port refuses; nothing stays connected.
    """

    def __init__(
        self,
        orb: Orb,
        endpoint: Endpoint,
        peer: PeerComponent,
        port: PeerPort,
        wanted: PortInterface,
        servant: Any,
        connections: Connections,
    ) -> None:
        super().__init__(endpoint)
        self._orb = orb
        self._reference = orb.serve(servant)
        names = f"{wanted.type}.{wanted.name}"
        ior = orb.text(self._reference)
        # The first is the key that 2.x asks for, the second that of 1.x.
        keys = {f"{peer.instance}.port.{port.name}.required.{names}": ior, f"port.{names}": ior}
        where = f"port {port.name!r} of component {peer.path!r}"
        with on_failure(orb.withdraw, self._reference):
            self._connector = connections.connect(where, keys, port)

    def _close(self) -> None:
        self._orb.withdraw(self._reference)
        self._connector.disconnect()


class ServicePort(PortServant):
    """A CorbaPort of our own component that provides one interface.

    Tools compare the names of the interface at both ports, which are free text: `instance` and
    `kind` are those to show; by default the interface's own, the instance in lower case. The IDL
    of an interface that was derived is a property of the port.
    """

    def __init__(
        self,
        orb: Orb,
        name: str,
        interface: IdlInterface,
        servant: Any,
        seconds: float,
        *,
        instance: str = "",
        kind: str = "",
        idl: str = "",
    ) -> None:
        properties = {"port.port_type": "CorbaPort", **({IDL: idl} if idl else {})}
        super().__init__(orb, name, properties, seconds)
        own = interface.name.split("/")[-1]
        kind, instance = kind or own, instance or own.lower()
        self._served = orb.serve(servant)
        component, port = name.split(".", 1)
        self._key = f"{kind}.{instance}"
        self._long_key = f"{component}.port.{port}.provided.{self._key}"
        self.interfaces = [RTC.PortInterfaceProfile(instance, kind, RTC.PROVIDED)]

    def close(self) -> None:
        """Disconnect everything, then stop serving."""
        super().close()
        self.orb.withdraw(self._served)

    def _publish(self, profile: Any) -> None:
        ior = self.orb.text(self._served)
        offers = {self._long_key: ior, f"port.{self._key}": ior}
        for name, value in properties_of(profile.properties).items():
            # A consumer of 2.x names the provider that it wants by its long key.
            if value == self._long_key:
                offers[name] = ior
        self._offer(profile, offers)

    def _subscribe(self, profile: Any) -> None:
        """Do nothing: a provider takes nothing from the others."""

    def _release(self, connector_id: str) -> None:
        """Do nothing: one object serves all connectors."""
