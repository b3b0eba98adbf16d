"""Channels: an output, an input, and a function that is served."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from typing import Any

from uoarm.bridge import (
    Channel,
    Delivery,
    Handler,
    NativeLink,
    ReceiveQueue,
    Sink,
    Source,
    foreign,
    text_of,
)
from uoarm.errors import BridgeError, ControlMessageError, FailureReason, MessageError
from uoarm.model import Budget, BudgetUse, Endpoint, Health, Message, scan_json
from uoarm_example._connection import ExampleConnection
from uoarm_example._health import Report, monitored
from uoarm_example._options import ExampleOptions

_BUDGET = Budget()


def encode(message: Message) -> str:
    """Write a message as the framework carries it.

    Raises:
        MessageError: it has no form there.
    """
    try:
        return json.dumps(message, allow_nan=False)
    except (TypeError, ValueError, RecursionError) as error:
        raise MessageError(f"the message has no form in JSON: {error}") from error


def decode(payload: str) -> Message:
    """Read a message, within a budget: it comes from others.

    Raises:
        ValueError: it cannot be read.
    """
    spending = BudgetUse(_BUDGET)
    try:
        spending.octets(len(payload))
        scan_json(payload, spending)
        message: Message = json.loads(payload)
    except ControlMessageError as error:
        raise ValueError(str(error)) from error
    return message


class _MemberChannel:
    """What the channels have in common: they are members of the connection, and have a health."""

    def __init__(
        self,
        channel: Channel,
        options: ExampleOptions,
        connection: ExampleConnection,
        report: Report,
        request: dict[str, Any] | None = None,
    ) -> None:
        self.request = request or {}
        self.lost = 0
        self.health = monitored(channel, options, report)
        self._connection = connection
        self._queue: ReceiveQueue[dict[str, Any]] | None = None
        self._number = 0

    def open(self, take: Callable[[dict[str, Any]], None] | None, name: str, most: int) -> None:
        """Join the connection; where something comes, `take` gets it in a thread of its own."""
        self._queue = None if take is None else ReceiveQueue(f"example {name}", take, most)
        try:
            self._number = self._connection.join(self)
        except BaseException:
            if self._queue is not None:
                self._queue.close()
            raise

    def close(self) -> None:
        """Leave the connection."""
        self.health.close()
        if self._queue is not None:
            self._queue.close()
        self._connection.leave(self._number)

    def facts(self) -> dict[str, object]:
        """Return what the status shows."""
        dropped = 0 if self._queue is None else self._queue.dropped
        return {**self.health.facts(), "lost_on_link": self.lost + dropped}

    def take(self, event: dict[str, Any]) -> None:
        if event["event"] == "gone":
            self.health.peer_reported(Health.LOST, event["cause"])
        elif self._queue is not None:
            self._queue.put(event)

    def connected(self) -> None:
        self.health.connected()

    def disconnected(self, cause: str) -> None:
        self.health.connected(0, cause)

    def refused(self, cause: str) -> None:
        self.health.refused(cause, final=True)

    def tick(self) -> None:
        self.health.tick()


class ExampleSource(Source):
    """What is published on a topic."""

    def __init__(
        self,
        endpoint: Endpoint,
        options: ExampleOptions,
        connection: ExampleConnection,
        deliver: Delivery,
        report: Report,
        *,
        latched: bool,
    ) -> None:
        super().__init__(endpoint, latched=latched)
        self._deliver = deliver
        topic = endpoint.address[0]
        request = {"do": "subscribe", "topic": topic}
        self._joined = _MemberChannel(self, options, connection, report, request)
        self._joined.open(self._take, topic, options.backlog)

    def facts(self) -> Mapping[str, object]:
        """Return what the status shows."""
        return self._joined.facts()

    def _take(self, event: dict[str, Any]) -> None:
        try:
            message = decode(event["payload"])
        except ValueError as error:
            self._deliver.unreadable(str(error))
            return
        self._joined.health.passed()
        self._deliver(message)

    def _close(self) -> None:
        self._joined.close()


class ExampleSink(Sink):
    """Publishes on a topic: the thread of the connection sends it, so nothing blocks."""

    blocking = False

    def __init__(
        self,
        endpoint: Endpoint,
        options: ExampleOptions,
        connection: ExampleConnection,
        report: Report,
    ) -> None:
        super().__init__(endpoint)
        self._connection = connection
        self._joined = _MemberChannel(self, options, connection, report)
        self._joined.open(None, endpoint.address[0], 1)

    def facts(self) -> Mapping[str, object]:
        """Return what the status shows."""
        return self._joined.facts()

    def drain(self, timeout: float) -> bool:
        """Wait until the bus has handed on all that was sent before."""
        try:
            self._connection.ask("ping", timeout)
        except BridgeError:
            return False
        return True

    def _send(self, message: Message) -> None:
        topic, payload = self.endpoint.address[0], encode(message)
        self._connection.post("publish", self._joined, topic=topic, payload=payload)
        self._joined.health.passed()

    def _close(self) -> None:
        self._joined.close()


class ExampleService(Channel):
    """A function of the robot that answers requests to a service, one after the other."""

    def __init__(
        self,
        endpoint: Endpoint,
        options: ExampleOptions,
        connection: ExampleConnection,
        handler: Handler,
        report: Report,
        schemas: Mapping[str, Any],
    ) -> None:
        super().__init__(endpoint)
        self._connection, self._handler = connection, handler
        name = endpoint.address[0]
        request = {"do": "serve", "service": name, **schemas}
        self._joined = _MemberChannel(self, options, connection, report, request)
        self._joined.open(self._take, name, options.backlog)

    def facts(self) -> Mapping[str, object]:
        """Return what the status shows."""
        return self._joined.facts()

    def _take(self, event: dict[str, Any]) -> None:
        reply: dict[str, Any]
        try:
            reply = {"payload": encode(foreign(self._handler, decode(event["payload"])))}
            self._joined.health.passed()
        except Exception as error:  # noqa: BLE001 - of the handler: its caller gets the text
            reply = {"error": text_of(error)}
        try:
            self._connection.post("reply", call=event["call"], **reply)
        except BridgeError:
            self._joined.lost += 1  # its caller has been refused by the break, too

    def _close(self) -> None:
        self._joined.close()


class ExampleLink(NativeLink):
    """Two topics that the bus connects without this process; it says when the first one ends."""

    def __init__(
        self,
        source: Endpoint,
        sink: Endpoint,
        options: ExampleOptions,
        connection: ExampleConnection,
        report: Report,
    ) -> None:
        super().__init__(source, sink)
        if source.address == sink.address:
            text = f"{source} and {sink} are one topic: it would go round without end"
            raise BridgeError(text, FailureReason.REFUSED)
        request = {"do": "link", "topic": source.address[0], "to": sink.address[0]}
        self._joined = _MemberChannel(self, options, connection, report, request)
        self._joined.open(None, source.address[0], 1)

    def _close(self) -> None:
        self._joined.close()
