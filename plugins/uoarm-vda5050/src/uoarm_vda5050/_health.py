"""Which vehicles are there, by their own word on `connection`."""

from __future__ import annotations

import threading
from collections.abc import Callable
from typing import Any

from attrs import define, field
from uoarm_mqtt.connection import BrokerConnection, ReceivedMessage, Receiver

from uoarm.bridge import HealthReason
from uoarm.errors import BridgeError, FailureReason, MessageError
from uoarm.model import Budget, Health
from uoarm_vda5050._messages import VdaCodec, check_of
from uoarm_vda5050._releases import VdaRelease, body_of

_SMALL = Budget(octets=16_384, elements=1000, depth=16)

Vehicle = tuple[str, str]
"""Manufacturer and serial number."""


@define
class _Known:
    """What a vehicle says: its connection state, or why that cannot be used."""

    state: str = ""
    wrong: str = ""
    names: set[str] = field(factory=set)  # of components that it is
    followers: list[Callable[[bool, str], object]] = field(factory=list)

    @property
    def is_online(self) -> bool:
        return self.state == "ONLINE" and not self.wrong

    @property
    def said(self) -> str:
        return self.wrong or f"its connection state is {self.state or 'not known'}"


class Presence:
    """Watches the connection topics of all vehicles, once anything is asked of it.

    Args:
        prefix: first levels of every topic.
        wait: seconds that a retained message may take beyond the broker's own answer.
        most: vehicles that are kept track of.
        on_health: is called with a component's name, health and cause when it comes or goes.
    """

    def __init__(
        self,
        link: BrokerConnection,
        prefix: str,
        release: VdaRelease,
        wait: float,
        most: int,
        on_health: Callable[[str, Health, str], object],
    ) -> None:
        self._link, self._wait, self._most, self._on_health = link, wait, most, on_health
        body = body_of("connection", release.name)
        self._codec = VdaCodec.reading(
            body,
            _SMALL,
            release=release,
            topic="connection",
            check=check_of(body.schema, "connection"),
        )
        topics = f"{prefix}/+/+/connection"
        self._receiver = Receiver(topics, self._take, retained=True, lapses=True)
        # Held while the subscription is made, so that a second caller waits for the first one's.
        self._opening = threading.Lock()
        self._is_open = False
        # Guards what is known, between the thread of the network and those of callers.
        self._lock = threading.Lock()
        self._known: dict[Vehicle, _Known] = {}
        self._came = threading.Event()

    def require(self, vehicle: Vehicle, component: str) -> None:
        """Return when a vehicle says that it is there; from then on its end is reported.

        Raises:
            BridgeError: with UNAVAILABLE: it says something else, or nothing.
        """
        self._open()
        with self._lock:
            known = self._of(vehicle)
            if known is not None:
                known.names.add(component)
                if known.is_online:
                    return
        said = known.said if known is not None else "there are too many (max_vehicles)"
        text = f"vehicle {'/'.join(vehicle)} is not there: {said}"
        raise BridgeError(text, FailureReason.UNAVAILABLE)

    def online(self) -> list[Vehicle]:
        """Return the vehicles that are there, in order."""
        self._open()
        with self._lock:
            return sorted(vehicle for vehicle, known in self._known.items() if known.is_online)

    def follow(self, vehicle: Vehicle, follower: Callable[[bool, str], object]) -> None:
        """Notify it when a vehicle that was required comes or goes; now, where it went since.

        It is called at once, in the thread of the network.
        """
        with self._lock:
            known = self._known[vehicle]
            known.followers.append(follower)
            if not known.is_online:
                follower(False, known.said)

    def _open(self) -> None:
        self._link.require_up()
        with self._opening:
            if self._is_open:
                return
            self._link.subscribe(self._receiver, settled=True)
            self._is_open = True
        # Mosquitto sends what is retained before it answers; others may be later.
        self._came.wait(self._wait)

    def _of(self, vehicle: Vehicle) -> _Known | None:
        if vehicle not in self._known and len(self._known) >= self._most:
            # One that is not there, and was never asked for, makes room.
            known = self._known.items()
            strangers = (name for name, said in known if not (said.is_online or said.names))
            if (stranger := next(strangers, None)) is None:
                return None
            del self._known[stranger]
        return self._known.setdefault(vehicle, _Known())

    def _take(self, incoming: ReceivedMessage) -> None:
        *_, manufacturer, serial_number, _ = incoming.topic.split("/")
        state, wrong = "", ""
        if incoming.payload:
            try:
                said: Any = self._codec.decode(incoming.payload)
                state = said["connectionState"]
            except MessageError as error:
                wrong = str(error)
        self._came.set()
        with self._lock:
            known = self._of((manufacturer, serial_number))
            if known is None:
                return
            before = known.is_online
            known.state, known.wrong = state, wrong
            now, why = known.is_online, known.said
            names = {*known.names, f"{manufacturer}/{serial_number}"}
            followers = list(known.followers)
        # What says again that it is there was away in between, which the broker noticed too late.
        if now or before:
            for follower in followers:
                follower(now, why)
        if now is not before and self._is_open:  # what is there from the beginning is no news
            health, reason = Health.LOST, f"{HealthReason.DISCONNECTED.value}: "
            if now:
                health, reason = Health.OK, ""
            elif state in {"OFFLINE", "HIBERNATING"}:
                health, reason = Health.FINISHED, f"{HealthReason.PEER.value}: "
            cause = f"{reason}vehicle {manufacturer}/{serial_number}: {why}"
            for name in sorted(names):
                self._on_health(name, health, cause)
