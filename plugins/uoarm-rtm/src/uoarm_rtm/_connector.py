"""A connection to somebody's data port, with us as the initiating client.

Only the remote port stands in the profile; what we serve goes along as a stringified reference,
since components in Python refuse object references (observed at OpenRTM-aist-Python).
"""

from __future__ import annotations

import contextlib
import threading
import uuid
from collections.abc import Mapping
from typing import Any

from omniORB import CORBA

from uoarm.errors import BridgeError, BridgeTimeoutError, FailureReason
from uoarm_rtm._calls import calls
from uoarm_rtm._faults import corba_errors
from uoarm_rtm._orb import limit
from uoarm_rtm._peer import Port, pairs, properties_of
from uoarm_rtm._settings import Settings
from uoarm_rtm._stubs import RTC

__all__ = ["Connector", "asked"]

_MEANINGS = {
    "RTC_ERROR": "it failed, or does not know what was asked",
    "BAD_PARAMETER": "something asked is unknown to it",
    "UNSUPPORTED": "it cannot do what was asked",
    "OUT_OF_RESOURCES": "it has no resources left",
    "PRECONDITION_NOT_MET": "it refuses in its present state, or is connected so already",
}


def asked(settings: Settings, data_type: str) -> dict[str, str]:
    """Return the connector properties that an endpoint's options ask for."""
    order = "big,little" if settings.endian == "big" else "little,big"
    return {
        "dataport.interface_type": "corba_cdr",
        "dataport.dataflow_type": settings.flow,
        "dataport.subscription_type": settings.subscription,
        "dataport.publisher.push_rate": f"{settings.rate:g}",
        "dataport.push_rate": f"{settings.rate:g}",
        "dataport.data_type": data_type,
        "dataport.serializer.cdr.endian": order,
        **settings.properties,
    }


class Connector:
    """One connection; made by connecting, ended by `disconnect`.

    Args:
        port: the remote port.
        where: the component's path and the port, for errors.
        properties: what the profile asks.
        seconds: limit of each call.
        others: further ports of the connection, after the first.

    Raises:
        BridgeError: REFUSED with the port's answer; UNAVAILABLE when it is gone. Nothing stays
            connected.
        BridgeTimeoutError: no answer; a connection that comes about later is ended.
    """

    def __init__(
        self,
        port: Port,
        where: str,
        properties: Mapping[str, str],
        seconds: float,
        others: tuple[Any, ...] = (),
    ) -> None:
        self.id = f"uoarm-{uuid.uuid4()}"
        self._port = limit(port.reference, seconds)
        self._where = where
        ports = [port.reference, *others]
        profile = RTC.ConnectorProfile(self.id, self.id, ports, pairs(properties))
        try:
            with corba_errors(f"connecting to {where}"):
                code, profile = self._port.connect(profile)
        except BridgeTimeoutError:
            # Whether it will be connected is unknown: it is told to let go when it wakes up.
            threading.Thread(target=self._let_go, name="uoarm-rtm-undo", daemon=True).start()
            raise
        except BridgeError:
            self._let_go()
            raise
        if code != RTC.RTC_OK:
            self._let_go()
            meaning = _MEANINGS.get(str(code), "an answer that the specification does not have")
            text = f"{where} refuses to connect: {code} ({meaning}); asked was {dict(properties)}"
            raise BridgeError(text, FailureReason.REFUSED)
        self.properties = properties_of(profile.properties)

    def published(self, *keys: str) -> str:
        """Return the first of these properties that a port has published.

        Raises:
            BridgeError: REFUSED when there is none; the connection is ended.
        """
        for key in keys:
            if self.properties.get(key):
                return self.properties[key]
        self._let_go()
        text = f"{self._where} connected, but published none of {', '.join(keys)}"
        raise BridgeError(text, FailureReason.REFUSED)

    def alive(self) -> bool:
        """Whether the port still has this connection.

        Raises:
            BridgeError: the component is gone.
            BridgeTimeoutError: it hangs.
        """
        with corba_errors(f"looking at the connection to {self._where}"):
            return bool(self._port.get_connector_profile(self.id).connector_id == self.id)

    def disconnect(self) -> None:
        """End the connection; one that the other side has ended is fine.

        Raises:
            BridgeTimeoutError: no answer.
        """
        try:
            with corba_errors(f"disconnecting from {self._where}"):
                self._port.disconnect(self.id)
        except BridgeTimeoutError:
            raise
        except BridgeError:
            return  # a component that is gone has no connections

    def _let_go(self) -> None:
        with contextlib.suppress(CORBA.Exception), calls:
            self._port.disconnect(self.id)
