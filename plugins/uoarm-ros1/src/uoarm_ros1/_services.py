"""Services: calls over connections that stay open, and functions that answer in ROS 1."""

from __future__ import annotations

import select
import socket
import threading
import time
from collections.abc import Callable, Mapping
from contextlib import AbstractContextManager, suppress

from uoarm.bridge import Channel, Handler, did_you_mean, foreign, text_of
from uoarm.errors import BridgeError, BridgeTimeoutError, FailureReason, MessageError
from uoarm.model import Budget, Endpoint, Health, Message
from uoarm_ros1._definitions import RosService
from uoarm_ros1._discovery import Graph
from uoarm_ros1._master import connect, failure_text
from uoarm_ros1._node import Node
from uoarm_ros1._publication import keep_alive
from uoarm_ros1._tcpros import (
    ProtocolError,
    ReplyReader,
    TcprosReader,
    decode_header,
    encode_header,
    service_header,
    service_problem,
)
from uoarm_ros1._types import LENGTH, framed_writer, reader

_CHUNK = 65_536
_PROBE_SECONDS = 2.0
_MAX_HEADER_OCTETS = 1 << 20
_MOST_IDLE = 8
_ANSWER_SECONDS = 10.0
_REQUEST_SECONDS = 10.0
_SHORTEST = 0.001
_MOST_UNFINISHED = 4
"""Requests of the greatest size that may be under way to one service, in octets."""


def probe_service(node: Node, service: str) -> tuple[str, str]:
    """Return type and md5sum of a service, as its server says them.

    Raises:
        BridgeError: no node serves it, or the server cannot be reached or does not say.
    """
    try:
        host, port = node.master.service_address(service)
    except BridgeError as error:
        if error.reason is not FailureReason.REFUSED:
            raise
        kind = node.master.types().by_topic.get(service)
        other = f"; there is a topic of that name, of type {kind}" if kind else ""
        other = other or did_you_mean(service, node.master.state().services)
        text = f"no node serves {service}: {error}{other}"
        raise BridgeError(text, FailureReason.NOT_FOUND) from error
    header = service_header(node.name, service, probe=True)
    connection, answer = _open(host, port, service, header, time.monotonic() + _PROBE_SECONDS)
    connection.close()
    return answer.get("type", ""), answer.get("md5sum", "")


def _open(
    host: str,
    port: int,
    service: str,
    header: Mapping[str, str],
    deadline: float,
    connecting: Callable[[socket.socket], object] = lambda _: None,
) -> tuple[socket.socket, dict[str, str]]:
    """Return a connection to a server, and what it answered; `connecting` as with `connect`.

    Raises:
        BridgeError: it cannot be reached, or refuses.
    """
    what = f"the server of {service}"
    connection = None
    try:
        connection = connect(host, port, deadline, connecting)
        connection.settimeout(max(_SHORTEST, deadline - time.monotonic()))
        connection.sendall(encode_header(header))
        # Exactly the header: what follows it are replies.
        octets = _receive_exactly(connection, LENGTH.size, deadline)
        (length,) = LENGTH.unpack(octets)
        answer = decode_header(_receive_exactly(connection, length, deadline))
        problem = f"it refuses: {answer['error'][:500]}" if "error" in answer else ""
    except (OSError, ProtocolError) as error:
        if connection is not None:
            connection.close()
        text = failure_text(what, host, port, error)
        raise BridgeError(text, FailureReason.UNAVAILABLE) from error
    if problem:
        connection.close()
        raise BridgeError(f"{what} at {host}:{port}: {problem}", FailureReason.UNAVAILABLE)
    keep_alive(connection)
    return connection, answer


def _receive_exactly(connection: socket.socket, count: int, deadline: float) -> bytes:
    if count > _MAX_HEADER_OCTETS:
        raise ProtocolError(f"a header of {count:,} octets")
    octets = bytearray()
    while len(octets) < count:
        connection.settimeout(max(_SHORTEST, deadline - time.monotonic()))
        part = connection.recv(min(_CHUNK, count - len(octets)))
        if not part:
            raise ProtocolError("it closed the connection")
        if time.monotonic() > deadline:
            raise TimeoutError
        octets += part
    return bytes(octets)


class _CallSocket:
    """The connection of one call, from before it is made until the call is over."""

    def __init__(self) -> None:
        # Between the call and who cancels it: afterwards the socket may be another call's.
        self._lock = threading.Lock()
        self._socket: socket.socket | None = None
        self._is_over = self.is_cancelled = False

    def use(self, made: socket.socket) -> None:
        """Have this one shut down when the call is cancelled.

        Raises:
            ConnectionAbortedError: it is.
        """
        with self._lock:
            self._socket = made
            if self.is_cancelled:
                raise ConnectionAbortedError

    def cancel(self) -> bool:
        """End the call, also while it connects; False, as the server cannot be notified."""
        with self._lock:
            if not self._is_over:
                self.is_cancelled = True
                if self._socket is not None:
                    with suppress(OSError):
                        self._socket.shutdown(socket.SHUT_RDWR)
        return False

    def end(self) -> None:
        """Leave the socket alone from now on."""
        with self._lock:
            self._is_over = True


class Caller:
    """A client of one service. Several calls at a time have a connection each."""

    def __init__(self, node: Node, service: str, kind: RosService) -> None:
        self._node, self._service, self._kind = node, service, kind
        budget = node.options.budget
        self._write, self._read = framed_writer(kind.request), reader(kind.reply, budget)
        self._most = budget.octets
        # Guards the connections that are idle, between threads that call.
        self._lock = threading.Lock()
        self._idle: list[socket.socket] = []
        self._is_closed = False

    def call(
        self,
        endpoint: Endpoint,
        message: Message,
        timeout: float,
        cancelling: Callable[[Callable[[], object]], AbstractContextManager[None]],
    ) -> Message:
        """Send a request and return the reply to it; a request is sent once.

        A call that is cancelled ends; what its server does goes on.

        Raises:
            BridgeError: no node serves it, the service failed, its server is gone, or the call was
                cancelled.
            BridgeTimeoutError: no reply within `timeout` seconds.
            MessageError: the request does not fit its type.
        """
        deadline = time.monotonic() + timeout
        request = self._write(message)
        own = _CallSocket()
        connection = None
        try:
            with cancelling(own.cancel):
                try:
                    connection = self._take()
                    if connection is not None:
                        own.use(connection)
                    else:
                        connection = self._connect(endpoint, deadline, own.use)
                    succeeded, reply = self._exchange(connection, request, deadline)
                finally:
                    own.end()
        except (OSError, ProtocolError, BridgeError) as error:
            if connection is not None:
                connection.close()
            if own.is_cancelled:
                raise BridgeError(f"{endpoint}: the call was cancelled") from None
            if isinstance(error, BridgeError):  # there is no connection
                raise
            if isinstance(error, TimeoutError):
                text = f"{endpoint}: no reply within {timeout:g} s"
                raise BridgeTimeoutError(text) from None
            text = f"{endpoint}: the server ended the connection before it replied: {error}"
            raise BridgeError(text, FailureReason.UNAVAILABLE) from error
        self._give_back(connection)
        if not succeeded:
            text = reply.decode("utf-8", "replace")[:1000]
            raise BridgeError(f"{endpoint}: the service failed: {text or 'it says not why'}")
        try:
            return self._read(reply)
        except MessageError as error:
            text = f"{endpoint}: the reply cannot be read: {error}"
            raise BridgeError(text, FailureReason.BAD_MESSAGE) from error

    def close(self) -> None:
        """Close the connections that are idle, and those in use as they are given back."""
        with self._lock:
            self._is_closed = True
            idle, self._idle = self._idle, []
        for connection in idle:
            connection.close()

    def _connect(
        self, endpoint: Endpoint, deadline: float, connecting: Callable[[socket.socket], object]
    ) -> socket.socket:
        host, port = self._node.master.service_address(self._service)
        header = service_header(self._node.name, self._service, self._kind.md5, persistent=True)
        try:
            connection, _ = _open(host, port, self._service, header, deadline, connecting)
        except BridgeError as error:
            raise BridgeError(f"{endpoint}: {error}", error.reason) from error
        return connection

    def _exchange(
        self, connection: socket.socket, request: bytes, deadline: float
    ) -> tuple[bool, bytes]:
        connection.settimeout(max(_SHORTEST, deadline - time.monotonic()))
        connection.sendall(request)
        replies = ReplyReader(self._most)
        while True:
            left = deadline - time.monotonic()
            if left <= 0:
                raise TimeoutError
            connection.settimeout(left)
            octets = connection.recv(_CHUNK)
            if not octets:
                raise ProtocolError("it closed the connection")
            if (reply := replies.received(octets)) is not None:
                return reply

    def _take(self) -> socket.socket | None:
        """Return a connection that is idle and whose server has not ended it."""
        while True:
            with self._lock:
                if not self._idle:
                    return None
                connection = self._idle.pop()
            poller = select.poll()
            poller.register(connection, select.POLLIN | select.POLLHUP | select.POLLERR)
            if not poller.poll(0):
                return connection
            connection.close()

    def _give_back(self, connection: socket.socket) -> None:
        with self._lock:
            if not self._is_closed and len(self._idle) < _MOST_IDLE:
                self._idle.append(connection)
                return
        connection.close()


class ServedService(Channel):
    """A function that answers in ROS 1: requests of one client one after the other.

    The master sends clients to the node that registered a service last. While that is another one,
    which lives, the channel is degraded.
    """

    def __init__(
        self,
        endpoint: Endpoint,
        node: Node,
        service: str,
        kind: RosService,
        handler: Handler,
        at_once: int,
        report: Callable[[Channel, Health, str], None],
    ) -> None:
        super().__init__(endpoint)
        self.name = service
        self._node, self._kind = node, kind
        self._handler, self._report = handler, report
        self._other = ""
        budget: Budget = node.options.budget
        self._read, self._write = reader(kind.request, budget), framed_writer(kind.reply)
        self._most = budget.octets
        self._turns = threading.BoundedSemaphore(at_once)
        self._most_clients = 8 * at_once
        # Guards the connections, between the loop, their threads and the close.
        self._lock = threading.Lock()
        # Octets that the request of each takes which is not whole.
        self._clients: dict[socket.socket, int] = {}
        self._answered = self._failed = self._refused = 0
        node.serve(service, self._arrived)

    def facts(self) -> Mapping[str, object]:
        """Return counters of requests."""
        return {
            "answered": self._answered,
            "failed": self._failed,
            "refused": self._refused,
            "clients": len(self._clients),
        }

    def look(self, graph: Graph) -> None:
        """Compare which nodes the master has for the service; in the thread that watches it.

        Raises:
            BridgeError: the master does not say.

        Where it has none, or one that does not live, the service is registered here again.
        """
        other = ""
        nodes = graph.state.services.get(self.name, ())
        if self._node.name not in nodes:
            if graph.living(nodes):
                other = ", ".join(nodes)
            else:
                with suppress(BridgeError):  # the next look tries again
                    self._node.register_service(self.name)
        if other == self._other:
            return
        self._other = other
        if other:
            text = f"clients of {self.name} are sent to node {other}, which registered it later"
            self._report(self, Health.DEGRADED, text)
        else:
            self._report(self, Health.OK, f"clients of {self.name} are sent here again")

    def _arrived(self, connection: socket.socket, header: dict[str, str]) -> None:
        """Take a client; in the loop's thread."""
        kind = self._kind
        problem = service_problem(header, self.name, kind.name, kind.md5)
        with self._lock:
            is_full = self.closed or len(self._clients) >= self._most_clients
            if not problem and not is_full and header.get("probe") != "1":
                self._clients[connection] = 0
        if is_full:
            problem = problem or f"{self.name} has {self._most_clients} clients already"
        if problem:
            self._refused += 1
            answer = {"error": problem, "callerid": self._node.name}
        else:
            answer = {
                "callerid": self._node.name,
                "md5sum": kind.md5,
                "request_type": kind.request.name,
                "response_type": kind.reply.name,
                "type": kind.name,
            }
        with suppress(OSError):
            connection.send(encode_header(answer))
        if problem or header.get("probe") == "1":
            connection.close()
            return
        keep_alive(connection)
        thread = threading.Thread(
            target=self._answer_client,
            args=(connection, header.get("persistent") == "1"),
            name=f"uoarm-ros1-{self.name}",
            daemon=True,
        )
        try:
            thread.start()
        except RuntimeError:  # the system gives no more
            with self._lock:
                self._clients.pop(connection)
            self._refused += 1
            connection.close()

    def _answer_client(self, connection: socket.socket, is_persistent: bool) -> None:  # noqa: FBT001 - of a thread
        requests = TcprosReader(self._most)
        until = time.monotonic() + _REQUEST_SECONDS
        try:
            while not self.closed:
                left: float | None = max(_SHORTEST, until - time.monotonic())
                if is_persistent:
                    left = None if requests.is_between_frames else _REQUEST_SECONDS
                connection.settimeout(left)
                count = connection.recv_into(requests.buffer())
                if not count:
                    return
                for frame in requests.received(count):
                    connection.settimeout(_ANSWER_SECONDS)  # a client that reads nothing
                    connection.sendall(self._reply(frame))
                    if not is_persistent:
                        return
                self._hold(connection, requests.held)
        except (OSError, ProtocolError):
            return
        finally:
            with self._lock:
                self._clients.pop(connection, None)
            connection.close()

    def _hold(self, connection: socket.socket, octets: int) -> None:
        """Take note of a request that is not whole; of too many, the largest is given up."""
        if octets == self._clients[connection]:
            return
        with self._lock:
            self._clients[connection] = octets
            if sum(self._clients.values()) <= _MOST_UNFINISHED * self._most:
                return
            largest = max(self._clients, key=self._clients.__getitem__)
            self._clients[largest] = 0
        with suppress(OSError):
            largest.shutdown(socket.SHUT_RDWR)

    def _reply(self, frame: bytes | bytearray) -> bytes:
        try:
            with self._turns:
                reply = self._handler(self._read(frame))
            octets = foreign(self._write, reply)
        except Exception as error:  # noqa: BLE001 - of the handler: the caller gets it
            self._failed += 1
            text = text_of(error).encode("utf-8", "replace")
            return b"\0" + LENGTH.pack(len(text)) + text
        self._answered += 1
        return b"\1" + octets

    def _close(self) -> None:
        self._node.unserve(self.name)
        with self._lock:
            clients = list(self._clients)
        for connection in clients:
            with suppress(OSError):
                connection.shutdown(socket.SHUT_RDWR)
