"""One node of rclpy with a thread of its own."""

from __future__ import annotations

import logging
import threading
import time
import weakref
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from typing import Any

from rclpy.action.graph import get_action_names_and_types
from rclpy.client import Client
from rclpy.duration import Duration
from rclpy.event_handler import PublisherEventCallbacks, SubscriptionEventCallbacks
from rclpy.exceptions import InvalidHandle
from rclpy.impl.implementation_singleton import rclpy_implementation as _rclpy
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.publisher import Publisher
from rclpy.service import Service

from uoarm.bridge import LimitedLog, Turns
from uoarm.errors import BridgeError, FailureReason
from uoarm_ros2._middleware._actions import (
    GoalEntity,
    GoalRequest,
    GoalServer,
    SharedActionClient,
)
from uoarm_ros2._middleware._loop import WaitLoop
from uoarm_ros2._middleware._translation import (
    Peer,
    new_profile,
    rclpy_errors,
    read_peer,
    server_profile,
)
from uoarm_ros2._middleware._wait_set import (
    Entity,
    EventEntity,
    ReplyEntity,
    RequestEntity,
    SubscriptionEntity,
    WaitableEntity,
)
from uoarm_ros2._qos import Policies

_TICK_SECONDS = 0.2
_GOING = frozenset({FailureReason.UNAVAILABLE, FailureReason.RAISED})
_AT_ONCE = Duration(seconds=0)
_SUBSCRIPTION_EVENTS = {
    "deadline": "RCL_SUBSCRIPTION_REQUESTED_DEADLINE_MISSED",
    "incompatible_qos": "RCL_SUBSCRIPTION_REQUESTED_INCOMPATIBLE_QOS",
    "liveliness": "RCL_SUBSCRIPTION_LIVELINESS_CHANGED",
    "matched": "RCL_SUBSCRIPTION_MATCHED",
    "message_lost": "RCL_SUBSCRIPTION_MESSAGE_LOST",
}
_PUBLISHER_EVENTS = {
    "deadline": "RCL_PUBLISHER_OFFERED_DEADLINE_MISSED",
    "incompatible_qos": "RCL_PUBLISHER_OFFERED_INCOMPATIBLE_QOS",
    "matched": "RCL_PUBLISHER_MATCHED",
}
Notify = Callable[[Any], None]
_GRAPH = "looking at the graph of ROS 2"
_OPENING = "opening an end of ROS 2"
_NAMES = "resolving a name of ROS 2"
_log = logging.getLogger("uoarm.ros2")


class NodeRunner:
    """One node, its wait-set loop and the thread that makes its turns.

    When the context is shut down from outside, `is_cut_off` is true: nothing comes any more, and
    `publish_released` publishes until `stop`.

    `stop` returns within its limit whatever a callback does; the thread itself puts everything
    away when it ends, and `done` is called last. `tick` is called a few times a second, `cut_off`
    once if the context is shut down from outside; both in the thread.

    What is opened, resolved or asked once it has ended fails with BridgeError, as CLOSED.
    """

    def __init__(self, context: Any, name: str, namespace: str, done: Callable[[], None]) -> None:
        self._records = LimitedLog(_log)
        self.node = Node(
            name,
            context=context,
            namespace=namespace or None,
            cli_args=[],
            use_global_arguments=False,
            enable_rosout=False,
            start_parameter_services=False,
            parameter_overrides=[Parameter("start_type_description_service", value=False)],
        )
        self.full_name: str = self.node.get_fully_qualified_name()
        self.tick: Callable[[], None] = _nothing
        self.cut_off: Callable[[], None] = _nothing
        self._context = context
        self._loop = WaitLoop(context, name, self._is_ending)
        self._entities: dict[Any, list[Entity]] = {}
        self._definitions: dict[type, str] = {}
        # Guards the lists of rclpy's node, which bear one thread at a time: channels are closed
        # from any thread, also while this one puts everything away.
        self._destroying = threading.Lock()
        self._stopping = False
        self._stopped = threading.Event()
        self._done = done
        self._ended = threading.Event()
        self._thread = threading.Thread(target=self._run, name=f"ros2 {name}", daemon=True)
        self._thread.start()

    @property
    def domain_id(self) -> int:
        """The DDS domain that the node is in."""
        return int(self._context.get_domain_id())

    @property
    def is_cut_off(self) -> bool:
        """Whether the context was shut down although the node was not stopped."""
        return not self._stopping and not self._context.ok()

    @contextmanager
    def calling(self, what: str) -> Iterator[None]:
        """Name the called entity in what the block raises.

        Once the node is stopped, what it holds goes one after the other: a server of its own may
        be away, or a client invalid, before the handles are.

        Raises:
            BridgeError: as `rclpy_errors`; with CLOSED, too, for what is away or raised since then.
        """
        try:
            with rclpy_errors(what):
                yield
        except BridgeError as error:
            if self._stopping and error.reason in _GOING:
                raise BridgeError(f"{what}: the bridge was closed", FailureReason.CLOSED) from error
            raise

    @property
    def turns(self) -> Turns:
        """How often its loop has turned, and how often for nothing."""
        return self._loop.turns

    def call_soon(self, act: Callable[[], None]) -> None:
        """Call a function in this node's thread, after its present callback; from any thread."""
        self._loop.call_soon(act)

    def stop(self, limit: float) -> bool:
        """End the thread; whether it ended within `limit` seconds."""
        self._stopping = True
        self._stopped.set()
        self._loop.wake()
        return threading.current_thread() is self._thread or self._ended.wait(limit)

    def _run(self) -> None:
        due = time.monotonic() + _TICK_SECONDS
        try:
            while not self._stopping:
                worked = False
                try:
                    worked = self._loop.turn(max(0.0, due - time.monotonic()))
                    if time.monotonic() >= due:
                        due = time.monotonic() + _TICK_SECONDS
                        self.tick()
                except Exception as error:  # noqa: BLE001 - one failure ends no other entity
                    self._failed(error)
                # Nothing comes any more in a context that has ended.
                if not worked and not self._context.ok():
                    break
            if not self._stopping:
                # What is open stays until it is closed: stop messages are sent after the end.
                self.cut_off()
                self._stopped.wait()
        finally:
            self._put_away()

    def _is_ending(self) -> bool:
        return self._stopping or not self._context.ok()

    def _failed(self, error: Exception) -> None:
        if not self._is_ending():
            self._records.write(logging.ERROR, "looking after a ROS 2 node failed", error)

    def _put_away(self) -> None:
        try:
            self._loop.close()
            with self._destroying:
                for native in list(self._entities):
                    if isinstance(native, (GoalServer, SharedActionClient)):  # left by the node
                        native.destroy()
                self.node.destroy_node()
        except Exception as error:  # noqa: BLE001 - the context must go all the same
            self._records.write(logging.ERROR, "putting away a ROS 2 node failed", error)
        finally:
            self._done()
            self._ended.set()

    def _wait_for(self, native: Any, *entities: Entity) -> Any:
        """Hand on what comes to a native entity from now on."""
        self._entities[native] = list(entities)
        self._loop.add(*entities)
        return native

    def discard(self, native: Any) -> None:
        """Destroy what was made here; waits for no thread that is held up."""
        self._loop.remove(*self._entities.pop(native, ()))
        # rclpy keeps a dead reference to each entity that its group ever had.
        self.node.default_callback_group.entities.discard(weakref.ref(native))
        with self._destroying:
            if isinstance(native, GoalServer):
                native.destroy()
            elif isinstance(native, Publisher):
                self.node.destroy_publisher(native)
            elif isinstance(native, Service):
                self.node.destroy_service(native)
            elif isinstance(native, Client):
                self.node.destroy_client(native)
            else:
                self.node.destroy_subscription(native)

    @rclpy_errors(_OPENING)
    def subscribe(
        self,
        native: type,
        topic: str,
        policies: Policies,
        take: Callable[..., None],
        *,
        events: dict[str, Notify],
        names_writers: bool = False,
    ) -> Any:
        """Create a subscription, which hands on messages as they are serialised.

        With `names_writers`, with the identity of the publisher of each.

        Events that the middleware does not have are left out.
        """
        made = self.node.create_subscription(
            native,
            topic,
            _nothing_with,
            new_profile(policies),
            raw=True,
            event_callbacks=SubscriptionEventCallbacks(use_default_callbacks=False),
        )
        known = _rclpy.rcl_subscription_event_type_t
        entity = SubscriptionEntity(made.handle, native, take, names_writers=names_writers)
        received = _events(made.handle, known, _SUBSCRIPTION_EVENTS, events, of=entity)
        return self._wait_for(made, entity, *received)

    @rclpy_errors(_OPENING)
    def advertise(
        self,
        native: type,
        topic: str,
        policies: Policies,
        *,
        events: dict[str, Notify],
    ) -> Any:
        """Create a publisher; events that the middleware does not have are left out."""
        made = self.node.create_publisher(
            native,
            topic,
            new_profile(policies),
            event_callbacks=PublisherEventCallbacks(use_default_callbacks=False),
        )
        known = _rclpy.rcl_publisher_event_type_t
        return self._wait_for(made, *_events(made.handle, known, _PUBLISHER_EVENTS, events))

    def is_acknowledged(self, publisher: Publisher) -> bool:
        """Whether every reliable subscription that is matched has what was published; at once."""
        try:
            # Any longer wait would keep the interpreter's lock for as long as it takes.
            return bool(publisher.wait_for_all_acked(_AT_ONCE))
        except (InvalidHandle, _rclpy.RCLError):
            return False  # it was put away, or the context has ended

    @rclpy_errors(_OPENING)
    def action_client(self, native: type, name: str) -> Any:
        """Create an action client; its callbacks run in this node's thread."""
        client = SharedActionClient(self.node, native, name)
        return self._wait_for(client, WaitableEntity(client))

    @rclpy_errors(_OPENING)
    def client(self, native: type, name: str) -> Any:
        """Create a service client; its replies arrive in this node's thread."""
        client = self.node.create_client(native, name)
        return self._wait_for(client, ReplyEntity(client))

    @rclpy_errors(_OPENING)
    def server(
        self, native: type, name: str, answer: Callable[[Any, Callable[[Any], None]], None]
    ) -> Any:
        """Create a service; `answer` takes each request in this node's thread.

        It is given the request and a function that sends the reply, from any thread.
        """
        service = self.node.create_service(
            native, name, _nothing_with, qos_profile=server_profile()
        )
        return self._wait_for(service, RequestEntity(service, answer))

    @rclpy_errors(_OPENING)
    def goal_server(
        self,
        native: type,
        name: str,
        ask: Callable[[GoalRequest], None],
        *,
        may_cancel: Callable[[bytes], bool],
        cancel: Callable[[bytes], None],
    ) -> GoalServer:
        """Create an action server, whose goals and cancellations come in this node's thread."""
        server = GoalServer(self.node, native, name, ask, may_cancel, cancel)
        self._wait_for(server, GoalEntity(server))
        return server

    @rclpy_errors(_NAMES)
    def topic_name(self, name: str) -> str:
        """Return the full name of a topic; the namespace is put before a relative one.

        Raises:
            BridgeError: the node has ended.
        """
        return str(self.node.resolve_topic_name(name))

    @rclpy_errors(_NAMES)
    def service_name(self, name: str) -> str:
        """Return the full name of a service or action, as that of a topic."""
        return str(self.node.resolve_service_name(name))

    @rclpy_errors(_GRAPH)
    def publishers(self, topic: str) -> tuple[Peer, ...]:
        """Return the publishers of a topic that are on the graph now."""
        return tuple(map(read_peer, self.node.get_publishers_info_by_topic(topic)))

    @rclpy_errors(_GRAPH)
    def subscriptions(self, topic: str) -> tuple[Peer, ...]:
        """Return the subscriptions of a topic that are on the graph now."""
        return tuple(map(read_peer, self.node.get_subscriptions_info_by_topic(topic)))

    def ends(self, topic: str) -> tuple[Peer, ...]:
        """Return the publishers and subscriptions of a topic that are on the graph now."""
        return (*self.publishers(topic), *self.subscriptions(topic))

    @rclpy_errors(_GRAPH)
    def own_definition(self, topic: str, type_name: str, native: type) -> str:
        """Return the hash of our definition of a type, as our own end of a topic shows it.

        Of each class the graph is asked once, unless ends of ours mean different ones by the name.
        """
        known = self._definitions.get(native)
        if known is not None:
            return known
        own = [
            end.definition
            for end in self.ends(topic)
            if (end.node, end.type) == (self.full_name, type_name)
        ]
        if own and own[0] and len(set(own)) == 1:
            self._definitions[native] = own[0]
        return next(iter(own), "")

    def has_server(self, service: str) -> bool:
        """Whether a server of this full name is on the graph; clients do not count.

        Raises:
            BridgeError: the node has ended, as for all that the graph is asked here.
        """
        return bool(self.server_count(service))

    @rclpy_errors(_GRAPH)
    def server_count(self, service: str) -> int:
        """Return how many servers of a full name are on the graph, ours included."""
        return int(self.node.count_services(service))

    @rclpy_errors(_GRAPH)
    def servers(self, service: str) -> tuple[Peer, ...]:
        """Return the servers of a full name, as their reply topics show them.

        Empty where the middleware names these topics otherwise than DDS does in ROS 2:
        https://design.ros2.org/articles/topic_and_service_names.html
        """
        found = self.node.get_publishers_info_by_topic(f"rr{service}Reply", no_mangle=True)
        return tuple(map(read_peer, found))

    @rclpy_errors(_GRAPH)
    def service_ends(self, service: str) -> tuple[tuple[Peer, ...], tuple[Peer, ...]]:
        """Return what servers of a full name have, and what clients have, each under DDS's names.

        Each has an end for requests and one for replies.
        """
        named = f"rq{service}Request", f"rr{service}Reply"
        found = [
            tuple(map(read_peer, look(topic, no_mangle=True)))
            for topic in named
            for look in (
                self.node.get_publishers_info_by_topic,
                self.node.get_subscriptions_info_by_topic,
            )
        ]
        asking, taking, answering, awaiting = found
        return (*taking, *answering), (*asking, *awaiting)

    @rclpy_errors(_GRAPH)
    def topics(self) -> dict[str, list[str]]:
        """Return the topics on the graph now, with their types."""
        return dict(self.node.get_topic_names_and_types())

    @rclpy_errors(_GRAPH)
    def services(self) -> dict[str, list[str]]:
        """Return the services on the graph now, with their types."""
        return dict(self.node.get_service_names_and_types())

    @rclpy_errors(_GRAPH)
    def actions(self) -> dict[str, list[str]]:
        """Return the actions on the graph now, with their types."""
        return dict(get_action_names_and_types(self.node))


def _events(
    parent: Any,
    known: Any,
    names: dict[str, str],
    wanted: dict[str, Notify],
    of: SubscriptionEntity | None = None,
) -> list[EventEntity]:
    """Return an entity for each event that this rclpy and its middleware have."""
    made = []
    for name, notify in wanted.items():
        kind = getattr(known, names[name], None)
        if kind is None:
            continue
        with suppress(_rclpy.UnsupportedEventTypeError), parent:
            made.append(EventEntity(_rclpy.EventHandle(parent, kind), notify, of))
    return made


def _nothing() -> None:
    pass


def _nothing_with(*_: object) -> None:
    """Stand where rclpy wants a callback, which only an executor would call."""
