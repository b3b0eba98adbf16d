"""Services both ways: calling a server of ROS, and being one.

DDS matches the ends of a service by the names of their types alone. A server whose type has the
same name and another definition misreads requests; one of another type is not matched, and ROS 2
does not say so: `ServerComparison` compares them.
"""

from __future__ import annotations

import threading
import time
from abc import abstractmethod
from collections.abc import Callable, Iterable, Mapping
from functools import partial
from typing import Any, Generic, TypeVar

from attrs import define, field, frozen

from uoarm.bridge import Channel, Handler, Log, ServedRequests, text_of
from uoarm.errors import BridgeError, BridgeTimeoutError, FailureReason
from uoarm.model import Endpoint, Health, Message
from uoarm_ros2._conversion import reader, writer
from uoarm_ros2._discovery import Ros2Graph, ServerPresence
from uoarm_ros2._health import Report
from uoarm_ros2._middleware import UNNAMED, NodeRunner, Peer
from uoarm_ros2._types import RecordType, ScalarType, StringType, import_type, service_records

_LOOK_SECONDS = 1.0
_LEASE_SECONDS = 30.0
_SEVERAL = 2
T = TypeVar("T")


@frozen
class Disagreement:
    """What differs, as a text, empty where nothing does; and whether no server agrees."""

    text: str = ""
    is_total: bool = False


class ServerComparison:
    """Compares the servers of some services, those of one action, with a client of ours.

    Args:
        what: the client is of, for the text.
        services: the full names.
    """

    def __init__(self, runner: NodeRunner, what: str, services: Iterable[str]) -> None:
        self._runner = runner
        self._what = what
        self._services = tuple(services)
        self._due = 0.0
        self._seen = Disagreement()

    def look(self) -> Disagreement:
        """Look at the graph, once a second at most.

        Raises:
            BridgeError: the node has ended.
        """
        now = time.monotonic()
        if now >= self._due:
            seen = self._compare()
            if UNNAMED not in seen.text:  # its node reaches the graph a moment later
                self._due, self._seen = now + _LOOK_SECONDS, seen
        return self._seen

    def _compare(self) -> Disagreement:
        reports: dict[str, str] = {}
        agreeing: set[str] = set()
        for service in self._services:
            servers, clients = self._runner.service_ends(service)
            own = {
                client.type: client for client in clients if client.node == self._runner.full_name
            }
            for server in servers if own else ():
                otherwise = _otherwise(server, own.get(server.type))
                if otherwise:
                    reports.setdefault(server.node, f"{server.node} {otherwise}")
                else:
                    agreeing.add(server.node)
        if not reports:
            return Disagreement()
        text = f"{self._what} is not the same everywhere: {'; '.join(reports.values())}"
        return Disagreement(text, is_total=agreeing <= reports.keys())


def _otherwise(server: Peer, own: Peer | None) -> str:
    name = server.type.replace("::dds_::", "::").removesuffix("_").replace("::", "/")
    if own is None:
        return f"has {name}"
    if "" in {server.definition, own.definition} or server.definition == own.definition:
        return ""
    return f"has {name} as {server.definition}, this process has {own.definition}"


_FIRST_GLANCE_SECONDS = 0.005
_GLANCE_SECONDS = 0.25
_log = Log("uoarm.ros2")


def answered(future: Any, deadline: float, there: Callable[[], bool], what: str) -> Any:
    """Wait for a future's result while its server is there.

    Raises:
        BridgeTimeoutError: the deadline passed.
        BridgeError: the server went away before it answered.
    """
    done = threading.Event()
    future.add_done_callback(lambda _: done.set())
    glance = _FIRST_GLANCE_SECONDS  # what is answered at once costs no look at the graph
    while not done.wait(max(0.0, min(glance, deadline - time.monotonic()))):
        if time.monotonic() >= deadline:
            raise BridgeTimeoutError(f"{what} did not answer in time")
        if not there():
            raise BridgeError(f"{what} went away in mid-call", FailureReason.UNAVAILABLE)
        glance = _GLANCE_SECONDS
    return future.result()


def require_agreement(comparison: ServerComparison) -> None:
    """Raise BridgeError where no server has our definition."""
    found = comparison.look()
    if found.is_total:
        raise BridgeError(found.text, FailureReason.UNAVAILABLE)


def _with_disagreement(
    error: BridgeTimeoutError, comparison: ServerComparison
) -> BridgeTimeoutError:
    """Add the servers with another definition, of which one may have been called."""
    found = comparison.look().text
    return BridgeTimeoutError(f"{error}; {found}") if found else error


class ServiceClient:
    """A client of one service, shared by all calls to it; calls may overlap.

    Attributes:
        comparison: whether its servers have our type.
    """

    def __init__(self, runner: NodeRunner, graph: Ros2Graph, name: str, type_name: str) -> None:
        native = import_type(type_name)
        request, reply = service_records(native, type_name)
        self._what = f"service {name}"
        self._name = name
        self._is_matched = False
        self._graph = graph
        self._write = writer(request)
        self._read = reader(reply)
        self._client = runner.client(native, name)
        self._runner = runner
        self.comparison = ServerComparison(runner, self._what, [name])

    def close(self) -> None:
        """Destroy the client, which has no call under way."""
        self._runner.discard(self._client)

    def ready(self) -> bool:
        """Whether a server is matched."""
        return bool(self._client.service_is_ready())

    def call(self, message: Message, timeout: float, wait: float) -> Message:
        """Send a request and return the reply.

        Raises:
            MessageError: the request does not fit its native type.
            BridgeTimeoutError: no reply within `timeout` seconds.
            BridgeError: no server within `wait` seconds, or none that has our definition of the
                type, or it went away in mid-call, or the bridge was closed.
        """
        deadline = time.monotonic() + timeout
        request = self._write(message)
        with self._runner.calling(self._what):
            if not (self._is_matched and self.ready()):
                self._await_server(timeout, wait)
            require_agreement(self.comparison)
            first = ServerPresence()
            future = self._client.call_async(request)

            def there() -> bool:
                return self.ready() and first.holds(self._graph.servers(self._name))

            try:
                return self._read(answered(future, deadline, there, self._what))
            except BridgeTimeoutError as error:
                raise _with_disagreement(error, self.comparison) from None
            finally:
                self._client.remove_pending_request(future)

    def _await_server(self, timeout: float, wait: float) -> None:
        """Wait for a server, and until it has met us too."""
        if not self._graph.until(self.ready, min(wait, timeout)):
            raise BridgeError(f"{self._what} has no server", FailureReason.UNAVAILABLE)
        self._graph.await_match(self._name, timeout / 2)
        self._is_matched = True


@define(eq=False)
class OtherServers:
    """Looks whether others serve a name that we serve: a client takes the reply that comes first.

    What was killed stays on the graph for its lease, twenty seconds with Fast DDS, beside what was
    started in its place. So only servers that are there for longer count.

    Args:
        name: the full name that is served, for the cause.
        service: the full name of the service to look at: of an action, one of those behind it.
    """

    _runner: NodeRunner
    _own: Callable[[], frozenset[str]]
    _name: str
    _service: str
    _report: Callable[[Health, str], None]
    _clock: Callable[[], float] = time.monotonic
    _since: float | None = field(default=None, init=False)
    _is_reported: bool = field(default=False, init=False)

    def tick(self) -> None:
        """Look at the graph, a few times a second."""
        now = self._clock()
        if self._runner.server_count(self._service) < _SEVERAL:
            self._since = None
            if self._is_reported:
                self._is_reported = False
                self._report(Health.OK, f"{self._name} has no other server any more")
            return
        self._since = now if self._since is None else self._since
        if not self._is_reported and now - self._since >= _LEASE_SECONDS:
            self._is_reported = True
            found = {peer.node for peer in self._runner.servers(self._service)} - self._own()
            named = sorted(node for node in found if UNNAMED not in node)
            nodes = ", ".join(named) or "another node"
            text = f"{self._name} is served by {nodes}, too: clients take the reply that is first"
            self._report(Health.DEGRADED, text)


def fitting(text: str, kind: StringType) -> str:
    """Return as much as a string holds of a text that can be encoded, without NUL."""
    encoding, unit = ("utf-16-le", 2) if kind.wide else ("utf-8", 1)
    octets = text.replace("\0", "").encode(encoding)
    most = None if kind.bound is None else kind.bound * unit
    return octets[:most].decode(encoding, "ignore")


def _reason_of(reply: RecordType) -> StringType | None:
    """Return the text in which a reply says why there is none; None: it has no such.

    rclpy looks at no value: of one that is not of its field's type the code below ends the process.
    """
    shapes = {field.name: field.shape for field in reply.fields}
    text = shapes.get("message")
    can_refuse = shapes.get("success") == ScalarType("bool")
    return text if can_refuse and isinstance(text, StringType) else None


class ServedFunction(Channel, Generic[T]):
    """A function that is offered to ROS: requests are handled a few at a time.

    Must implement: `_serve`, `_answer`, `_refuse`, `_close`.

    Args:
        handler: called by `at_once` threads at most.
    """

    def __init__(
        self,
        runner: NodeRunner,
        endpoint: Endpoint,
        name: str,
        type_name: str,
        handler: Handler,
        at_once: int,
        report: Report,
    ) -> None:
        super().__init__(endpoint)
        self._runner, self._name, self._handler = runner, name, handler
        self.requests: ServedRequests[T] = ServedRequests(
            f"serving {name}", self._answer, self._refuse, at_once, partial(report, self)
        )
        self._serve(type_name)

    def facts(self) -> Mapping[str, object]:
        """Return counters of requests."""
        return self.requests.facts()

    @abstractmethod
    def _serve(self, type_name: str) -> None:
        """Put requests from now on."""

    @abstractmethod
    def _answer(self, request: T) -> None:
        """Handle a request."""

    @abstractmethod
    def _refuse(self, request: T, error: Exception) -> None:
        """Refuse one that failed, or for which there is no room."""


class ServiceServer(ServedFunction[tuple[Any, Message]]):
    """A service offered to ROS.

    When the handler fails, a reply type with a boolean `success` and a text `message` says so; any
    other client is left without a reply, since ROS 2 has no other way to refuse, and the channel is
    degraded. The same happens to requests for which there is no room.
    """

    def _serve(self, type_name: str) -> None:
        native: Any = import_type(type_name)
        request, reply = service_records(native, type_name)
        read, put = reader(request), self.requests.put
        self._native = native
        self._write = writer(reply)
        self._reason = _reason_of(reply)
        self._service = self._runner.server(
            native, self._name, lambda asked, answer: put((answer, read(asked)))
        )

    def _close(self) -> None:
        self.requests.close()
        self._runner.discard(self._service)

    def _answer(self, request: tuple[Any, Message]) -> None:
        answer, message = request
        self._send(answer, self._write(self._handler(message)))

    def _refuse(self, request: tuple[Any, Message], error: Exception) -> None:
        if self._reason is not None:
            message = fitting(
                text_of(error).removeprefix(f"{type(error).__name__}: "), self._reason
            )
            self._send(request[0], self._native.Response(success=False, message=message))

    def _send(self, answer: Callable[[Any], None], native: Any) -> None:
        """Send a reply; a client that is gone, or a channel that was closed, gets none."""
        try:
            answer(native)
        except Exception as error:  # noqa: BLE001 - rclpy's, of several kinds
            if not self._closed:
                _log.warning("a reply of %s could not be sent: %s", self._name, error)
