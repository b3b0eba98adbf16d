"""Sources and sinks on topics and parameters, and functions that are served as services."""

from __future__ import annotations

import json
import threading
import time
from collections import deque
from collections.abc import Callable, Mapping
from contextlib import suppress
from typing import Any

from uoarm.bridge import Channel, Delivery, Handler, Sink, Source
from uoarm.errors import BridgeError, FailureReason, MessageError
from uoarm.model import Endpoint, Health, Message
from uoarm_rosbridge._wire import write_publish
from uoarm_rosbridge.client._connection import Fields, ServerConnection
from uoarm_rosbridge.client._options import Port
from uoarm_rosbridge.client._types import RosType, reader, writer

__all__ = ["ParameterSink", "ParameterSource", "ServedService", "TopicSink", "TopicSource"]

Report = Callable[[Channel, Health, str], None]
_MOST_REQUESTS = 256


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
        self._connection, self._topic, self._deliver = connection, topic, deliver
        self._read, self._report, self._port = reader(made), report, port
        # Guards what waits, between the connection's thread and that which delivers.
        self._changed = threading.Condition()
        self._waiting: deque[Any] = deque()
        self._received = self._dropped = 0
        self._last = time.monotonic()
        self._is_ended = self._is_lost = False
        self.is_silent = False
        self._identity = connection.new_id("subscribe")
        self._thread = threading.Thread(
            target=self._run, name=f"uoarm-rosbridge-{topic}", daemon=True
        )
        connection.on_status(self._identity, lambda text: self.lose(f"{topic}: {text}"))
        first = _add(connection, topic, self._take)
        self._thread.start()
        try:
            if first:
                connection.send(
                    {
                        "op": "subscribe",
                        "id": self._identity,
                        "topic": topic,
                        "type": made.name,
                        "throttle_rate": port.throttle,
                        "queue_length": 0,
                        "compression": connection.options.compression,
                    }
                )
            connection.rosapi("get_time")  # operations are worked through in order
        except BaseException:
            self._close()
            raise

    @property
    def topic(self) -> str:
        """Its full name."""
        return self._topic

    def facts(self) -> Mapping[str, object]:
        """Return counters."""
        return {
            "received": self._received,
            "under_way": len(self._waiting),
            "lost_on_link": self._dropped,
        }

    def lose(self, cause: str) -> None:
        """Report that it is lost, once."""
        if not self._is_lost and not self._is_ended:
            self._is_lost = True
            self._report(self, Health.LOST, cause)

    def tick(self) -> None:
        """Look whether messages come."""
        limit = self._port.stale_after
        if limit is not None and time.monotonic() - self._last > limit:
            self.is_silent = True
            self.lose(f"{self._topic}: no message for {limit:g} s")

    def _take(self, message: Any) -> None:
        with self._changed:
            if self._is_ended:
                return
            self._last = time.monotonic()
            self._received += 1
            self._waiting.append(message)
            if len(self._waiting) > self._port.queue:
                self._waiting.popleft()
                self._dropped += 1
            self._changed.notify()

    def _run(self) -> None:
        while True:
            with self._changed:
                self._changed.wait_for(lambda: self._waiting or self._is_ended)
                if self._is_ended:
                    return
                came = self._waiting.popleft()
            try:
                message = self._read(came)
            except MessageError as error:
                self._deliver.unreadable(f"{self._topic}: {error}")
            else:
                self._deliver(message)

    def _close(self) -> None:
        with self._changed:
            self._is_ended = True
            self._waiting.clear()
            self._changed.notify_all()
        connection = self._connection
        connection.forget_status(self._identity)
        if _remove(connection, self._topic, self._take) and connection.is_up:
            with suppress(BridgeError):
                connection.send({"op": "unsubscribe", "topic": self._topic})


_LISTENERS = threading.Lock()
"""Guards the tables of who takes what of connections, between steps."""


def _add(connection: ServerConnection, topic: str, take: Callable[[Any], None]) -> bool:
    """Have a topic's messages taken; returns whether it is the first to take them.

    The server sends each message once to a client, however often that has subscribed.
    """
    with _LISTENERS:
        before = connection.topics.get(topic, ())
        connection.topics = {**connection.topics, topic: (*before, take)}
        return not before


def _remove(connection: ServerConnection, topic: str, take: Callable[[Any], None]) -> bool:
    """Have them taken no more; returns whether it was the last."""
    with _LISTENERS:
        left = tuple(other for other in connection.topics.get(topic, ()) if other != take)
        topics = {name: takes for name, takes in connection.topics.items() if name != topic}
        was_there = topic in connection.topics
        connection.topics = {**topics, topic: left} if left else topics
        return was_there and not left


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
        self._connection, self._topic = connection, topic
        self._write, self._report = writer(made), report
        self._sent = self._refused = 0
        self._why = ""
        self._is_lost = self._is_ended = False
        self._identity = connection.new_id("advertise")
        connection.on_status(self._identity, self._status)
        try:
            connection.send(
                {
                    "op": "advertise",
                    "id": self._identity,
                    "topic": topic,
                    "type": made.name,
                    "latch": port.latch,
                    "queue_size": port.queue,
                }
            )
            connection.rosapi("get_time")  # operations are worked through in order
        except BaseException:
            self._close()
            raise
        if self._refused:
            text = f"{endpoint}: the server refuses to have {topic} advertised: {self._why}"
            self._close()
            raise BridgeError(text, FailureReason.REFUSED)

    @property
    def topic(self) -> str:
        """Its full name."""
        return self._topic

    def facts(self) -> Mapping[str, object]:
        """Return counters."""
        return {"sent": self._sent, "refused_by_server": self._refused}

    def lose(self, cause: str) -> None:
        """Report that it is lost, once."""
        if not self._is_lost and not self._is_ended:
            self._is_lost = True
            self._report(self, Health.LOST, cause)

    def drain(self, timeout: float) -> bool:
        """Wait until the server has worked through what was sent."""
        del timeout  # of rosapi's own, which is shorter than a step
        try:
            self._connection.rosapi("get_time")
        except BridgeError:
            return False
        return True

    def _send(self, message: Message) -> None:
        head = f'{{"id":"{self._identity}",'
        octets = write_publish(self._topic, self._write(message))
        self._connection.send_text(head + octets[1:].decode())
        self._sent += 1

    def _status(self, text: str) -> None:
        """Take note of what the server says of it: an operation was refused."""
        self._refused += 1
        self._why = text
        if self._sent and not self._is_ended:
            self._report(self, Health.DEGRADED, f"{self._topic}: the server says: {text}")

    def _close(self) -> None:
        self._is_ended = True
        connection = self._connection
        connection.forget_status(self._identity)
        if connection.is_up:
            with suppress(BridgeError):
                connection.send({"op": "unadvertise", "id": self._identity, "topic": self._topic})


class ServedService(Channel):
    """A function that clients of the server call; a few requests at a time, the others wait."""

    def __init__(
        self,
        endpoint: Endpoint,
        connection: ServerConnection,
        service: str,
        kind: str,
        types: tuple[RosType, RosType],
        handler: Handler,
        at_once: int,
    ) -> None:
        super().__init__(endpoint)
        self._connection, self._service, self._kind = connection, service, kind
        self._read, self._write = reader(types[0]), writer(types[1])
        self._handler = handler
        # Guards the requests that wait, between the connection's thread and those that answer.
        self._changed = threading.Condition()
        self._waiting: deque[Fields] = deque()
        self._is_ended = False
        self._answered = self._failed = self._refused = 0
        if service in connection.services:
            raise BridgeError(f"{endpoint}: it is served here already", FailureReason.REFUSED)
        connection.services[service] = self._take
        self._why = ""
        self._identity = connection.new_id("serve")
        connection.on_status(self._identity, self._status)
        self._threads = [
            threading.Thread(target=self._run, name=f"uoarm-rosbridge-{service}", daemon=True)
            for _ in range(at_once)
        ]
        for thread in self._threads:
            thread.start()
        try:
            self.advertise()
        except BaseException:
            self._close()
            raise

    def advertise(self) -> None:
        """Tell the server of it, for the first time or after a break.

        Raises:
            BridgeError: the connection is down, or the server refuses.
        """
        fields = {
            "op": "advertise_service", "id": self._identity, "service": self._service,
            "type": self._kind,
        }  # fmt: skip
        self._why = ""
        self._connection.send(fields)
        self._connection.rosapi("get_time")
        if self._why:
            text = f"{self.endpoint}: the server refuses to have it served: {self._why}"
            raise BridgeError(text, FailureReason.REFUSED)

    def facts(self) -> Mapping[str, object]:
        """Return counters of requests."""
        return {
            "answered": self._answered,
            "failed": self._failed,
            "refused": self._refused,
            "waiting": len(self._waiting),
        }

    def _status(self, text: str) -> None:
        self._why = text

    def _take(self, fields: Fields) -> None:
        with self._changed:
            if not self._is_ended and len(self._waiting) < _MOST_REQUESTS:
                self._waiting.append(fields)
                self._changed.notify()
                return
            self._refused += 1
        self._respond(fields, f"{_MOST_REQUESTS} requests wait already", succeeded=False)

    def _run(self) -> None:
        while True:
            with self._changed:
                self._changed.wait_for(lambda: self._waiting or self._is_ended)
                if self._is_ended:
                    return
                fields = self._waiting.popleft()
            try:
                values = self._write(self._handler(self._read(fields.get("args") or {})))
            except Exception as error:  # noqa: BLE001 - of the handler: the caller gets it
                self._failed += 1
                self._respond(fields, f"{type(error).__name__}: {error}"[:1000], succeeded=False)
            else:
                self._answered += 1
                self._respond(fields, values, succeeded=True)

    def _respond(self, fields: Fields, values: object, *, succeeded: bool) -> None:
        answer = {
            "op": "service_response", "id": fields.get("id"), "service": self._service,
            "values": values, "result": succeeded,
        }  # fmt: skip
        with suppress(BridgeError):  # who asked is gone with the connection
            self._connection.send(answer)

    def _close(self) -> None:
        connection = self._connection
        with self._changed:
            self._is_ended = True
            self._changed.notify_all()
        connection.forget_status(self._identity)
        if connection.services.get(self._service) == self._take:
            del connection.services[self._service]
        if connection.is_up:
            with suppress(BridgeError):
                connection.send({"op": "unadvertise_service", "service": self._service})


class ParameterSource(Source):
    """The value of a parameter as it is, and each time that it is found to be another.

    rosbridge says nothing of changes: it is looked at now and then.
    """

    latched = True

    def __init__(
        self, endpoint: Endpoint, connection: ServerConnection, name: str, deliver: Delivery
    ) -> None:
        super().__init__(endpoint)
        self._connection, self._name, self._deliver = connection, name, deliver
        self._received = 0
        self._is_lost = False
        self._last = parameter(connection, endpoint, name)
        self._deliver(self._last)

    def facts(self) -> Mapping[str, object]:
        """Return counters."""
        return {"received": self._received}

    def look(self) -> None:
        """Look at the value; raises BridgeError where it is gone, or the connection is."""
        value = parameter(self._connection, self.endpoint, self._name)
        if value != self._last and not self.closed:
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
            value = json.dumps(_plain(message), allow_nan=False)
        except (TypeError, ValueError) as error:
            raise MessageError(f"{self._name}: it has no form as JSON: {error}") from error
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
    if answer.get("successful") is False or text in {None, "", "null"}:
        raise BridgeError(f"{endpoint}: the parameter is not set", FailureReason.NOT_FOUND)
    try:
        return json.loads(str(text))
    except ValueError as error:
        raise BridgeError(f"{endpoint}: {error}", FailureReason.BAD_MESSAGE) from error


def _plain(value: Any) -> Any:
    if isinstance(value, Mapping):
        return {key: _plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(item) for item in value]
    return value.tolist() if hasattr(value, "tolist") else value
