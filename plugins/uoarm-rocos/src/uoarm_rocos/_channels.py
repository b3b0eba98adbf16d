"""Channels of the bridge over open flows of its devices."""

from __future__ import annotations

import threading
from collections import deque
from collections.abc import Callable, Mapping
from typing import Any

from uoarm.bridge import Channel, ChannelMonitor, Delivery, Sink, Source
from uoarm.model import Endpoint, Health, Message
from uoarm_rocos._catalogue import Api, Direction
from uoarm_rocos._device import DeviceFlow, InputFlow
from uoarm_rocos._framing import WireError
from uoarm_rocos._structure import fit

__all__ = [
    "DeliveryThread",
    "ProfileFlow",
    "ProfileInput",
    "ProfileOutput",
    "SinkChannel",
    "SourceChannel",
]

Report = Callable[[Channel, Health, str], None]


class SourceChannel(Source):
    """A flow from a device. Made before the flow, so that the flow can report its health."""

    def __init__(self, endpoint: Endpoint, report: Report) -> None:
        super().__init__(endpoint)
        self._report = report
        self._flow: DeviceFlow | None = None

    def report_health(self, health: Health, cause: str) -> None:
        """Pass a change on to the manager."""
        self._report(self, health, cause)

    def attach(self, flow: DeviceFlow) -> None:
        """Take the open flow."""
        self._flow = flow

    def facts(self) -> Mapping[str, object]:
        """Return the flow's counters."""
        return {} if self._flow is None else self._flow.facts()

    def _close(self) -> None:
        if self._flow is not None:
            self._flow.close()


class SinkChannel(Sink):
    """A flow into a device; `send` blocks as long as the line does."""

    def __init__(self, endpoint: Endpoint, report: Report) -> None:
        super().__init__(endpoint)
        self._report = report
        self._feed: InputFlow | None = None

    def report_health(self, health: Health, cause: str) -> None:
        """Pass a change on to the manager."""
        self._report(self, health, cause)

    def attach(self, feed: InputFlow) -> None:
        """Take the open flow."""
        self._feed = feed

    def _send(self, message: Message) -> None:
        """Send one message to the device.

        Raises:
            BridgeError: it does not fit, or the line is gone.
        """
        assert self._feed is not None, "attached before the channel was returned"
        self._feed.send(message)

    def facts(self) -> Mapping[str, object]:
        """Return the flow's counters."""
        return {} if self._feed is None else self._feed.facts()

    def _close(self) -> None:
        if self._feed is not None:
            self._feed.close()


_MOST = 1024


class DeliveryThread:
    """A bounded queue and one thread; where it is full the oldest message is dropped.

    Args:
        name: for the thread's name.
        most: length of the queue.
    """

    def __init__(self, name: str, most: int = _MOST) -> None:
        self._waiting: deque[tuple[QueuedReceiver, Any]] = deque()
        self._most = most
        # Guards the queue and `_closed` between the line's thread, this one and `close`.
        self._awake = threading.Condition()
        self._closed = False
        self._thread = threading.Thread(target=self._run, name=f"uoarm-{name}", daemon=True)
        self._thread.start()

    def put(self, receiver: QueuedReceiver, message: Any) -> None:
        """Take a message for a receiver; never blocks, any thread."""
        with self._awake:
            if len(self._waiting) >= self._most:
                self._waiting.popleft()[0].dropped += 1
            self._waiting.append((receiver, message))
            self._awake.notify()

    def close(self) -> None:
        """End; a delivery under way ends alone, no other begins."""
        with self._awake:
            self._closed = True
            self._waiting.clear()
            self._awake.notify()

    def _run(self) -> None:
        while True:
            with self._awake:
                while not self._waiting and not self._closed:
                    self._awake.wait()
                if self._closed:
                    return
                receiver, message = self._waiting.popleft()
            receiver.hand_over(message)


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

    def take(self, message: Mapping[str, Any]) -> None:
        """Take a message from the line, in its thread; a flow into a device has none to take."""

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
        delivery_thread: DeliveryThread,
    ) -> None:
        super().__init__(api, monitor, end)
        self._receiver = QueuedReceiver(deliver)
        self._unreadable = QueuedReceiver(deliver.unreadable)
        self._delivery_thread = delivery_thread
        self._received = 0

    def take(self, message: Mapping[str, Any]) -> None:
        """Check a message and hand it on; of a wrong one, what is wrong with it."""
        try:
            values = fit(self.api.output, message, f"data of {self.api.name}")
        except WireError as error:
            why = f"the device breaks its catalogue: {error}"
            self._delivery_thread.put(self._unreadable, why)
            return
        self._received += 1
        self._delivery_thread.put(self._receiver, values)
        self.monitor.passed()

    def facts(self) -> Mapping[str, object]:
        """Return how many messages came, or found the receiver too slow, and when the last did."""
        counts = {"received": self._received, "dropped": self._receiver.dropped}
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
        self._send(self, fit(self.api.input, message, f"input of {self.api.name}"))
        self._sent += 1

    def facts(self) -> Mapping[str, object]:
        """Return how many messages were sent."""
        return {"sent": self._sent}
