"""The bridge: raw steps only; the base class keeps time limits, errors and the list of channels."""

from __future__ import annotations

import threading
from functools import partial

from uoarm_mqtt.connection import (
    BrokerConnection,
    MqttSink,
    MqttSource,
    TopicOptions,
    connection_options,
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
from uoarm.model import Endpoint, Health, Message, MessageStructure, Role
from uoarm_vda5050._channels import TransportSink, TransportSource, VehicleFollower, call
from uoarm_vda5050._discovery import VehicleDirectory
from uoarm_vda5050._health import Presence, Vehicle
from uoarm_vda5050._messages import Headers, Published, VdaCodec, check_of, read_published
from uoarm_vda5050._options import TRANSPORT, FleetOptions, VehicleAddress, place_of
from uoarm_vda5050._releases import RELEASES, SENT, TOPICS
from uoarm_vda5050._transport_state import Times, TransportState

_RETAINED = ("connection", "factsheet")


class Vda5050Bridge(Bridge):
    """An endpoint's address is manufacturer, serial number, topic, and a part of `transport`."""

    capabilities = Capabilities(discover=True, call=True)

    def __init__(self, name: str, options: FleetOptions) -> None:
        super().__init__(name, options)
        self._options = options
        self._release = RELEASES[self._options.release]
        self._prefix = self._release.prefix(self._options.interface)
        folder = self._options.schemas
        schemas = read_published(folder, self._release) if folder is not None else {}
        self._published = Published(self._release, schemas)
        self._checks = {topic: check_of(self._published.whole(topic), topic) for topic in TOPICS}
        self._broker = BrokerConnection(name, connection_options(name, options), self.report)
        self._presence = Presence(
            self._broker,
            self._prefix,
            self._release,
            self._options.retained_wait,
            self._options.max_vehicles,
            lambda component, health, cause: self.report(health, cause, component=component),
        )
        self._directory = VehicleDirectory(
            name,
            self._broker,
            self._prefix,
            self._published,
            self._reading("factsheet", self._published.body("factsheet"), None),
        )
        self._followers: dict[Vehicle, VehicleFollower] = {}
        # Behind which vehicle each end of a component is. An end has one: with another
        # configuration it may be another one.
        self._vehicles: dict[tuple[str, Role, str], Vehicle] = {}
        self._headers: dict[Vehicle, Headers] = {}
        # Of each vehicle, held while it begins to be followed, so that callers in several threads
        # begin once; a broker that does not answer holds up no other vehicle.
        self._opening: dict[Vehicle, threading.Lock] = {}
        # Guards these locks and vehicles, between the threads of callers and of followers.
        self._lock = threading.Lock()

    @property
    def process_id(self) -> int | None:
        """Return None: the broker and the vehicles are anywhere."""
        return None

    def _describe(self, endpoint: Endpoint) -> Description:
        place = self._place(endpoint)
        self._presence.require(place.vehicle, endpoint.component)
        return self._directory.description(place)

    def _open_source(
        self, endpoint: Endpoint, structure: MessageStructure, deliver: Delivery
    ) -> Source:
        place = self._place(endpoint)
        follower = self._follow(place, endpoint)
        follower.greet(endpoint.component)
        if place.topic == TRANSPORT:
            limits = self._broker.options
            return TransportSource(endpoint, place.part, follower, deliver, limits)
        codec = self._codec(place, structure)
        is_kept = place.topic in _RETAINED
        port = TopicOptions(qos=1 if place.topic == "connection" else 0, retain=is_kept)
        topic = f"{self._topic(place)}/{place.topic}"
        # A state stands until the next one, as what is retained does; the broker keeps none of it.
        return MqttSource(
            endpoint,
            topic,
            port,
            codec,
            self._broker,
            deliver,
            self.report_channel,
            latched=is_kept or place.topic == "state",
        )

    def _open_sink(self, endpoint: Endpoint, structure: MessageStructure) -> Sink:
        place = self._place(endpoint)
        follower = self._follow(place, endpoint)
        follower.greet(endpoint.component)
        if place.topic == TRANSPORT:
            return TransportSink(endpoint, place.part, follower, self._broker)
        codec = self._codec(place, structure)
        topic = f"{self._topic(place)}/{place.topic}"
        return MqttSink(
            endpoint, topic, TopicOptions(qos=0), codec, self._broker, self.report_channel
        )

    def _call(
        self, endpoint: Endpoint, structures: ServiceStructures, message: Message, timeout: float
    ) -> Message:
        del structures
        place = self._place(endpoint)
        is_known = self._vehicles.get(_end_of(endpoint)) == place.vehicle
        follower = self._follow(place, endpoint)
        if not is_known:
            follower.greet(endpoint.component)
        return call(endpoint, follower, message, timeout, self.cancelling)

    def _discover(self) -> tuple[Discovered, ...]:
        return self._directory.listing(self._presence.online())

    def _close(self) -> None:
        self._broker.close()  # what is being opened fails
        with self._lock:
            openings = list(self._opening.items())
        for vehicle, opening in openings:
            with opening:
                follower = self._followers.get(vehicle)
            if follower is not None:
                follower.close()

    def _place(self, endpoint: Endpoint) -> VehicleAddress:
        with reading_endpoint(endpoint):
            if endpoint.is_offered:
                raise ValueError("functions cannot be offered as vehicles")
            place = place_of(endpoint.address, endpoint.options, endpoint.port)
            place.check_role(endpoint.role)
        return place

    def _follow(self, place: VehicleAddress, endpoint: Endpoint) -> VehicleFollower:
        """Return what follows a vehicle that is there."""
        vehicle = place.vehicle
        self._presence.require(vehicle, endpoint.component)
        with self._lock:
            self._vehicles[_end_of(endpoint)] = vehicle
            opening = self._opening.setdefault(vehicle, threading.Lock())
        with opening:
            follower = self._followers.get(vehicle)
            if follower is None:
                follower = self._new_follower(place)
                follower.open()
                self._followers[vehicle] = follower
                self._presence.follow(vehicle, follower.connection)
        return follower

    def _new_follower(self, place: VehicleAddress) -> VehicleFollower:
        options, vehicle = self._options, place.vehicle
        headers = self._headers.setdefault(vehicle, Headers(self._release, *vehicle))
        codecs = {
            topic: self._reading(topic, self._published.body(topic), headers)
            for topic in (*SENT, "state")
        }
        times = Times(options.repeat, options.accept_timeout)
        return VehicleFollower(
            self._broker,
            self._topic(place),
            TransportState(self._release, times, options.max_nodes),
            options.state_timeout,
            codecs,
            partial(self._report_vehicle, vehicle),
            self._broker.options.backlog_octets,
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
            self._broker.options.budget,
            release=self._release,
            topic=topic,
            headers=headers,
            check=self._checks[topic],
            is_header_kept=header,
        )

    def _codec(self, place: VehicleAddress, structure: MessageStructure) -> VdaCodec:
        headers = self._headers[place.vehicle]
        return self._reading(place.topic, structure, headers, header=place.header)

    def _topic(self, place: VehicleAddress) -> str:
        return f"{self._prefix}/{place.manufacturer}/{place.serial_number}"

    def _report_vehicle(self, vehicle: Vehicle, health: Health, cause: str, component: str) -> None:
        with self._lock:
            ends = [end for end, behind in self._vehicles.items() if behind == vehicle]
        for name in [component] if component else sorted({name for name, _, _ in ends}):
            self.report(health, cause, component=name)


def _end_of(endpoint: Endpoint) -> tuple[str, Role, str]:
    return endpoint.component, endpoint.role, endpoint.port
