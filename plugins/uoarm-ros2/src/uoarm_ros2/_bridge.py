"""The bridge: which native thing stands behind each step of the contract."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Mapping
from contextlib import ExitStack, suppress
from typing import Any, TypeVar

from attrs import evolve

from uoarm.bridge import (
    Bridge,
    Capabilities,
    Channel,
    Delivery,
    Description,
    Discovered,
    Handler,
    ServiceStructures,
    Sink,
    Source,
)
from uoarm.errors import BridgeError, FailureReason, MessageError
from uoarm.model import Endpoint, Health, Message, MessageStructure, Options, Role
from uoarm_ros2 import _action_types, _services
from uoarm_ros2._actions import Action, ActionSink, ActionSource
from uoarm_ros2._cdr_read import cdr_reader
from uoarm_ros2._cdr_write import cdr_writer
from uoarm_ros2._defined import DefinedTypes
from uoarm_ros2._discovery import Attendance, discovered
from uoarm_ros2._end import Place
from uoarm_ros2._frame_lookups import FrameLookups
from uoarm_ros2._graph import Graph, Topic
from uoarm_ros2._link import Relay, SameTopic
from uoarm_ros2._managed_node import NodeAccess
from uoarm_ros2._managed_nodes import ManagedNodes
from uoarm_ros2._middleware import Participant
from uoarm_ros2._offered_action import (
    OfferedCall,
    OfferedSink,
    OfferedSource,
)
from uoarm_ros2._pulse import SimulatedClock
from uoarm_ros2._qos import Policies
from uoarm_ros2._schema import structure_of
from uoarm_ros2._services import Caller, Server
from uoarm_ros2._settings import (
    LOOKUP,
    Address,
    BridgeSettings,
    Settings,
    address_of,
    settings_of,
)
from uoarm_ros2._shape import is_described, is_large, shape_of
from uoarm_ros2._shared_ends import SharedEnds
from uoarm_ros2._sink import TopicSink
from uoarm_ros2._source import TopicSource
from uoarm_ros2._type_finder import DESCRIPTION_SERVICE, TypeFinder
from uoarm_ros2._types import ACTION, import_type
from uoarm_ros2._write import writer

__all__ = ["Ros2Bridge"]

_CLOSE_SECONDS = 1.0
_LEAVE_SECONDS = 3.0
_DESCRIPTION_SECONDS = 2.0
_CLOCK = "rosgraph_msgs/msg/Clock"
Watched = TypeVar("Watched", TopicSource, TopicSink, Relay)


class Ros2Bridge(Bridge):
    """One participant in one DDS domain, with a context of its own.

    Messages are delivered in one thread; replies, results and feedback arrive in a second one, so
    that whoever takes a message may call a service through the same bridge; requests to services
    that it offers are handled in threads of their own.
    """

    capabilities = Capabilities(discover=True, call=True, serve=True, link=True)

    def __init__(self, name: str, options: Options) -> None:
        super().__init__(name, options)
        given = {key: value for key, value in options.items() if key != "node"}
        node = str(options.get("node", f"uoarm_{''.join(c if c.isalnum() else '_' for c in name)}"))
        self._settings = BridgeSettings(node, **given)  # type: ignore[arg-type]  # by the schema
        defined = DefinedTypes(self._settings.definitions)
        self._participant = Participant(
            self._settings.domain_id, self._settings.namespace, self._settings.shared_memory
        )
        try:
            self._station = self._participant.station(node)
            self._clock = self._hear_clock() if self._settings.use_sim_time else time.monotonic
        except BaseException:
            self._participant.close(_CLOSE_SECONDS)
            raise
        self._graph = Graph(self._station, self._settings.wait)
        self._types = TypeFinder(self._ask_for_description, self._station.ends, defined)
        self._attendance = Attendance(
            self._station.node, self._participant.node_names, self._told_of
        )
        access = NodeAccess(self._ask, self._station.has_server, self._listen, self._told_of)
        resolve = self._station.topic_name
        self._managed = ManagedNodes(access, self._graph, resolve)
        self._lookups = FrameLookups(self._station, self._graph, self._types.find)
        self._shared = SharedEnds(
            self._station, self._graph, lambda: self._participant.station(f"{node}_replies")
        )
        self._called: dict[Address, Caller | Action] = {}
        self._disagreements: dict[str, str] = {}
        self._watched: dict[Channel, Callable[[], None]] = {}
        self._station.tick = self._tick
        self._station.cut_off = self._cut_off

    def facts(self) -> Mapping[str, object]:
        """Return how often the loops of its nodes turned for nothing."""
        return {"empty_turns": self._participant.turns().empty}

    def _describe(self, endpoint: Endpoint) -> Description:
        address = address_of(endpoint)
        settings = self._managed.described(endpoint, settings_of(endpoint))
        if address.part == LOOKUP:
            return self._lookups.describe(address, settings)
        if endpoint.role is Role.SERVICE:
            return self._describe_service(address, settings)
        if address.kind == ACTION:
            if not endpoint.is_offered:
                self._require_server(address, settings, action=True)
            return Description(message=_action_types.part_structure(address.type, address.part))
        topic = self._graph.topic(address, endpoint.role, settings)
        self._mention_others(topic, endpoint)
        return Description(message=self._structure(topic.type, topic.name))

    def _describe_service(self, address: Address, settings: Settings) -> Description:
        action, _, type_name = self._require_server(address, settings)
        return _action_types.described(type_name) if action else _services.described(type_name)

    def _require_server(
        self,
        address: Address,
        settings: Settings,
        *,
        action: bool | None = None,
        at_most: float = math.inf,
    ) -> tuple[bool, str, str]:
        """Return whether it is an action, its full name and its type, once a server is there."""
        name = self._station.service_name(address.name)
        hidden = f"{name}/_action/send_goal"

        def there() -> bool:
            return self._station.has_server(name) or self._station.has_server(hidden)

        needed = settings.peer_required or not address.type
        if needed and not self._graph.settled(f"a server of {name}", there, settings, at_most):
            text = self._graph.absence(
                f"there is no server of {name}", name, self._graph.servers_named()
            )
            raise BridgeError(text, FailureReason.NOT_FOUND)
        if action is None:
            action = address.kind == ACTION
            if not address.type:
                action = not self._station.has_server(name)
        full, type_name = self._graph.service(address, action=action)
        return action, full, type_name

    def _open_source(
        self, endpoint: Endpoint, structure: MessageStructure, deliver: Delivery
    ) -> Source:
        del structure  # the native type is in the address, or on the graph
        address, settings = address_of(endpoint), settings_of(endpoint)
        if address.kind == ACTION and endpoint.is_offered:
            return self._shared.with_offered(
                self._station.service_name(address.name),
                address.type,
                lambda offered: OfferedSource(endpoint, offered, address.part, deliver),
            )
        with self._managed.held(endpoint, settings) as held:
            if address.kind == ACTION:
                action = self._reachable(address, held.settings)
                source = ActionSource(endpoint, action, address.part, deliver, self._told)
                return held.until_closed(source)
            place = self._place(endpoint, address, held.settings)
            read = cdr_reader(shape_of(place.native, place.topic.type))
            return held.until_closed(self._waited(TopicSource(place, read, deliver)))

    def _open_sink(self, endpoint: Endpoint, structure: MessageStructure) -> Sink:
        del structure
        address, settings = address_of(endpoint), settings_of(endpoint)
        if address.kind == ACTION and endpoint.is_offered:
            return self._shared.with_offered(
                self._station.service_name(address.name),
                address.type,
                lambda offered: OfferedSink(endpoint, offered, address.part),
            )
        with self._managed.held(endpoint, settings) as held:
            if address.kind == ACTION:
                action = self._reachable(address, held.settings)
                return held.until_closed(ActionSink(endpoint, action, address.part))
            place = self._place(endpoint, address, held.settings)
            shape = shape_of(place.native, place.topic.type)
            write: Callable[[Message], object] = writer(shape)
            if is_described(place.native):
                write = _serialising(write, cdr_writer(shape))
            return held.until_closed(self._waited(TopicSink(place, write)))

    def _call(
        self, endpoint: Endpoint, structures: ServiceStructures, message: Message, timeout: float
    ) -> Message:
        del structures  # the native type is in the address, or on the graph
        address, settings = address_of(endpoint), settings_of(endpoint)
        with self._managed.held(endpoint, settings) as held:
            if address.part == LOOKUP:
                return self._lookups.call(address, message, timeout)
            wait = min(self._graph.limit(settings), timeout / 2)
            server = self._called.get(address)
            if server is None or not server.ready():
                action, name, type_name = self._require_server(address, held.settings, at_most=wait)
                server = (self._shared.action if action else self._shared.caller)(name, type_name)
                self._called[address] = server
            try:
                if isinstance(server, Action):
                    return server.call(message, timeout, wait, self.cancelling)
                return server.call(message, timeout, wait)
            finally:
                self._tell_disagreement(endpoint, server)

    def _serve(
        self, endpoint: Endpoint, structures: ServiceStructures, handler: Handler
    ) -> Channel:
        del structures
        address, settings = address_of(endpoint), settings_of(endpoint)
        if not address.type:
            text = f"{endpoint}: serving needs a type, as package/srv/Name, in the address"
            raise BridgeError(text, FailureReason.UNSUPPORTED)
        name = self._station.service_name(address.name)
        kind = OfferedCall if address.kind == ACTION else Server
        station, at_once = self._shared.replies(), settings.at_once
        return kind(station, endpoint, name, address.type, handler, at_once, self._told)

    def _link(self, source: Endpoint, sink: Endpoint) -> Channel | None:
        wanted = [
            (endpoint, address_of(endpoint), settings_of(endpoint)) for endpoint in (source, sink)
        ]
        if any(address.kind == ACTION for _, address, _ in wanted):
            return None
        with ExitStack() as stack:
            ends = [stack.enter_context(self._managed.held(end, asked)) for end, _, asked in wanted]
            places = [
                self._place(end, address, held.settings)
                for (end, address, _), held in zip(wanted, ends, strict=True)
            ]
            if places[0].topic.type != places[1].topic.type:
                return None
            if places[0].topic.name != places[1].topic.name:
                link: Channel = self._waited(Relay(*places))
            else:
                same = SameTopic(*places)
                self._watched[same] = same.tick
                link = same
            for held in ends:
                held.until_closed(link)
            return link

    def _discover(self) -> tuple[Discovered, ...]:
        self._graph.settled("anything", lambda: False, Settings())
        own = self._participant.node_names()
        return discovered(self.name, self._station.node, own, self._structure)

    def _close(self) -> None:
        self._managed.close(_LEAVE_SECONDS)
        self._lookups.close()
        self._watched.clear()
        self._shared.close()
        self._participant.close(_CLOSE_SECONDS)

    def _structure(self, type_name: str, topic: str) -> MessageStructure:
        return structure_of(shape_of(self._types.find(type_name, topic), type_name))

    def _ask_for_description(self, node: str, request: Message) -> Message:
        """Ask a node what a type of its is made of."""
        name = f"{node}/get_type_description"
        if not self._station.has_server(name):
            text = f"there is no service {name}"
            raise BridgeError(text, FailureReason.NOT_FOUND)
        return self._ask(name, DESCRIPTION_SERVICE, request, _DESCRIPTION_SECONDS)

    def _ask(self, name: str, type_name: str, request: Message, seconds: float) -> Message:
        return self._shared.ask(name, type_name, request, seconds)

    def _listen(self, topic: str, heard: Callable[[], None]) -> Callable[[], None]:
        """Have something called, in the station's thread, when a node tells of its lifecycle."""
        native = import_type("lifecycle_msgs/msg/TransitionEvent")
        station = self._station
        made = station.subscribe(native, topic, Policies(), lambda _: heard(), events={})
        return lambda: station.discard(made)

    def _place(self, endpoint: Endpoint, address: Address, settings: Settings) -> Place:
        topic = self._graph.topic(address, endpoint.role, settings)
        self._mention_others(topic, endpoint)
        native = self._types.find(topic.type, topic.name)
        large = is_large(shape_of(native, topic.type))
        settings = evolve(settings, qos=settings.qos.for_type(large=large))
        return Place(
            self._station,
            self._graph,
            endpoint,
            topic,
            native,
            settings,
            self._settings.settle,
            self._told,
            self._clock,
        )

    def _hear_clock(self) -> SimulatedClock:
        clock, native = SimulatedClock(), import_type(_CLOCK)
        read = cdr_reader(shape_of(native, _CLOCK))

        def take(octets: bytes) -> None:
            with suppress(MessageError):
                now: Any = read(octets)
                clock.take(now["clock"]["sec"] * 1_000_000_000 + now["clock"]["nanosec"])

        latest = Policies(reliability="best_effort", depth=1)
        self._station.subscribe(native, "/clock", latest, take, events={})
        return clock

    def _waited(self, channel: Watched) -> Watched:
        """Wait for the other end; nothing stays open when it does not come."""
        self._watched[channel] = channel.tick
        try:
            channel.wait()
        except BaseException:
            channel.close()
            raise
        return channel

    def _mention_others(self, topic: Topic, endpoint: Endpoint) -> None:
        if topic.others:
            text = f"topic {topic.name} carries other types than {topic.type} too: {topic.others}"
            self.report(Health.DEGRADED, text, component=endpoint.component)

    def _tell_disagreement(self, endpoint: Endpoint, server: Caller | Action) -> None:
        """Tell of a component that is called beside others who serve the name as something else."""
        with suppress(BridgeError):  # the bridge was closed meanwhile
            text = server.agreement.look().text
            before = self._disagreements.get(endpoint.component, "")
            self._disagreements[endpoint.component] = text
            if text != before:
                health = Health.DEGRADED if text else Health.OK
                self._told_of(health, text or "all who serve it mean the same", endpoint.component)

    def _reachable(self, address: Address, settings: Settings) -> Action:
        _, name, type_name = self._require_server(address, settings, action=True)
        action = self._shared.action(name, type_name)
        if settings.peer_required:
            action.wait(self._graph.limit(settings))
        return action

    def _told(self, channel: Channel, health: Health, cause: str) -> None:
        self.report(health, cause, channel=channel)

    def _told_of(self, health: Health, cause: str, component: str) -> None:
        self.report(health, cause, component=component)

    def _cut_off(self) -> None:
        text = "the ROS 2 context was shut down from outside, as rclpy's signal handlers do"
        self.report(Health.LOST, text)

    def _tick(self) -> None:
        for channel, tick in list(self._watched.items()):
            if channel.closed:
                self._watched.pop(channel, None)
            else:
                tick()
        self._shared.tick()
        self._lookups.tick()
        self._managed.tick()
        self._graph.tick()
        self._attendance.tick()


def _serialising(
    write: Callable[[Message], object], serialise: Callable[[object], bytes]
) -> Callable[[Message], object]:
    return lambda message: serialise(write(message))
