"""OutPorts of components as sources: they push to us, or we ask them."""

from __future__ import annotations

import logging
import threading
from collections.abc import Mapping
from typing import Any

from omniORB import CORBA

from uoarm.bridge import Channel, Delivery
from uoarm.errors import BridgeError, MessageError
from uoarm.model import Deliver, Health
from uoarm_rtm._buffering import buffer_policy, says_what_empty_means
from uoarm_rtm._calls import Calls, calls
from uoarm_rtm._codec import BIG, LITTLE
from uoarm_rtm._connector import Connector, asked
from uoarm_rtm._data_ports import INPORT_IOR, OUTPORT_IOR
from uoarm_rtm._faults import corba_text
from uoarm_rtm._orb import limit, narrowed
from uoarm_rtm._place import Place, Pulse
from uoarm_rtm._stubs import OpenRTM, OpenRTM__POA

__all__ = ["Source"]

_log = logging.getLogger("uoarm.rtm")


class _Inlet(OpenRTM__POA.InPortCdr):  # type: ignore[misc]  # generated, without annotations
    """What the component's OutPort pushes to."""

    def __init__(self, source: Source) -> None:
        self._source = source

    def put(self, data: bytes) -> Any:
        """Take one message (CORBA operation)."""
        return self._source.receive(data)


class Source(Channel):
    """One connector from an OutPort.

    Messages are delivered in a thread of the ORB (push), or in one of the channel's own (pull).

    Args:
        place: the port.
        deliver: takes the messages.

    Raises:
        BridgeError: the port refuses or is gone; nothing stays connected.
    """

    def __init__(self, place: Place, deliver: Deliver) -> None:
        super().__init__(place.endpoint)
        self._place = place
        self._delivery = Delivery(deliver)
        self._order = BIG if place.settings.endian == "big" else LITTLE
        self._ended = threading.Event()
        self._asking = Calls()
        self._longest = place.seconds
        self.pulse = Pulse(self, place, place.settings.stale_after)
        self._inlet = place.orb.serve(_Inlet(self)) if place.settings.flow == "push" else None
        properties = asked(place.settings, place.codec.name)
        if self._inlet is not None:
            properties[INPORT_IOR] = place.orb.text(self._inlet)
        try:
            self._connector = Connector(place.port, place.where, properties, place.seconds)
            if self._inlet is None:
                self._begin_pulling()
        except BridgeError:
            self._withdraw()
            raise

    def receive(self, data: bytes) -> Any:
        """Decode and deliver one message; returns the status to answer."""
        if self._delivery.ended:
            return OpenRTM.PORT_ERROR
        try:
            message = self._place.codec.decode(data, self._order)
        except MessageError as error:
            self.pulse.refused += 1
            self.pulse.tell(Health.DEGRADED, f"{self._place.where}: {error}")
            return OpenRTM.PORT_ERROR
        self.pulse.beat()
        self._delivery.give(message)
        return OpenRTM.PORT_OK

    def tick(self) -> None:
        """Look after the connection; called about once a second by the bridge's watch."""
        self.pulse.look(self._connector)

    def facts(self) -> Mapping[str, object]:
        """Return counters and the port."""
        return self.pulse.facts()

    def _close(self) -> None:
        self._ended.set()
        self._delivery.end()
        # A component in C++ aborts when it is disconnected while it is asked (observed).
        self._asking.end(self._longest)
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
        threading.Thread(
            target=self._pull, args=(target,), name="uoarm-rtm-pull", daemon=True
        ).start()

    def _pull(self, target: Any) -> None:
        """Ask `rate` times a second.

        Components in C++ give their last datum again for ever, unless told otherwise; those in
        Python raise BAD_PARAM while they are empty (observed). A datum that comes again is left
        out, unless the endpoint's options say what an empty buffer shall do.
        """
        before = b""
        all_of_them = says_what_empty_means(self._place.settings.properties)
        while not self._ended.wait(1.0 / self._place.settings.rate):
            try:
                with calls, self._asking:
                    status, data = target.get()
            except (CORBA.BAD_PARAM, CORBA.TIMEOUT):
                continue
            except CORBA.Exception as error:
                if self._ended.is_set():
                    return
                text = f"{self._place.where} is gone ({corba_text(error)})"
                self.pulse.tell(Health.LOST, text)
                return
            if status == OpenRTM.PORT_OK and (all_of_them or data != before):
                before = data
                self.receive(data)
