"""What vehicles have: structures of their ports, and a listing with their factsheets."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from attrs import frozen
from uoarm_mqtt.connection import BrokerConnection, ReceivedMessage, Receiver, limits_of

from uoarm.bridge import Description, Discovered
from uoarm.errors import MessageError
from uoarm.model import Endpoint
from uoarm_vda5050._health import Vehicle
from uoarm_vda5050._messages import HEADER_OCTETS, Published, VdaCodec
from uoarm_vda5050._options import TRANSPORT, VehicleAddress, mistake, place_of
from uoarm_vda5050._releases import SENT, TOPICS, TRANSPORT_PARTS, transport_structure, with_header

_PARTS = tuple((TRANSPORT, part) for part in TRANSPORT_PARTS)
_PORTS = (*((topic,) for topic in TOPICS), *_PARTS, (TRANSPORT,))


@frozen(eq=False)
class VehicleDirectory:
    """Describes the ports of vehicles, and lists the vehicles that are there.

    Args:
        prefix: first levels of every topic.
        codec: reads factsheets.
    """

    _bridge: str
    _link: BrokerConnection
    _prefix: str
    _published: Published
    _codec: VdaCodec

    def description(self, place: VehicleAddress) -> Description:
        """Return the structures of what passes at an address."""
        if place.topic == TRANSPORT:
            if place.part:
                return Description(transport_structure(place.part))
            goal, reply = transport_structure("goal"), transport_structure("reply")
            return Description(request=goal, reply=reply)
        body = self._published.body(place.topic)
        if place.topic in SENT:
            topic = "/".join((self._prefix, *place.vehicle, place.topic))
            most = self._link.largest_payload(topic) - HEADER_OCTETS
            return Description(body, limits=limits_of("json", max(1, most)))
        return Description(with_header(body) if place.header else body)

    def listing(self, vehicles: Sequence[Vehicle]) -> tuple[Discovered, ...]:
        """Return vehicles with all their ports and what is retained of their factsheets.

        Raises:
            BridgeError: the broker is away.
        """
        details = self._factsheets()
        # Any client may publish levels that no address can have, as an empty one.
        named = [vehicle for vehicle in vehicles if not mistake(vehicle, {})]
        return tuple(self._found(vehicle, details.get(vehicle, "")) for vehicle in named)

    def _found(self, vehicle: Vehicle, detail: str) -> Discovered:
        name = "/".join(vehicle)
        endpoints = []
        for port in _PORTS:
            address = (*vehicle, *port)
            place = place_of(address, {})
            endpoint = Endpoint(self._bridge, name, place.roles[0], address, port[-1])
            endpoints.append((endpoint, self.description(place)))
        return Discovered(name, tuple(endpoints), detail)

    def _factsheets(self) -> dict[Vehicle, str]:
        """Return what vehicles say of their type, as far as it is retained."""
        found: dict[Vehicle, str] = {}

        def take(incoming: ReceivedMessage) -> None:
            *_, manufacturer, serial_number, _ = incoming.topic.split("/")
            try:
                sheet: Any = self._codec.decode(incoming.payload)
                found[manufacturer, serial_number] = _kind_of(sheet["typeSpecification"])
            except (MessageError, LookupError, TypeError, ValueError, OverflowError):
                return  # a schema of the user's may allow what has no series or mass

        receiver = Receiver(f"{self._prefix}/+/+/factsheet", take, qos=0, retained=True)
        self._link.subscribe(receiver)
        try:
            self._link.barrier()
        finally:
            self._link.unsubscribe(receiver)
        return found


def _kind_of(kind: Any) -> str:
    """Return the series of a vehicle, and the highest load."""
    mass = kind.get("maxLoadMass", kind.get("maximumLoadMass", 0))
    return f"{kind['seriesName']}, {mass:g} kg"[:200]
