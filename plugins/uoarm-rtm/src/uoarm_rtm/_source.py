"""OutPorts of components as sources: they push to us, or we ask them."""

from __future__ import annotations

import logging
from collections.abc import Mapping
from typing import Any

from _uoarm_rtm_stubs import OpenRTM, OpenRTM__POA
from omniORB import CORBA

from uoarm.bridge import Delivery, Source
from uoarm.errors import BridgeError, MessageError
from uoarm_rtm._buffering import buffer_policy, says_what_empty_means
from uoarm_rtm._codec import BIG, LITTLE
from uoarm_rtm._connector import connector_properties
from uoarm_rtm._data_ports import INPORT_IOR, OUTPORT_IOR
from uoarm_rtm._faults import corba_text
from uoarm_rtm._orb import limit, narrowed
from uoarm_rtm._place import ConnectorHealth, RemotePort
from uoarm_rtm._puller import Puller

__all__ = ["OutPortSource"]

_log = logging.getLogger("uoarm.rtm")


class _Inlet(OpenRTM__POA.InPortCdr):  # type: ignore[misc]  # generated, without annotations
    """What the component's OutPort pushes to."""

    def __init__(self, source: OutPortSource) -> None:
        self._source = source

    def put(self, data: bytes) -> Any:
        """Take one message (CORBA operation)."""
        return self._source.receive(data)


class OutPortSource(Source):
    """One connector from an OutPort.

    Messages are delivered in a thread of the ORB (push), or in one of the channel's own (pull).

    Args:
        remote: the port.
        deliver: takes the messages.

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
        try:
            self._connector = remote.connections.connect(remote.where, properties, remote.port)
            if self._inlet is None:
                self._begin_pulling()
        except BridgeError:
            self._withdraw()
            raise

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

    def tick(self) -> None:
        """Check the connection; called about once a second by the bridge's ticker."""
        self.health.check(self._connector)

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
            self._remote.ended()

    def _withdraw(self) -> None:
        if self._inlet is not None:
            self._remote.orb.withdraw(self._inlet)

    def _begin_pulling(self) -> None:
        remote = self._remote
        ior = self._connector.published(OUTPORT_IOR)
        what = f"{remote.where}: its OutPortCdr"
        try:
            target = narrowed(remote.orb.reference(ior), OpenRTM.OutPortCdr, remote.seconds, what)
            self._longest += buffer_policy(remote.options.properties, "outport").longest_read
            limit(target, self._longest)
        except BridgeError:
            self._connector.disconnect()
            raise
        self._puller = Puller(
            target,
            remote.options.rate,
            repeats=says_what_empty_means(remote.options.properties),
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
        self.health.lose(f"{self._remote.where} is gone ({corba_text(error)})")
