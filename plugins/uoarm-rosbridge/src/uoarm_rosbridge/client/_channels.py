"""Sources and sinks on topics and parameters."""

from __future__ import annotations

import json
import threading
import time
from collections.abc import Callable, Mapping
from functools import partial
from typing import Any

import numpy as np

from uoarm import cdr
from uoarm.bridge import (
    Channel,
    ChannelHealth,
    ChannelMonitor,
    Delivery,
    ReceiveQueue,
    Sink,
    Source,
    foreign,
    on_failure,
    text_of,
)
from uoarm.errors import BridgeError, FailureReason, MessageError
from uoarm.model import Budget, Endpoint, Health, Message, array_as_lists, plain_copy
from uoarm_rosbridge._wire import write_publish
from uoarm_rosbridge.client._connection import Fields, ServerConnection, json_text
from uoarm_rosbridge.client._options import Port
from uoarm_rosbridge.client._types import RosType, compression_for, reader, structure_of, writer

Report = Callable[[Channel, Health, str], None]


def monitored(channel: Channel, topic: str, port: Port, report: Report) -> ChannelMonitor:
    """Return the health of a channel on a topic, which has a peer as it is opened."""
    now, without_peers = time.monotonic(), Health.LOST if port.peer_required else Health.OK
    health = ChannelHealth(topic, now, stale_after=port.stale_after, without_peers=without_peers)
    health.connected(now)
    return ChannelMonitor(health, partial(report, channel))


class TopicSource(Source):
    """What comes on a topic, delivered in a thread of its own: no consumer holds up another.

    What its consumer does not take waits; the oldest that waits is dropped where too many do.
    """

    def __init__(
        self,
        endpoint: Endpoint,
        connection: ServerConnection,
        topic: str,
        made: RosType,
        port: Port,
        deliver: Delivery,
        report: Report,
    ) -> None:
        super().__init__(endpoint)
        self.latched = port.latch
        self._connection, self.topic, self._deliver = connection, topic, deliver
        self.made = made
        self._received = 0
        self._breaks = self._seen_breaks = connection.breaks
        self._newest: Any = None
        # Guards what is put into the queue from the thread that opens it, beside the connection's.
        self._taking = threading.Lock()
        self.health = monitored(self, topic, port, report)
        self._identity = connection.new_id("subscribe")
        self._is_readable = threading.Event()  # set once it is known how messages come
        self._queue: ReceiveQueue[Any] = ReceiveQueue(
            f"uoarm-rosbridge-{topic}", self._hand_over, port.queue
        )
        connection.on_status(self._identity, lambda text: self.health.refused(text, final=True))
        options = connection.options
        fields: Fields = {
            "op": "subscribe", "id": self._identity, "topic": topic, "type": made.name,
            "throttle_rate": port.throttle, "queue_length": 0,
            "compression": compression_for(made, port.compression or options.compression),
        }  # fmt: skip
        with on_failure(self._close):
            # Where another source has the topic already, messages come as that has asked for.
            subscription = connection.subscribe(fields, self._take)
            with self._taking:  # the server sends what stands to the first of them alone
                if self.latched and not self._received:
                    self._put(subscription.newest)
            is_raw = subscription.fields["compression"] == "cbor-raw"
            self._read = raw_reader(made, options.budget) if is_raw else reader(made)
            self._is_readable.set()
            connection.settle()

    def facts(self) -> Mapping[str, object]:
        """Return counters."""
        return {
            "received": self._received,
            "under_way": len(self._queue),
            "lost_on_link": self._queue.dropped,
            "interruptions": self._connection.breaks - self._breaks,
            **self.health.facts(),
        }

    def _take(self, message: Any) -> None:
        """Take a message, in the thread of the connection."""
        if self.closed:
            return
        self.health.passed()
        with self._taking:
            self._put(message)

    def _put(self, message: Any) -> None:
        if self.latched:
            before, self._newest = self._newest, message
            is_first = self._seen_breaks != self._connection.breaks
            self._seen_breaks = self._connection.breaks
            if message is before or (is_first and is_same(before, message)):
                return  # what stands is sent again with each subscription
        self._received += 1
        self._queue.put(message)

    def _hand_over(self, came: Any) -> None:
        self._is_readable.wait()
        if self.closed:
            return
        try:
            message = self._read(came)
        except MessageError as error:
            self._deliver.unreadable(f"{self.topic}: {error}")
        else:
            self._deliver(message)

    def _close(self) -> None:
        self.health.close()
        self._queue.close()
        self._is_readable.set()
        connection = self._connection
        connection.forget_status(self._identity)
        connection.unsubscribe(self.topic, self._take)


class TopicSink(Sink):
    """Publishes on a topic. Whether a subscriber gets it, the server does not say."""

    parallel = True

    def __init__(
        self,
        endpoint: Endpoint,
        connection: ServerConnection,
        topic: str,
        made: RosType,
        port: Port,
        report: Report,
    ) -> None:
        super().__init__(endpoint)
        self._connection, self.topic = connection, topic
        self._write, self.made = writer(made), made
        self._sent = self._refused = 0
        # How many were sent, and how often the connection broke, when the server last refused one.
        self._refused_at: tuple[int, int] | None = None
        self._why = ""
        self._is_open = False
        self.health = monitored(self, topic, port, report)
        self._identity = connection.new_id("advertise")
        connection.on_status(self._identity, self._status)
        with on_failure(self._close):
            connection.stand(
                {
                    "op": "advertise",
                    "id": self._identity,
                    "topic": topic,
                    "type": made.name,
                    "latch": port.latch,
                    "queue_size": port.queue,
                }
            )
            connection.settle()
        if self._refused:
            text = f"{endpoint}: the server refuses to have {topic} advertised: {self._why}"
            self._close()
            raise BridgeError(text, FailureReason.REFUSED)
        self._is_open = True

    def facts(self) -> Mapping[str, object]:
        """Return counters."""
        return {"sent": self._sent, "refused_by_server": self._refused}

    def drain(self, timeout: float) -> bool:
        """Wait until the server has worked through what was sent."""
        try:
            self._connection.settle(timeout)
        except BridgeError:
            return False
        return True

    def look(self) -> None:
        """Look whether a message has passed since the server refused one.

        Of a connection that began since, none was refused.

        Raises:
            BridgeError: the server does not answer.
        """
        refused, refused_at, connection = self._refused, self._refused_at, self._connection
        if refused_at is None:
            return
        sent, breaks = refused_at
        if breaks == connection.breaks:
            if self._sent <= sent:
                return
            connection.settle()
        if self._refused == refused:  # what is refused is said before what comes after it
            self._refused_at = None
            self.health.passed()

    def _send(self, message: Message) -> None:
        head = f'{{"id":"{self._identity}",'
        octets = write_publish(self.topic, self._sent, self._write(message))
        self._connection.send_text(head + octets[1:].decode())
        self._sent += 1

    def _status(self, text: str) -> None:
        """Take note of what the server says of it: an operation was refused."""
        self._refused += 1
        # It may be one that is not counted yet.
        self._refused_at, self._why = (self._sent + 1, self._connection.breaks), text
        if self._is_open:
            self.health.refused(f"the server says: {text}")

    def _close(self) -> None:
        self.health.close()
        connection = self._connection
        connection.forget_status(self._identity)
        fields = {"op": "unadvertise", "id": self._identity, "topic": self.topic}
        connection.withdraw(self._identity, fields)


class ParameterSource(Source):
    """The value of a parameter as it is, and each time that it is found to be another.

    rosbridge says nothing of changes: it is looked at now and then.
    """

    latched = True

    def __init__(
        self,
        endpoint: Endpoint,
        connection: ServerConnection,
        name: str,
        deliver: Delivery,
        report: Report,
    ) -> None:
        super().__init__(endpoint)
        self._connection, self._name, self._deliver = connection, name, deliver
        self._report = report
        self._received = 0
        self._is_lost = False
        self._last = parameter(connection, endpoint, name)
        self._deliver(self._last)

    def facts(self) -> Mapping[str, object]:
        """Return counters."""
        return {"received": self._received}

    def look(self) -> None:
        """Look at the value; raises BridgeError where it is gone, or the connection is."""
        try:
            value = parameter(self._connection, self.endpoint, self._name)
        except BridgeError as error:
            if error.reason is FailureReason.NOT_FOUND and not self._is_lost:
                self._is_lost = True
                self._report(self, Health.LOST, str(error))
            raise
        if not is_same(value, self._last) and not self.closed:
            self._last = value
            self._received += 1
            self._deliver(value)

    def _close(self) -> None:
        """Nothing was opened."""


class ParameterSink(Sink):
    """Sets a parameter; waits for the server to have done so."""

    def __init__(self, endpoint: Endpoint, connection: ServerConnection, name: str) -> None:
        super().__init__(endpoint)
        self._connection, self._name = connection, name
        self._sent = 0
        connection.require_up()

    def facts(self) -> Mapping[str, object]:
        """Return counters."""
        return {"sent": self._sent}

    def _send(self, message: Message) -> None:
        try:
            value = foreign(json_text, foreign(plain_copy, message, array_as_lists))
        except Exception as error:  # of a value's own methods, say
            raise MessageError(f"{self._name}: {text_of(error)}") from error
        answer = self._connection.rosapi("set_param", name=self._name, value=value)
        if answer.get("successful") is False:
            text = f"{self.endpoint}: {str(answer.get('reason'))[:300]}"
            raise BridgeError(text, FailureReason.REFUSED)
        self._sent += 1

    def _close(self) -> None:
        """Nothing was opened."""


def parameter(connection: ServerConnection, endpoint: Endpoint, name: str) -> Any:
    """Return the value of a parameter.

    Raises:
        BridgeError: it is not set, or cannot be asked for.
    """
    answer = connection.rosapi("get_param", name=name)
    text = answer.get("value")
    if answer.get("successful") is False or text is None or str(text) in {"", "null"}:
        raise BridgeError(f"{endpoint}: the parameter is not set", FailureReason.NOT_FOUND)
    try:
        return json.loads(str(text))
    except (ValueError, RecursionError) as error:
        raise BridgeError(f"{endpoint}: {error}", FailureReason.BAD_MESSAGE) from error


def raw_reader(made: RosType, budget: Budget) -> Callable[[Any], Message]:
    """Return the function that makes a message of what `cbor-raw` brought; it raises MessageError.

    Raises:
        MessageError: the type has no layout as ROS 1 serialises it.
    """
    encoding = cdr.ROS_1 if made.is_of_ros_1 else cdr.DDS
    codec = cdr.Codec(structure_of(made), encoding, budget)

    def read(came: Any) -> Message:
        octets = came.get("bytes") if isinstance(came, dict) else None
        if not isinstance(octets, bytes | bytearray | memoryview):
            raise MessageError(
                f"{made.name}: expected the octets of cbor-raw, got {type(came).__name__}"
            )
        return codec.decode(octets, "<")

    return read


def is_same(value: Any, other: Any) -> bool:
    """Return whether two messages are equal as they came; of cbor-raw the octets count."""
    if isinstance(value, dict) and isinstance(other, dict):
        if "bytes" in value and value.keys() == other.keys() == {"secs", "nsecs", "bytes"}:
            return bool(value["bytes"] == other["bytes"])
        same_names = value.keys() == other.keys()
        return same_names and all(is_same(item, other[name]) for name, item in value.items())
    if isinstance(value, list) and isinstance(other, list):
        return len(value) == len(other) and all(map(is_same, value, other))
    if isinstance(value, np.ndarray) and isinstance(other, np.ndarray):
        return value.dtype == other.dtype and value.tobytes() == other.tobytes()
    is_none = value != value and other != other  # noqa: PLR0124 - two NaN
    return type(value) is type(other) and bool(is_none or value == other)
