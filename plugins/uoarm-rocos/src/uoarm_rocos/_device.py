"""What the bridge asks of a device, whatever it speaks: the profile, its own frames, a voice."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from typing import Any, Protocol

from uoarm.bridge import Delivery
from uoarm.errors import BridgeError, FailureReason
from uoarm.model import Health
from uoarm_rocos._catalogue import Api, Catalogue, Kind
from uoarm_rocos._messages import Direction

__all__ = ["Device", "Feed", "Flow", "Told", "find"]

Told = Callable[[Health, str], None]


class Flow(Protocol):
    """An open flow from a device."""

    def facts(self) -> Mapping[str, object]:
        """Return counters for the status; quick."""

    def close(self) -> None:
        """End the flow; does not wait for a delivery under way, begins no other."""


class Feed(Flow, Protocol):
    """An open flow into a device."""

    def send(self, message: object) -> None:
        """Hand over one message; blocks as long as the line does, which is bounded.

        Raises:
            BridgeError: it does not fit, or the line is gone.
        """


class Device(ABC):
    """One device that a bridge instance uses.

    Must implement: `catalogue`, `stop`, `close`. May implement what its catalogue offers.

    Attributes:
        is_prompt: whether `call` ends in its time whatever the device does.
    """

    is_prompt = False

    @abstractmethod
    def catalogue(self, timeout: float) -> Catalogue:
        """Return what the device offers now, waiting so many seconds for it to be there.

        Raises:
            BridgeError: UNAVAILABLE with the cause.
        """

    def open_output(self, api: Api, deliver: Delivery, told: Told, timeout: float) -> Flow:
        """Open a flow from the device; it is open when this returns.

        Raises:
            BridgeError: the device refused or is gone.
        """
        raise NotImplementedError

    def open_input(self, api: Api, told: Told, timeout: float) -> Feed:
        """Open a flow into the device; it is open when this returns.

        Raises:
            BridgeError: the device refused or is gone.
        """
        raise NotImplementedError

    def call(self, api: Api, message: object, timeout: float) -> dict[str, Any]:
        """Ask a service and wait for its answer at most `timeout` seconds.

        Raises:
            BridgeTimeoutError: no answer; the call was given up.
            BridgeError: the device refused, failed, or is gone.
        """
        raise NotImplementedError

    @abstractmethod
    def stop(self) -> None:
        """Begin to let go; returns at once, and `close` comes next."""

    @abstractmethod
    def close(self) -> None:
        """Let go of the device; bounded, once."""


def find(catalogue: Catalogue, name: str, direction: Direction | None) -> Api:
    """Return an API that is a service (None), or a flow of this direction.

    Raises:
        BridgeError: NOT_FOUND, or BAD_ENDPOINT when it is used in the wrong way.
    """
    api = catalogue.apis.get(name)
    if api is None:
        known = ", ".join(catalogue.apis) or "none"
        text = f"device {catalogue.device!r} has no API {name!r}; it has {known}"
        raise BridgeError(text, FailureReason.NOT_FOUND)
    if direction is None:
        if api.kind is Kind.FLOW:
            text = f"API {name!r} is a flow: use it as an output or input, not as a service"
            raise BridgeError(text, FailureReason.BAD_ENDPOINT)
        return api
    if api.kind is Kind.SERVICE:
        text = f"API {name!r} is a service: it has no {direction.value}"
        raise BridgeError(text, FailureReason.BAD_ENDPOINT)
    if not (api.output if direction is Direction.OUTPUT else api.input):
        text = f"the flow {name!r} has no {direction.value}"
        raise BridgeError(text, FailureReason.BAD_ENDPOINT)
    return api
