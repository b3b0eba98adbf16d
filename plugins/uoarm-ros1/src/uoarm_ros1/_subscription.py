"""A topic that the node subscribes to: a connection, and a thread, for each of its publishers."""

from __future__ import annotations

import re
import socket
import struct
import threading
import time
from collections.abc import Callable
from contextlib import suppress
from typing import Any

from attrs import define, field, frozen

from uoarm.bridge import Backoff, on_failure, text_of
from uoarm.errors import BridgeError
from uoarm_ros1._master import Peers, call_api, connect, failure_text
from uoarm_ros1._publication import keep_alive
from uoarm_ros1._tcpros import (
    ProtocolError,
    TcprosReader,
    decode_header,
    encode_header,
    publisher_problem,
    subscriber_header,
)

_CONNECT_SECONDS = 5.0
_LISTED_SECONDS = 1.0
_LISTED_LOOK_SECONDS = 0.002
_ALIVE_SHARE = 0.5
_BACKOFF = Backoff(first=0.1, most=2.0)
_MAX_HEADER_OCTETS = 1 << 20
_ASKED_IN_VAIN = 2
_MOST_PUBLISHERS = 256


@frozen
class SubscriptionOptions:
    """What a subscription takes.

    Attributes:
        caller: the node's own name.
        topic: its full name.
        kind: type of messages; empty: any.
        md5: of the type; empty: any.
        node: the publisher that is meant; empty: all.
        most: octets that a message may have.
        silence: seconds without a message until a publisher is asked whether it is alive.
        nodelay: whether the publisher is to send small messages at once.
        in_runs: whether messages that come together are taken as one run, to be sent on.
    """

    caller: str
    topic: str
    kind: str = ""
    md5: str = ""
    node: str = ""
    most: int = 16_777_216
    silence: float = 5.0
    nodelay: bool = True
    in_runs: bool = False


@frozen
class PublisherHeader:
    """What a publisher says of itself."""

    node: str
    kind: str
    md5: str
    definition: str
    latching: bool

    @staticmethod
    def of(header: dict[str, str]) -> PublisherHeader:
        """Read the fields of a header."""
        return PublisherHeader(
            header.get("callerid", ""),
            header.get("type", ""),
            header.get("md5sum", ""),
            header.get("message_definition", ""),
            header.get("latching") == "1",
        )


def read_publisher_header(
    uri: str, wanted: SubscriptionOptions, deadline: float
) -> PublisherHeader:
    """Ask a publisher what it publishes, and take nothing of it.

    Raises:
        BridgeError: it cannot be reached, or refuses.
        OSError, ProtocolError: its port cannot be reached, or does not keep to the protocol.
    """
    connection, header, _ = _subscribe(uri, wanted, deadline)
    connection.close()
    return PublisherHeader.of(header)


def _subscribe(
    uri: str, wanted: SubscriptionOptions, deadline: float
) -> tuple[socket.socket, dict[str, str], TcprosReader]:
    """Return a connection behind whose headers messages follow."""
    answer = call_api(uri, "requestTopic", wanted.caller, wanted.topic, [["TCPROS"]])
    match answer:
        case ["TCPROS", str() as host, int() as port] if 0 < port < 1 << 16:
            pass
        case _:
            raise ProtocolError(f"the node at {uri} offers no TCPROS for {wanted.topic}")
    what = f"topic {wanted.topic}"
    try:
        connection = connect(host, port, deadline)
    except OSError as error:
        raise ConnectionError(failure_text(what, host, port, error)) from error
    with on_failure(connection.close):
        try:
            header = subscriber_header(wanted.caller, wanted.topic, nodelay=wanted.nodelay)
            connection.sendall(encode_header(header))
            answered, reader = _receive_header(connection, wanted, deadline)
        except OSError as error:
            raise ConnectionError(failure_text(what, host, port, error)) from error
    keep_alive(connection)
    return connection, answered, reader


def _receive_header(
    connection: socket.socket, wanted: SubscriptionOptions, deadline: float
) -> tuple[dict[str, str], TcprosReader]:
    """Return what a publisher answers, and what takes the messages behind it apart."""
    reader = TcprosReader(max(_MAX_HEADER_OCTETS, wanted.most))
    frames: list[bytes | bytearray] = []
    while not frames:
        left = deadline - time.monotonic()
        if left <= 0:
            raise TimeoutError
        connection.settimeout(left)
        count = connection.recv_into(reader.buffer())
        if not count:
            raise ProtocolError(f"topic {wanted.topic}: the publisher ended it unanswered")
        frames = reader.received(count)
    answered = decode_header(frames[0])
    if problem := publisher_problem(answered, wanted.topic, wanted.kind, wanted.md5):
        raise ProtocolError(problem)
    reader.most, reader.in_runs = wanted.most, wanted.in_runs
    reader.ready = frames[1:]
    if wanted.in_runs:
        reader.ready = [struct.pack("<I", len(frame)) + frame for frame in reader.ready]
    return answered, reader


def text_of_connection(host: str, port: int) -> re.Pattern[str]:
    """Return what is found in a listing's text of a connection to an address of ours.

    No bracket is passed over, so that a text of many costs no more than it is long.
    """
    return re.compile(rf"to \[(?:{re.escape(host)}|[^\[\]]*):{port}\b")


class _Publisher:
    """One publisher of the topic, and the thread that reads from it."""

    def __init__(self, uri: str, owner: TopicSubscription) -> None:
        self.uri = uri
        self._api = owner.peers.at(uri)
        self.header: PublisherHeader | None = None
        self.failure = ""  # why it was not reached last time; empty: it was, or is not tried yet
        self.is_listed = True
        self._owner = owner
        self._closed = threading.Event()
        self._poked = threading.Event()
        self._socket: socket.socket | None = None
        name = f"uoarm-ros1-{owner.wanted.topic}"
        self._thread = threading.Thread(target=self._run, name=name, daemon=True)

    @property
    def is_settled(self) -> bool:
        """Whether it is connected, or could not be."""
        return self.header is not None or bool(self.failure)

    def start(self) -> None:
        """Begin to connect."""
        self._thread.start()

    def mark(self, *, is_listed: bool) -> None:
        """Take note whether the master names it; what is not connected tries again now, or ends."""
        self.is_listed = is_listed
        self._poked.set()

    def close(self) -> None:
        """End it; does not wait for its thread, which may be in a delivery."""
        self._closed.set()
        self._poked.set()
        connection = self._socket
        if connection is not None:
            with suppress(OSError):
                connection.shutdown(socket.SHUT_RDWR)

    def _run(self) -> None:
        failed = 0  # times in a row that it could not be connected
        while not self._closed.is_set():
            is_refusal = False
            try:
                cause = self._connect_and_read()
            except ProtocolError as error:
                cause, is_refusal = str(error), True
            except (OSError, BridgeError) as error:
                cause = str(error)
            except Exception as error:  # noqa: BLE001 - of what takes messages: it is reported
                cause = text_of(error)
            header, self.failure, self.header = self.header, cause, None
            if self._closed.is_set():
                break
            name = self.uri if header is None else header.node
            # A node that was killed stays listed, and is tried for ever: it is said once.
            if header is not None or not failed:
                self._owner.ended(
                    name, cause, was_connected=header is not None, is_refusal=is_refusal
                )
            failed = failed + 1 if header is None else 0
            if self.is_listed:
                self._poked.wait(_BACKOFF.pause(failed + 1))
                self._poked.clear()
            if not self.is_listed:
                break
        self._owner.left(self)

    def _connect_and_read(self) -> str:
        wanted = self._owner.wanted
        connection, fields, reader = _subscribe(
            self.uri, wanted, time.monotonic() + _CONNECT_SECONDS
        )
        with connection:
            self._socket = connection
            if self._closed.is_set():
                return ""
            header = PublisherHeader.of(fields)
            if wanted.node and header.node != wanted.node:
                self.is_listed = False
                return ""
            self._await_listing(connection)
            self.header, self.failure = header, ""
            self._owner.came(self.uri, header)
            return self._read(connection, reader)

    def _await_listing(self, connection: socket.socket) -> None:
        """Wait until the publisher has added us: it answers first, and loses what comes between."""
        host, port = connection.getsockname()[:2]
        ends = text_of_connection(host, port)
        deadline = time.monotonic() + _LISTED_SECONDS
        pause = threading.Event()
        while time.monotonic() < deadline and not self._closed.is_set():
            # Before the first question, too: mostly it takes the publisher less than that.
            pause.wait(_LISTED_LOOK_SECONDS)
            try:
                listing: Any = self._api.connections.get()
            except BridgeError:
                return  # a node that does not say
            if not isinstance(listing, list):
                return
            if any(self._is_this(entry, ends) for entry in listing):
                return

    def _is_this(self, entry: object, ends: re.Pattern[str]) -> bool:
        """Whether an entry of a listing stands for a connection, as far as it says which."""
        match entry:
            case [_, _, "o", _, topic, *more] if topic == self._owner.wanted.topic:
                return len(more) < len(("connected", "text")) or bool(ends.search(str(more[1])))
        return False

    def _read(self, connection: socket.socket, reader: TcprosReader) -> str:
        """Take messages until the connection ends; returns why it did."""
        take, wanted = self._owner.take, self._owner.wanted
        writer = "" if self.header is None else self.header.node
        for frame in reader.ready:
            take(frame, writer)
        # The system's own time limit: Python's would ask it twice for each message.
        connection.settimeout(None)
        whole, part = divmod(wanted.silence, 1)
        silence = struct.pack("ll", int(whole), int(part * 1_000_000))
        connection.setsockopt(socket.SOL_SOCKET, socket.SO_RCVTIMEO, silence)
        receive, buffer, received = connection.recv_into, reader.buffer, reader.received
        asked = 0
        while True:
            try:
                count = receive(buffer())
            except BlockingIOError:
                asked += 1
                if cause := self._ask():
                    if asked >= _ASKED_IN_VAIN:
                        return cause
                else:
                    asked = 0
                continue
            except OSError as error:
                return f"the connection broke: {error.strerror or error}"
            if not count:
                return "it closed the connection"
            asked = 0
            for frame in received(count):
                take(frame, writer)

    def _ask(self) -> str:
        """Return why a publisher that is silent is taken for dead, nothing where it answers."""
        # A node of hundreds of silent topics is not asked for each. An answer that this one had
        # before is older than this.
        since = time.monotonic() - _ALIVE_SHARE * self._owner.wanted.silence
        try:
            self._api.pid.get(since)
        except BridgeError as error:
            return str(error)
        return ""


@define(eq=False)
class TopicSubscription:
    """One topic, kept connected to the publishers that the master names.

    Args:
        take: takes the octets of messages and the name of their node, in the thread of each
            publisher.
        came: is called when a publisher is connected, with its header.
        went: is called when one that was connected is not any more, or one cannot be connected,
            with its name or address, the cause, whether it had been connected, and whether it is
            there and cannot be understood.
        settled: is called with the address of a publisher that is connected, or listed no more.
    """

    wanted: SubscriptionOptions
    peers: Peers
    take: Callable[[bytes | bytearray, str], object]
    _came: Callable[[PublisherHeader], object]
    _went: Callable[[str, str, bool, bool], object]
    _settled: Callable[[str], object] = lambda _: None
    # Guards the table of publishers, between the loop, in which the master's word comes, and
    # their threads.
    _changed: threading.Condition = field(factory=threading.Condition, init=False)
    _publishers: dict[str, _Publisher] = field(factory=dict, init=False)
    _closed: bool = field(default=False, init=False)

    @property
    def connected(self) -> list[PublisherHeader]:
        """What the publishers that are connected say of themselves."""
        return [
            publisher.header
            for publisher in tuple(self._publishers.values())
            if publisher.header is not None
        ]

    @property
    def failures(self) -> list[str]:
        """Why publishers that are listed are not connected."""
        return [
            publisher.failure for publisher in tuple(self._publishers.values()) if publisher.failure
        ]

    @property
    def listed(self) -> list[str]:
        """The addresses of the publishers that the master named last."""
        return [
            publisher.uri for publisher in tuple(self._publishers.values()) if publisher.is_listed
        ]

    def update(self, uris: tuple[str, ...]) -> str:
        """Take note of who publishes the topic now; returns at once.

        Returns:
            Why one cannot be connected to, as there is no thread for it: the next update tries
            again. Nothing where each has a thread.
        """
        failure = ""
        with self._changed:
            if self._closed:
                return failure
            for uri, publisher in self._publishers.items():
                # What it sent before it left still comes: its connection is its own to close.
                publisher.mark(is_listed=uri in uris)
            fresh = [uri for uri in dict.fromkeys(uris) if uri not in self._publishers]
            room = max(0, _MOST_PUBLISHERS - len(self._publishers))
            started = [_Publisher(uri, self) for uri in fresh[:room]]
            self._publishers |= {publisher.uri: publisher for publisher in started}
            self._changed.notify_all()
        for publisher in started:
            try:
                publisher.start()
            except RuntimeError as error:
                failure = f"topic {self.wanted.topic}: {publisher.uri} is not connected: {error}"
                with self._changed:
                    self._publishers.pop(publisher.uri, None)
                self.ended(publisher.uri, failure, was_connected=False)
        if left_out := fresh[room:]:
            text = f"topic {self.wanted.topic} has more than {_MOST_PUBLISHERS} publishers"
            self.ended(left_out[0], text, was_connected=False)
        return failure

    def wait(self, is_ready: Callable[[], bool], seconds: float) -> bool:
        """Wait until something holds of the publishers."""
        with self._changed:
            return self._changed.wait_for(is_ready, seconds)

    def is_settled(self) -> bool:
        """Whether each publisher that is listed is connected, or could not be."""
        return all(publisher.is_settled for publisher in self._publishers.values())

    def close(self) -> None:
        """Close every connection; waits for no thread."""
        with self._changed:
            self._closed = True
            publishers = list(self._publishers.values())
            self._publishers.clear()
        for publisher in publishers:
            publisher.close()

    def came(self, uri: str, header: PublisherHeader) -> None:
        """Take note of a connection; for its thread."""
        self._came(header)
        self._settled(uri)
        with self._changed:
            self._changed.notify_all()

    def ended(
        self, name: str, cause: str, *, was_connected: bool, is_refusal: bool = False
    ) -> None:
        """Take note that a publisher is not connected, and why; for its thread."""
        with self._changed:
            self._changed.notify_all()
            if self._closed:
                return
        if cause:
            self._went(name, cause, was_connected, is_refusal)

    def left(self, publisher: _Publisher) -> None:
        """Forget a publisher that is listed no more; for its thread, as it ends."""
        with self._changed:
            if self._publishers.get(publisher.uri) is publisher:
                del self._publishers[publisher.uri]
            again = publisher.is_listed and not self._closed
            self._changed.notify_all()
        self._settled(publisher.uri)
        if again:  # listed again while its thread was ending
            self.update((*self.listed, publisher.uri))
