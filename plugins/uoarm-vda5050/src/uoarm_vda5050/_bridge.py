"""The bridge: raw steps only; the base class keeps time limits, errors and the list of channels."""

from __future__ import annotations

import threading
from functools import partial
from typing import Any

from uoarm_mqtt.connection import (
    BrokerConnection,
    MqttSink,
    MqttSource,
    PayloadCodec,
    Receiver,
    TopicOptions,
    connection_options,
    limits_of,
)

from uoarm.bridge import (
    Bridge,
    Capabilities,
    Delivery,
    Description,
    Discovered,
    ServiceStructures,
    Sink,
    Source,
    reading_endpoint,
)
from uoarm.errors import MessageError
from uoarm.model import Endpoint, Health, Message, MessageStructure, Options
from uoarm_vda5050._follower import Follower
from uoarm_vda5050._health_state import VehicleHealth
from uoarm_vda5050._messages import HEADER_OCTETS, Headers, VdaCodec, check_of
from uoarm_vda5050._options import TRANSPORT, Place, mistake, place_of, prefix_of, release_of
from uoarm_vda5050._presence import Presence, Vehicle
from uoarm_vda5050._published import Published, read_published
from uoarm_vda5050._releases import SENT, TOPICS
from uoarm_vda5050._structures import TRANSPORT_PARTS, transport_structure, with_header
from uoarm_vda5050._transport import TransportSink, TransportSource, call
from uoarm_vda5050._transport_state import Times, TransportState

__all__ = ["Vda5050Bridge"]

_RETAINED = ("connection", "factsheet")


class Vda5050Bridge(Bridge):
    """An endpoint's address is manufacturer, serial number, topic, and a part of `transport`."""

    capabilities = Capabilities(discover=True, call=True)

    def __init__(self, name: str, options: Options) -> None:
        super().__init__(name, options)
        self._given: dict[str, Any] = dict(options)
        self._release, self._prefix = release_of(self._given), prefix_of(self._given)
        folder = self._given.get("schemas")
        schemas = read_published(folder, self._release) if folder is not None else {}
        self._published = Published(self._release, schemas)
        self._checks = {topic: check_of(self._published.whole(topic)) for topic in TOPICS}
        self._broker = BrokerConnection(name, connection_options(name, self._given), self.report)
        self._presence = Presence(
            self._broker,
            self._prefix,
            self._release,
            self._given.get("retained_wait", 0.2),
            self._given.get("max_vehicles", 1000),
            lambda component, health, cause: self.report(health, cause, component=component),
        )
        self._followers: dict[Vehicle, Follower] = {}
        self._names: dict[Vehicle, set[str]] = {}
        self._headers: dict[Vehicle, Headers] = {}
        self._lock = threading.Lock()

    @property
    def process_id(self) -> int | None:
        """Return None: the broker and the vehicles are anywhere."""
        return None

    def _describe(self, endpoint: Endpoint) -> Description:
        place = self._place(endpoint)
        self._presence.require(place.vehicle, endpoint.component)
        return self._description(place)

    def _open_source(
        self, endpoint: Endpoint, structure: MessageStructure, deliver: Delivery
    ) -> Source:
        place = self._place(endpoint)
        follower = self._follow(place, endpoint)
        if place.topic == TRANSPORT:
            most = self._broker.options.backlog
            return TransportSource(endpoint, place.part, follower, deliver, most)
        codec = self._codec(place, structure)
        is_kept = place.topic in _RETAINED
        port = TopicOptions(qos=1 if place.topic == "connection" else 0, retain=is_kept)
        topic = self._topic(place, place.topic)
        # A state stands until the next one, as what is retained does; the broker keeps none of it.
        return MqttSource(
            endpoint,
            topic,
            port,
            codec,
            self._broker,
            deliver,
            self._report_channel,
            latched=is_kept or place.topic == "state",
        )

    def _open_sink(self, endpoint: Endpoint, structure: MessageStructure) -> Sink:
        place = self._place(endpoint)
        follower = self._follow(place, endpoint)
        if place.topic == TRANSPORT:
            return TransportSink(endpoint, place.part, follower, self._broker)
        codec = self._codec(place, structure)
        topic = self._topic(place, place.topic)
        return MqttSink(
            endpoint, topic, TopicOptions(qos=0), codec, self._broker, self._report_channel
        )

    def _call(
        self, endpoint: Endpoint, structures: ServiceStructures, message: Message, timeout: float
    ) -> Message:
        del structures
        follower = self._follow(self._place(endpoint), endpoint)
        return call(endpoint, follower, message, timeout)

    def _discover(self) -> tuple[Discovered, ...]:
        # Any client may publish levels that no address can have, as an empty one.
        vehicles = [name for name in self._presence.online() if not mistake(name, {})]
        details = self._factsheets()
        return tuple(self._discovered(vehicle, details.get(vehicle, "")) for vehicle in vehicles)

    def _close(self) -> None:
        with self._lock:
            followers = list(self._followers.values())
        for follower in followers:
            follower.close()
        self._broker.close()

    def _place(self, endpoint: Endpoint) -> Place:
        with reading_endpoint(endpoint):
            if endpoint.is_offered:
                raise ValueError("functions cannot be offered as vehicles")
            place = place_of(endpoint.address, endpoint.options, endpoint.port)
            place.check_role(endpoint.role)
        return place

    def _description(self, place: Place) -> Description:
        if place.topic != TRANSPORT:
            body = self._published.body(place.topic)
            if place.topic in SENT:
                most = self._broker.largest_payload(self._topic(place, place.topic)) - HEADER_OCTETS
                return Description(body, limits=limits_of("json", max(1, most)))
            return Description(with_header(body) if place.header else body)
        if place.part:
            return Description(transport_structure(place.part))
        goal, reply = transport_structure("goal"), transport_structure("reply")
        return Description(request=goal, reply=reply)

    def _follow(self, place: Place, endpoint: Endpoint) -> Follower:
        """Return what follows a vehicle that is there."""
        vehicle = place.vehicle
        self._presence.require(vehicle, endpoint.component)
        with self._lock:
            self._names.setdefault(vehicle, set()).add(endpoint.component)
            follower = self._followers.get(vehicle)
            if follower is None:
                follower = self._new_follower(place)
                follower.open()
                self._followers[vehicle] = follower
                self._presence.follow(vehicle, follower.connection)
        return follower

    def _new_follower(self, place: Place) -> Follower:
        given, vehicle = self._given, place.vehicle
        headers = self._headers.setdefault(vehicle, Headers(self._release, *vehicle))
        codecs = {
            topic: self._reading(topic, self._published.body(topic), headers)
            for topic in (*SENT, "state")
        }
        times = Times(given.get("repeat", 2.0), given.get("accept_timeout", 15.0))
        return Follower(
            self._broker,
            self._topic(place, "")[:-1],
            TransportState(self._release, times, given.get("max_nodes", 1000)),
            VehicleHealth(given.get("state_timeout", 35.0)),
            codecs,
            partial(self._report_vehicle, vehicle),
        )

    def _reading(
        self,
        topic: str,
        structure: MessageStructure,
        headers: Headers | None,
        *,
        header: bool = False,
    ) -> VdaCodec:
        return VdaCodec.reading(
            structure,
            PayloadCodec("json", self._broker.options.budget),
            release=self._release,
            topic=topic,
            headers=headers,
            check=self._checks[topic],
            is_header_kept=header,
        )

    def _codec(self, place: Place, structure: MessageStructure) -> VdaCodec:
        with self._lock:
            headers = self._headers[place.vehicle]
        return self._reading(place.topic, structure, headers, header=place.header)

    def _topic(self, place: Place, topic: str) -> str:
        return f"{self._prefix}/{place.manufacturer}/{place.serial_number}/{topic}"

    def _factsheets(self) -> dict[Vehicle, str]:
        """Return what vehicles say of their type, as far as it is retained."""
        found: dict[Vehicle, str] = {}
        codec = self._reading("factsheet", self._published.body("factsheet"), None)

        def take(incoming: Any) -> None:
            *_, manufacturer, serial_number, _ = incoming.topic.split("/")
            try:
                said: Any = codec.decode(incoming.payload)
            except MessageError:
                return
            kind = said["typeSpecification"]
            mass = kind.get("maxLoadMass", kind.get("maximumLoadMass", 0))
            found[manufacturer, serial_number] = f"{kind['seriesName']}, {mass:g} kg"[:200]

        receiver = Receiver(f"{self._prefix}/+/+/factsheet", take, qos=0, retained=True)
        self._broker.subscribe(receiver)
        try:
            self._broker.barrier()
        finally:
            self._broker.unsubscribe(receiver)
        return found

    def _discovered(self, vehicle: Vehicle, detail: str) -> Discovered:
        name = "/".join(vehicle)
        there: list[tuple[str, ...]] = [(topic,) for topic in TOPICS]
        there += [(TRANSPORT, part) for part in TRANSPORT_PARTS]
        made = []
        for rest in (*there, (TRANSPORT,)):
            address = (*vehicle, *rest)
            place = place_of(address, {})
            endpoint = Endpoint(self.name, name, place.roles[0], address, rest[-1])
            made.append((endpoint, self._description(place)))
        return Discovered(name, tuple(made), detail)

    def _report_channel(self, channel: Any, health: Health, cause: str) -> None:
        self.report(health, cause, channel=channel)

    def _report_vehicle(self, vehicle: Vehicle, health: Health, cause: str) -> None:
        with self._lock:
            names = sorted(self._names.get(vehicle, ()))
        for name in names:
            self.report(health, cause, component=name)
