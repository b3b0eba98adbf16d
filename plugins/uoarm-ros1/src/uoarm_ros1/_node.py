"""The bridge's node: its master, topics and services, /rosout and /clock."""

from __future__ import annotations

import os
import re
import socket
import threading
import time
from collections.abc import Callable, Mapping
from contextlib import suppress
from functools import partial
from itertools import count
from typing import Any, Protocol, TypeVar

from attrs import evolve

from uoarm.bridge import on_failure
from uoarm.errors import BridgeError, FailureReason, MessageError
from uoarm.model import Health
from uoarm_ros1._definitions import RosRecord
from uoarm_ros1._master import Master, Peers, call_api
from uoarm_ros1._options import NodeIdentity, Ros1BridgeOptions
from uoarm_ros1._publication import TopicPublication
from uoarm_ros1._server import NodeServer, SocketLoop
from uoarm_ros1._subscription import SubscriptionOptions, TopicSubscription
from uoarm_ros1._tcpros import encode_header
from uoarm_ros1._types import TypeStore, framed_writer, reader
from uoarm_ros1._xmlrpc import (
    NodeApi,
    ParameterUpdate,
    PublisherUpdate,
    Shutdown,
    TransportRefusal,
)

_ASK_SECONDS = 0.5
_HEAD_OCTETS = 4096
_TEXT = re.compile(rb"<string>([^<]*)</string>")
_LOOPBACK = {"localhost", "127.0.0.1", "::1"}
T = TypeVar("T")
Arrived = Callable[[socket.socket, dict[str, str]], None]


class ParameterListener(Protocol):
    """Takes the value of a parameter, or of one within it, in the thread that found it."""

    def __call__(self, key: str, value: Any, *, is_set: bool) -> object:
        """Take a value; without `is_set` it is what a registration found, and may be known."""


class Node:
    """One node. It is there as long as the bridge is, whether the master is or not.

    Args:
        identity: its name, and where its master is.
        ended: is called, with the reason, when the master or an operator asks the node to end.

    Attributes:
        name: its full name.
        peers: the APIs of the nodes that it is connected to.
        loop: that watches its sockets.
        stamp: returns the time as headers have it: this machine's, or that of /clock.
        has_registered: whether the master has ever taken a registration of it.
    """

    def __init__(
        self, identity: NodeIdentity, options: Ros1BridgeOptions, ended: Callable[[str], object]
    ) -> None:
        self.identity, self.options = identity, options
        self.name = identity.names.node
        self._ended = ended
        self.has_registered = False
        self.stamp: Callable[[], Mapping[str, int]] = _stamp
        # Guards the tables of what is registered, between steps, the loop and the watch.
        self._lock = threading.RLock()
        self._publications: dict[str, tuple[TopicPublication, int]] = {}
        self._subscriptions: dict[str, tuple[TopicSubscription, ...]] = {}
        self._services: dict[str, Arrived] = {}
        self._parameters: dict[str, tuple[ParameterListener, ...]] = {}
        # The last change of a parameter, and how often it came.
        self._updated: tuple[tuple[str, Any], int] = ("", None), 0
        self._tables: Mapping[str, Mapping[str, object]] = {
            "publisher": self._publications,
            "subscriber": self._subscriptions,
            "service": self._services,
            "parameter": self._parameters,
        }
        # What the master has taken, by kind and name; under the lock.
        self._registered: set[tuple[str, str]] = set()
        self._is_closing = self._is_alone = False
        self._numbers = count(2)
        host = identity.host or _own_address(identity.master_host, identity.master_port)
        # Who says that it is reached on this machine alone is reached from no other.
        is_here = host in _LOOPBACK or host.startswith("127.")
        address = ("127.0.0.1" if host == "localhost" else host) if is_here else ""
        self._api = NodeApi(self.name, identity.master, os.getpid(), host)
        self._api.connections = self._connections
        self.loop = SocketLoop(f"uoarm-ros1{self.name}")
        with on_failure(self.loop.close):
            server = NodeServer(
                self.loop,
                address or "0.0.0.0",  # noqa: S104 - see above
                self._answer,
                self._arrived,
                self._look_at_parameter,
            )
        self._api.port = server.port
        at = f"[{host}]" if ":" in host else host
        self.uri = f"http://{at}:{server.api_port}/"
        self.service_uri = f"rosrpc://{at}:{server.port}"
        self.master = master = Master(identity.master, self.name, self.uri)
        self.peers = Peers(self.name)
        self._take_back: Mapping[str, Callable[[str], object]] = {
            "publisher": partial(master.unregister, "Publisher"),
            "subscriber": partial(master.unregister, "Subscriber"),
            "service": lambda service: master.unregister_service(service, self.service_uri),
            "parameter": partial(master.call, "unsubscribeParam", self.uri),
        }

    def resolve(self, name: str) -> str:
        """Return a full name."""
        return self.identity.names.resolve(name)

    @property
    def is_registered(self) -> bool:
        """Whether the master should know the node. What is being registered it need not know yet.

        Registered a second time, a publisher would be announced twice. rospy connects for both at
        once, and closes the first connection.
        """
        return bool(self._registered)

    def advertise(self, topic: str, record: RosRecord, **more: Any) -> TopicPublication:
        """Publish a topic; one that is published already is shared.

        Raises:
            BridgeError: it is published as another type, or the master cannot be reached.
        """
        with self._lock:
            self._require_open()
            known = self._publications.get(topic)
            if known is None:
                made = TopicPublication(self.loop, self.name, topic, record, **more)
                self._publications[topic] = (made, 1)
                self._api.publications[topic] = record.name
            else:
                made, users = known
                if made.record.md5 != record.md5:
                    text = f"topic {topic} is published here as {made.record.name} already"
                    raise BridgeError(text, FailureReason.REFUSED)
                made.latch = max(made.latch, more.get("latch", 0))
                made.registered = None  # of the first that opened it
                self._publications[topic] = (made, users + 1)
                return made
        with on_failure(self.withdraw, made):
            call = partial(self.master.register_publisher, topic, record.name)
            made.registered = len(self._register("publisher", topic, call))
        return made

    def withdraw(self, publication: TopicPublication) -> None:
        """Publish a topic no more, once no channel here does."""
        topic = publication.topic
        with self._lock:
            made, users = self._publications.get(topic, (None, 0))
            if made is not publication:
                return
            if users > 1:
                self._publications[topic] = (publication, users - 1)
                return
            del self._publications[topic]
            self._api.publications.pop(topic, None)
        self._unregister("publisher", topic)
        publication.close()

    def wanted(self, topic: str, record: RosRecord) -> SubscriptionOptions:
        """Return what a subscription of this node takes of any publisher of a topic."""
        options = self.options
        return SubscriptionOptions(
            self.name,
            topic,
            record.name,
            record.md5,
            most=options.budget.octets,
            silence=options.silence,
        )

    def subscribe(self, subscription: TopicSubscription) -> None:
        """Connect a subscription to the publishers of its topic, from now on.

        Raises:
            BridgeError: the master cannot be reached, or there is no thread for a publisher.
        """
        topic, kind = subscription.wanted.topic, subscription.wanted.kind
        with self._lock:
            self._require_open()
            before = self._subscriptions.get(topic, ())
            if any(other.wanted.caller == self.name for other in before):
                subscription.wanted = evolve(subscription.wanted, caller=self.another_name())
            self._subscriptions[topic] = (*before, subscription)
            self._api.subscriptions[topic] = kind or "*"
        with on_failure(self.unsubscribe, subscription):
            call = partial(self.master.register_subscriber, topic, kind)
            if failure := subscription.update(self._register("subscriber", topic, call)):
                raise BridgeError(failure, FailureReason.UNAVAILABLE)

    def unsubscribe(self, subscription: TopicSubscription) -> None:
        """Close a subscription."""
        topic = subscription.wanted.topic
        subscription.close()
        with self._lock:
            before = self._subscriptions.get(topic, ())
            left = tuple(other for other in before if other is not subscription)
            if left:
                self._subscriptions[topic] = left
                return
            if self._subscriptions.pop(topic, None) is None:
                return
            self._api.subscriptions.pop(topic, None)
        self._unregister("subscriber", topic)

    def another_name(self) -> str:
        """Return a name for one more connection to a topic.

        A publisher of rospy ends the connection that it has to the same name.
        """
        return f"{self.name}_{next(self._numbers)}"

    def own_callers(self, topic: str) -> dict[str, bool]:
        """Return the names under which the node itself connects to a topic of its own.

        Each with whether it takes messages: one may be given up after the publisher took it in.
        """
        return {
            subscription.wanted.caller: any(
                header.node == self.name for header in subscription.connected
            )
            for subscription in self._subscriptions.get(topic, ())
            if subscription.wanted.node in {"", self.name}
        }

    def serve(self, service: str, arrived: Arrived) -> None:
        """Serve a service: connections of clients go to `arrived`, in the loop's thread.

        Raises:
            BridgeError: it is served here already, or the master cannot be reached.
        """
        with self._lock:
            self._require_open()
            if service in self._services:
                text = f"service {service} is served here already"
                raise BridgeError(text, FailureReason.REFUSED)
            self._services[service] = arrived
        with on_failure(self.unserve, service):
            self.register_service(service)

    def register_service(self, service: str) -> None:
        """Have the master send clients of a service here, unless it is not served any more.

        Raises:
            BridgeError: the master cannot be reached.
        """
        call = partial(self.master.register_service, service, self.service_uri)
        self._register("service", service, call)

    def unserve(self, service: str) -> None:
        """Serve a service no more."""
        with self._lock:
            if self._services.pop(service, None) is None:
                return
        self._unregister("service", service)

    def watch_parameter(self, key: str, changed: ParameterListener) -> Any:
        """Have changes of a parameter reported; returns its value, an empty object: none.

        Raises:
            BridgeError: the master cannot be reached.
        """
        with self._lock:
            self._require_open()
            self._parameters[key] = (*self._parameters.get(key, ()), changed)
        with on_failure(self.unwatch_parameter, key, changed):
            return self._register("parameter", key, partial(self.master.watch_parameter, key))

    def unwatch_parameter(self, key: str, changed: ParameterListener) -> None:
        """Have them reported no more."""
        with self._lock:
            left = tuple(other for other in self._parameters.get(key, ()) if other != changed)
            if left:
                self._parameters[key] = left
                return
            if self._parameters.pop(key, None) is None:
                return
        self._unregister("parameter", key)

    def parameter_changed(self, key: str, value: Any) -> None:
        """Report a change here; of those that the node itself makes, the master says nothing."""
        for watched, listeners in tuple(self._parameters.items()):
            if _is_within(key, watched):
                for changed in listeners:
                    changed(key, value, is_set=True)

    def is_known(self) -> bool:
        """Whether the master knows the node; one that was started again knows no node.

        Raises:
            BridgeError: it cannot be reached.
        """
        try:
            return self.master.node_uri(self.name) == self.uri
        except BridgeError as error:
            if error.reason is FailureReason.REFUSED:
                return False
            raise

    def address(self, node: str) -> str:
        """Return the address that the master has for a node, nothing where it has none."""
        with suppress(BridgeError):
            return self.master.node_uri(node)
        return ""

    def answers(self, address: str) -> bool:
        """Whether a node answers at an address."""
        try:
            call_api(address, "getPid", self.name, seconds=_ASK_SECONDS)
        except BridgeError:
            return False
        return True

    def register_again(self) -> None:
        """Register everything with a master that does not know the node, as after its restart.

        Raises:
            BridgeError: it cannot be reached.
        """
        with self._lock:
            publications = [made for made, _ in self._publications.values()]
            subscriptions = {topic: made for topic, made in self._subscriptions.items() if made}
            services, parameters = tuple(self._services), dict(self._parameters)
        for publication in publications:
            topic = publication.topic
            call = partial(self.master.register_publisher, topic, publication.record.name)
            self._register("publisher", topic, call)
        for service in services:
            self.register_service(service)
        for topic, made in subscriptions.items():
            ask = partial(self.master.register_subscriber, topic, made[0].wanted.kind)
            uris = self._register("subscriber", topic, ask)
            for subscription in made:
                # What is connected stays so, whether its publisher has come back to the master.
                subscription.update((*uris, *subscription.listed))
        for key, listeners in parameters.items():
            value = self._register("parameter", key, partial(self.master.watch_parameter, key))
            for changed in listeners:
                changed(key, value, is_set=False)

    def close(self) -> None:
        """Take every registration back, and close every socket."""
        with self._lock:
            self._is_closing = True
            publications = [made for made, _ in self._publications.values()]
            subscriptions = [made for all_of in self._subscriptions.values() for made in all_of]
            services, parameters = tuple(self._services), dict(self._parameters)
        for publication in publications:
            with self._lock:
                self._publications[publication.topic] = (publication, 1)
            self.withdraw(publication)
        for subscription in subscriptions:
            self.unsubscribe(subscription)
        for service in services:
            self.unserve(service)
        for key, listeners in parameters.items():
            for changed in listeners:
                self.unwatch_parameter(key, changed)
        self.loop.close()

    def _require_open(self) -> None:
        if self._is_closing:  # nothing would take a registration back
            raise BridgeError(f"node {self.name} is closed", FailureReason.UNAVAILABLE)

    def _register(self, kind: str, name: str, call: Callable[[], T]) -> T:
        # What is taken back meanwhile may reach the master before it is registered here: it is
        # taken back once more, or the master knew for good what is there no longer.
        found = call()
        self.has_registered = True
        with self._lock:
            is_wanted = name in self._tables[kind]
            if is_wanted:
                self._registered.add((kind, name))
        if not is_wanted:
            self._unregister(kind, name)
        return found

    def _unregister(self, kind: str, name: str) -> None:
        with self._lock:
            self._registered.discard((kind, name))
        if self._is_alone:
            return
        try:
            self._take_back[kind](name)
        except BridgeError as error:
            # A master that is gone knows of nothing; one that stalls is waited for once.
            self._is_alone = self._is_closing and error.reason is FailureReason.UNAVAILABLE

    def _connections(self) -> list[list[Any]]:
        listing: list[list[Any]] = []
        for topic, (publication, _) in tuple(self._publications.items()):
            for caller, text in publication.connections():
                listing.append([len(listing) + 1, caller, "o", "TCPROS", topic, True, text])
        for topic, subscriptions in tuple(self._subscriptions.items()):
            for subscription in subscriptions:
                for header in subscription.connected:
                    listing.append([len(listing) + 1, header.node, "i", "TCPROS", topic, True, ""])
        return listing

    def _answer(self, method: str, arguments: list[Any]) -> Any:
        result, event = self._api.answer(method, arguments)
        if isinstance(event, PublisherUpdate):
            for subscription in self._subscriptions.get(event.topic, ()):
                subscription.update(event.publishers)
        elif isinstance(event, ParameterUpdate):
            self._parameter_updated(event.key.rstrip("/"), event.value)
        elif isinstance(event, TransportRefusal) and event.topic in self._publications:
            self._publications[event.topic][0].refuse_transport(arguments[0][:200])
        elif isinstance(event, Shutdown):
            self._ended(event.reason)
        return result

    def _parameter_updated(self, key: str, value: Any) -> None:
        """Report a change, which the master sends once for each of those watched that it is in."""
        copies = sum(_is_within(key, watched) for watched in tuple(self._parameters))
        before, seen = self._updated
        if before == (key, value) and seen < copies:
            self._updated = before, seen + 1
            return
        self._updated = (key, value), 1
        self.parameter_changed(key, value)

    def _look_at_parameter(self, body: bytes) -> None:
        """Have a parameter looked at of which a change came that is more than a call may hold."""
        head = body[:_HEAD_OCTETS]
        texts = _TEXT.findall(head) if b">paramUpdate<" in head else []
        if len(texts) > 1:  # the caller, and the key
            self.parameter_changed(texts[1].decode("utf-8", "replace").rstrip("/"), {})

    def _arrived(self, connection: socket.socket, header: dict[str, str]) -> None:
        if "service" in header:
            arrived = self._services.get(header["service"])
            problem = f"{self.name} serves no {header['service'][:200]}"
        else:
            known = self._publications.get(header.get("topic", ""))
            arrived = None if known is None else known[0].arrived
            problem = f"{self.name} does not publish {header.get('topic', 'it')[:200]}"
        if arrived is not None:
            arrived(connection, header)
            return
        with suppress(OSError):
            connection.send(encode_header({"error": problem, "callerid": self.name}))
        connection.close()


def _is_within(key: str, watched: str) -> bool:
    return f"{key}/".startswith(f"{watched.rstrip('/')}/")


def _stamp() -> dict[str, int]:
    secs, nsecs = divmod(time.time_ns(), 1_000_000_000)
    return {"secs": secs, "nsecs": nsecs}


def _own_address(host: str, port: int) -> str:
    """Return the address under which the master's machine sees this one."""
    if host in _LOOPBACK or host.startswith("127."):
        return "127.0.0.1" if host == "localhost" else host
    try:
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
            probe.connect((host, port))
            return str(probe.getsockname()[0])
    except OSError:
        return socket.gethostname()


_INFO, _WARN, _ERROR = 2, 4, 8
_LEVELS = {
    Health.OK: _INFO,
    Health.FINISHED: _INFO,
    Health.DEGRADED: _WARN,
    Health.LOST: _ERROR,
}


class Rosout:
    """Says on /rosout what the bridge reports, once the master is there."""

    def __init__(self, node: Node, types: TypeStore) -> None:
        self._node = node
        self._record = types.require("rosgraph_msgs/Log")
        self._write = framed_writer(self._record)
        self._publication: TopicPublication | None = None
        self._count = 0

    def open(self) -> None:
        """Publish the topic, unless it is published.

        Raises:
            BridgeError: the master cannot be reached.
        """
        if self._publication is None:
            self._publication = self._node.advertise("/rosout", self._record)

    def say(self, health: Health, text: str) -> None:
        """Say what was reported; returns at once, and never raises."""
        publication = self._publication
        if publication is None:
            return
        self._count += 1
        message = {
            "header": {"seq": self._count, "stamp": self._node.stamp(), "frame_id": ""},
            "level": _LEVELS[health],
            "name": self._node.name,
            "msg": text,
            "file": "",
            "function": "",
            "line": 0,
            "topics": [],
        }
        with suppress(MessageError):
            publication.send(self._write(message))

    def close(self) -> None:
        """Publish it no more."""
        if self._publication is not None:
            self._node.withdraw(self._publication)


class Clock:
    """The seconds of /clock: they stand while it does, and never go back."""

    def __init__(self, node: Node, types: TypeStore) -> None:
        record = types.require("rosgraph_msgs/Clock")
        self._node = node
        self._read = reader(record, node.options.budget)
        self._wanted = SubscriptionOptions(node.name, "/clock", record.name, record.md5)
        self._subscription: TopicSubscription | None = None
        self._seconds = 0.0
        self._time: Mapping[str, int] | None = None  # nothing was said yet
        node.stamp = self.stamp

    def now(self) -> float:
        """Return the seconds that it has counted since it said something first."""
        return self._seconds

    def stamp(self) -> Mapping[str, int]:
        """Return the time that was said last, as headers have it."""
        return self._time or {"secs": 0, "nsecs": 0}

    def open(self) -> None:
        """Subscribe to it, unless it is done.

        Raises:
            BridgeError: the master cannot be reached.
        """
        if self._subscription is None:
            made = TopicSubscription(
                self._wanted, self._node.peers, self._take, lambda _: None, lambda *_: None
            )
            self._node.subscribe(made)
            self._subscription = made

    def close(self) -> None:
        """Subscribe to it no more."""
        if self._subscription is not None:
            self._node.unsubscribe(self._subscription)

    def _take(self, frame: bytes | bytearray, _: str) -> None:
        with suppress(MessageError):
            time: Mapping[str, int] = self._read(frame)["clock"]
            before = self._time or time
            passed = time["secs"] - before["secs"] + (time["nsecs"] - before["nsecs"]) / 1e9
            self._seconds += max(0.0, passed)  # one that is earlier is of another run
            self._time = time
