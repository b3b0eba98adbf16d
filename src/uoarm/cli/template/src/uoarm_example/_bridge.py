"""The bridge: raw steps only; the base class keeps time limits, errors and the list of channels."""

from __future__ import annotations

from collections.abc import Callable

from uoarm.bridge import Bridge, Channel, Delivery, Description, Sink
from uoarm.errors import BridgeError, FailureReason
from uoarm.model import Deliver, Endpoint, Message, MessageStructure, Options
from uoarm_example._framework import TOPICS, Bus

__all__ = ["ExampleBridge"]


class ExampleBridge(Bridge):
    """An endpoint's address is one topic. Components publish and subscribe on it."""

    def __init__(self, name: str, options: Options) -> None:
        super().__init__(name, options)
        self._bus = Bus()

    def _describe(self, endpoint: Endpoint) -> Description:
        return Description(MessageStructure(TOPICS[_topic(endpoint)]))

    def _open_source(
        self, endpoint: Endpoint, structure: MessageStructure, deliver: Deliver
    ) -> Channel:
        del structure
        delivery = Delivery(deliver)
        leave = self._bus.subscribe(_topic(endpoint), delivery.give)

        def close() -> None:
            delivery.end()
            leave()

        return _Source(endpoint, close)

    def _open_sink(self, endpoint: Endpoint, structure: MessageStructure) -> Sink:
        del structure
        topic = _topic(endpoint)
        return _Topic(endpoint, lambda message: self._bus.publish(topic, message))

    def _close(self) -> None:
        """Nothing to let go of: every channel is closed before."""


class _Source(Channel):
    def __init__(self, endpoint: Endpoint, close: Callable[[], None]) -> None:
        super().__init__(endpoint)
        self._leave = close

    def _close(self) -> None:
        self._leave()


class _Topic(Sink):
    def __init__(self, endpoint: Endpoint, publish: Callable[[Message], None]) -> None:
        super().__init__(endpoint)
        self._publish = publish

    def send(self, message: Message) -> None:
        """Publish one message.

        Raises:
            BridgeError: the channel is closed.
        """
        if self.closed:
            raise BridgeError(f"{self.endpoint} is closed", FailureReason.CLOSED)
        self._publish(message)

    def _close(self) -> None:
        """Nothing to let go of."""


def _topic(endpoint: Endpoint) -> str:
    if len(endpoint.address) != 1:
        text = f"expected one topic, got {list(endpoint.address)}"
        raise BridgeError(text, FailureReason.BAD_ENDPOINT)
    topic = endpoint.address[0]
    if topic not in TOPICS:
        text = f"there is no topic {topic!r}; there are {', '.join(TOPICS)}"
        raise BridgeError(text, FailureReason.NOT_FOUND)
    return topic
