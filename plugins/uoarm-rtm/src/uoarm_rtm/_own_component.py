"""The bridge as a component itself: ports of ours that other components connect to."""

from __future__ import annotations

import threading
from collections.abc import Callable, Mapping, Sequence

from uoarm.bridge import Channel, Sink, Source, on_failure
from uoarm.errors import BridgeError
from uoarm.model import Deliver, Endpoint, Health, Message
from uoarm_rtm._descriptors import IdlInterface
from uoarm_rtm._naming import NamingService
from uoarm_rtm._options import RtmEndpointOptions
from uoarm_rtm._orb import Orb
from uoarm_rtm._services import ServicePort, servant_of
from uoarm_rtm._types import Types
from uoarm_rtm.component import ComponentProfile, RtComponent


class _OwnSource(Source):
    """An InPort of ours: what others write to it is delivered, one message at a time."""

    def __init__(
        self, own: OwnComponent, endpoint: Endpoint, name: str, type_id: str, deliver: Deliver
    ) -> None:
        super().__init__(endpoint)
        self._own = own
        self._deliver = deliver
        self._count = 0
        rate = RtmEndpointOptions.of_endpoint(endpoint).rate
        self._port = own.component.add_in_port(name, type_id, own.types, self._take, rate)

    def facts(self) -> Mapping[str, object]:
        """Return the count of messages and of connectors."""
        return {"count": self._count, "connectors": len(self._port.get_connector_profiles())}

    def _take(self, message: Message) -> None:
        self._count += 1
        self._deliver(message)

    def _close(self) -> None:
        self._own.component.remove_port(self._port)


class _OwnSink(Sink):
    """An OutPort of ours: what is sent goes to every connected port."""

    def __init__(self, own: OwnComponent, endpoint: Endpoint, name: str, type_id: str) -> None:
        super().__init__(endpoint)
        self._own = own
        self._count = 0
        self._port = own.component.add_out_port(name, type_id, own.types)

    def _send(self, message: Message) -> None:
        """Write one message; a hung reader with `flush` costs its time limit."""
        self._port.write(message)
        self._count += 1

    def facts(self) -> Mapping[str, object]:
        """Return the counts of messages, of those that buffers dropped, and of connectors."""
        return {
            "count": self._count,
            "dropped": self._port.dropped,
            "connectors": len(self._port.get_connector_profiles()),
        }

    def _close(self) -> None:
        self._own.component.remove_port(self._port)


class OwnComponent:
    """The component of a bridge: made, bound and activated with its first port.

    Args:
        orb: where it is served.
        name: its name; bound as `NAME.rtc`.
        services: naming services to be visible in.
        types: the bridge's types.
        seconds: limit of calls to other components.
        report: takes (health, sentence) when its name is lost or bound again.

    Raises:
        BridgeError: no naming service answers.
    """

    def __init__(
        self,
        orb: Orb,
        name: str,
        services: Sequence[NamingService],
        types: Types,
        seconds: float,
        report: Callable[[Health, str], None],
    ) -> None:
        self.types = types
        self._orb = orb
        self._services = services
        self._report = report
        self._seconds = seconds
        # Guards `_closed` while the name is looked up and bound, from `close` in another thread.
        self._binding = threading.Lock()
        self._closed = False
        self.component = RtComponent(orb, ComponentProfile(name), seconds=seconds)
        self.component.lifecycle.activate()
        with on_failure(self.component.close):
            self._bind()

    def source(self, endpoint: Endpoint, name: str, type_id: str, deliver: Deliver) -> Source:
        """Open an InPort of ours."""
        return _OwnSource(self, endpoint, name, type_id, deliver)

    def sink(self, endpoint: Endpoint, name: str, type_id: str) -> Sink:
        """Open an OutPort of ours."""
        return _OwnSink(self, endpoint, name, type_id)

    def service(
        self,
        endpoint: Endpoint,
        name: str,
        interface: IdlInterface,
        operation: str,
        handler: Callable[[Message], Message],
        idl: str = "",
    ) -> Channel:
        """Open a CorbaPort of ours that provides an interface."""
        servant = servant_of(interface, operation, handler)
        full = f"{self.component.profile.name}.{name}"
        options = RtmEndpointOptions.of_endpoint(endpoint)
        port = ServicePort(
            self._orb,
            full,
            interface,
            servant,
            self._seconds,
            instance=options.instance,
            kind=options.interface,
            idl=idl,
        )
        self.component.add_port(port)
        return Channel(endpoint, lambda: self.component.remove_port(port))

    def _bind(self) -> None:
        silent = []
        for service in self._services:
            try:
                self.component.bind([service])
            except BridgeError as error:  # `tick` binds the name there once the service answers
                silent.append(error)
        if silent and len(silent) == len(self._services):
            raise silent[0]

    def tick(self) -> None:
        """Bind the name again where a naming service has forgotten it; nothing once closed."""
        for service in self._services:
            try:
                with self._binding:
                    if self._closed or service.resolve(self.component.path) is not None:
                        continue
                    self.component.bind([service])
            except BridgeError:
                continue  # the monitor reports that it is gone
            text = f"naming service {service.address} had forgotten us; bound again"
            self._report(Health.OK, text)

    def close(self) -> None:
        """Disappear."""
        with self._binding:  # a check that is under way would take what is unbound for forgotten
            self._closed = True
        self.component.close()
