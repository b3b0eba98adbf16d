"""Services of components, called: the object behind a provider's port, and its operations."""

from __future__ import annotations

import threading
from collections.abc import Mapping
from typing import Any

from omniORB import CORBA

from uoarm.bridge import Description
from uoarm.errors import BridgeError, BridgeTimeoutError, FailureReason, MessageError
from uoarm.model import Message, MessageStructure
from uoarm_rtm._connector import Connections, Connector
from uoarm_rtm._faults import corba_errors
from uoarm_rtm._operations import IdlInterface, IdlOperation
from uoarm_rtm._orb import Orb, limit, narrowed
from uoarm_rtm._peer import PeerComponent, PeerPort, PortInterface
from uoarm_rtm._types import plain_name
from uoarm_rtm.errors import IdlError

__all__ = ["OperationCaller", "described", "offered", "split"]


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
    for item in interface.operations.values():
        request, reply = item.structures
        properties = {"operation": {"const": item.name}, "arguments": request.schema}
        several.append(
            {
                "type": "object",
                "properties": properties,
                "required": list(properties),
                "additionalProperties": False,
            }
        )
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


class OperationCaller:
    """A connection to one provided interface, made with the first call and ended with a loss.

    Used from any thread. A provider answers only while its component is ACTIVE. Once it has ended
    it connects no more, so that no connection is left behind that no caller knows of.

    Args:
        orb: the ORB to call through.
        peer: the component.
        port: its CorbaPort.
        interface: as our IDL has it.
        offer: as the port has it.
        operation: the one to call; empty for that which each request names.
        seconds: limit of connecting.
        connections: makes the connector.
    """

    def __init__(
        self,
        orb: Orb,
        peer: PeerComponent,
        port: PeerPort,
        interface: IdlInterface,
        offer: PortInterface,
        operation: str,
        seconds: float,
        connections: Connections,
    ) -> None:
        self._connections = connections
        self._operation = operation
        self._orb = orb
        self._port = port
        self._interface = interface
        self._offer = offer
        self._seconds = seconds
        self._where = f"port {port.name!r} of component {peer.path!r}"
        self._instance = peer.instance
        # Guards connector and object: one call connects, `end` of another thread disconnects.
        self._lock = threading.Lock()
        self._connector: Connector | None = None
        self._object: Any = None
        self._ended = False

    def call(self, message: Message, seconds: float, whose: str) -> Message:
        """Call the operation and return its reply, in so many seconds; `whose` names their limit.

        Raises:
            MessageError: the request does not fit.
            IdlError: the service raised an exception that its IDL declares.
            BridgeError: the component is gone, inactive, or failed, and this has ended; or, with
                CLOSED, it had before, and nothing was called.
            BridgeTimeoutError: no reply in time.
        """
        chosen, arguments = split(self._interface, self._operation, message)
        natives = chosen.arguments(arguments)
        what = f"{self._where}: {self._interface.name}::{chosen.name}"
        try:
            target = limit(self._reach(), seconds)
        except BridgeTimeoutError:
            raise
        except BridgeError:
            self.end()
            raise
        try:
            with corba_errors(what):
                try:
                    result = getattr(target, chosen.name)(*natives)
                except CORBA.OBJECT_NOT_EXIST as error:
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

    @property
    def ended(self) -> bool:
        """Whether it connects no more."""
        return self._ended

    def end(self) -> None:
        """Disconnect for good: a call that has not begun yet fails, and connects no more."""
        with self._lock:
            self._ended = True
            connector, self._connector, self._object = self._connector, None, None
        if connector is not None:
            connector.disconnect()

    def _reach(self) -> Any:
        with self._lock:
            if self._ended:
                text = f"{self._where}: the connection has ended, or the bridge was closed"
                raise BridgeError(text, FailureReason.CLOSED)
            if self._object is None:
                connector = self._connections.connect(self._where, {}, self._port)
                names = f"{self._offer.type}.{self._offer.name}"
                ior = connector.published(
                    f"{self._instance}.port.{self._port.name}.provided.{names}", f"port.{names}"
                )
                try:
                    reference = self._orb.reference(ior)
                    self._object = narrowed(
                        reference, self._interface.stub, self._seconds, self._where
                    )
                except BridgeError:
                    connector.disconnect()
                    raise
                self._connector = connector
            return self._object


def _declared(operation: IdlOperation, error: Any, what: str) -> BridgeError:
    identifier = str(getattr(error, "_NP_RepositoryId", type(error).__name__))
    part = operation.raised.get(identifier)
    if part is None:
        return BridgeError(f"{what} raised {identifier}", FailureReason.RAISED)
    members = operation.members(part, error)
    return IdlError(f"{what} raised {part.name}: {members}", identifier, members)
