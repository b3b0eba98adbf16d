"""A vehicle that is an RT-Component without a way of its own: commands become velocities."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Annotated, Final

from typing_extensions import TypedDict
from warehouse_floor.navigator import STAND, Driver, Point

from uoarm.local import Emit, Range
from warehouse_parts.messages import NOTHING, Command, Metres

__all__ = ["Cart", "Pose", "Status"]

_SECONDS: Final = 0.1


class Pose(TypedDict):
    """What a map takes from RTC::TimedPose2D."""

    x: Metres
    y: Metres
    heading: float


class Status(TypedDict):
    """Warehouse::Status without its time: the battery in per cent."""

    battery: float
    load: str
    localised: bool
    blocked: bool
    leg: Annotated[int, Range(-(2**31), 2**31 - 1)]


class Cart:
    """The component; velocities and a state go out with every pose.

    Args:
        payload: kg that the vehicle carries.
    """

    def __init__(self, payload: float) -> None:
        self._driver = Driver(sideways=True)
        self._command = NOTHING
        self._payload = payload
        self._status: Status | None = None
        self._where: Point | None = None

    def command(self, command: Command) -> None:
        """Take a command; it is carried out as poses come."""
        self._command = command
        points = [(point["x"], point["y"]) for point in command["points"]]
        self._driver.go(command["leg"], points)

    def status(self, message: Status) -> None:
        """Take what the cart says beside its pose."""
        self._status = message

    def pose(self, message: Pose) -> Iterator[Emit]:
        """Take where it is; steer it, and say how it is."""
        status = self._status
        if status is None:
            return
        where = (message["x"], message["y"])
        speed = math.dist(where, self._where or where) / _SECONDS
        self._where = where
        pose = (*where, message["heading"])
        step = self._driver.step(pose, status["load"], self._command["carry"])
        velocity = step.velocity if status["localised"] else STAND
        leg, points = self._command["leg"], self._command["points"]
        has_taken = status["leg"] == leg and not points
        if not has_taken:  # until then one that came before may be under way still
            vx, vy, va = velocity
            yield Emit("velocity", {"leg": leg, "vx": vx, "vy": vy, "va": va})
        yield Emit("carry", {"box": self._driver.carry})
        state = {
            **message,
            "speed": speed,
            "battery": status["battery"],
            "payload": self._payload,
            "load": status["load"],
            "leg": self._driver.done,
            "stopped": leg if has_taken else 0,
            "is_localised": status["localised"],
            "is_blocked": status["blocked"],
            "drives_on": False,
        }
        yield Emit("state", state)
