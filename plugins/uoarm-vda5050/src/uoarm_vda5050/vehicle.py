"""The vehicle's side of VDA 5050, for simulators and tests.

A program that drives, or pretends to, asks a `Vehicle` in its own loop for its `task`, says with
`reached` and `finished` what became of it, and with `set` where it is.

No thread of this module publishes states: `set` does, when one is due. So a loop that hangs is
noticed by its silence, as a vehicle that hangs is.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import suppress
from functools import partial
from typing import Any

from attrs import evolve
from typing_extensions import Self
from uoarm_mqtt.connection import (
    BrokerConnection,
    BrokerOptions,
    PresenceAnnouncement,
    ReceivedMessage,
    Receiver,
    connection_options,
)

from uoarm.bridge import on_failure
from uoarm.errors import BridgeError, ConfigurationError, MessageError
from uoarm.model import Health
from uoarm_vda5050._messages import Headers, VdaCodec, check_of
from uoarm_vda5050._releases import RELEASES, TOPICS, body_of
from uoarm_vda5050._vehicle_state import Act, Drive, Task, VehicleState

__all__ = ["Act", "Drive", "Task", "Vehicle"]


class Vehicle:
    """One vehicle on a broker. Every method may be called from any thread and returns at once.

    Only `open` waits for the broker. While the broker is away the vehicle goes on with its order,
    as the standard has it, and announces itself again when it is back.

    Args:
        url: of the broker, `mqtt://host:port` or `mqtts://`.
        manufacturer: a level of its topics.
        serial_number: a level of its topics.
        release: of the standard: 2.0, 2.1 or 3.0.
        actions: types of actions that it performs within orders; others are refused.
        factsheet: what its factsheet says beside, or in place of, what is made up.
        interface: first level of topics; None: as the release suggests.
        state_seconds: between two states, where nothing happens.
        visualization_seconds: between two messages of its position; 0 for none.
        options: further options of the connection, such as user and tls, as of a bridge.
    """

    def __init__(  # noqa: PLR0913 - what a vehicle is made of, once
        self,
        url: str,
        manufacturer: str,
        serial_number: str,
        *,
        release: str = "2.1",
        actions: Iterable[str] = (),
        factsheet: Mapping[str, Any] | None = None,
        interface: str | None = None,
        state_seconds: float = 1.0,
        visualization_seconds: float = 0.2,
        options: Mapping[str, Any] | None = None,
    ) -> None:
        self._release = RELEASES[release]
        self._topic = f"{self._release.prefix(interface or '')}/{manufacturer}/{serial_number}"
        self._name = f"{manufacturer}/{serial_number}"
        self._headers = Headers(self._release, manufacturer, serial_number)
        self._lock = threading.RLock()
        self._state = VehicleState(self._release, frozenset(actions))
        self._factsheet = _factsheet(self._release.major, self._name, actions, factsheet or {})
        self._periods = state_seconds, visualization_seconds
        self._facts: dict[str, Any] = {
            "velocity": {"vx": 0.0, "vy": 0.0, "omega": 0.0},
            "loads": [],
            "safetyState": {self._release.emergency: "NONE", "fieldViolation": False},
        }
        self._battery, self._charging, self._localized = 100.0, False, True
        self._said_at = self._shown_at = float("-inf")
        given = {"url": url, "grace": 86400.0, **(options or {})}
        try:
            broker = BrokerOptions.of(given)
        except ValueError as error:
            raise ConfigurationError(f"vehicle {self._name!r}: {error}") from None
        self._options = connection_options(self._name, broker)
        self._codecs = {topic: self._codec(topic) for topic in TOPICS}
        self._broker = self._connection()

    @property
    def task(self) -> Task | None:
        """What is to be done now; None: stand still."""
        with self._lock:
            return self._state.task

    @property
    def order_id(self) -> str:
        """The order that is under way, or was last; empty before the first."""
        with self._lock:
            return self._state.order_id

    @property
    def is_idle(self) -> bool:
        """Whether no order is under way."""
        with self._lock:
            return self._state.is_idle

    def open(self) -> None:
        """Connect, take orders from now on, and say that the vehicle is there.

        Raises:
            BridgeError: the broker cannot be reached, or refuses.
        """
        for topic, act in (("order", self._state.order), ("instantActions", self._instants)):
            take = partial(self._take, topic, act)
            self._broker.subscribe(Receiver(f"{self._topic}/{topic}", take, qos=0))
        with self._lock:
            self._publish_factsheet()
            self._publish_state()

    def close(self) -> None:
        """Say that it goes offline, and disconnect."""
        self._broker.close()

    def __enter__(self) -> Self:
        with on_failure(self.close):  # or it would go on trying, and come later
            self.open()
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def set(
        self,
        *,
        position: tuple[float, float, float, str] | None = None,
        velocity: tuple[float, float, float] | None = None,
        driving: bool | None = None,
        battery: float | None = None,
        charging: bool | None = None,
        loads: Sequence[Mapping[str, Any]] | None = None,
        localized: bool | None = None,
        mode: str | None = None,
    ) -> None:
        """Say what has changed, and publish what is due.

        Args:
            position: x and y in metres, theta in radians, name of the map.
            velocity: vx and vy in metres a second, omega in radians a second.
            driving: whether it moves; where it stops moving a cancellation is finished.
            battery: charge in percent.
            charging: whether it is being charged.
            loads: objects with `loadId`, `loadType`, `weight` in kg and so on.
            localized: whether it knows where it is.
            mode: operating mode, such as AUTOMATIC or MANUAL.
        """
        with self._lock:
            state = self._state
            if position is not None:
                state.position = position
            if velocity is not None:
                self._facts["velocity"] = dict(zip(("vx", "vy", "omega"), velocity, strict=True))
            changed = self._change(driving, charging, localized, mode)
            if loads is not None and list(loads) != self._facts["loads"]:
                self._facts["loads"], changed = [dict(load) for load in loads], True
            self._battery = self._battery if battery is None else battery
            if not state.driving:
                changed = state.stands() or changed
            now = time.monotonic()
            every, shown = self._periods
            if changed or now - self._said_at >= every:
                self._publish_state()
            if shown and state.position is not None and now - self._shown_at >= shown:
                self._shown_at = now
                self._publish("visualization", self._where())

    def started(self, task: Task) -> bool:
        """Say that an action is being performed; return whether it is still the task."""
        return self._report(lambda: self._state.started(task))

    def reached(self, task: Task) -> bool:
        """Say that a node was reached; return whether it was still the task."""
        return self._report(lambda: self._state.reached(task))

    def finished(self, task: Task, result: str = "") -> bool:
        """Say that an action was performed; return whether it was still the task."""
        return self._report(lambda: self._state.finished(task, result))

    def failed(self, task: Task, why: str) -> bool:
        """Say that a task cannot be done: the order ends; return whether it was still the task."""
        return self._report(lambda: self._state.failed(task, why))

    def raise_error(self, kind: str, text: str, *, fatal: bool = False) -> None:
        """Report an error from now on; again with the same text, nothing happens."""
        level = "FATAL" if fatal else "WARNING"
        error = {"errorType": kind, "errorLevel": level, "errorDescription": text}

        def change() -> bool:
            changed = self._state.errors.get(kind) != error
            self._state.errors[kind] = error
            return changed

        self._report(change)

    def clear_error(self, kind: str) -> None:
        """Report an error no more."""
        self._report(lambda: self._state.errors.pop(kind, None) is not None)

    def _change(
        self,
        driving: bool | None,  # noqa: FBT001
        charging: bool | None,  # noqa: FBT001
        localized: bool | None,  # noqa: FBT001
        mode: str | None,
    ) -> bool:
        state = self._state
        before = (state.driving, self._charging, self._localized, state.mode)
        state.driving = state.driving if driving is None else driving
        self._charging = self._charging if charging is None else charging
        self._localized = self._localized if localized is None else localized
        if mode is not None and mode != state.mode:
            state.set_mode(mode)
        return before != (state.driving, self._charging, self._localized, state.mode)

    def _report(self, change: Callable[[], bool]) -> bool:
        with self._lock:
            changed = change()
            if changed:
                self._publish_state()
            return changed

    def _take(self, topic: str, act: Callable[[Any], object], incoming: ReceivedMessage) -> None:
        with self._lock:
            try:
                body = self._codecs[topic].decode(incoming.payload)
            except MessageError as error:
                self._state.refuse_unreadable(str(error))
            else:
                act(body)
            self._publish_state()

    def _instants(self, body: dict[str, Any]) -> None:
        whole = next(iter(self._release.also_named), "actions")
        actions = body.get("actions") or body.get(whole) or []
        kinds = [self._state.instant(action) for action in actions]
        if "factsheetRequest" in kinds:
            self._publish_factsheet()

    def _publish_state(self) -> None:
        second, charge = self._release.battery
        body = {
            **self._state.body(),
            **self._facts,
            **self._where(),
            second: {charge: self._battery, "charging": self._charging},
        }
        self._said_at = time.monotonic()
        self._publish("state", body)

    def _where(self) -> dict[str, Any]:
        if self._state.position is None:
            return {"velocity": self._facts["velocity"]}
        x, y, theta, map_id = self._state.position
        where = {"x": x, "y": y, "theta": theta, "mapId": map_id}
        where[self._release.localized] = self._localized
        return {self._release.position: where, "velocity": self._facts["velocity"]}

    def _publish_factsheet(self) -> None:
        self._publish("factsheet", self._factsheet, retain=True)

    def _publish(self, topic: str, body: dict[str, Any], *, retain: bool = False) -> None:
        with suppress(BridgeError):  # the broker is away: the next state says it all
            payload = self._codecs[topic].encode(body)
            self._broker.publish(f"{self._topic}/{topic}", payload, qos=0, retain=retain)

    def _codec(self, topic: str) -> VdaCodec:
        body = body_of(topic, self._release.name)
        return VdaCodec.reading(
            body,
            self._options.budget,
            release=self._release,
            topic=topic,
            headers=self._headers,
            check=check_of(body.schema, topic),
        )

    def _connection(self) -> BrokerConnection:
        def say(state: str) -> str:
            return self._codecs["connection"].encode({"connectionState": state}).decode()

        announcement = PresenceAnnouncement(
            f"{self._topic}/connection",
            will=say(self._release.broken),
            online=lambda: say("ONLINE"),
            offline=lambda: say("OFFLINE"),
        )
        options = evolve(self._options, announcement=announcement)
        return BrokerConnection(self._name, options, self._on_health)

    def _on_health(self, health: Health, cause: str) -> None:
        """The broker is back: the next `set` publishes a state."""
        del cause
        if health is Health.OK:
            self._said_at = float("-inf")


# As releases 2 and 3 name them, and what this carrier states.
_LIMITS = (
    ("speedMin", "minimumSpeed", 0.0),
    ("speedMax", "maximumSpeed", 1.0),
    ("accelerationMax", "maximumAcceleration", 1.0),
    ("decelerationMax", "maximumDeceleration", 1.0),
    ("heightMin", "minimumHeight", 0.1),
    ("heightMax", "maximumHeight", 0.5),
)


def _factsheet(
    major: str, name: str, actions: Iterable[str], given: Mapping[str, Any]
) -> dict[str, Any]:
    """Return a factsheet that has what the standard requires, of a small carrier."""
    old = major == "2"
    performed = [
        {"actionType": action, "actionScopes": ["NODE", "EDGE"], "actionParameters": []}
        for action in actions
    ]
    kind = {
        "seriesName": name,
        "agvKinematic" if old else "mobileRobotKinematics": "DIFF" if old else "DIFFERENTIAL",
        "agvClass" if old else "mobileRobotClass": "CARRIER",
        "maxLoadMass" if old else "maximumLoadMass": 0.0,
        "localizationTypes": ["NATURAL"],
        "navigationTypes": ["AUTONOMOUS" if old else "FREELY_NAVIGATING"],
    }
    most, least, lengths = ("max", "min", "Lens") if old else ("maximum", "minimum", "Lengths")
    made: dict[str, Any] = {
        "typeSpecification": kind,
        "physicalParameters": {
            **{two if old else three: value for two, three, value in _LIMITS},
            "width": 0.5,
            "length": 0.5,
        },
        "protocolLimits": {
            f"{most}String{lengths}": {},
            f"{most}Array{lengths}": {},
            "timing": {f"{least}OrderInterval": 0.0, f"{least}StateInterval": 0.0},
        },
        "protocolFeatures": {
            "optionalParameters": [],
            "agvActions" if old else "mobileRobotActions": performed,
        },
        "agvGeometry" if old else "mobileRobotGeometry": {},
        "loadSpecification": {},
    }
    for key, value in given.items():
        made[key] = {**made[key], **value} if isinstance(made.get(key), dict) else value
    return made
