"""The bridge: raw steps only; the base class keeps time limits, errors and the list of channels."""

from __future__ import annotations

from uoarm.bridge import Bridge, Description, Sink, Source
from uoarm.errors import BridgeError, FailureReason
from uoarm.model import Deliver, Endpoint, MessageStructure, Options
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
    ) -> Source:
        del structure
        return Source(endpoint, self._bus.subscribe(_topic(endpoint), deliver))

    def _open_sink(self, endpoint: Endpoint, structure: MessageStructure) -> Sink:
        del structure
        topic = _topic(endpoint)
        return Sink(
            endpoint,
            send=lambda message: self._bus.publish(topic, message),
            close=lambda: None,  # there is nothing to let go of
        )

    def _close(self) -> None:
        """Nothing to let go of: every channel is closed before."""


def _topic(endpoint: Endpoint) -> str:
    if len(endpoint.address) != 1:
        text = f"expected one topic, got {list(endpoint.address)}"
        raise BridgeError(text, FailureReason.BAD_ENDPOINT)
    topic = endpoint.address[0]
    if topic not in TOPICS:
        text = f"there is no topic {topic!r}; there are {', '.join(TOPICS)}"
        raise BridgeError(text, FailureReason.NOT_FOUND)
    return topic
