"""InPorts of components as sinks: we push, or they ask us."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from omniORB import CORBA

from uoarm.bridge import Sink
from uoarm.errors import BridgeError, BridgeTimeoutError, FailureReason
from uoarm.model import Health, Message
from uoarm_rtm._calls import calls
from uoarm_rtm._codec import BIG, LITTLE
from uoarm_rtm._connector import Connector, asked
from uoarm_rtm._data_ports import INPORT_IOR, OUTPORT_IOR
from uoarm_rtm._faults import corba_text
from uoarm_rtm._orb import limit, narrowed
from uoarm_rtm._place import Place, Pulse
from uoarm_rtm._publisher import Pulled
from uoarm_rtm._stubs import OpenRTM

__all__ = ["InPortSink"]

_REASONS = {
    "BUFFER_FULL": "its buffer is full",
    "BUFFER_TIMEOUT": "its buffer stayed full",
    "PORT_ERROR": "it could not take the data",
    "UNKNOWN_ERROR": "it could not take the data",
}


class InPortSink(Sink):
    """One connector to an InPort. `send` waits for the component's answer (push).

    Args:
        place: the port.

    Raises:
        BridgeError: the port refuses or is gone; nothing stays connected.
    """

    def __init__(self, place: Place) -> None:
        super().__init__(place.endpoint)
        self._place = place
        self._order = BIG if place.settings.endian == "big" else LITTLE
        self.pulse = Pulse(self, place)
        self._buffer = Pulled() if place.settings.flow == "pull" else None
        self._outlet = None if self._buffer is None else place.orb.serve(self._buffer)
        self.blocking = self._buffer is None
        properties = asked(place.settings, place.codec.name)
        if self._outlet is not None:
            properties[OUTPORT_IOR] = place.orb.text(self._outlet)
        self._target: Any = None
        try:
            self._connector = Connector(place.port, place.where, properties, place.seconds)
            if self._buffer is None:
                self._target = self._reach()
        except BridgeError:
            self._withdraw()
            raise

    def send(self, message: Message) -> None:
        """Hand one message to the port.

        Raises:
            MessageError: it does not fit the data type; the text names the field.
            BridgeError: the component is gone or refuses the data, or the channel is closed.
            BridgeTimeoutError: the component does not answer in time.
        """
        if self._closed:
            text = f"bridge {self.endpoint.bridge!r}: {self.endpoint} is closed"
            raise BridgeError(text, FailureReason.CLOSED)
        data = self._place.codec.encode(message, self._order)
        if self._buffer is not None:
            self._buffer.write(data)
        else:
            self._put(data)
        self.pulse.beat()

    def tick(self) -> None:
        """Look after the connection; called about once a second by the bridge's watch."""
        self.pulse.look(self._connector)

    def facts(self) -> Mapping[str, object]:
        """Return counters and the port."""
        return self.pulse.facts()

    def _put(self, data: bytes) -> None:
        try:
            with calls:
                status = self._target.put(data)
        except CORBA.TIMEOUT as error:
            text = f"{self._place.where} did not take a message within its time limit"
            self.pulse.tell(Health.DEGRADED, text)
            raise BridgeTimeoutError(text) from error
        except CORBA.Exception as error:
            text = f"{self._place.where} is gone ({corba_text(error)})"
            self.pulse.tell(Health.LOST, text)
            raise BridgeError(text, FailureReason.UNAVAILABLE) from error
        if status != OpenRTM.PORT_OK:
            self.pulse.refused += 1
            reason = _REASONS.get(str(status), "it said so")
            text = f"{self._place.where} refused a message: {status} ({reason})"
            raise BridgeError(text, FailureReason.REFUSED)

    def _reach(self) -> Any:
        place = self._place
        ior = self._connector.published(INPORT_IOR)
        try:
            what = f"{place.where}: its InPortCdr"
            target = narrowed(place.orb.reference(ior), OpenRTM.InPortCdr, place.seconds, what)
            return limit(target, place.settings.timeout or place.seconds)
        except BridgeError:
            self._connector.disconnect()
            raise

    def _close(self) -> None:
        self._withdraw()
        try:
            self._connector.disconnect()
        finally:
            self._place.ended()

    def _withdraw(self) -> None:
        if self._outlet is not None:
            self._place.orb.withdraw(self._outlet)
