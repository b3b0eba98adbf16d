"""The bridge as a component itself: ports of ours that other components connect to."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Mapping, Sequence
from functools import partial

from uoarm.bridge import (
    Channel,
    ChannelHealth,
    ChannelMonitor,
    Delivery,
    Sink,
    Source,
    on_failure,
)
from uoarm.errors import BridgeError
from uoarm.model import Endpoint, Health, Message
from uoarm_rtm._data_ports import InPort
from uoarm_rtm._descriptors import IdlInterface
from uoarm_rtm._naming import NamingService
from uoarm_rtm._options import RtmEndpointOptions
from uoarm_rtm._orb import Orb
from uoarm_rtm._services import ServicePort, servant_of
from uoarm_rtm._types import Types
from uoarm_rtm.component import Callbacks, ComponentProfile, RtComponent


class OwnSource(Source):
    """An InPort of ours: what others write to it is delivered, one message at a time."""

    def __init__(
        self, own: OwnComponent, endpoint: Endpoint, name: str, type_id: str, deliver: Delivery
    ) -> None:
        super().__init__(endpoint)
        self._own = own
        self._deliver = deliver
        self._count = self._dropped = 0
        full = f"{own.component.profile.name}.{name}"
        health = ChannelHealth(f"port {full}", time.monotonic())
        self._monitor = ChannelMonitor(health, partial(own.report, channel=self))
        self._port = InPort(
            own.orb,
            full,
            own.types.codec(type_id),
            self._take,
            own.seconds,
            RtmEndpointOptions.of_endpoint(endpoint).rate,
            deliver.unreadable,
        )
        own.component.add_port(self._port)
        own.enter(self)

    def judge(self) -> None:
        """Report whether our component takes what comes: other programs may deactivate it."""
        if self._own.is_active:
            self._monitor.peer_reported(Health.OK, "our component is active again")
        else:
            text = "another program has deactivated our component: what comes is dropped"
            self._monitor.peer_reported(Health.DEGRADED, text)

    def facts(self) -> Mapping[str, object]:
        """Return the counts of messages, of those that came while inactive, and of connectors."""
        return {
            "count": self._count,
            "lost_on_link": self._dropped,
            "connectors": len(self._port.get_connector_profiles()),
        }

    def _take(self, message: Message) -> None:
        if not self._own.is_active:
            self._dropped += 1
            return
        self._count += 1
        self._deliver(message)

    def _close(self) -> None:
        self._monitor.close()
        self._own.leave(self)
        self._own.component.remove_port(self._port)


class OwnSink(Sink):
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
        name: its name; bound as `NAME.rtc`.
        services: naming services to be visible in.
        seconds: limit of calls to other components.

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
        report: Callable[..., None],
    ) -> None:
        self.types, self.orb, self.report, self.seconds = types, orb, report, seconds
        self._services = services
        self.is_active = True
        self._sources: dict[OwnSource, None] = {}
        # Guards `_closed` while the name is looked up and bound, from `close` in another thread.
        self._binding = threading.Lock()
        self._closed = False
        callbacks = Callbacks(
            activated=partial(self._judge, is_active=True),
            deactivated=partial(self._judge, is_active=False),
        )
        self.component = RtComponent(
            orb, ComponentProfile(name), callbacks=callbacks, seconds=seconds
        )
        self.component.lifecycle.activate()
        with on_failure(self.component.close):
            self._bind()

    def enter(self, source: OwnSource) -> None:
        """Have a source notified whenever it is activated or deactivated; now, where it is not."""
        self._sources[source] = None  # before the look, so that no change passes between
        source.judge()

    def leave(self, source: OwnSource) -> None:
        """Notify a source no more."""
        self._sources.pop(source, None)

    def _judge(self, *, is_active: bool) -> None:
        self.is_active = is_active
        for source in list(self._sources):
            source.judge()

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
            self.orb,
            full,
            interface,
            servant,
            self.seconds,
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
            self.report(Health.OK, text)

    def close(self) -> None:
        """Disappear."""
        with self._binding:  # a check that is under way would take what is unbound for forgotten
            self._closed = True
        self.component.close()
