"""Data ports of our own component: an InPort that others write to, an OutPort that they read."""

from __future__ import annotations

import logging
import threading
from collections.abc import Callable, Mapping
from typing import Any

from _uoarm_rtm_stubs import RTC, OpenRTM, OpenRTM__POA
from attrs import frozen
from omniORB import CORBA

from uoarm.bridge import LimitedLog, foreign
from uoarm.cdr import ByteOrder
from uoarm.errors import BridgeError, MessageError
from uoarm.model import Message
from uoarm_rtm._dataflow import PullBuffer, Puller, Pusher, SizeLimit, ThreadedPusher
from uoarm_rtm._options import says_what_empty_means
from uoarm_rtm._orb import Orb, calls, limit, narrowed
from uoarm_rtm._peer import properties_of
from uoarm_rtm._port_servant import (
    ConnectorOptions,
    ConnectorRefusal,
    PortServant,
    read_connector_options,
    read_policies,
)
from uoarm_rtm._shape import CdrCodec, IdlStruct
from uoarm_rtm._types import IDL, idl_of, is_derived, plain_name

INPORT_IOR = "dataport.corba_cdr.inport_ior"
OUTPORT_IOR = "dataport.corba_cdr.outport_ior"

_PUT_SECONDS = 0.5  # a reader may be ending the connection from within the very `put`

_log = logging.getLogger("uoarm.rtm")


def _profile(kind: str, codec: CdrCodec) -> Mapping[str, str]:
    """Return the properties of a data port, lists separated as both lines of OpenRTM read them."""
    properties = {
        "port.port_type": kind,
        "dataport.data_type": codec.name,
        "dataport.interface_type": "corba_cdr",
        "dataport.dataflow_type": "push, pull",
        "dataport.marshaling_types": "corba",
    }
    if kind == "DataOutPort":
        properties["dataport.subscription_type"] = "flush, new, periodic"
    if is_derived(codec.name) and isinstance(codec.shape, IdlStruct):
        properties[IDL] = idl_of(codec.shape)
    return properties


class _Inlet(OpenRTM__POA.InPortCdr):  # type: ignore[misc]  # generated, without annotations
    """One connector's way into an InPort."""

    def __init__(self, port: InPort, order: ByteOrder) -> None:
        self._records = LimitedLog(_log)
        self._port = port
        self._order = order

    def put(self, data: bytes) -> Any:
        """Take one message (CORBA operation); a wrong one is answered with PORT_ERROR."""
        try:
            message = self._port.codec.decode(data, self._order)
        except MessageError as error:
            self._records.write(logging.WARNING, f"an InPort refuses data: {error}")
            self._port.unreadable(f"port {self._port.name}: {error}")
            return OpenRTM.PORT_ERROR
        try:
            foreign(self._port.take, message)
        except Exception as error:  # noqa: BLE001 - whatever the listener raises stays here
            self._records.write(logging.ERROR, "an InPort's listener failed", error)
            return OpenRTM.UNKNOWN_ERROR
        return OpenRTM.PORT_OK


class _DataPort(PortServant):
    """What InPort and OutPort share: the check of a profile, references by connector."""

    def __init__(self, orb: Orb, name: str, kind: str, codec: CdrCodec, seconds: float) -> None:
        super().__init__(orb, name, _profile(kind, codec), seconds)
        self.codec = codec

    def _connector_options(self, profile: Any) -> ConnectorOptions:
        options = read_connector_options(properties_of(profile.properties))
        mine = plain_name(self.codec.name)
        if (
            options.data_type
            and plain_name(options.data_type).split("/")[-1] != mine.split("/")[-1]
        ):
            text = f"its data type is {options.data_type}, this port's is {self.codec.name}"
            raise ConnectorRefusal(text, RTC.BAD_PARAMETER)
        return options

    def _reach(self, profile: Any, key: str, interface: Any) -> Any:
        """Return the object that another port published under a key."""
        text = properties_of(profile.properties).get(key)
        if not text:
            raise ConnectorRefusal(f"no port published {key}", RTC.BAD_PARAMETER)
        try:
            what = f"port {self.name}: {key}"
            return narrowed(self.orb.reference(text), interface, self._seconds, what)
        except BridgeError as error:
            raise ConnectorRefusal(str(error), RTC.RTC_ERROR) from error


class InPort(_DataPort):
    """Takes messages of one type.

    Args:
        name: `COMPONENT.PORT`.
        take: called with each message, in a thread of the ORB; one at a time a connector.
        seconds: limit of calls to other ports.
        rate: times a second that OutPorts of pull connectors are asked; 0: `fetch` asks.
        unreadable: called with why, for each message that is none of its type; raises nothing.

    Attributes:
        dropped: messages that its component did not take, as it was not ACTIVE.
    """

    dropped = 0

    def __init__(
        self,
        orb: Orb,
        name: str,
        codec: CdrCodec,
        take: Callable[[Message], None],
        seconds: float,
        rate: float = 0.0,
        unreadable: Callable[[str], object] = lambda _: None,
    ) -> None:
        super().__init__(orb, name, "DataInPort", codec, seconds)
        self.take, self.unreadable = take, unreadable
        self._rate = rate
        self._inlets: dict[str, Any] = {}
        self._pulls: dict[str, tuple[Any, ByteOrder]] = {}
        self._pullers: dict[str, Puller] = {}

    def fetch(self) -> int:
        """Ask every pull connector for one message; returns how many came."""
        count = 0
        for connector, (target, order) in list(self._pulls.items()):
            try:
                with calls:
                    status, data = target.get()
            except (CORBA.BAD_PARAM, CORBA.TIMEOUT):
                continue  # components in Python raise BAD_PARAM while they are empty
            except CORBA.Exception:
                self.drop(connector)
                continue
            if status == OpenRTM.PORT_OK:
                self.take(self.codec.decode(data, order))
                count += 1
        return count

    def _publish(self, profile: Any) -> None:
        options = self._connector_options(profile)
        if options.push:
            inlet = self.orb.serve(_Inlet(self, options.order))
            self._inlets[profile.connector_id] = inlet
            self._offer(profile, {INPORT_IOR: self.orb.text(inlet)})

    def _subscribe(self, profile: Any) -> None:
        options = self._connector_options(profile)
        if options.push:
            return
        target = self._reach(profile, OUTPORT_IOR, OpenRTM.OutPortCdr)
        connector = profile.connector_id
        if not self._rate:
            self._pulls[connector] = target, options.order
            return
        properties = properties_of(profile.properties)
        limit(target, self._seconds + read_policies(properties)[0].longest_read)
        inlet = _Inlet(self, options.order)
        self._pullers[connector] = Puller(
            target,
            self._rate,
            repeats=says_what_empty_means(properties),
            take=inlet.put,
            lost=lambda _: self.drop(connector),
        )

    def _quiesce(self, connector_id: str) -> None:
        puller = self._pullers.get(connector_id)
        if puller is not None:
            puller.end(self._seconds)

    def _release(self, connector_id: str) -> None:
        self._pulls.pop(connector_id, None)
        puller = self._pullers.pop(connector_id, None)
        if puller is not None:
            puller.end(0)
        inlet = self._inlets.pop(connector_id, None)
        if inlet is not None:
            self.orb.withdraw(inlet)


@frozen
class _Outlet:
    writer: Pusher | ThreadedPusher | PullBuffer
    order: ByteOrder
    reference: Any = None
    pusher: Pusher | None = None

    @property
    def dropped(self) -> int:
        """Messages that a buffer gave up or did not take, were too large, or did not arrive."""
        writers = {id(item): item for item in (self.writer, self.pusher) if item is not None}
        return sum(writer.dropped for writer in writers.values())


class OutPort(_DataPort):
    """Emits messages of one type; `write` may be called from any thread.

    Args:
        name: `COMPONENT.PORT`.
        seconds: limit of one delivery, and of calls to other ports.
    """

    def __init__(self, orb: Orb, name: str, codec: CdrCodec, seconds: float) -> None:
        super().__init__(orb, name, "DataOutPort", codec, seconds)
        self._outlets: dict[str, _Outlet] = {}
        # Held while a message goes to all connectors: they get the messages of several threads in
        # one order.
        self._writing = threading.Lock()
        self._dropped_before = 0

    @property
    def dropped(self) -> int:
        """Messages that did not get through, of all connectors there were."""
        outlets = list(self._outlets.values())
        return self._dropped_before + sum(outlet.dropped for outlet in outlets)

    def write(self, message: Message) -> None:
        """Send a message to all connectors.

        Blocks as long as the connectors with `flush` take, and those whose full buffers block.
        A message that a full buffer does not take is counted in `dropped`.

        Raises:
            MessageError: it does not fit the port's type.
        """
        encoded: dict[ByteOrder, bytes] = {}
        with self._writing:
            for outlet in list(self._outlets.values()):
                if outlet.order not in encoded:
                    encoded[outlet.order] = self.codec.encode(message, outlet.order)
                outlet.writer.write(encoded[outlet.order])
            if not encoded:
                self.codec.encode(message)

    def _publish(self, profile: Any) -> None:
        options = self._connector_options(profile)
        if not options.push:
            buffer = PullBuffer(read_policies(properties_of(profile.properties))[0])
            reference = self.orb.serve(buffer)
            self._outlets[profile.connector_id] = _Outlet(buffer, options.order, reference)
            self._offer(profile, {OUTPORT_IOR: self.orb.text(reference)})

    def _subscribe(self, profile: Any) -> None:
        options = self._connector_options(profile)
        if not options.push:
            return
        target = self._reach(profile, INPORT_IOR, OpenRTM.InPortCdr)
        connector = profile.connector_id
        sizes = SizeLimit(f"a connection of port {self.name}", self.orb.most_octets)
        pusher = Pusher(target, sizes, lambda: self.drop(connector))
        writer: Pusher | ThreadedPusher = pusher
        if options.subscription != "flush":
            buffer, push = read_policies(properties_of(profile.properties))
            writer = ThreadedPusher(pusher.write, buffer, push, options.period)
        self._outlets[connector] = _Outlet(writer, options.order, pusher=pusher)

    def _quiesce(self, connector_id: str) -> None:
        outlet = self._outlets.get(connector_id)
        if outlet is not None:
            outlet.writer.close()
            if outlet.pusher is not None:
                outlet.pusher.end(min(_PUT_SECONDS, self._seconds))

    def _release(self, connector_id: str) -> None:
        outlet = self._outlets.pop(connector_id, None)
        if outlet is not None:
            outlet.writer.close()
            self._dropped_before += outlet.dropped + outlet.writer.unsent
            if outlet.reference is not None:
                self.orb.withdraw(outlet.reference)
