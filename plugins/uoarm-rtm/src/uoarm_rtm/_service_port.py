"""Functions of ours offered to components: to a port that requires them, or at a port of ours."""

from __future__ import annotations

import logging
from collections.abc import Callable, Mapping
from typing import Any

from _uoarm_rtm_stubs import RTC
from omniORB import CORBA

from uoarm.bridge import Channel, foreign
from uoarm.errors import MessageError
from uoarm.model import Endpoint, Message
from uoarm_rtm._connector import Connections
from uoarm_rtm._derived import IDL, REQUEST
from uoarm_rtm._operations import RETURN, IdlInterface, IdlOperation
from uoarm_rtm._orb import Orb
from uoarm_rtm._peer import PeerComponent, PeerPort, PortInterface, properties_of
from uoarm_rtm._port_servant import PortServant
from uoarm_rtm.errors import IdlError

__all__ = ["ServicePort", "ServicePortChannel", "servant_of", "unwrapped"]

_log = logging.getLogger("uoarm.rtm")
Handler = Callable[[Message], Message]


def servant_of(interface: IdlInterface, operation: str, handler: Handler) -> Any:
    """Return a CORBA servant whose operations call a handler.

    Args:
        interface: what it serves.
        operation: the only one that it answers, its arguments being the request; empty for all,
            as `{operation, arguments}`.
        handler: called in threads of the ORB, several at a time.
    """
    methods = {}
    for item in interface.operations.values():
        if not operation:
            methods[item.name] = _method(item, _named(item.name, handler))
        elif item.name == operation:
            methods[item.name] = _method(item, handler)
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
    def method(servant: Any, *arguments: Any) -> Any:
        del servant
        try:
            return operation.result(foreign(handler, operation.message(arguments)))
        except IdlError as error:
            raised = operation.exception(error.exception, error.members)
            if raised is not None:
                raise raised from error
            _log.warning("%s raised %s, which it does not declare", operation.name, error.exception)
        except MessageError:
            _log.exception("a reply of %s does not fit its IDL", operation.name)
        except Exception:  # noqa: BLE001 - the caller gets UNKNOWN, whatever it was
            _log.exception("a function that serves %s failed", operation.name)
        raise CORBA.UNKNOWN(0, CORBA.COMPLETED_MAYBE)

    return method


class ServicePortChannel(Channel):
    """A function of ours, connected to a port of a component that requires it.

    Args:
        orb: where it is served.
        endpoint: the endpoint served.
        peer: the component.
        port: its CorbaPort.
        wanted: the required interface, as the port has it.
        servant: what answers.
        connections: makes the connector.

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
        try:
            self._connector = connections.connect(where, keys, port)
        except BaseException:
            orb.withdraw(self._reference)
            raise

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
        *,
        instance: str = "",
        kind: str = "",
        idl: str = "",
    ) -> None:
        properties = {"port.port_type": "CorbaPort", **({IDL: idl} if idl else {})}
        super().__init__(orb, name, properties, 2.0)
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
