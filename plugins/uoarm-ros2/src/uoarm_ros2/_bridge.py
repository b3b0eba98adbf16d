"""The bridge: which native entity stands behind each step of the contract."""

from __future__ import annotations

import math
import threading
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import ExitStack, contextmanager, suppress
from functools import partial
from typing import Any, TypeVar

from attrs import define

from uoarm.bridge import (
    Bridge,
    Capabilities,
    Channel,
    Delivery,
    Description,
    Discovered,
    Handler,
    NativeLink,
    ServiceStructures,
    Sink,
    Source,
    on_failure,
)
from uoarm.cdr import definition_of
from uoarm.errors import BridgeError, FailureReason, MessageError
from uoarm.model import Endpoint, Health, Message, MessageStructure, Role
from uoarm_ros2._actions import Action, ActionSink, ActionSource
from uoarm_ros2._channels import PublisherSink, SameTopicLink, SerialisedRelay, SubscriptionSource
from uoarm_ros2._conversion import codec_of
from uoarm_ros2._diagnostics import DiagnosticsReader
from uoarm_ros2._discovery import NodePresence, Ros2Graph, discovered
from uoarm_ros2._health import SimulatedClock
from uoarm_ros2._managed_nodes import ManagedNodes, NodeAccess
from uoarm_ros2._middleware import NodeRunner, Participant
from uoarm_ros2._offered_actions import (
    OfferedAction,
    OfferedCall,
    OfferedSink,
    OfferedSource,
)
from uoarm_ros2._options import (
    LOOKUP,
    Ros2Address,
    Ros2BridgeOptions,
    Ros2Options,
    address_of,
    options_of,
)
from uoarm_ros2._qos import Policies
from uoarm_ros2._services import OtherServers, ServiceClient, ServiceServer
from uoarm_ros2._topic_endpoint import TopicContext
from uoarm_ros2._transforms import FrameLookups
from uoarm_ros2._type_finder import DESCRIPTION_SERVICE, DefinedTypes, TypeFinder
from uoarm_ros2._types import (
    ACTION,
    describe_action,
    describe_service,
    import_type,
    is_large,
    part_structure,
    shape_of,
    structure_of,
)

_UNUSED_SECONDS = 10.0
_Key = tuple[str, str]


@define(eq=False)
class _NodeClient:
    """The client of a node's service, how many use it now, and when it was last used."""

    caller: ServiceClient
    users: int = 0
    last: float = 0.0


class SharedEntities:
    """Ends that the calls and the channels of a bridge share, by full name and type.

    Replies, results and feedback arrive in the thread of a node of their own, which starts with the
    first client that needs it. All methods may be called from any thread, `tick` in the runner's.

    Args:
        runner: of the node in whose thread goals of offered actions come, as messages of topics do,
            so that a consumer of goals may call services.
    """

    def __init__(
        self, runner: NodeRunner, graph: Ros2Graph, start_replies: Callable[[], NodeRunner]
    ) -> None:
        self._runner = runner
        self._graph = graph
        self._start_replies = start_replies
        # Guards the tables below and the making of what is in them: of two threads that want the
        # same client one makes it. Held while a channel joins an offered action, so that `tick`
        # cannot destroy the action between. Reentrant, as making a client starts the node.
        self._making = threading.RLock()
        self._replies: NodeRunner | None = None
        self._callers: dict[_Key, ServiceClient] = {}
        self._node_clients: dict[_Key, _NodeClient] = {}
        self._actions: dict[_Key, Action] = {}
        self._offered: dict[_Key, OfferedAction] = {}

    def replies(self) -> NodeRunner:
        """Return the node in whose thread replies arrive."""
        with self._making:
            if self._replies is None:
                self._replies = self._start_replies()
            return self._replies

    def caller(self, name: str, type_name: str) -> ServiceClient:
        """Return the client of a service."""
        with self._making:
            caller = self._callers.get((name, type_name))
            if caller is None:
                caller = ServiceClient(self.replies(), self._graph, name, type_name)
                self._callers[name, type_name] = caller
            return caller

    def ask(self, name: str, type_name: str, request: Message, seconds: float) -> Message:
        """Call a service of a node; its client goes once it is unused for a while.

        Nodes with names that are never seen again come and go.

        Raises:
            BridgeError: as `ServiceClient.call`.
        """
        with self._making:
            client = self._node_clients.get((name, type_name))
            if client is None:
                client = _NodeClient(ServiceClient(self.replies(), self._graph, name, type_name))
                self._node_clients[name, type_name] = client
            client.users += 1
        try:
            return client.caller.call(request, seconds, seconds)
        finally:
            with self._making:
                client.users -= 1
                client.last = time.monotonic()

    def action(self, name: str, type_name: str) -> Action:
        """Return the client of an action."""
        with self._making:
            action = self._actions.get((name, type_name))
            if action is None:
                action = Action(self.replies(), self._graph, name, type_name)
                self._actions[name, type_name] = action
            return action

    @contextmanager
    def offered(self, name: str, type_name: str) -> Iterator[OfferedAction]:
        """Provide the server of an action, which stays while the block opens a channel at it."""
        with self._making:
            offered = self._offered.get((name, type_name))
            if offered is None:
                offered = OfferedAction(self._runner, name, type_name)
                self._offered[name, type_name] = offered
            yield offered

    def tick(self) -> None:
        """Look after all of them a few times a second, and put away what is unused."""
        self._close_unused()
        for action in list(self._actions.values()):
            action.tick()
        for key, offered in list(self._offered.items()):
            offered.tick()
            with self._making:
                if offered.is_unused:
                    del self._offered[key]
                    offered.destroy()

    def _close_unused(self) -> None:
        now = time.monotonic()
        for key, client in list(self._node_clients.items()):
            with self._making:
                if not client.users and now - client.last > _UNUSED_SECONDS:
                    del self._node_clients[key]
                    client.caller.close()

    def close(self) -> None:
        """End the goals that are offered."""
        for offered in list(self._offered.values()):
            offered.destroy()


_CLOSE_SECONDS = 1.0
_LEAVE_SECONDS = 3.0
_DESCRIPTION_SECONDS = 2.0
_CLOCK = "rosgraph_msgs/msg/Clock"
Watched = TypeVar("Watched", SubscriptionSource, PublisherSink, SerialisedRelay)


class Ros2Bridge(Bridge):
    """One participant in one DDS domain, with a context of its own.

    Messages are delivered in one thread; replies, results and feedback arrive in a second one, so
    that the consumer of a message may call a service through the same bridge; requests to services
    that it offers are handled in threads of their own.
    """

    capabilities = Capabilities(discover=True, call=True, serve=True, link=True)

    def __init__(self, name: str, options: Ros2BridgeOptions) -> None:
        super().__init__(name, options)
        self._options = options
        defined = DefinedTypes(self._options.definitions)
        self._participant = Participant(
            self._options.domain_id, self._options.namespace, self._options.shared_memory
        )
        with on_failure(self._participant.close, _CLOSE_SECONDS):
            self._runner = self._participant.start_node(options.node_name(name))
            self._clock = (
                self._subscribe_to_clock() if self._options.use_sim_time else time.monotonic
            )
        self._graph = Ros2Graph(self._runner, self._options.wait)
        self._types = TypeFinder(self._ask_for_description, self._runner.ends, defined)
        self._attendance = NodePresence(
            self._runner.node, self._participant.node_names, self._report_component
        )
        self._shared = SharedEntities(
            self._runner,
            self._graph,
            partial(self._participant.start_node, f"{options.node_name(name)}_replies"),
        )
        access = NodeAccess(
            self._shared.ask,
            self._runner.has_server,
            self._subscribe_to_changes,
            partial(self._report_component, about="lifecycle"),
        )
        self._managed = ManagedNodes(access, self._graph, self._runner.topic_name)
        self._diagnostics = DiagnosticsReader(
            self._runner,
            self._graph,
            self._runner.topic_name(options.diagnostics_topic),
            options.diagnostics_timeout,
            self._report_component,
        )
        self._lookups = FrameLookups(self._runner, self._graph, self._types.find)
        if isinstance(self._clock, SimulatedClock):
            self._clock.begins_again = self._lookups.forget_moving
        self._called: dict[Ros2Address, ServiceClient | Action] = {}
        # What differs at components that were called, and the client that looks.
        self._disagreements: dict[str, tuple[str, ServiceClient | Action]] = {}
        self._watched: dict[Channel, Callable[[], None]] = {}
        self._runner.tick = self._tick
        self._runner.cut_off = self._cut_off

    def facts(self) -> Mapping[str, object]:
        """Return how often the loops of its nodes turned for nothing."""
        return {"empty_turns": self._participant.turns().empty}

    def _describe(self, endpoint: Endpoint) -> Description:
        address = address_of(endpoint)
        options = self._managed.described(endpoint, options_of(endpoint))
        if address.part == LOOKUP:
            return self._lookups.describe(address, options)
        if endpoint.role is Role.SERVICE:
            return self._describe_service(address, options)
        if address.kind == ACTION:
            if not endpoint.is_offered:
                self._require_server(address, options, action=True)
            return Description(message=part_structure(address.type, address.part))
        self._diagnostics.require_well(options.diagnostics, endpoint.component)
        topic = self._graph.topic(address, endpoint.role, options)
        others = f"it carries other types than {topic.type} too: {topic.others}"
        structure = self._structure(topic.type, topic.name)
        return Description(message=structure, note=others if topic.others else "")

    def _describe_service(self, address: Ros2Address, options: Ros2Options) -> Description:
        action, _, type_name = self._require_server(address, options)
        return describe_action(type_name) if action else describe_service(type_name)

    def _require_server(
        self,
        address: Ros2Address,
        options: Ros2Options,
        *,
        action: bool | None = None,
        at_most: float = math.inf,
    ) -> tuple[bool, str, str]:
        """Return whether it is an action, its full name and its type, once a server is there."""
        name = self._runner.service_name(address.name)
        hidden = f"{name}/_action/send_goal"

        def has_server() -> bool:
            return self._runner.has_server(name) or self._runner.has_server(hidden)

        needed = options.peer_required or not address.type
        if needed and not self._graph.settled(f"a server of {name}", has_server, options, at_most):
            text = self._graph.absence(
                f"there is no server of {name}", name, self._graph.servers_named()
            )
            raise BridgeError(text, FailureReason.NOT_FOUND)
        if action is None:
            action = address.kind == ACTION
            if not address.type:
                action = not self._runner.has_server(name)
        full, type_name = self._graph.service(address, action=action)
        return action, full, type_name

    def _open_source(
        self, endpoint: Endpoint, structure: MessageStructure, deliver: Delivery
    ) -> Source:
        del structure  # the native type is in the address, or on the graph
        address, options = address_of(endpoint), options_of(endpoint)
        if address.kind == ACTION and endpoint.is_offered:
            name = self._runner.service_name(address.name)
            with self._shared.offered(name, address.type) as offered:
                return OfferedSource(endpoint, offered, address.part, deliver)
        with self._managed.leased(endpoint, options) as leased:
            if address.kind == ACTION:
                action = self._reachable(address, leased.options)
                source = ActionSource(endpoint, action, address.part, deliver, self.report_channel)
                return leased.until_closed(source)
            context = self._topic_context(endpoint, address, leased.options)
            shape = shape_of(context.native, context.topic.type)
            subscription = SubscriptionSource(
                context, codec_of(shape).decode, deliver, _definition(structure_of(shape))
            )
            return leased.until_closed(self._wait_for_peer(subscription))

    def _open_sink(self, endpoint: Endpoint, structure: MessageStructure) -> Sink:
        del structure
        address, options = address_of(endpoint), options_of(endpoint)
        if address.kind == ACTION and endpoint.is_offered:
            name = self._runner.service_name(address.name)
            with self._shared.offered(name, address.type) as offered:
                return OfferedSink(endpoint, offered, address.part)
        with self._managed.leased(endpoint, options) as leased:
            if address.kind == ACTION:
                action = self._reachable(address, leased.options)
                return leased.until_closed(ActionSink(endpoint, action, address.part))
            context = self._topic_context(endpoint, address, leased.options)
            write = codec_of(shape_of(context.native, context.topic.type)).encode
            return leased.until_closed(self._wait_for_peer(PublisherSink(context, write)))

    def _call(
        self, endpoint: Endpoint, structures: ServiceStructures, message: Message, timeout: float
    ) -> Message:
        del structures  # the native type is in the address, or on the graph
        address, options = address_of(endpoint), options_of(endpoint)
        with self._managed.leased(endpoint, options) as leased:
            if address.part == LOOKUP:
                return self._lookups.call(address, message, timeout)
            wait = min(self._graph.limit(options), timeout / 2)
            server = self._called.get(address)
            if server is None or not server.ready():
                action, name, type_name = self._require_server(
                    address, leased.options, at_most=wait
                )
                server = (self._shared.action if action else self._shared.caller)(name, type_name)
                self._called[address] = server
            try:
                if isinstance(server, Action):
                    return server.call(message, timeout, wait, self.cancelling)
                return server.call(message, timeout, wait)
            finally:
                self._report_disagreement(endpoint.component, server)

    def _serve(
        self, endpoint: Endpoint, structures: ServiceStructures, handler: Handler
    ) -> Channel:
        del structures
        address, options = address_of(endpoint), options_of(endpoint)
        if not address.type:
            text = f"{endpoint}: serving needs a type, as package/srv/Name, in the address"
            raise BridgeError(text, FailureReason.UNSUPPORTED)
        name = self._runner.service_name(address.name)
        is_action = address.kind == ACTION
        kind = OfferedCall if is_action else ServiceServer
        runner, at_once = self._shared.replies(), options.at_once
        made = kind(runner, endpoint, name, address.type, handler, at_once, self.report_channel)
        asked = f"{name}/_action/send_goal" if is_action else name
        others = OtherServers(
            self._runner, self._participant.node_names, name, asked, made.requests.peer_reported
        )
        self._watched[made] = others.tick
        return made

    def _link(self, source: Endpoint, sink: Endpoint) -> NativeLink | None:
        wanted = [
            (endpoint, address_of(endpoint), options_of(endpoint)) for endpoint in (source, sink)
        ]
        if any(address.kind == ACTION for _, address, _ in wanted):
            return None
        with ExitStack() as stack:
            ends = [
                stack.enter_context(self._managed.leased(end, asked)) for end, _, asked in wanted
            ]
            contexts = [
                self._topic_context(end, address, leased.options)
                for (end, address, _), leased in zip(wanted, ends, strict=True)
            ]
            if contexts[0].topic.type != contexts[1].topic.type:
                return None
            if contexts[0].topic.name != contexts[1].topic.name:
                link: NativeLink = self._wait_for_peer(SerialisedRelay(*contexts))
            else:
                same = SameTopicLink(*contexts)
                self._watched[same] = same.tick
                link = same
            for leased in ends:
                leased.until_closed(link)
            return link

    def _discover(self) -> tuple[Discovered, ...]:
        self._graph.wait_until_formed()
        own = self._participant.node_names()
        return discovered(self.name, self._runner.node, own, self._structure)

    def _close(self) -> None:
        self._managed.close(_LEAVE_SECONDS)
        self._lookups.close()
        self._diagnostics.close()
        self._watched.clear()
        self._shared.close()
        self._participant.close(_CLOSE_SECONDS)

    def _structure(self, type_name: str, topic: str) -> MessageStructure:
        return structure_of(shape_of(self._types.find(type_name, topic), type_name))

    def _ask_for_description(self, node: str, request: Message) -> Message:
        """Ask a node for the description of a type that it uses."""
        name = f"{node}/get_type_description"
        if not self._runner.has_server(name):
            text = f"there is no service {name}"
            raise BridgeError(text, FailureReason.NOT_FOUND)
        return self._shared.ask(name, DESCRIPTION_SERVICE, request, _DESCRIPTION_SECONDS)

    def _subscribe_to_changes(self, topic: str, changed: Callable[[], None]) -> Callable[[], None]:
        """Have a node's changes of lifecycle state notified in the runner's thread."""
        native = import_type("lifecycle_msgs/msg/TransitionEvent")
        runner = self._runner
        made = runner.subscribe(native, topic, Policies(), lambda _: changed(), events={})
        return partial(runner.discard, made)

    def _topic_context(
        self, endpoint: Endpoint, address: Ros2Address, options: Ros2Options
    ) -> TopicContext:
        self._diagnostics.require_well(options.diagnostics, endpoint.component)
        topic = self._graph.topic(address, endpoint.role, options)
        native = self._types.find(topic.type, topic.name)
        large = is_large(shape_of(native, topic.type))
        return TopicContext(
            self._runner,
            self._graph,
            endpoint,
            topic,
            native,
            options,
            options.policies.for_type(large=large),
            self._options.settle,
            partial(self.report_channel, component=endpoint.component),
            self._diagnostics,
            self._clock,
        )

    def _subscribe_to_clock(self) -> SimulatedClock:
        clock, native = SimulatedClock(), import_type(_CLOCK)
        read = codec_of(shape_of(native, _CLOCK)).decode

        def take(octets: bytes) -> None:
            with suppress(MessageError):
                now: Any = read(octets)
                clock.take(now["clock"]["sec"] * 1_000_000_000 + now["clock"]["nanosec"])

        latest = Policies(reliability="best_effort", depth=1)
        self._runner.subscribe(native, "/clock", latest, take, events={})
        return clock

    def _wait_for_peer(self, channel: Watched) -> Watched:
        """Wait for the other end; nothing stays open when it does not come."""
        self._watched[channel] = channel.tick
        with on_failure(channel.close):
            channel.wait()
        return channel

    def _report_disagreement(self, component: str, server: ServiceClient | Action) -> None:
        """Report a component that is called beside servers of the same name with another type."""
        with suppress(BridgeError):  # the bridge was closed meanwhile
            text = server.comparison.look().text
            before = self._disagreements.get(component, ("", server))[0]
            self._disagreements[component] = text, server
            if text != before:
                health = Health.DEGRADED if text else Health.OK
                self._report_component(
                    health,
                    text or "every server of it has our definition",
                    component,
                    about="definition",
                )

    def _reachable(self, address: Ros2Address, options: Ros2Options) -> Action:
        _, name, type_name = self._require_server(address, options, action=True)
        action = self._shared.action(name, type_name)
        if options.peer_required:
            action.wait(self._graph.limit(options))
        return action

    def _report_component(
        self, health: Health, cause: str, component: str, about: str = ""
    ) -> None:
        self.report(health, cause, component=component, about=about)

    def _cut_off(self) -> None:
        text = "the ROS 2 context was shut down from outside, as rclpy's signal handlers do"
        self.report(Health.LOST, text)

    def _tick(self) -> None:
        self._diagnostics.tick()  # before the channels that it judges
        for channel, tick in list(self._watched.items()):
            if channel.closed:
                self._watched.pop(channel, None)
            else:
                tick()
        self._shared.tick()
        for component, (text, server) in list(self._disagreements.items()):
            if text:  # it may end without another call
                self._report_disagreement(component, server)
        self._lookups.tick()
        self._managed.tick()
        self._graph.tick()
        self._attendance.tick()


def _definition(structure: MessageStructure) -> str:
    """Return the text of a type; empty where a message file cannot have it."""
    try:
        return definition_of(structure, structure.native_type).text
    except MessageError:
        return ""
