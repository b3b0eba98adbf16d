"""A device that sends by itself as long as it is switched on: one flow, several receivers."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Mapping
from typing import Any

from uoarm.bridge import Delivery
from uoarm.errors import BridgeError, FailureReason
from uoarm.model import Health
from uoarm_rocos._catalogue import Api, DeviceCatalogue
from uoarm_rocos._channels import DeliveryThread, QueuedReceiver
from uoarm_rocos._device import Device, ReportHealth
from uoarm_rocos._errors import LineError
from uoarm_rocos._line import DeviceLine
from uoarm_rocos._options import Timing
from uoarm_rocos._transport import LineTransport
from uoarm_rocos.devices._oximeters import OximeterDecoder

__all__ = ["StreamDevice"]

_PERIODS = 5
_LEAST_SILENCE = 1.0
_ADVICE = "is the device on, and this its port?"


class StreamDevice(Device):
    """Counts as there once a whole frame has come, and as silent when none comes any more.

    Args:
        name: for threads and errors.
        catalogue: with its one flow.
        decoder: makes a decoder for each new connection.
        transport: makes an unopened transport.
        timing: limits.
    """

    def __init__(
        self,
        name: str,
        catalogue: DeviceCatalogue,
        decoder: Callable[[], OximeterDecoder],
        transport: Callable[[], LineTransport],
        timing: Timing,
    ) -> None:
        self._name = name
        self._catalogue = catalogue
        self._make_decoder = decoder
        self._decoder = decoder()
        self._timing = timing
        (self._api,) = catalogue.apis.values()
        self._patience = max(_PERIODS * (self._api.period or 0.0), _LEAST_SILENCE)
        # Guards `_there`, `_closed` and the tuple of flows between callers and the line's thread.
        self._state = threading.Condition()
        self._there = False
        self._cause = "not connected yet"
        self._last = time.monotonic()
        self._closed = False
        self._flows: tuple[_StreamFlow, ...] = ()
        self._delivery_thread = DeliveryThread(f"{name}-deliver")
        self._line = DeviceLine(name, transport, self, timing.backoff)
        self._line.start()

    def catalogue(self, timeout: float) -> DeviceCatalogue:
        """Return the catalogue once the device sends."""
        with self._state:
            if not self._state.wait_for(lambda: self._there or self._closed, timeout):
                raise LineError(f"{self._name} is not there after {timeout:g} s: {self._cause}")
        if self._closed:
            raise BridgeError(f"{self._name} is closed", FailureReason.CLOSED)
        return self._catalogue

    def open_output(
        self, api: Api, deliver: Delivery, report: ReportHealth, timeout: float
    ) -> _StreamFlow:
        """Give messages to one more receiver."""
        self.catalogue(timeout)
        flow = _StreamFlow(api, deliver, report, self)
        with self._state:
            self._flows = (*self._flows, flow)
        return flow

    def leave(self, flow: _StreamFlow) -> None:
        """Give this receiver nothing more."""
        with self._state:
            self._flows = tuple(
                stream_flow for stream_flow in self._flows if stream_flow is not flow
            )

    def facts(self) -> Mapping[str, object]:
        """Return how many octets belonged to no frame."""
        return {"discarded": self._decoder.discarded}

    def stop(self) -> None:
        """Have the line end."""
        self._line.stop()

    def close(self) -> None:
        """Let go of the line."""
        with self._state:
            self._closed = True
            self._state.notify_all()
        self._line.close()
        self._delivery_thread.close()

    def connected(self) -> None:
        """Begin with a new decoder."""
        self._decoder = self._make_decoder()
        self._cause = f"the line is open, but no frame came: {_ADVICE}"
        self._last = time.monotonic()

    def received(self, data: bytes) -> None:
        """Decode and hand on."""
        messages = self._decoder.feed(data)
        if not messages:
            return
        self._last = time.monotonic()
        if not self._there:
            with self._state:
                self._there = True
                self._state.notify_all()
            self._report_health(Health.OK, "frames arrive")
        for message in messages:
            for flow in self._flows:
                self._delivery_thread.put(flow.receiver, message)

    def tick(self, now: float) -> None:
        """Notice silence."""
        silent = now - self._last
        if silent > self._patience:
            said = f"no frame from {self._name} for {silent:.1f} s: {_ADVICE}"
            self._missing(said, silent)

    def lost(self, cause: str) -> None:
        """Notice that the line is gone; called again at each attempt to open it."""
        self._missing(f"the line to {self._name} is lost: {cause}", time.monotonic() - self._last)

    def _missing(self, cause: str, lasted: float) -> None:
        self._cause = cause
        with self._state:
            self._there = False
        gone = lasted > self._patience + self._timing.grace
        self._report_health(Health.LOST if gone else Health.DEGRADED, cause)

    def _report_health(self, health: Health, cause: str) -> None:
        for flow in self._flows:
            flow.report_health(health, cause)


class _StreamFlow:
    """One receiver of a device's messages."""

    def __init__(
        self, api: Api, deliver: Callable[[Any], None], report: ReportHealth, device: StreamDevice
    ) -> None:
        self.api = api
        self.receiver = QueuedReceiver(deliver)
        self._report = report
        self._device = device
        self._health = Health.OK

    def report_health(self, health: Health, cause: str) -> None:
        """Report a change, once, and nothing after a loss."""
        if health is not self._health and self._health is not Health.LOST:
            self._health = health
            self._report(health, cause)

    def facts(self) -> Mapping[str, object]:
        """Return the device's counters and what this receiver was too slow for."""
        return {**self._device.facts(), "dropped": self.receiver.dropped}

    def close(self) -> None:
        """End; no other delivery begins."""
        self.receiver.close()
        self._device.leave(self)
