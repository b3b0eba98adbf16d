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
from uoarm_rtm._connector import asked
from uoarm_rtm._data_ports import INPORT_IOR, OUTPORT_IOR
from uoarm_rtm._faults import corba_text
from uoarm_rtm._orb import limit, narrowed
from uoarm_rtm._place import Place, Pulse
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
        place: the port.
        deliver: takes the messages.

    Raises:
        BridgeError: the port refuses or is gone; nothing stays connected.
    """

    def __init__(self, place: Place, deliver: Delivery) -> None:
        super().__init__(place.endpoint)
        self._place = place
        self._deliver = deliver
        self._order = BIG if place.settings.endian == "big" else LITTLE
        self._puller: Puller | None = None
        self._longest = place.seconds
        self.pulse = Pulse(self, place, place.settings.stale_after)
        self._inlet = place.orb.serve(_Inlet(self)) if place.settings.flow == "push" else None
        properties = asked(place.settings, place.codec.name)
        if self._inlet is not None:
            properties[INPORT_IOR] = place.orb.text(self._inlet)
        try:
            self._connector = place.connections.connect(place.where, properties, place.port)
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
            message = self._place.codec.decode(data, self._order)
        except MessageError as error:
            self._deliver.unreadable(f"{self._place.where}: {error}")
            return OpenRTM.PORT_ERROR
        self.pulse.beat()
        self._deliver(message)
        return OpenRTM.PORT_OK

    def tick(self) -> None:
        """Look after the connection; called about once a second by the bridge's watch."""
        self.pulse.look(self._connector)

    def facts(self) -> Mapping[str, object]:
        """Return counters and the port."""
        return self.pulse.facts()

    def _close(self) -> None:
        if self._puller is not None:
            self._puller.end(self._longest)
        self._withdraw()
        try:
            self._connector.disconnect()
        finally:
            self._place.ended()

    def _withdraw(self) -> None:
        if self._inlet is not None:
            self._place.orb.withdraw(self._inlet)

    def _begin_pulling(self) -> None:
        place = self._place
        ior = self._connector.published(OUTPORT_IOR)
        what = f"{place.where}: its OutPortCdr"
        try:
            target = narrowed(place.orb.reference(ior), OpenRTM.OutPortCdr, place.seconds, what)
            self._longest += buffer_policy(place.settings.properties, "outport").longest_read
            limit(target, self._longest)
        except BridgeError:
            self._connector.disconnect()
            raise
        self._puller = Puller(
            target,
            place.settings.rate,
            repeats=says_what_empty_means(place.settings.properties),
            take=self.receive,
            lost=self._lost,
            missed=self._missed,
        )

    def _missed(self, error: CORBA.Exception) -> None:
        text = (
            f"an answer of {self._place.where} does not arrive ({corba_text(error)}): it may be "
            f"larger than our limit of {self._place.orb.most_octets} octets (`max_message`), or "
            "than the component's own (-ORBgiopMaxMsgSize there)"
        )
        self._deliver.unreadable(text)

    def _lost(self, error: CORBA.Exception) -> None:
        self.pulse.lose(f"{self._place.where} is gone ({corba_text(error)})")
