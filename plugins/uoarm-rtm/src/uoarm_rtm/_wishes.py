"""What a connector profile asks of a data port, read from its properties and checked.

The names and their meaning are those observed at OpenRTM components; answers to what cannot be
had are the return codes that they give.
"""

from __future__ import annotations

from collections.abc import Mapping

from _uoarm_rtm_stubs import RTC
from attrs import frozen

from uoarm_rtm._buffering import BufferPolicy, PushPolicy, buffer_policy, push_policy
from uoarm_rtm._codec import BIG, LITTLE
from uoarm_rtm._scalars import Order

__all__ = ["ConnectorOptions", "ConnectorRefusal", "read_connector_options", "read_policies"]

_ORDERS: dict[str, Order] = {"little": LITTLE, "big": BIG}
_SUBSCRIPTIONS = ("flush", "new", "periodic")
_DEFAULT_HZ = 10.0


class ConnectorRefusal(Exception):  # noqa: N818 - an answer, not a failure of ours
    """A connector that cannot be had; `code` is the RTC return code to answer with."""

    def __init__(self, text: str, code: object) -> None:
        super().__init__(text)
        self.code = code


@frozen
class ConnectorOptions:
    """How one connector moves data.

    Attributes:
        push: whether the OutPort calls the InPort, rather than being asked.
        subscription: when an OutPort pushes: `flush` at once in the writing thread, `new` from
            a thread of its own, `periodic` at `rate` a second.
        order: byte order of the data.
        data_type: as the profile writes it, empty when it says nothing.
    """

    push: bool
    subscription: str
    rate: float
    order: Order
    data_type: str

    @property
    def period(self) -> float:
        """Seconds from one push to the next; 0 for whenever there is something."""
        return 1.0 / self.rate if self.subscription == "periodic" else 0.0


def read_connector_options(properties: Mapping[str, str]) -> ConnectorOptions:
    """Read the properties of a connector profile.

    Raises:
        ConnectorRefusal: something in them is unknown here.
    """
    interface = properties.get("dataport.interface_type", "").strip().lower()
    if interface != "corba_cdr":
        raise ConnectorRefusal(f"interface type {interface!r} is not corba_cdr", RTC.BAD_PARAMETER)
    flow = properties.get("dataport.dataflow_type", "").strip().lower()
    if flow not in {"push", "pull"}:
        raise ConnectorRefusal(
            f"dataflow type {flow!r} is neither push nor pull", RTC.BAD_PARAMETER
        )
    subscription = properties.get("dataport.subscription_type", "flush").strip().lower()
    if flow == "push" and subscription not in _SUBSCRIPTIONS:
        raise ConnectorRefusal(f"subscription type {subscription!r} is unknown", RTC.RTC_ERROR)
    return ConnectorOptions(
        push=flow == "push",
        subscription=subscription,
        rate=_rate(properties),
        order=_order(properties.get("dataport.serializer.cdr.endian", "little")),
        data_type=properties.get("dataport.data_type", "").strip(),
    )


def read_policies(properties: Mapping[str, str]) -> tuple[BufferPolicy, PushPolicy]:
    """Read how an OutPort is to keep what waits, and which of it to push.

    Raises:
        ConnectorRefusal: a policy is unknown here.
    """
    try:
        return buffer_policy(properties, "outport"), push_policy(properties)
    except ValueError as error:
        raise ConnectorRefusal(str(error), RTC.BAD_PARAMETER) from None


def _rate(properties: Mapping[str, str]) -> float:
    text = properties.get("dataport.publisher.push_rate") or properties.get("dataport.push_rate")
    try:
        rate = float(text) if text else _DEFAULT_HZ
    except ValueError:
        rate = 0.0
    if not 0 < rate <= 1e6:  # noqa: PLR2004 - no port has a period of a microsecond
        raise ConnectorRefusal(
            f"push rate {text!r} is not a number of calls a second", RTC.BAD_PARAMETER
        )
    return rate


def _order(text: str) -> Order:
    """Return the first byte order of a list that is known."""
    for word in text.lower().split(","):
        order = _ORDERS.get(word.strip())
        if order is not None:
            return order
    raise ConnectorRefusal(f"byte order {text!r} is neither little nor big", RTC.UNSUPPORTED)
