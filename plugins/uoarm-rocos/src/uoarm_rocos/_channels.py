"""Channels of the bridge over open flows of its devices."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any, Generic, TypeVar

from uoarm.bridge import Channel, ChannelMonitor, Delivery, ReceiveQueue, Sink, Source
from uoarm.model import Message
from uoarm_rocos._catalogue import Api, Direction
from uoarm_rocos._device import DeviceFlow, InputFlow
from uoarm_rocos._framing import TCP_LIMITS, WireError
from uoarm_rocos._structure import fit, fit_given

F = TypeVar("F", bound=DeviceFlow)


class _FlowChannel(Channel, Generic[F]):
    """A flow of a device. Made before the flow, so that the flow can report its health.

    Attributes:
        flow: set once it is open.
    """

    flow: F | None = None

    def facts(self) -> Mapping[str, object]:
        """Return the flow's counters."""
        return {} if self.flow is None else self.flow.facts()

    def _close(self) -> None:
        if self.flow is not None:
            self.flow.close()


class SourceChannel(_FlowChannel[DeviceFlow], Source):
    """A flow from a device."""


class SinkChannel(_FlowChannel[InputFlow], Sink):
    """A flow into a device; `send` blocks as long as the line does."""

    def _send(self, message: Message) -> None:
        """Send one message to the device.

        Raises:
            BridgeError: it does not fit, or the line is gone.
        """
        assert self.flow is not None, "set before the channel was returned"
        self.flow.send(message)


_MOST = 1024
QueuedDelivery = tuple["QueuedReceiver", Any, int]
"""A receiver, its message, and how many octets that had on the line."""


def delivery_queue(name: str) -> ReceiveQueue[QueuedDelivery]:
    """Return what hands the messages of one device to its receivers, in a thread of its own."""
    return ReceiveQueue(
        f"uoarm-{name}-deliver",
        lambda delivery: delivery[0].hand_over(delivery[1]),
        _MOST,
        most_size=8 * TCP_LIMITS.octets,
        size=lambda delivery: delivery[2],
        dropped=lambda delivery: delivery[0].count_dropped(),
    )


class QueuedReceiver:
    """One receiver; `dropped` counts what it missed because it was slower than its source."""

    def __init__(self, deliver: Callable[[Any], None]) -> None:
        self.dropped = 0
        self._deliver = deliver
        self._closed = False

    def hand_over(self, message: Any) -> None:
        """Deliver a message unless the receiver is closed."""
        if not self._closed:
            self._deliver(message)

    def count_dropped(self) -> None:
        """Count a message that was dropped before its turn."""
        self.dropped += 1

    def close(self) -> None:
        """Begin no other delivery."""
        self._closed = True


class ProfileFlow:
    """A flow from a device.

    Attributes:
        api: as it was when the flow was opened.
        monitor: judges its health.
        id: of the conversation now; 0 while the line is lost.
        refused: messages of the line that could not be read when one of the flow came last.
    """

    direction = Direction.OUTPUT

    def __init__(
        self, api: Api, monitor: ChannelMonitor, end: Callable[[ProfileFlow], None]
    ) -> None:
        self.api = api
        self.monitor = monitor
        self.id = 0
        self.refused = 0
        self._end = end

    def take(self, message: Mapping[str, Any], octets: int) -> None:
        """Take a message from the line, in its thread; a flow into a device has none to take.

        Args:
            message: its values.
            octets: that it had on the line.
        """

    def facts(self) -> Mapping[str, object]:
        """Return counters for the status."""
        return {}

    def close(self) -> None:
        """End the flow."""
        self.monitor.close()
        self._end(self)


class ProfileOutput(ProfileFlow):
    """Messages of a device, checked against its catalogue, to one receiver."""

    def __init__(
        self,
        api: Api,
        monitor: ChannelMonitor,
        end: Callable[[ProfileFlow], None],
        deliver: Delivery,
        queue: ReceiveQueue[QueuedDelivery],
    ) -> None:
        super().__init__(api, monitor, end)
        self._receiver = QueuedReceiver(deliver)
        self._unreadable = QueuedReceiver(deliver.unreadable)
        self._queue = queue
        self._received = 0

    def take(self, message: Mapping[str, Any], octets: int) -> None:
        """Check a message and hand it on; of a wrong one, what is wrong with it."""
        try:
            values = fit(self.api.output, message, f"data of {self.api.name}")
        except WireError as error:
            why = f"the device breaks its catalogue: {error}"
            self._queue.put((self._unreadable, why, octets))
            return
        self._received += 1
        self._queue.put((self._receiver, values, octets))
        self.monitor.passed()

    def facts(self) -> Mapping[str, object]:
        """Return how many messages came, and of how many that came the receiver was too slow."""
        dropped = self._receiver.dropped + self._unreadable.dropped
        counts = {"received": self._received, "lost_on_link": dropped}
        return {**counts, **self.monitor.facts()}

    def close(self) -> None:
        """End the flow; no other delivery begins."""
        self._receiver.close()
        self._unreadable.close()
        super().close()


class ProfileInput(ProfileFlow):
    """Messages to a device, checked against its catalogue."""

    direction = Direction.INPUT

    def __init__(
        self,
        api: Api,
        monitor: ChannelMonitor,
        end: Callable[[ProfileFlow], None],
        send: Callable[[ProfileFlow, dict[str, Any]], None],
    ) -> None:
        super().__init__(api, monitor, end)
        self._send = send
        self._sent = 0

    def send(self, message: object) -> None:
        """Send one message.

        Raises:
            BridgeError: it does not fit, or the line is gone.
        """
        self._send(self, fit_given(self.api.input, message, f"input of {self.api.name}"))
        self._sent += 1

    def facts(self) -> Mapping[str, object]:
        """Return how many messages were sent."""
        return {"sent": self._sent}
