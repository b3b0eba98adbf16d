"""The bridge itself: addresses to ports, ports to channels."""

from __future__ import annotations

import threading
from collections.abc import Callable

from uoarm.bridge import Bridge, Capabilities, Channel, Description, Discovered, Sink
from uoarm.errors import BridgeError, FailureReason
from uoarm.model import Deliver, Endpoint, Health, Message, MessageStructure, Options, Role
from uoarm_rtm import _control
from uoarm_rtm._directory import Directory
from uoarm_rtm._discovery import discovered
from uoarm_rtm._naming import NamingService
from uoarm_rtm._orb import Orb
from uoarm_rtm._peer import Peer, Port
from uoarm_rtm._place import Place
from uoarm_rtm._settings import (
    CONFIGURATION,
    LIFECYCLE,
    Address,
    address_of,
    bridge_settings,
    settings_of,
)
from uoarm_rtm._sink import InPortSink
from uoarm_rtm._source import Source
from uoarm_rtm._types import Types
from uoarm_rtm._watch import Attendance, Watch

__all__ = ["RtmBridge"]

_PORT_KINDS = {Role.OUTPUT: "DataOutPort", Role.INPUT: "DataInPort"}


class RtmBridge(Bridge):
    """OpenRTM components through CORBA.

    Args:
        name: name of this instance in the configuration.
        options: checked against `_settings.BRIDGE_OPTIONS`.

    Raises:
        BridgeError: the IDL of the options cannot be compiled, or the ORB cannot begin.
    """

    capabilities = Capabilities(discover=True, call=True)

    def __init__(self, name: str, options: Options) -> None:
        super().__init__(name, options)
        self._settings = bridge_settings(name, options)
        self._types = Types(self._settings.idl, self._settings.text)
        seconds = self._settings.call_seconds
        self._orb = Orb(self._settings.address, seconds)
        self._services = [
            NamingService(self._orb, each, seconds) for each in self._settings.nameservers
        ]
        self._directory = Directory(self._services, seconds)
        self._guard = threading.Lock()
        self._ticking: dict[Channel, Callable[[], None]] = {}
        own = f"{self._settings.component}.rtc"
        self._attendance = Attendance(self._directory, self._component_changed, own)
        self._watch = Watch(self._ticks, self._settings.watch_seconds)

    def _describe(self, endpoint: Endpoint) -> Description:
        address = address_of(endpoint)
        if address.port == LIFECYCLE:
            self._directory.peer(address.component)
            return Description(request=_control.LIFECYCLE_REQUEST, reply=_control.LIFECYCLE_REPLY)
        if address.port == CONFIGURATION:
            self._directory.peer(address.component)
            return Description(
                request=_control.CONFIGURATION_REQUEST, reply=_control.CONFIGURATION_REPLY
            )
        _, port = self._port(endpoint, address)
        return Description(message=self._types.structure(port.data_type))

    def _open_source(
        self, endpoint: Endpoint, structure: MessageStructure, deliver: Deliver
    ) -> Channel:
        del structure  # the data type is in the address, or at the port
        place = self._place(endpoint)
        source = Source(place, deliver)
        return self._looked_after(source, source.tick, place)

    def _open_sink(self, endpoint: Endpoint, structure: MessageStructure) -> Sink:
        del structure
        place = self._place(endpoint)
        sink = InPortSink(place)
        self._looked_after(sink, sink.tick, place)
        return sink

    def _call(self, endpoint: Endpoint, message: Message, timeout: float) -> Message:
        address = address_of(endpoint)
        peer = self._directory.peer(address.component)
        seconds = min(timeout, self._settings.call_seconds)
        if address.port == LIFECYCLE:
            return _control.drive(peer, message, seconds)
        return _control.configure(peer, message, seconds)

    def _discover(self) -> tuple[Discovered, ...]:
        return discovered(self.name, self._directory, self._types, self._settings.call_seconds)

    def _close(self) -> None:
        self._watch.close()
        with self._guard:
            self._ticking.clear()
        self._orb.close()

    def _place(self, endpoint: Endpoint) -> Place:
        peer, port = self._port(endpoint, address_of(endpoint))
        return Place(
            self._orb,
            endpoint,
            peer,
            port,
            self._types.codec(port.data_type),
            settings_of(endpoint),
            self._settings.call_seconds,
            self._told,
        )

    def _port(self, endpoint: Endpoint, address: Address) -> tuple[Peer, Port]:
        """Return the port of an address, whose kind and type are what is asked."""
        peer = self._directory.peer(address.component)
        port = peer.port(address.port)
        wanted = _PORT_KINDS[endpoint.role]
        if port.kind != wanted:
            text = (
                f"port {port.name!r} of component {peer.path!r} is a "
                f"{port.kind or 'nameless kind'}, but an {endpoint.role.value} needs a {wanted}"
            )
            raise BridgeError(text, FailureReason.BAD_ENDPOINT)
        if address.type and not self._types.same(address.type, port.data_type):
            text = (
                f"port {port.name!r} of component {peer.path!r} carries {port.data_type}, "
                f"the configuration says {address.type}: correct the endpoint"
            )
            raise BridgeError(text, FailureReason.REFUSED)
        return peer, port

    def _looked_after(self, channel: Channel, tick: Callable[[], None], place: Place) -> Channel:
        """Have a channel watched, and its component activated when that is asked."""
        if place.settings.activate:
            try:
                _control.change(place.peer, "activate", place.seconds, there_is_fine=True)
            except BridgeError:
                channel.close()
                raise
        with self._guard:
            self._ticking[channel] = tick
        return channel

    def _ticks(self) -> list[Callable[[], None]]:
        with self._guard:
            for channel in [each for each in self._ticking if each.closed]:
                del self._ticking[channel]
            return [*self._ticking.values(), self._attendance.tick]

    def _told(self, channel: Channel, health: Health, cause: str) -> None:
        self.report(health, cause, channel=channel)

    def _component_changed(self, health: Health, cause: str, path: str) -> None:
        self.report(health, cause, component=path or None)
