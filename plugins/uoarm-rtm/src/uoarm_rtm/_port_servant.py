# ruff: noqa: SLF001 - CORBA begins the names of its own operations with an underscore
"""A port of our own component: connecting and disconnecting by the RTC specification.

`connect` walks the ports of a profile: each publishes what it offers, hands the profile to the
next, then takes from it what the others published. The port that fails undoes the walk.

The names in a profile and their meaning are those observed at OpenRTM components; answers to what
cannot be had are the return codes that they give.
"""

from __future__ import annotations

import threading
import uuid
from collections.abc import Mapping
from contextlib import suppress
from typing import Any

from _uoarm_rtm_stubs import RTC, RTC__POA
from attrs import frozen
from omniORB import CORBA

from uoarm.bridge import Log, text_of
from uoarm.cdr import ByteOrder
from uoarm_rtm._options import BufferPolicy, PushPolicy, buffer_policy, push_policy
from uoarm_rtm._orb import Orb, calls, limit
from uoarm_rtm._peer import pairs
from uoarm_rtm._shape import BIG, LITTLE

_ORDERS: dict[str, ByteOrder] = {"little": LITTLE, "big": BIG}
_SUBSCRIPTIONS = ("flush", "new", "periodic")
_DEFAULT_HZ = 10.0
_MOST_CONNECTORS = 256  # of a port: each may have a thread, and a buffer


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
    order: ByteOrder
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


def _order(text: str) -> ByteOrder:
    """Return the first byte order of a list that is known."""
    for word in text.lower().split(","):
        order = _ORDERS.get(word.strip())
        if order is not None:
            return order
    raise ConnectorRefusal(f"byte order {text!r} is neither little nor big", RTC.UNSUPPORTED)


_log = Log("uoarm.rtm")


class PortServant(RTC__POA.PortService):  # type: ignore[misc]  # generated, without annotations
    """What all ports have in common.

    Calls come from threads of the ORB. No lock is held while another port is called.

    Must implement: `_publish`, `_subscribe`, `_release`. May implement: `_quiesce`.

    Args:
        name: `COMPONENT.PORT`.
        properties: what the profile says of the port.
        seconds: limit of calls to other ports.
    """

    def __init__(self, orb: Orb, name: str, properties: Mapping[str, str], seconds: float) -> None:
        self.name = name
        self.orb = orb
        self.properties = dict(properties)
        self.interfaces: list[Any] = []
        self.owner: Any = None
        self._seconds = seconds
        # Guards both tables below: two requests for one connector may come at once, in threads of
        # the ORB. Not held while another port is called: that port may call this one back.
        self._lock = threading.Lock()
        self._profiles: dict[str, Any] = {}
        # Not shown before they are made: components of 1.2 take them for a second connection.
        self._making: dict[str, Any] = {}
        self._is_closed = False
        self.reference = orb.serve(self)

    def close(self) -> None:
        """Disconnect everything, then stop serving; what is being made ends as it is made."""
        with self._lock:
            self._is_closed = True
        self.disconnect_all()
        self.orb.withdraw(self.reference)

    def get_port_profile(self) -> Any:
        """Return the port's profile (CORBA operation)."""
        connectors = self.get_connector_profiles()
        properties = pairs(self.properties)
        return RTC.PortProfile(
            self.name, self.interfaces, self.reference, connectors, self.owner, properties
        )

    def get_connector_profiles(self) -> list[Any]:
        """Return the profiles of all connectors (CORBA operation)."""
        with self._lock:
            return list(self._profiles.values())

    def get_connector_profile(self, connector_id: str) -> Any:
        """Return one connector's profile, an empty one when there is none (CORBA operation)."""
        with self._lock:
            empty = RTC.ConnectorProfile("", "", [], [])
            return self._profiles.get(connector_id, empty)

    def connect(self, profile: Any) -> tuple[Any, Any]:
        """Connect the ports of a profile (CORBA operation)."""
        if not profile.ports:
            return RTC.BAD_PARAMETER, profile
        if not profile.connector_id:
            profile.connector_id = str(uuid.uuid4())
        elif profile.connector_id in self._profiles or profile.connector_id in self._making:
            return RTC.PRECONDITION_NOT_MET, profile
        try:
            with calls:
                code, profile = limit(profile.ports[0], self._seconds).notify_connect(profile)
        except CORBA.Exception:
            code = RTC.RTC_ERROR
        if code != RTC.RTC_OK:
            self._undo(profile)
        return code, profile

    def notify_connect(self, profile: Any) -> tuple[Any, Any]:
        """Take part in a connection (CORBA operation)."""
        identifier = profile.connector_id
        with self._lock:
            is_known = identifier in self._profiles or identifier in self._making
            if is_known or self._is_closed:
                return RTC.PRECONDITION_NOT_MET, profile
            if len(self._profiles) + len(self._making) >= _MOST_CONNECTORS:
                _log.warning("port %s has %d connectors: no more", self.name, _MOST_CONNECTORS)
                return RTC.OUT_OF_RESOURCES, profile
            self._making[identifier] = profile
        try:
            self._publish(profile)
            code, profile = self._next_connect(profile)
            if code == RTC.RTC_OK:
                self._subscribe(profile)
        except ConnectorRefusal as refusal:
            _log.warning("port %s refuses connector %s: %s", self.name, profile.name, refusal)
            code = refusal.code
        except Exception as error:  # noqa: BLE001 - nothing is left of what could not be made
            _log.warning("port %s: connector %s: %s", self.name, profile.name, text_of(error))
            code = RTC.RTC_ERROR
        if code != RTC.RTC_OK:
            self.drop(identifier)
            return code, profile
        with self._lock:
            # One that was disconnected meanwhile, or whose port was closed, stays so.
            is_kept = self._making.pop(identifier, None) is not None and not self._is_closed
            if is_kept:
                self._profiles[identifier] = profile
        if not is_kept:
            self._release(identifier)
            code = RTC.RTC_ERROR
        return code, profile

    def disconnect(self, connector_id: str) -> Any:
        """End a connection at all its ports (CORBA operation)."""
        with self._lock:
            profile = self._profiles.get(connector_id)
        if profile is None:
            return RTC.BAD_PARAMETER
        self._quiesce(connector_id)
        for port in profile.ports:
            with suppress(CORBA.Exception), calls:
                return limit(port, self._seconds).notify_disconnect(connector_id)
        return self.notify_disconnect(connector_id)

    def disconnect_all(self) -> Any:
        """End all connections (CORBA operation)."""
        codes = [self.disconnect(profile) for profile in list(self._profiles)]
        return next((code for code in codes if code != RTC.RTC_OK), RTC.RTC_OK)

    def notify_disconnect(self, connector_id: str) -> Any:
        """Take part in the end of a connection (CORBA operation)."""
        self._quiesce(connector_id)
        profile = self.drop(connector_id)
        if profile is None:
            return RTC.BAD_PARAMETER
        following = self._following(profile)
        if following is not None:
            with suppress(CORBA.Exception), calls:  # gone, and its end of the connection with it
                return limit(following, self._seconds).notify_disconnect(connector_id)
        return RTC.RTC_OK

    def drop(self, connector_id: str) -> Any:
        """Forget a connector, notifying no other port; returns its profile, None for none."""
        with self._lock:
            making = self._making.pop(connector_id, None)
            profile = self._profiles.pop(connector_id, making)
        self._release(connector_id)
        return profile

    def _publish(self, profile: Any) -> None:
        """Add what this port offers to the profile, or raise ConnectorRefusal."""
        raise NotImplementedError

    def _subscribe(self, profile: Any) -> None:
        """Take what the others offer and begin, or raise ConnectorRefusal."""
        raise NotImplementedError

    def _quiesce(self, connector_id: str) -> None:
        """Begin no call to the other side any more, and wait for one that is under way.

        Components in C++ abort when a connector ends under such a call (observed).
        """

    def _release(self, connector_id: str) -> None:
        """End what `_publish` and `_subscribe` began; quick, also for an unknown connector."""
        raise NotImplementedError

    def _offer(self, profile: Any, properties: Mapping[str, str]) -> None:
        kept = [pair for pair in profile.properties if pair.name not in properties]
        profile.properties = [*kept, *pairs(properties)]

    def _next_connect(self, profile: Any) -> tuple[Any, Any]:
        following = self._following(profile)
        if following is None:
            return RTC.RTC_OK, profile
        try:
            with calls:
                code, profile = limit(following, self._seconds).notify_connect(profile)
        except CORBA.Exception as error:
            raise ConnectorRefusal(
                f"the next port does not answer ({error})", RTC.RTC_ERROR
            ) from error
        return code, profile

    def _following(self, profile: Any) -> Any:
        """Return the port after this one in a profile, None for the last."""
        mine = [
            index
            for index, port in enumerate(profile.ports)
            if port is not None and self.reference._is_equivalent(port)
        ]
        if not mine or mine[0] + 1 >= len(profile.ports):
            return None
        return profile.ports[mine[0] + 1]

    def _undo(self, profile: Any) -> None:
        for port in profile.ports:
            with suppress(CORBA.Exception), calls:
                limit(port, self._seconds).notify_disconnect(profile.connector_id)
