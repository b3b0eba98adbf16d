"""A relay between two data ports as one would write it by hand with omniORBpy, without uoarm.

It takes a message, unmarshals it, makes another one of its members, marshals that and puts it to
the other port. So it is what Python and its ORB cost between two components, and the measure for
ours.
"""

from __future__ import annotations

import threading
from collections import deque
from typing import Any

import omniORB
from _uoarm_rtm_stubs import RTC, OpenRTM, OpenRTM__POA
from uoarm_rtm._connector import Connections, asked
from uoarm_rtm._naming import NamingService
from uoarm_rtm._orb import Orb
from uoarm_rtm._peer import peer_at
from uoarm_rtm._settings import Settings

__all__ = ["BareRelay"]

_IOR = "dataport.corba_cdr.inport_ior"
_SECONDS = 5.0


class BareRelay:
    """Relays from `Talker.rtc` to `Counter.rtc` until it is left.

    Args:
        address: the naming service.
        port: name of both ports.
        kind: their data type.
        waiting: messages that may wait for a thread that puts them, the oldest giving way; 0: the
            thread that took a message puts it, while the sender waits.
    """

    def __init__(self, address: str, port: str, kind: str, waiting: int) -> None:
        self._orb = Orb("127.0.0.1", _SECONDS)
        naming = NamingService(self._orb, address, _SECONDS)
        talker, counter = (
            peer_at(name, naming.resolve(name), _SECONDS).port(port)
            for name in ("Talker.rtc", "Counter.rtc")
        )
        name = kind.split("/")[1].split(":", maxsplit=1)[0]
        self._code, self._type = getattr(RTC, f"_tc_{name}"), getattr(RTC, name)
        self._messages: deque[Any] = deque(maxlen=waiting)
        self._changed = threading.Condition()
        self._closed = False
        connections = Connections(self._orb, "bench", _SECONDS)
        into = connections.connect("counter", asked(Settings(), kind), counter)
        reference = self._orb.reference(into.properties[_IOR])
        self._target = reference._narrow(OpenRTM.InPortCdr)  # noqa: SLF001 - CORBA's own name
        self._thread = threading.Thread(target=self._run)
        self._thread.start()
        relay = self._keep if waiting else self._put

        class Inlet(OpenRTM__POA.InPortCdr):  # type: ignore[misc]  # generated
            def put(self, data: bytes) -> Any:
                relay(data)
                return OpenRTM.PORT_OK

        wishes = {**asked(Settings(), kind), _IOR: self._orb.text(self._orb.serve(Inlet()))}
        self._into, self._out = into, connections.connect("talker", wishes, talker)

    def close(self) -> None:
        """Disconnect, and end the thread."""
        self._out.disconnect()
        with self._changed:
            self._closed = True
            self._changed.notify()
        self._thread.join()
        self._into.disconnect()
        self._orb.close()

    def _keep(self, data: bytes) -> None:
        message = omniORB.cdrUnmarshal(self._code, data, True)
        with self._changed:
            self._messages.append(message)
            self._changed.notify()

    def _put(self, data: bytes) -> None:
        self._send(omniORB.cdrUnmarshal(self._code, data, True))

    def _send(self, message: Any) -> None:
        mapped = self._type(message.tm, message.data)
        self._target.put(omniORB.cdrMarshal(self._code, mapped, True))

    def _run(self) -> None:
        while True:
            with self._changed:
                self._changed.wait_for(lambda: self._messages or self._closed)
                if self._closed:
                    return
                message = self._messages.popleft()
            self._send(message)
