"""A robot on two wheels: it drives where it is told and counts its way, exactly and repeatably."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

from uoarm_rocos._catalogue import Catalogue
from uoarm_rocos._catalogue_xml import load_catalogue
from uoarm_rocos.simulate._server import Job

__all__ = ["Robot", "robot_catalogue"]

_STOP_SECONDS = 0.5
_USUAL_SPEED = 0.25


def robot_catalogue() -> Catalogue:
    """Return the catalogue that the simulated robot offers."""
    return load_catalogue(Path(__file__).with_name("robot.xml"))


class Robot:
    """Moves by the kinematics of a unicycle, integrated from one look at the clock to the next.

    Args:
        catalogue: replaces the robot's own, to see how a host takes it.
    """

    def __init__(self, catalogue: Catalogue | None = None) -> None:
        self.catalogue = catalogue or robot_catalogue()
        self._x = self._y = self._heading = 0.0
        self._linear = self._angular = 0.0
        self._until = 0.0
        self._at: float | None = None
        self._command = 0

    def call(self, api: str, values: dict[str, Any], now: float) -> dict[str, Any] | Job:
        """Answer `echo` at once, `driveStraight` when it is done."""
        if api == "echo":
            return values
        if api == "driveStraight":
            return self._drive(values["distance"], values.get("speed", _USUAL_SPEED), now)
        raise ValueError(f"the simulated robot does not know how to {api}")

    def sample(self, api: str, now: float) -> dict[str, Any] | None:
        """Return the odometry."""
        del api
        self._move(now)
        return {"x": self._x, "y": self._y, "heading": self._heading}

    def events(self, now: float) -> list[tuple[str, dict[str, Any]]]:
        """Return nothing: every flow from this robot has a period."""
        del now
        return []

    def take(self, api: str, values: dict[str, Any], now: float) -> None:
        """Take a velocity for half a second."""
        del api
        self._move(now)
        self._command += 1
        self._linear, self._angular = values["linear"], values["angular"]
        self._until = now + _STOP_SECONDS

    def _drive(self, distance: float, speed: float, now: float) -> Job:
        self._move(now)
        self._command += 1
        mine, needed = self._command, abs(distance) / speed
        velocity = math.copysign(speed, distance)
        self._linear, self._angular = velocity, 0.0
        self._until = now + needed

        def job(later: float) -> dict[str, Any] | None:
            if self._command != mine:
                return {"outcome": "interrupted", "driven": velocity * min(later - now, needed)}
            self._move(later)
            return {"outcome": "arrived", "driven": distance} if later >= now + needed else None

        return job

    def _move(self, now: float) -> None:
        begin = now if self._at is None else self._at
        lasted = max(0.0, min(now, self._until) - begin)
        turned = self._angular * lasted
        middle = self._heading + turned / 2
        self._x += self._linear * lasted * math.cos(middle)
        self._y += self._linear * lasted * math.sin(middle)
        self._heading = math.remainder(self._heading + turned, 2 * math.pi)
        self._at = now
