"""The bridge as a component itself: ports of ours that other components connect to."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Mapping, Sequence
from functools import partial

from _uoarm_rtm_stubs import RTC
from omniORB import CORBA

from uoarm.bridge import (
    Channel,
    ChannelHealth,
    ChannelMonitor,
    Delivery,
    Sink,
    Source,
    on_failure,
)
from uoarm.errors import BridgeError, FailureReason
from uoarm.model import Endpoint, Health, Message
from uoarm_rtm._descriptors import IdlInterface
from uoarm_rtm._naming import NamingService
from uoarm_rtm._options import RtmEndpointOptions
from uoarm_rtm._orb import Orb
from uoarm_rtm._port_servant import PortServant
from uoarm_rtm._services import ServicePort, servant_of
from uoarm_rtm._types import Types
from uoarm_rtm.component import ComponentProfile, RtComponent

_RESTS = "another program has deactivated our component"


class _OwnChannel(Channel):
    """A channel at a port of ours, which rests while our component is not active."""

    def __init__(self, own: OwnComponent, endpoint: Endpoint, port: PortServant) -> None:
        super().__init__(endpoint)
        self._own, self._own_port = own, port
        health = ChannelHealth(f"port {port.name}", time.monotonic())
        self._monitor = ChannelMonitor(health, partial(own.report, channel=self))
        own.enter(self)

    def judge(self) -> None:
        """Report whether our component is active: other programs may deactivate it."""
        if self._own.is_active:
            self._monitor.peer_reported(Health.OK, "our component is active again")
        else:
            self._monitor.peer_reported(Health.DEGRADED, f"{_RESTS}: nothing passes")

    def _close(self) -> None:
        self._monitor.close()
        self._own.leave(self)
        self._own.component.remove_port(self._own_port)


class OwnSource(_OwnChannel, Source):
    """An InPort of ours: what others write to it is delivered, one message at a time."""

    def __init__(
        self, own: OwnComponent, endpoint: Endpoint, name: str, type_id: str, deliver: Delivery
    ) -> None:
        self._deliver = deliver
        self._count = 0
        rate = RtmEndpointOptions.of_endpoint(endpoint).rate
        self._port = own.component.add_in_port(
            name, type_id, own.types, self._take, rate, deliver.unreadable
        )
        super().__init__(own, endpoint, self._port)

    def facts(self) -> Mapping[str, object]:
        """Return the counts of messages, of those that came while inactive, and of connectors."""
        return {
            "count": self._count,
            "lost_on_link": self._port.dropped,
            "connectors": len(self._port.get_connector_profiles()),
        }

    def _take(self, message: Message) -> None:
        self._count += 1
        self._deliver(message)


class OwnSink(_OwnChannel, Sink):
    """An OutPort of ours: what is sent goes to every connected port."""

    def __init__(self, own: OwnComponent, endpoint: Endpoint, name: str, type_id: str) -> None:
        self._count = 0
        self._port = own.component.add_out_port(name, type_id, own.types)
        super().__init__(own, endpoint, self._port)

    def _send(self, message: Message) -> None:
        """Write one message; a hung reader with `flush` costs its time limit.

        Raises:
            BridgeError: our component is not active.
        """
        if not self._own.is_active:
            raise BridgeError(f"{self.endpoint}: {_RESTS}", FailureReason.UNAVAILABLE)
        self._port.write(message)
        self._count += 1

    def facts(self) -> Mapping[str, object]:
        """Return the counts of messages, of those that buffers dropped, and of connectors."""
        return {
            "count": self._count,
            "dropped": self._port.dropped,
            "connectors": len(self._port.get_connector_profiles()),
        }


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
        self._channels: dict[_OwnChannel, None] = {}
        # Guards `_closed` while the name is looked up and bound, from `close` in another thread.
        self._binding = threading.Lock()
        self._closed = False
        self.component = RtComponent(orb, ComponentProfile(name), seconds=seconds)
        self.component.lifecycle.activate()
        self.component.lifecycle.entered = self._judge
        with on_failure(self.component.close):
            self._bind()

    @property
    def is_active(self) -> bool:
        """Whether no other program has deactivated it."""
        return bool(self.component.lifecycle.state == RTC.ACTIVE_STATE)

    def enter(self, channel: _OwnChannel) -> None:
        """Have a channel judge whenever it is activated or deactivated, and now."""
        with self.component.lifecycle.lock:  # no change passes in between
            self._channels[channel] = None
            channel.judge()

    def leave(self, channel: _OwnChannel) -> None:
        """Notify a channel no more."""
        self._channels.pop(channel, None)

    def _judge(self) -> None:
        for channel in list(self._channels):
            channel.judge()

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

        def answer(message: Message) -> Message:
            if not self.is_active:  # as OpenRTM's own components do
                raise CORBA.OBJECT_NOT_EXIST(0, CORBA.COMPLETED_NO)
            return handler(message)

        servant = servant_of(interface, operation, answer)
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
        return _OwnChannel(self, endpoint, port)

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
