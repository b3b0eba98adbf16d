"""Calls of XML-RPC with a deadline, and the ROS master behind them."""

from __future__ import annotations

import math
import socket
import threading
import time
from collections.abc import Callable, Mapping
from contextlib import suppress
from functools import partial
from typing import Any, Generic, TypeVar
from urllib.parse import urlsplit
from weakref import WeakValueDictionary

from attrs import field, frozen

from uoarm.bridge import close_in_children
from uoarm.errors import BridgeError, FailureReason
from uoarm_ros1._tcpros import ProtocolError
from uoarm_ros1._xmlrpc import Fault, HttpReader, decode_reply, encode_call, http_request

_CALL_SECONDS = 2.0
"""How long one call may take: less than a step may, so that its error says what did not come."""

_MAX_OCTETS = 8 << 20
_CHUNK = 65_536
_DONE = 1
_RESULT = 3
T = TypeVar("T")


def connect(
    host: str,
    port: int,
    deadline: float,
    connecting: Callable[[socket.socket], object] = lambda _: None,
) -> socket.socket:
    """Return a connection.

    Args:
        host: of the server.
        port: of the server.
        deadline: a time of `time.monotonic`.
        connecting: gets each socket before it connects, so that another thread may shut it down.

    Raises:
        OSError: there is none by the deadline, or it was shut down.
    """
    failure = OSError("it has no address")
    for family, kind, protocol, _, place in socket.getaddrinfo(host, port, type=socket.SOCK_STREAM):
        connection = socket.socket(family, kind, protocol)
        try:
            connecting(connection)
            connection.settimeout(max(0.001, deadline - time.monotonic()))
            connection.connect(place)
        except OSError as error:
            connection.close()
            failure = error
            continue
        close_in_children(connection)
        connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        return connection
    raise failure


def failure_text(what: str, host: str, port: int, error: Exception) -> str:
    """Return why something of a peer failed: with host, port, and what to set."""
    where = f"{what} at {host}:{port}"
    if isinstance(error, socket.gaierror):
        return (
            f"{where}: the name {host!r} cannot be resolved here ({error.strerror}): set ROS_IP or "
            f"ROS_HOSTNAME where that node runs, or enter the name in /etc/hosts here"
        )
    if isinstance(error, TimeoutError):
        return (
            f"{where}: no answer in time: it is stopped or overloaded, or a firewall or a wrong "
            f"ROS_IP or ROS_HOSTNAME of that node is in between"
        )
    if isinstance(error, OSError):
        why = error.strerror or str(error)
        return f"{where}: {why}: it has ended, or its ROS_IP or ROS_HOSTNAME names another machine"
    return f"{where}: {error}"


def call_api(
    uri: str, method: str, *arguments: Any, seconds: float = _CALL_SECONDS, what: str = "the node"
) -> Any:
    """Call a method of the master or of a node and return the value of its answer.

    Raises:
        BridgeError: it cannot be reached, does not answer in time or in order, or refuses; with
            host, port and what to set.
    """
    host, port = _host_and_port(uri)
    if not port:
        raise BridgeError(f"{what} has the address {uri[:200]!r}, which is none")
    reason = FailureReason.UNAVAILABLE
    try:
        body = _exchange(host, port, encode_call(method, arguments), time.monotonic() + seconds)
        reason = FailureReason.BAD_MESSAGE
        result = decode_reply(body)
    except (OSError, ProtocolError, Fault) as error:
        if isinstance(error, Fault):  # which can be read
            reason = FailureReason.UNAVAILABLE
        text = failure_text(f"{method}: {what}", host, port, error)
        raise BridgeError(text, reason) from error
    if not isinstance(result, list) or len(result) != _RESULT or type(result[0]) is not int:
        text = f"{method}: {what} at {host}:{port} answered with no code, text and value"
        raise BridgeError(text, FailureReason.BAD_MESSAGE)
    code, status, value = result
    if code != _DONE:
        why = str(status)[:500].strip() or "it says not why"
        text = f"{method}: {what} at {host}:{port} refuses: {why}"
        raise BridgeError(text, FailureReason.REFUSED)
    return value


def _host_and_port(uri: str) -> tuple[str, int]:
    """Return where a URI leads, and no port where it leads nowhere."""
    try:
        parts = urlsplit(uri)
        host, port = parts.hostname or "", parts.port or 0
    except ValueError:
        return "", 0
    return (host, port) if host else ("", 0)


def _exchange(host: str, port: int, body: bytes, deadline: float) -> bytes:
    """Send a request and return the body of the reply; the deadline is for all of it together."""
    with connect(host, port, deadline) as connection:
        connection.settimeout(max(0.001, deadline - time.monotonic()))
        connection.sendall(http_request(host, port, body))
        reader = HttpReader(_MAX_OCTETS)
        while True:
            left = deadline - time.monotonic()
            if left <= 0:
                raise TimeoutError("no answer in time")
            connection.settimeout(left)
            octets = connection.recv(_CHUNK)
            messages = reader.received(octets) if octets else [reader.ended()]
            if not messages:
                continue
            message = messages[0]
            if message is None:
                raise ProtocolError("the connection ended before an answer")
            if not message.is_ok:
                raise ProtocolError(f"it answered {message.start[:100]!r}")
            return message.body


class SharedAnswer(Generic[T]):
    """An answer that many want to know: it is asked for once for all that wait. Thread safe.

    Args:
        ask: returns it, within its own time limit, or raises BridgeError.
    """

    def __init__(self, ask: Callable[[], T]) -> None:
        self._ask = ask
        # Held while it is asked for: of hundreds that want it at once, the first asks, and the
        # second for all that came since.
        self._lock = threading.Lock()
        self._asked = -math.inf
        self._answer: T | BridgeError

    def get(self, since: float | None = None) -> T:
        """Return what was answered to a question of that time or later; waits for two at most.

        Args:
            since: time of the monotonic clock; None: the time of this call.

        Raises:
            BridgeError: what the question came to.
        """
        wanted = time.monotonic() if since is None else since
        with self._lock:
            if self._asked < wanted:
                self._asked = time.monotonic()
                try:
                    self._answer = self._ask()
                except BridgeError as error:
                    # Who came while it was waited for need not wait as long again: up to now there
                    # was no answer.
                    self._answer, self._asked = error, time.monotonic()
            answer = self._answer
        if isinstance(answer, BridgeError):
            # One of its own for each, as threads write into what they raise.
            raise BridgeError(str(answer), answer.reason) from answer
        return answer


class PeerApi:
    """The API of another node, for all channels that are connected to it. Thread safe.

    Attributes:
        pid: of its process, which says that it lives.
        connections: as it lists them: of hundreds an answer takes a node in Python 20 ms.
    """

    def __init__(self, uri: str, caller: str) -> None:
        call = partial(call_api, uri, what="the node")
        self.pid: SharedAnswer[object] = SharedAnswer(partial(call, "getPid", caller))
        self.connections: SharedAnswer[object] = SharedAnswer(partial(call, "getBusInfo", caller))


class Peers:
    """The APIs of other nodes, as long as channels use them. Thread safe.

    Args:
        caller: name of the node that asks.
    """

    def __init__(self, caller: str) -> None:
        self._caller = caller
        # Guards the look and the entry: of two APIs of one node each would be asked.
        self._lock = threading.Lock()
        self._apis: WeakValueDictionary[str, PeerApi] = WeakValueDictionary()

    def at(self, uri: str) -> PeerApi:
        """Return the API at an address, the same one for all."""
        with self._lock:
            found = self._apis.get(uri)
            if found is None:
                found = self._apis[uri] = PeerApi(uri, self._caller)
            return found


@frozen
class GraphState:
    """Who publishes, subscribes and serves what, as the master knows it: nodes by name.

    Attributes:
        asked: when the master was asked, by the monotonic clock.
    """

    asked: float
    publishers: Mapping[str, tuple[str, ...]] = field(factory=dict)
    subscribers: Mapping[str, tuple[str, ...]] = field(factory=dict)
    services: Mapping[str, tuple[str, ...]] = field(factory=dict)


@frozen
class TopicTypes:
    """The types of topics, by topic.

    Attributes:
        asked: when the master was asked, by the monotonic clock.
    """

    asked: float
    by_topic: Mapping[str, str] = field(factory=dict)


class Master:
    """The master, as one node calls it. Each call is made once and raises BridgeError."""

    def __init__(self, uri: str, caller: str, own: str) -> None:
        self.uri = uri
        self._caller = caller
        self._own = own
        self._state, self._types = SharedAnswer(self._ask_state), SharedAnswer(self._ask_types)

    def call(self, method: str, *arguments: Any) -> Any:
        """Call a method.

        Raises:
            BridgeError: with host, port and what to set.
        """
        try:
            return call_api(self.uri, method, self._caller, *arguments, what="the ROS master")
        except BridgeError as error:
            if error.reason is not FailureReason.UNAVAILABLE:
                raise
            hint = "start it, or set the bridge's option `master` or ROS_MASTER_URI"
            raise BridgeError(f"{error}; {hint}", FailureReason.UNAVAILABLE) from error

    def identity(self) -> tuple[object, object]:
        """Return what another master has otherwise: its process, and the run that roscore names.

        In a container every process has the same number.
        """
        process, run = self.call("getPid"), None
        with suppress(BridgeError):  # one that was not begun by roscore names none
            run = self.call("getParam", "/run_id")
        return process, run

    def state(self, since: float | None = None) -> GraphState:
        """Return who publishes, subscribes and serves what.

        Args:
            since: time of the monotonic clock; what was asked for since then is not asked again.
                Of thousands of topics an answer takes a tenth of a second. None: it is asked now.
        """
        return self._state.get(since)

    def _ask_state(self) -> GraphState:
        asked, value = time.monotonic(), self.call("getSystemState")
        if not isinstance(value, list) or len(value) != _RESULT:
            raise self._wrong("getSystemState")
        try:
            return GraphState(
                asked,
                *(
                    {str(name): tuple(map(str, nodes)) for name, nodes in listing}
                    for listing in value
                ),
            )
        except (TypeError, ValueError):
            raise self._wrong("getSystemState") from None

    def types(self, since: float | None = None) -> TopicTypes:
        """Return the types of topics; a topic without one is left out. `since` as for `state`."""
        return self._types.get(since)

    def _ask_types(self) -> TopicTypes:
        asked, value = time.monotonic(), self.call("getTopicTypes")
        try:
            types = {str(topic): str(kind) for topic, kind in value if kind != "*"}
        except (TypeError, ValueError):
            raise self._wrong("getTopicTypes") from None
        return TopicTypes(asked, types)

    def node_uri(self, node: str) -> str:
        """Return the address of a node's API."""
        return str(self.call("lookupNode", node))

    def register_publisher(self, topic: str, kind: str) -> tuple[str, ...]:
        """Say that this node publishes a topic; returns the addresses of who subscribes to it."""
        return self._register("registerPublisher", topic, kind)

    def register_subscriber(self, topic: str, kind: str) -> tuple[str, ...]:
        """Say that this node subscribes to a topic; returns the addresses of who publishes it."""
        return self._register("registerSubscriber", topic, kind or "*")

    def _register(self, method: str, topic: str, kind: str) -> tuple[str, ...]:
        value = self.call(method, topic, kind, self._own)
        if not isinstance(value, list) or not all(isinstance(uri, str) for uri in value):
            raise self._wrong(method)
        return tuple(value)

    def unregister(self, kind: str, name: str) -> None:
        """Take a registration back; `kind` is Publisher or Subscriber."""
        self.call(f"unregister{kind}", name, self._own)

    def register_service(self, service: str, address: str) -> None:
        """Say that this node serves a service."""
        self.call("registerService", service, address, self._own)

    def unregister_service(self, service: str, address: str) -> None:
        """Say that it serves it no more."""
        self.call("unregisterService", service, address)

    def service_address(self, service: str) -> tuple[str, int]:
        """Return host and port of who serves a service."""
        uri = str(self.call("lookupService", service))
        host, port = _host_and_port(uri)
        if not port:
            text = f"the master has {uri[:200]!r} for service {service}, which is no address"
            raise BridgeError(text, FailureReason.BAD_MESSAGE)
        return host, port

    def watch_parameter(self, key: str) -> Any:
        """Have changes of a parameter reported to this node; returns its value, `{}`: none."""
        return self.call("subscribeParam", self._own, key)

    def _wrong(self, method: str) -> BridgeError:
        text = f"{method}: the ROS master at {self.uri} answered what it should not"
        return BridgeError(text, FailureReason.BAD_MESSAGE)
