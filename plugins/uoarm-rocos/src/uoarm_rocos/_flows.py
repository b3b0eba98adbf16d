"""Open flows of a device that speaks the profile, across reconnections."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from typing import Any

from uoarm.bridge import Delivery
from uoarm.model import Health
from uoarm_rocos._catalogue import Api
from uoarm_rocos._courier import Courier, Parcel
from uoarm_rocos._device import Told
from uoarm_rocos._errors import WireError
from uoarm_rocos._fit import fit
from uoarm_rocos._messages import Direction

__all__ = ["OutputFlow", "ProfileFeed", "ProfileFlow"]

_PERIODS = 5
_LEAST_SILENCE = 1.0


class ProfileFlow:
    """A flow from a device.

    Attributes:
        api: as it was when the flow was opened.
        id: of the conversation now; 0 while the line is lost.
        refused: messages of the line that could not be read when one of the flow came last.
    """

    direction = Direction.OUTPUT

    def __init__(self, api: Api, told: Told, end: Callable[[ProfileFlow], None]) -> None:
        self.api = api
        self.id = 0
        self.refused = 0
        self._told = told
        self._end = end
        self._health = Health.OK
        self._closed = False

    def tell(self, health: Health, cause: str, *, anew: bool = False) -> None:
        """Tell of a change; the same health is told again if `anew`, nothing after a loss."""
        changed = anew or health is not self._health
        if changed and self._health is not Health.LOST and not self._closed:
            self._health = health
            self._told(health, cause)

    def take(self, message: Mapping[str, Any]) -> None:
        """Take a message from the line, in its thread; a flow into a device has none to take."""

    def tick(self, now: float, came: str = "") -> None:
        """Look at the clock, in the line's thread; `came` says what could not be read."""

    def facts(self) -> Mapping[str, object]:
        """Return counters for the status."""
        return {}

    def close(self) -> None:
        """End the flow."""
        self._closed = True
        self._end(self)


class OutputFlow(ProfileFlow):
    """Messages of a device, checked against its catalogue, to one receiver."""

    def __init__(
        self,
        api: Api,
        told: Told,
        end: Callable[[ProfileFlow], None],
        deliver: Delivery,
        courier: Courier,
        grace: float,
    ) -> None:
        super().__init__(api, told, end)
        self._grace = grace
        self._parcel = Parcel(deliver)
        self._unreadable = Parcel(deliver.unreadable)
        self._courier = courier
        self._received = 0
        self._last = time.monotonic()
        period = api.period
        self._patience = None if period is None else max(_PERIODS * period, _LEAST_SILENCE)

    def take(self, message: Mapping[str, Any]) -> None:
        """Check a message and hand it on; of a wrong one, what is wrong with it."""
        self._last = time.monotonic()
        try:
            values = fit(self.api.output, message, f"data of {self.api.name}")
        except WireError as error:
            why = f"the device breaks its catalogue: {error}"
            self._courier.put(self._unreadable, why)
            return
        self._received += 1
        self._courier.put(self._parcel, values)
        self.tell(Health.OK, "messages arrive")

    def tick(self, now: float, came: str = "") -> None:
        """Tell when a flow with a period falls silent."""
        silent = now - self._last
        if self._patience is not None and self.id and silent > self._patience:
            gone = silent > self._patience + self._grace
            self.tell(
                Health.LOST if gone else Health.DEGRADED,
                f"no message of {self.api.name} for {silent:.1f} s, its period is "
                f"{self.api.period:g} s{came}",
            )

    def facts(self) -> Mapping[str, object]:
        """Return how many messages came, or found the receiver too slow."""
        return {"received": self._received, "dropped": self._parcel.dropped}

    def close(self) -> None:
        """End the flow; no other delivery begins."""
        self._parcel.close()
        self._unreadable.close()
        super().close()


class ProfileFeed(ProfileFlow):
    """Messages to a device, checked against its catalogue."""

    direction = Direction.INPUT

    def __init__(
        self,
        api: Api,
        told: Told,
        end: Callable[[ProfileFlow], None],
        send: Callable[[ProfileFlow, dict[str, Any]], None],
    ) -> None:
        super().__init__(api, told, end)
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
