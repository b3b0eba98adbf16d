"""Channels to the data ports of components: sources, sinks, and native links between two ports.

`required_port` finds the port that an endpoint means, or why it cannot be had, before anything is
connected. OutPorts push to us, or we ask them; to InPorts we push, at once or from a buffer, or
they ask us. Over a native link the components move the data, and we only check it.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from _uoarm_rtm_stubs import OpenRTM, OpenRTM__POA
from attrs import evolve
from omniORB import CORBA

from uoarm.bridge import Delivery, NativeLink, Sink, Source, on_failure
from uoarm.errors import BridgeError, BridgeTimeoutError, FailureReason, MessageError
from uoarm.model import Message, Role
from uoarm_rtm._data_ports import INPORT_IOR, OUTPORT_IOR
from uoarm_rtm._dataflow import PullBuffer, Puller, SizeLimit, ThreadedPusher
from uoarm_rtm._health import ConnectorHealth, LinkHealth, RemotePort, WatchedPort
from uoarm_rtm._options import (
    PortAddress,
    RtmEndpointOptions,
    buffer_policy,
    push_policy,
    says_what_empty_means,
)
from uoarm_rtm._orb import CallGuard, calls, corba_text, deliveries, limit, narrowed
from uoarm_rtm._peer import Connector, PeerComponent, PeerPort, connector_properties
from uoarm_rtm._shape import BIG, LITTLE
from uoarm_rtm._types import Types

_KINDS = {Role.OUTPUT: "DataOutPort", Role.INPUT: "DataInPort"}
_MISREAD = (Role.OUTPUT, "push"), (Role.INPUT, "pull")


def required_port(
    peer: PeerComponent,
    role: Role,
    address: PortAddress,
    options: RtmEndpointOptions,
    types: Types,
) -> PeerPort:
    """Return the port of an address, with the data type that goes over it.

    Raises:
        BridgeError: NOT_FOUND, where there is none; BAD_ENDPOINT or REFUSED, where it is another
            one than the configuration says; UNSUPPORTED, where we do not speak as it does.
    """
    port = peer.port(address.port)
    where = f"port {port.name!r} of component {peer.path!r}"
    if port.kind != _KINDS[role]:
        kind = port.kind or "nameless kind"
        text = f"{where} is a {kind}, but an {role.value} needs a {_KINDS[role]}"
        raise BridgeError(text, FailureReason.BAD_ENDPOINT)
    if port.interface_types and "corba_cdr" not in port.interface_types:
        text = (
            f"{where} offers the interface types {', '.join(port.interface_types)}, and we speak "
            "corba_cdr: let the component offer it, too (in its rtc.conf: `provider_types` and "
            "`consumer_types` of the port)"
        )
        raise BridgeError(text, FailureReason.UNSUPPORTED)
    if port.takes_events:
        port = _event(port, where, address, options)
    elif options.event:
        text = f"{where} takes {port.data_type}, and no events: leave the option `event` out"
        raise BridgeError(text, FailureReason.BAD_ENDPOINT)
    if address.type and not types.same(address.type, port.data_type):
        text = (
            f"{where} carries {port.data_type}, the configuration says {address.type}: "
            "correct the endpoint"
        )
        raise BridgeError(text, FailureReason.REFUSED)
    if is_big_in_cpp(peer, options) and (role, options.flow) in _MISREAD:
        text = (
            f"{where}: components in C++ take no notice of `endian` where they push or ask: "
            "leave it out"
        )
        raise BridgeError(text, FailureReason.REFUSED)
    return port


def is_big_in_cpp(peer: PeerComponent, options: RtmEndpointOptions) -> bool:
    """Whether big-endian data is asked of a component that may not notice."""
    return options.endian == "big" and peer.language == "C++"


def _event(
    port: PeerPort, where: str, address: PortAddress, options: RtmEndpointOptions
) -> PeerPort:
    """Return the port of a state machine as that of one event, which has a data type."""
    if not address.type or not options.event:
        text = (
            f"{where} takes the events of a state machine (type any): name the event in the "
            "option `event`, and its data type as third part of the endpoint"
        )
        raise BridgeError(text, FailureReason.BAD_ENDPOINT)
    return evolve(port, data_type=address.type)


def _reached(
    remote: RemotePort, connector: Connector, key: str, interface: Any, seconds: float
) -> Any:
    """Return the object that a port published; without it nothing stays connected."""
    ior = connector.published(key)
    with on_failure(connector.disconnect):
        what = f"{remote.where}: its {interface.__name__}"
        target = narrowed(remote.orb.reference(ior), interface, remote.seconds, what)
        return limit(target, seconds)


class _Inlet(OpenRTM__POA.InPortCdr):  # type: ignore[misc]  # generated, without annotations
    """What the component's OutPort pushes to."""

    def __init__(self, source: OutPortSource) -> None:
        self._source = source

    def put(self, data: bytes) -> Any:
        """Take one message (CORBA operation)."""
        with deliveries:
            return self._source.receive(data)


class OutPortSource(Source):
    """One connector from an OutPort.

    Messages are delivered in a thread of the ORB (push), or in one of the channel's own (pull).

    Raises:
        BridgeError: the port refuses or is gone; nothing stays connected.
    """

    def __init__(self, remote: RemotePort, deliver: Delivery) -> None:
        super().__init__(remote.endpoint)
        self._remote = remote
        self._deliver = deliver
        self._order = BIG if remote.options.endian == "big" else LITTLE
        self._puller: Puller | None = None
        self._longest = remote.seconds
        self.health = ConnectorHealth(self, remote, remote.options.stale_after)
        self._inlet = remote.orb.serve(_Inlet(self)) if remote.options.flow == "push" else None
        properties = connector_properties(remote.options, remote.codec.name)
        if self._inlet is not None:
            properties[INPORT_IOR] = remote.orb.text(self._inlet)
        with on_failure(self._withdraw):
            self._connector = remote.connections.connect(remote.where, properties, remote.port)
            if self._inlet is None:
                self._begin_pulling()

    def receive(self, data: bytes) -> Any:
        """Decode and deliver one message; returns the status to answer."""
        if self.closed:
            return OpenRTM.PORT_ERROR
        try:
            message = self._remote.codec.decode(data, self._order)
        except MessageError as error:
            self._deliver.unreadable(f"{self._remote.where}: {error}")
            return OpenRTM.PORT_ERROR
        self.health.note_message()
        self._deliver(message)
        return OpenRTM.PORT_OK

    @property
    def ports(self) -> tuple[WatchedPort, ...]:
        """What is to be checked."""
        return (WatchedPort(self, self.health, self._remote, self._connector),)

    def facts(self) -> Mapping[str, object]:
        """Return counters and the port."""
        return self.health.facts()

    def _close(self) -> None:
        if self._puller is not None:
            self._puller.end(self._longest)
        self._withdraw()
        try:
            self._connector.disconnect()
        finally:
            self._remote.ended(self)

    def _withdraw(self) -> None:
        if self._inlet is not None:
            self._remote.orb.withdraw(self._inlet)

    def _begin_pulling(self) -> None:
        remote = self._remote
        requested = remote.options.requested_properties
        self._longest += buffer_policy(requested, "outport").longest_read
        target = _reached(remote, self._connector, OUTPORT_IOR, OpenRTM.OutPortCdr, self._longest)
        with on_failure(self._connector.disconnect):  # the system gives no more threads
            self._puller = Puller(
                target,
                remote.options.rate,
                repeats=says_what_empty_means(requested),
                take=self.receive,
                lost=self._lost,
                missed=self._missed,
            )

    def _missed(self, error: CORBA.Exception) -> None:
        text = (
            f"an answer of {self._remote.where} does not arrive ({corba_text(error)}): it may be "
            f"larger than our limit of {self._remote.orb.most_octets} octets (`max_message`), or "
            "than the component's own (-ORBgiopMaxMsgSize there)"
        )
        self._deliver.unreadable(text)

    def _lost(self, error: CORBA.Exception) -> None:
        self.health.lose(f"is gone ({corba_text(error)})")


_REASONS = {
    "BUFFER_FULL": "its buffer is full",
    "BUFFER_TIMEOUT": "its buffer stayed full",
    "PORT_ERROR": "it could not take the data",
    "UNKNOWN_ERROR": "it could not take the data",
}


class InPortSink(Sink):
    """One connector to an InPort.

    `send` waits for the component's answer where we push with `flush`; otherwise it puts the
    message into our buffer, whose policy may be to wait for room.

    Raises:
        BridgeError: the port refuses or is gone; nothing stays connected.
    """

    def __init__(self, remote: RemotePort) -> None:
        super().__init__(remote.endpoint)
        self._remote = remote
        self._order = BIG if remote.options.endian == "big" else LITTLE
        self.health = ConnectorHealth(self, remote)
        requested = remote.options.requested_properties
        self._policy = buffer_policy(requested, "outport")
        self._buffer: PullBuffer | ThreadedPusher | None = None
        self._outlet: Any = None
        self._target: Any = None
        self._gone = ""
        self._putting = CallGuard()
        self._sizes = SizeLimit(remote.where, remote.orb.most_octets)
        waits = buffer_policy(requested, "inport").longest_write
        self._is_released = False
        self._refused = 0
        self._lost_on_link = 0
        self._longest = remote.options.timeout or remote.seconds + waits
        properties = connector_properties(remote.options, remote.codec.name)
        pulls = remote.options.flow == "pull"
        if pulls:
            self._buffer = PullBuffer(self._policy)
            self._outlet = remote.orb.serve(self._buffer)
            properties[OUTPORT_IOR] = remote.orb.text(self._outlet)
        elif remote.options.subscription != "flush":  # before there is a connection: it may fail
            push, period = push_policy(requested), remote.options.period
            self._buffer = ThreadedPusher(self._push, self._policy, push, period)
        with on_failure(self._withdraw):
            self._connector = remote.connections.connect(remote.where, properties, remote.port)
            if not pulls:
                inlet = INPORT_IOR, OpenRTM.InPortCdr
                self._target = _reached(remote, self._connector, *inlet, self._longest)
        self.blocking = self._buffer is None or self._policy.full == "block"

    def _send(self, message: Message) -> None:
        """Hand one message to the port.

        Raises:
            MessageError: it does not fit the data type; the text names the field. Or it is larger
                than an ORB takes.
            BridgeError: the component is gone or refuses the data, our buffer is full, or the
                channel was closed meanwhile.
            BridgeTimeoutError: the component does not answer in time.
        """
        self._require_open()
        data = self._remote.codec.encode(message, self._order)
        if self._buffer is None:
            self._put(data)
            self.health.note_message()
        else:
            self._keep(data)

    def drain(self, timeout: float) -> bool:
        """Wait until what is in our buffer has been taken, `timeout` seconds at most."""
        return self._buffer is None or self._buffer.drain(timeout)

    @property
    def ports(self) -> tuple[WatchedPort, ...]:
        """What is to be checked."""
        return (WatchedPort(self, self.health, self._remote, self._connector),)

    def facts(self) -> Mapping[str, object]:
        """Return counters and the port."""
        facts = {**self.health.facts(), "refused": self._refused}
        if self._buffer is not None:
            # What waits to be asked for when the component is lost is not asked for any more.
            unasked = self._buffer.waiting if self._outlet is not None and self.health.lost else 0
            lost = self._lost_on_link + unasked
            facts |= {"dropped": self._buffer.dropped, "lost_on_link": lost}
            if isinstance(self._buffer, ThreadedPusher):
                facts["under_way"] = self._buffer.under_way
        return facts

    def _require_open(self) -> None:
        if self._is_released:  # later than `closed`: what moves is stopped before it is released
            text = f"bridge {self.endpoint.bridge!r}: {self.endpoint} is closed"
            raise BridgeError(text, FailureReason.CLOSED)
        if self._gone:
            raise BridgeError(self._gone, FailureReason.UNAVAILABLE)

    def _keep(self, data: bytes) -> None:
        """Have a message wait in our buffer."""
        assert self._buffer is not None
        if self._outlet is not None and self.health.lost:  # it would never be asked for
            raise BridgeError(self.health.lost, FailureReason.UNAVAILABLE)
        if self._buffer.write(data):
            if self._outlet is not None:  # what we push counts when it has been put
                self.health.note_message()
            return
        self._require_open()
        policy = self._policy
        stayed = f" and stayed so for {policy.write_seconds:g} s" if policy.full == "block" else ""
        text = f"{self._remote.where}: our buffer of {policy.length} for it is full{stayed}"
        raise BridgeError(text, FailureReason.REFUSED)

    def _push(self, data: bytes) -> None:
        """Put one message from the buffer's thread, which has no caller to take an error."""
        try:
            self._put(data)
        except BridgeTimeoutError:
            self._lost_on_link += 1  # it is reported; the component may be back for the next
        except MessageError as error:
            self._degrade(error)
        except BridgeError as error:
            if error.reason is FailureReason.UNAVAILABLE:
                self._gone = str(error)
            if error.reason is not FailureReason.REFUSED:  # which is counted as that
                self._lost_on_link += 1
            self._degrade(error)
        else:
            self.health.note_message()

    def _degrade(self, error: Exception) -> None:
        self.health.degrade(str(error).removeprefix(self._remote.where).lstrip(": "))

    def _put(self, data: bytes) -> None:
        too_large = self._sizes.refusal(len(data))
        if too_large:
            self._refused += 1
            raise MessageError(too_large)
        try:
            with calls, self._putting:
                status = self._target.put(data)
        except CORBA.TIMEOUT as error:
            cause = "did not take a message within its time limit"
            self.health.degrade(cause)
            raise BridgeTimeoutError(f"{self._remote.where} {cause}") from error
        except CORBA.Exception as error:
            self._require_open()
            too_large = self._sizes.explain(error, self._target, len(data))
            if too_large:
                self._refused += 1
                raise MessageError(too_large) from error
            cause = f"is gone ({corba_text(error)})"
            self.health.lose(cause)
            text = f"{self._remote.where} {cause}"
            raise BridgeError(text, FailureReason.UNAVAILABLE) from error
        self._sizes.passed(len(data))
        if status != OpenRTM.PORT_OK:
            self._refused += 1
            reason = _REASONS.get(str(status), "it said so")
            text = f"{self._remote.where} refused a message: {status} ({reason})"
            raise BridgeError(text, FailureReason.REFUSED)

    def _close(self) -> None:
        self._is_released = True
        self._withdraw()
        # A component in C++ may abort when it is disconnected while it takes a message.
        self._putting.end(self._longest)
        try:
            self._connector.disconnect()
        finally:
            self._remote.ended(self)

    def _withdraw(self) -> None:
        if self._buffer is not None:
            self._buffer.close()
        if self._outlet is not None:
            self._remote.orb.withdraw(self._outlet)


class NativeConnector(NativeLink):
    """A connector from one component's OutPort to another's InPort.

    Args:
        options: what the options of both ends ask together.

    Raises:
        BridgeError: a port refuses; nothing stays connected.
    """

    def __init__(
        self,
        source: RemotePort,
        sink: RemotePort,
        options: RtmEndpointOptions,
    ) -> None:
        super().__init__(source.endpoint, sink.endpoint)
        self._ends = source, sink
        self._where = f"{source.where} to {sink.where}"
        ends = (ConnectorHealth(self, end) for end in self._ends)
        self._health = LinkHealth(self._where, *ends)
        properties = connector_properties(options, source.port.data_type)
        self._connector = source.connections.connect(
            self._where, properties, source.port, sink.port
        )

    def facts(self) -> Mapping[str, object]:
        """Return which ports are connected, and the states of both components."""
        return {"native": self._where, "states": self._health.states}

    @property
    def ports(self) -> tuple[WatchedPort, ...]:
        """What is to be checked."""
        return tuple(
            WatchedPort(self, self._health, remote, self._connector, end)
            for end, remote in enumerate(self._ends)
        )

    def _close(self) -> None:
        try:
            self._connector.disconnect()
        finally:
            for remote in self._ends:
                remote.ended(self)
