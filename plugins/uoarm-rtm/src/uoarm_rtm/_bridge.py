"""The bridge itself: addresses to ports, ports to channels."""

from __future__ import annotations

import contextlib
import threading
import time
import weakref
from collections.abc import Sequence
from functools import partial
from typing import TypeVar

from uoarm.bridge import (
    Bridge,
    Capabilities,
    Channel,
    Delivery,
    Description,
    Discovered,
    Handler,
    NativeLink,
    ServiceStructures,
    Sink,
    Source,
    at_exit,
    on_failure,
)
from uoarm.errors import BridgeError, FailureReason
from uoarm.model import Endpoint, Health, Message, MessageStructure, Role
from uoarm_rtm._channels import (
    InPortSink,
    NativeConnector,
    OutPortSource,
    is_big_in_cpp,
    required_port,
)
from uoarm_rtm._control import DESCRIPTIONS, Activations, configure, drive
from uoarm_rtm._discovery import Directory, DirectoryMonitor, discovered
from uoarm_rtm._health import RemotePort, WatchedComponent, WatchedPort
from uoarm_rtm._naming import NamingService
from uoarm_rtm._observers import Observers
from uoarm_rtm._options import (
    CONFIGURATION,
    LIFECYCLE,
    SELF,
    PortAddress,
    RtmBridgeOptions,
    RtmEndpointOptions,
    address_of,
    linked_options,
)
from uoarm_rtm._orb import Orb
from uoarm_rtm._own_component import OwnComponent, OwnSink, OwnSource
from uoarm_rtm._peer import Connections, PeerComponent, PeerPort, state_of
from uoarm_rtm._services import (
    OperationCaller,
    ServicePortChannel,
    described,
    offered,
    servant_of,
    unwrapped,
)
from uoarm_rtm._types import CALL, Types
from uoarm_rtm._watch import Check, Ticker

_EXIT_SECONDS = 3.0
_WATCH_SECONDS = 1.0

Ticked = TypeVar("Ticked", OutPortSource, InPortSink)


class RtmBridge(Bridge):
    """OpenRTM components through CORBA.

    Raises:
        BridgeError: the IDL of the options cannot be compiled, or the ORB cannot begin.
    """

    capabilities = Capabilities(discover=True, call=True, serve=True, link=True)

    def __init__(self, name: str, options: RtmBridgeOptions) -> None:
        super().__init__(name, options)
        self._options = options
        self._component = options.component or f"uoarm_{name}"
        self._types = Types(options.idl_sources, options.text, options.idl_folder)
        seconds = options.call_seconds
        self._orb = Orb(options.address, seconds, int(options.max_message))
        with on_failure(self._orb.close):  # a bridge that was never made is never closed
            self._services = [
                NamingService(self._orb, nameserver, seconds)
                for nameserver in self._options.nameservers
            ]
        self._directory = Directory(self._services, seconds)
        self._connections = Connections(self._orb, self._component, seconds)
        # Guards the callers, our own component and what is watched: calls, openings, closings and
        # the ticker's rounds are in different threads. Never held while a component is called.
        self._guard = threading.Lock()
        # Held while our own component is made, which calls naming services: `close` waits for it.
        self._making = threading.Lock()
        self._own: OwnComponent | None = None
        self._callers: dict[tuple[str, ...], OperationCaller] = {}
        # By path, which components of the configuration are there, and whether each is called.
        self._named: dict[str, dict[str, bool]] = {}
        self._active = Activations(seconds)
        self._watched: dict[str, WatchedComponent] = {}
        self._ticking: dict[OutPortSource | InPortSink, None] = {}
        self._ticker = Ticker(self._checks, self._options.watch)
        soon, follow, own = self._ticker.soon, self._ticker.follow, f"{self._component}.rtc"
        self._monitor = DirectoryMonitor(self._directory, self._report_path, own, follow)
        self._observers = Observers(self._orb, self._component, seconds, soon)
        with on_failure(self._orb.close):
            self._ticker.start()
        self._forget_exit = at_exit(partial(_end_at_exit, weakref.ref(self)))

    def _describe(self, endpoint: Endpoint) -> Description:
        address = address_of(endpoint)
        if endpoint.role is Role.SERVICE:
            return self._describe_service(endpoint, address)
        if address.component == SELF:
            known = self._types.structure(address.type) if address.type else None
            return Description(message=known)
        _, port = self._port(endpoint, address)
        return Description(message=self._types.structure(port.data_type))

    def _describe_service(self, endpoint: Endpoint, address: PortAddress) -> Description:
        if address.component == SELF:
            known = described(*self._types.interface(address.type)) if address.type else None
            return known or Description()
        peer = self._peer(endpoint, address)
        if address.port in DESCRIPTIONS:
            return DESCRIPTIONS[address.port]
        port = peer.port(address.port)
        self._require_no_error(peer)
        return described(*self._types.interface(address.type or _only_type(peer, port)))

    def _open_source(
        self, endpoint: Endpoint, structure: MessageStructure, deliver: Delivery
    ) -> Source:
        address = address_of(endpoint)
        if address.component == SELF:
            own = address.type or self._types.derive(address.port, structure, is_read=True)
            return OwnSource(self._own_component(), endpoint, address.port, own, deliver)
        remote = self._remote_port(endpoint)
        return self._ticked(OutPortSource(remote, deliver))

    def _open_sink(self, endpoint: Endpoint, structure: MessageStructure) -> Sink:
        address = address_of(endpoint)
        if address.component == SELF:
            own = address.type or self._types.derive(address.port, structure, is_read=False)
            return OwnSink(self._own_component(), endpoint, address.port, own)
        remote = self._remote_port(endpoint)
        return self._ticked(InPortSink(remote))

    def _call(
        self, endpoint: Endpoint, structures: ServiceStructures, message: Message, timeout: float
    ) -> Message:
        del structures  # the interface is in the address, or at the port
        address = address_of(endpoint)
        seconds = min(timeout, self._options.call_seconds)
        own = RtmEndpointOptions.of_endpoint(endpoint).timeout if endpoint.options else None
        limit = timeout, "the limit of the call"
        if own is not None:
            limit = min(limit, (own, "`timeout` of the endpoint"))
        elif self._options.call_timeout is not None:
            limit = min(limit, (self._options.call_timeout, "`call_timeout` of the bridge"))
        if address.port == LIFECYCLE:
            return drive(self._directory.peer(address.component), message, seconds)
        if address.port == CONFIGURATION:
            return configure(self._directory.peer(address.component), message, seconds)
        key = (address.component, address.port, address.type)
        while True:
            caller = self._callers.get(key)
            if caller is None:
                made = self._caller(address)
                with self._guard:
                    self._require_open()
                    caller = self._callers.setdefault(key, made)
            try:
                return caller.call(message, *limit)
            except BridgeError as error:
                if not caller.ended:
                    raise
                if self.closed:
                    text = f"{endpoint}: the bridge was closed"
                    raise BridgeError(text, FailureReason.CLOSED) from error
                # The next call looks for the component anew: it may have come back elsewhere.
                with self._guard:
                    if self._callers.get(key) is caller:
                        del self._callers[key]
                if error.reason is not FailureReason.CLOSED:
                    raise
                # Another call has ended it before this one began.

    def _caller(self, address: PortAddress) -> OperationCaller:
        peer = self._directory.peer(address.component)
        port = peer.port(address.port)
        wanted = address.type or _only_type(peer, port)
        interface, operation = self._types.interface(wanted)
        offer = offered(peer, port, interface.name, provided=True)
        seconds = self._options.call_seconds
        return OperationCaller(
            self._orb, peer, port, interface, offer, operation, seconds, self._connections
        )

    def _serve(
        self, endpoint: Endpoint, structures: ServiceStructures, handler: Handler
    ) -> Channel:
        address = address_of(endpoint)
        if address.component == SELF:
            idl = ""
            if address.type:
                interface, operation = self._types.interface(address.type)
            else:
                interface, idl = self._types.derive_interface(address.port, structures)
                operation, handler = CALL, unwrapped(handler)
            return self._own_component().service(
                endpoint, address.port, interface, operation, handler, idl
            )
        peer = self._directory.peer(address.component)
        port = peer.port(address.port)
        interface, operation = self._types.interface(address.type or _only_type(peer, port))
        wanted = offered(peer, port, interface.name, provided=False)
        servant = servant_of(interface, operation, handler)
        return ServicePortChannel(
            self._orb, endpoint, peer, port, wanted, servant, self._connections
        )

    def _link(self, source: Endpoint, sink: Endpoint) -> NativeLink | None:
        addresses = address_of(source), address_of(sink)
        if any(address.component == SELF for address in addresses):
            return None
        options = linked_options(source, sink)
        if options is None:
            return None
        start, end = self._remote_port(source), self._remote_port(sink)
        if not self._types.same(start.port.data_type, end.port.data_type):
            return None
        if is_big_in_cpp(start.peer, options) or is_big_in_cpp(end.peer, options):
            return None
        native = NativeConnector(start, end, options)
        self._supervise(native, native.ports[::-1])  # the sink is activated first
        return native

    def _discover(self) -> tuple[Discovered, ...]:
        return discovered(self.name, self._directory, self._types, self._options.call_seconds)

    def _close(self) -> None:
        self._forget_exit()
        try:
            self._ticker.close(0)
            with self._guard:
                self._ticking.clear()
                self._watched.clear()
            self._active.tick()
            self._observers.close()
            self._connections.close()
            # Steps may be under way: none makes a caller any more, and one that makes our
            # component puts it away itself; the ORB waits for that, as long as a call may take.
            is_made = self._making.acquire(timeout=self._options.call_seconds)
            with self._guard:
                callers, own = list(self._callers.values()), self._own
            if is_made:
                self._making.release()
            for caller in callers:
                with contextlib.suppress(BridgeError):
                    caller.end()
            if own is not None:
                own.close()
            self._ticker.close(_WATCH_SECONDS)
        finally:
            self._orb.close()  # the process has one, which would have a user for ever

    def end_at_exit(self) -> None:
        """End all connections, in a process that exits without closing the bridge.

        In this thread, since none can begin any more; what takes too long is left to the next
        process.
        """
        self._ticker.close(_EXIT_SECONDS)
        deadline = time.monotonic() + _EXIT_SECONDS
        for channel in list(self._open):
            if not channel.closed and time.monotonic() < deadline:
                with contextlib.suppress(BridgeError):
                    channel._close()  # noqa: SLF001 - all of them are ours
        self._active.tick()
        self._observers.close(_EXIT_SECONDS)

    def _remote_port(self, endpoint: Endpoint) -> RemotePort:
        peer, port = self._port(endpoint, address_of(endpoint))
        return RemotePort(
            self._orb,
            self._connections,
            endpoint,
            peer,
            port,
            self._types.codec(port.data_type),
            RtmEndpointOptions.of_endpoint(endpoint),
            self._options.call_seconds,
            self.report_channel,
            self._active.leave,
        )

    def _port(self, endpoint: Endpoint, address: PortAddress) -> tuple[PeerComponent, PeerPort]:
        """Return the port of an address, which can be what is asked, and is not of a failed one."""
        peer = self._peer(endpoint, address)
        options = RtmEndpointOptions.of_endpoint(endpoint)
        port = required_port(peer, endpoint.role, address, options, self._types)
        if not options.reset:
            self._require_no_error(peer)
        return peer, port

    def _peer(self, endpoint: Endpoint, address: PortAddress) -> PeerComponent:
        peer = self._directory.peer(address.component)
        with self._guard:
            named = self._named.setdefault(peer.path, {})
            named[endpoint.component] = endpoint.role is Role.SERVICE
        return peer

    def _report_path(self, health: Health, cause: str, *, component: str | None) -> None:
        """Report what became of a path in naming services; None: of all of it."""
        self.report(health, cause, component=component)
        with self._guard:
            named = self._named.get(component or "", {}).copy()
        for name, is_called in named.items():
            # That what is open was lost, its channels report.
            if name != component and (is_called or health is Health.OK):
                self.report(health, cause, component=name)

    def _require_no_error(self, peer: PeerComponent) -> None:
        """Raise BridgeError, UNAVAILABLE, where a component has failed: then another is chosen."""
        if state_of(peer, self._options.call_seconds) == "error":
            text = (
                f"component {peer.path!r} has failed: it is in state ERROR; reset it, "
                "or give its endpoint `activate: true` and `reset: true`"
            )
            raise BridgeError(text, FailureReason.UNAVAILABLE)

    def _ticked(self, channel: Ticked) -> Ticked:
        """Have a channel watched, which is also lost where it is silent."""
        self._supervise(channel, channel.ports)
        with self._guard:
            self._ticking[channel] = None
        return channel

    def _supervise(self, channel: Channel, ports: Sequence[WatchedPort]) -> None:
        """Have a channel's ports watched, and its components activated when that is asked."""
        for port in ports:
            with on_failure(channel.close):
                self._active.enter(channel, port.remote.peer, port.remote.options)
        components = []
        for port in ports:
            key = self._orb.text(port.remote.peer.reference)  # one that came back is another
            with self._guard:
                component = self._watched.get(key)
                if component is None:
                    seconds = self._options.call_seconds
                    component = WatchedComponent(port.remote.peer, seconds, self._ticker)
                    self._watched[key] = component
                component.enter(port)
            components.append(component)
        for port, other in zip(ports, reversed(components), strict=True):
            port.other = other if len(ports) > 1 else None
        if self._options.observe and self._options.watch:
            for component in components:
                self._observers.enter(component)

    def _require_open(self) -> None:
        if self.closed:
            raise BridgeError(f"bridge {self.name!r} is closed", FailureReason.CLOSED)

    def _own_component(self) -> OwnComponent:
        """Return our own component, made when it is first needed."""
        with self._making:
            self._require_open()
            if self._own is not None:
                return self._own
            name, seconds = self._component, self._options.call_seconds
            made = OwnComponent(self._orb, name, self._services, self._types, seconds, self.report)
            with on_failure(made.close), self._guard:
                self._require_open()
                self._own = made
            return made

    def _checks(self) -> list[Check]:
        """Return the checks of one round; none of them waits for another."""
        with self._guard:
            self._watched = {key: found for key, found in self._watched.items() if found.is_used}
            self._ticking = {channel: None for channel in self._ticking if not channel.closed}
            checks: list[Check] = [channel.health.tick for channel in self._ticking]
            checks += [component.check for component in self._watched.values()]
        checks += [*self._active.checks(), *self._observers.checks(), *self._monitor.checks()]
        return checks if self._own is None else [*checks, self._own.tick]


def _end_at_exit(reference: weakref.ref[RtmBridge]) -> None:
    bridge = reference()
    if bridge is not None and not bridge.closed:
        bridge.end_at_exit()


def _only_type(peer: PeerComponent, port: PeerPort) -> str:
    """Return the interface type of a port that has only one.

    Raises:
        BridgeError: BAD_ENDPOINT when it has none or several.
    """
    if len(port.interfaces) == 1:
        return port.interfaces[0].type
    names = ", ".join(interface.type for interface in port.interfaces) or "none"
    text = f"port {port.name!r} of {peer.path!r} has interfaces {names}: say which, as third part"
    raise BridgeError(text, FailureReason.BAD_ENDPOINT)
